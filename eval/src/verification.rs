//! Checks whether the current sources render the pictures that were measured with earlier ones.

use std::sync::atomic::AtomicBool;

use crate::{
    Budget, Experiment, Record, Result, RunOptions, Store, ViewKey, covered, experiment::SamplerEntry,
    measurement::mean_luminance, runner, select, store::rounded,
};

/// Tolerance of the mean luminance: it covers the pixels that surfaces cover entirely, and which those are at
/// edges depends on the samples. Beside a bright window, few pixels are 4 % of the light.
const MEAN: f64 = 5e-2;

/// Result of a verification.
#[derive(Debug, Default)]
pub struct Verification {
    /// Number of pictures that were rendered again.
    pub pictures: usize,
    /// Pictures that differ.
    pub different: Vec<String>,
}

/// Renders first runs of `views` measured views again, evenly chosen, with the same numbers of samples, and
/// compares rays per sample and largest contributions to the digit, and the mean luminance within 5 %. Skips pictures
/// of `auto` at budgets of seconds, whose sampler depends on the clock.
///
/// # Errors
/// If a view or a sampler cannot be opened.
pub fn verify(
    experiment: &Experiment,
    store: &Store,
    options: &RunOptions,
    views: usize,
    stop: &AtomicBool,
) -> Result<Verification> {
    let records = store.records(&experiment.name)?;
    let first: Vec<&Record> = records.iter().filter(|own| own.run == 0).collect();
    let is_measured =
        |key: &ViewKey| first.iter().any(|own| own.view() == *key) && runner::is_there(experiment, key, options);
    let keys: Vec<ViewKey> = experiment.view_keys().into_iter().filter(is_measured).collect();
    let count = views.min(keys.len());
    let pool = runner::pool(experiment)?;
    let mut found = Verification::default();
    for key in (0..count).map(|k| &keys[k * keys.len() / count]) {
        let samplers: Vec<&SamplerEntry> = experiment.samplers_for(&key.material).collect();
        pool.install(|| -> Result<()> {
            let (view, entries) = runner::open(experiment, key, &samplers, options, (stop, &()))?;
            for entry in &entries {
                for own in first.iter().filter(|own| own.view() == *key && own.sampler == entry.name) {
                    let Some(budget) =
                        experiment.budgets.iter().map(|entry| entry.0).find(|budget| budget.to_string() == own.budget)
                    else {
                        continue;
                    };
                    if entry.is_chosen_by_clock(budget) {
                        continue;
                    }
                    let (taken, points) = (Budget::Samples(own.spp as u32), view.points(budget, own.seed));
                    let again = view.render(entry.at(budget).0, taken, points, stop, &|_| {});
                    found.pictures += 1;
                    let mean = mean_luminance(&select(&again.surfaces, &covered(&again.coverage)?));
                    let is_same = rounded(again.rays_per_sample) == own.rays_per_sample
                        && rounded(f64::from(again.max_weight)) == own.max_weight
                        && (mean / own.mean_luminance - 1.0).abs() < MEAN;
                    if !is_same {
                        let ViewKey { scene, map, material } = key;
                        let name = format!("{scene} under {map}, {material}: {} at {}", own.sampler, own.budget);
                        let [rays, weight] =
                            [again.rays_per_sample - own.rays_per_sample, f64::from(again.max_weight) - own.max_weight];
                        found.different.push(format!(
                            "{name} (rays {rays:+.2e}, weight {weight:+.2e}, mean {:+.2e})",
                            mean / own.mean_luminance - 1.0
                        ));
                    }
                }
            }
            Ok(())
        })?;
    }
    Ok(found)
}
