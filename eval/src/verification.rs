//! Checks whether the current sources render the pictures that were measured with earlier ones.

use std::{fmt, sync::atomic::AtomicBool};

use headtail_render::integrator::Rendering;

use crate::{
    Budget, Experiment, Record, Result, RunOptions, Store, ViewKey, covered,
    experiment::SamplerEntry,
    measurement::mean_luminance,
    runner::{self, Opened},
    select,
    store::rounded,
};

/// Tolerance of the mean luminance.
const MEAN: f64 = 1e-2;
/// Tolerance of rays per sample: a camera ray in 100,000 may meet another surface, as at the edges of meshes.
pub const RAYS: f64 = 1e-5;

/// Result of a verification.
#[derive(Debug, Default)]
pub struct Verification {
    /// Number of pictures that were rendered again.
    pub pictures: usize,
    /// Pictures that differ.
    pub different: Vec<String>,
}

/// Renders first runs of `views` measured views again, evenly chosen, with the same numbers of samples, and
/// compares rays per sample within [`RAYS`], largest contributions to the digit, and the mean luminance within
/// 1 %. Skips pictures of `auto` at budgets of seconds, whose sampler depends on the clock.
///
/// The mean was taken over the pixels that surfaces cover entirely in the reference. Those of the picture itself differ from them at
/// edges, which usually is less than the tolerance; where it is not, as beside a bright window, the reference is obtained.
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
        let samplers: Vec<&SamplerEntry> = experiment.samplers_for(key).collect();
        pool.install(|| -> Result<()> {
            let Opened { view, entries, .. } = runner::open(experiment, key, &samplers, options, (stop, &()))?;
            let mut reference = None;
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
                    let (taken, points) = (Budget::Samples(own.spp as u32), view.points(own.seed));
                    let again = view.render_by(entry.at(budget).0, taken, points, stop, &|_| {})?;
                    found.pictures += 1;
                    let mut change = Change::between(own, &again, &covered(&again.coverage)?);
                    if change.is_of_mean_alone() {
                        let known = match reference.take() {
                            Some(known) => known,
                            None => runner::reference(experiment, &view, options, stop)?,
                        };
                        change = Change::between(own, &again, &known.covered);
                        reference = Some(known);
                    }
                    if !change.is_none() {
                        let ViewKey { scene, map, material } = key;
                        let view = format!("{scene} under {map}, {material}");
                        found.different.push(format!("{view}: {} at {} ({change})", own.sampler, own.budget));
                    }
                }
            }
            Ok(())
        })?;
    }
    Ok(found)
}

/// What differs between a picture and its record.
struct Change {
    /// Rays per sample.
    rays: f64,
    /// The largest contribution.
    weight: f64,
    /// Relative change of the mean luminance.
    mean: f64,
}

impl Change {
    fn between(own: &Record, again: &Rendering, covered: &[bool]) -> Self {
        Self {
            rays: rounded(again.rays_per_sample) - own.rays_per_sample,
            weight: rounded(f64::from(again.max_weight)) - own.max_weight,
            mean: mean_luminance(&select(&again.surfaces, covered)) / own.mean_luminance - 1.0,
        }
    }

    fn is_of_mean_alone(&self) -> bool {
        self.rays.abs() <= RAYS && self.weight == 0.0 && !self.is_none()
    }

    fn is_none(&self) -> bool {
        self.rays.abs() <= RAYS && self.weight == 0.0 && self.mean.abs() < MEAN
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rays {:+.2e}, weight {:+.2e}, mean {:+.2e}", self.rays, self.weight, self.mean)
    }
}
