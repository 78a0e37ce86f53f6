//! Measurements of a trained sampler, as named figures.

use std::{collections::BTreeMap, path::Path, sync::atomic::AtomicBool};

use anyhow::Result;
use headtail_eval::{Budget, Entry, Plan, Reference, ReferencePolicy, Run};
use headtail_render::{scene::MaterialSpec, spec::SamplerSpec};

use super::view::MeasuredView;
use crate::arguments::open_view;

/// Figures by name: `kl`, `mse:temple`, ...
pub type Measures = BTreeMap<String, f64>;

/// Measures mean squared errors of a picture over the pixels that surfaces cover entirely: `mse:NAME` at
/// equal samples and `mse_at_time:NAME` at equal time.
///
/// # Errors
/// If the scene or the sampler's file cannot be opened, or the reference cannot be rendered.
pub fn errors_of_view(
    measured: &MeasuredView,
    env: &str,
    material: &MaterialSpec,
    spec: &SamplerSpec,
    cache: &Path,
) -> Result<Measures> {
    let opened = open_view(&measured.view(env, material)?)?;
    let entry = Entry::new(spec.to_string(), opened.estimator(spec)?);
    let never = AtomicBool::new(false);
    let policy = ReferencePolicy::new(measured.reference_spp, 1);
    let mut reference = Reference::obtain(&opened, policy, Some(cache), &never, &|_| {})?;
    let spp = measured.spp.map(|spp| ("mse", Budget::Samples(spp)));
    let seconds = measured.seconds.map(|seconds| ("mse_at_time", Budget::Seconds(seconds)));
    let budgets: Vec<(&str, Budget)> = spp.into_iter().chain(seconds).collect();
    let plan = Plan {
        scene: opened.scene_name(),
        env: opened.light_name(),
        material: String::new(),
        budgets: budgets.iter().map(|(_, budget)| *budget).collect(),
        runs: measured.runs,
        seed: 1,
        // Other processes read the same references: refining one would change their measurements.
        cache: None,
    };
    let mut keep = |_: Run<'_>| anyhow::Ok(());
    let rows = headtail_eval::measure(&opened, &[entry], &mut reference, &plan, (&never, &()), &mut keep)?;
    let mean = |budget: Budget| {
        let own = rows.iter().filter(|row| row.budget == budget.to_string()).map(|row| row.mse);
        own.sum::<f64>() / f64::from(measured.runs)
    };
    Ok(budgets.iter().map(|(kind, budget)| (format!("{kind}:{}", measured.name()), mean(*budget))).collect())
}
