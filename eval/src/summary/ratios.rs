//! Ratios of a baseline's error to a sampler's, over views.

use std::collections::BTreeMap;

use headtail_render::random::Stream;

use super::{
    bootstrap::{Interval, bootstrap, index},
    curve::{Curve, Point},
};
use crate::{ViewKey, store::Record};

/// Runs of all samplers on one view.
#[derive(Clone, Debug)]
pub struct ViewRuns {
    /// The view.
    pub key: ViewKey,
    /// Runs by sampler and budget.
    pub samplers: BTreeMap<String, BTreeMap<String, Vec<Record>>>,
}

/// Groups records by view.
pub fn views_of(records: &[Record]) -> Vec<ViewRuns> {
    let mut views: BTreeMap<ViewKey, ViewRuns> = BTreeMap::new();
    for record in records {
        let key = record.view();
        let view = views.entry(key.clone()).or_insert_with(|| ViewRuns { key, samplers: BTreeMap::new() });
        let budgets = view.samplers.entry(record.sampler.clone()).or_default();
        budgets.entry(record.budget.clone()).or_default().push(record.clone());
    }
    views.into_values().collect()
}

/// Cost at which errors are compared.
#[derive(Clone, Debug)]
pub enum Comparison {
    /// At equal wall-clock time, with or without preparation.
    Time {
        /// Seconds.
        seconds: f64,
        /// Whether preparation counts.
        counts_preparation: bool,
    },
    /// At a budget of samples, by its name.
    Samples(String),
}

impl ViewRuns {
    /// Returns the mean error of a sampler over the runs `picks`, or over all runs if `None`.
    fn error(&self, sampler: &str, at: &Comparison, picks: Option<&[usize]>) -> Option<f64> {
        let budgets = self.samplers.get(sampler)?;
        let mean = |runs: &[Record], value: fn(&Record) -> f64| match picks {
            None => runs.iter().map(value).sum::<f64>() / runs.len() as f64,
            Some(picks) => picks.iter().map(|&k| value(&runs[k % runs.len()])).sum::<f64>() / picks.len() as f64,
        };
        match at {
            Comparison::Samples(budget) => budgets.get(budget).map(|runs| mean(runs, |run| run.mse)),
            Comparison::Time { seconds, counts_preparation } => {
                let timed = budgets.iter().filter(|(name, _)| name.ends_with('s'));
                let points = timed.map(|(_, runs)| Point {
                    seconds: mean(runs, |run| run.seconds),
                    error: mean(runs, |run| run.mse),
                    preparation: runs.iter().map(|run| run.preparation).fold(f64::INFINITY, f64::min),
                });
                Curve::new(points.collect())?.error_at(*seconds, *counts_preparation)
            }
        }
    }

    /// Returns the smallest error of some samplers.
    fn least(&self, samplers: &[String], at: &Comparison, picks: Option<&[usize]>) -> Option<f64> {
        samplers.iter().filter_map(|sampler| self.error(sampler, at, picks)).min_by(f64::total_cmp)
    }

    /// Returns the error of the best baseline over that of the best sampler, both chosen in this view with
    /// hindsight.
    pub fn ratio(
        &self,
        samplers: &[String],
        baselines: &[String],
        at: &Comparison,
        picks: Option<&[usize]>,
    ) -> Option<f64> {
        let ratio = self.least(baselines, at, picks)? / self.least(samplers, at, picks)?;
        (ratio.is_finite() && ratio > 0.0).then_some(ratio)
    }

    /// Returns the number of runs per sampler and budget.
    fn runs(&self) -> usize {
        self.samplers.values().flat_map(BTreeMap::values).map(Vec::len).max().unwrap_or(0)
    }

    /// Returns the ratio with its interval over runs.
    pub fn interval(&self, samplers: &[String], baselines: &[String], at: &Comparison) -> Option<Interval> {
        let count = self.runs();
        bootstrap(|random| match random {
            None => self.ratio(samplers, baselines, at, None),
            Some(random) => self.ratio(samplers, baselines, at, Some(&picks(random, count))),
        })
    }
}

fn picks(random: &mut Stream, count: usize) -> Vec<usize> {
    (0..count).map(|_| index(random, count)).collect()
}

/// Ratios over views.
#[derive(Clone, Debug, PartialEq)]
pub struct Ratios {
    /// Geometric mean, with the interval over views and runs.
    pub mean: Interval,
    /// Smallest ratio.
    pub least: f64,
    /// Largest ratio.
    pub most: f64,
    /// Number of views with a ratio below 1.
    pub below_one: usize,
    /// Number of views with a ratio.
    pub count: usize,
    /// Number of views without one: the sampler was not measured there, or its preparation takes all the
    /// time.
    pub without: usize,
}

impl Ratios {
    /// Returns the ratios of the best of `baselines` to the best of `samplers`; `None` if no view has one.
    pub fn of(views: &[&ViewRuns], samplers: &[String], baselines: &[String], at: &Comparison) -> Option<Self> {
        let ratios: Vec<(&ViewRuns, f64)> =
            views.iter().filter_map(|view| Some((*view, view.ratio(samplers, baselines, at, None)?))).collect();
        let count = ratios.len();
        let mean = bootstrap(|random| match random {
            None => geometric_mean(ratios.iter().map(|(_, ratio)| *ratio)),
            Some(random) => {
                let drawn: Vec<f64> = (0..count)
                    .filter_map(|_| {
                        let (view, _) = ratios[index(random, count)];
                        let runs = picks(random, view.runs());
                        view.ratio(samplers, baselines, at, Some(&runs))
                    })
                    .collect();
                geometric_mean(drawn.into_iter())
            }
        })?;
        let values = || ratios.iter().map(|(_, ratio)| *ratio);
        Some(Self {
            mean,
            least: values().fold(f64::INFINITY, f64::min),
            most: values().fold(0.0, f64::max),
            below_one: values().filter(|ratio| *ratio < 1.0).count(),
            count,
            without: views.len() - count,
        })
    }
}

/// Returns the geometric mean; `None` without values.
pub fn geometric_mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value.ln(), count + 1));
    (count > 0).then(|| (sum / count as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(scene: &str, sampler: &str, budget: &str, run: u32, (seconds, mse): (f64, f64)) -> Record {
        Record {
            scene: scene.into(),
            map: "map".into(),
            material: "diffuse".into(),
            sampler: sampler.into(),
            budget: budget.into(),
            run,
            seed: 1,
            spp: 1.0,
            seconds,
            processor_seconds: seconds,
            preparation: if sampler == "table" { 0.9 } else { 0.0 },
            rays_per_sample: 1.0,
            mse,
            relmse: mse,
            relmse_trimmed: mse,
            mean_luminance: 1.0,
            reference_luminance: 1.0,
            reference_mse: 0.0,
            max_weight: 1.0,
            tile_p: 1.0,
            environment: "e1".into(),
        }
    }

    /// `ours` has half the error of `mis` in one view and the same in the other; `table` has 1/8, after a
    /// long preparation.
    fn records() -> Vec<Record> {
        let mut records = Vec::new();
        for (scene, factor) in [("a", 0.5), ("b", 1.0)] {
            for run in 0..3 {
                for (budget, seconds) in [("0.25s", 0.25), ("1s", 1.0)] {
                    for (sampler, factor) in [("mis", 1.0), ("mis2", 2.0), ("ours", factor), ("table", 0.125)] {
                        let noise = 1.0 + 0.1 * f64::from(run);
                        records.push(record(scene, sampler, budget, run, (seconds, factor * noise / seconds)));
                    }
                }
            }
        }
        records
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn ratios_are_to_the_best_baseline_of_each_view() {
        let views = views_of(&records());
        let views: Vec<&ViewRuns> = views.iter().collect();
        let at = Comparison::Time { seconds: 1.0, counts_preparation: false };
        let ratios = Ratios::of(&views, &names(&["ours"]), &names(&["mis", "mis2"]), &at).unwrap();
        assert!((ratios.mean.value - 2.0_f64.sqrt()).abs() < 1e-9 && (ratios.least - 1.0).abs() < 1e-9);
        assert_eq!((ratios.count, ratios.below_one, ratios.without), (2, 0, 0));
        // Noise common to the runs cancels; the interval is that of drawing the two views.
        assert!((ratios.mean.low - 1.0).abs() < 1e-9 && (ratios.mean.high - 2.0).abs() < 1e-9, "{ratios:?}");
        let at = Comparison::Samples("1s".into());
        assert!(
            (Ratios::of(&views, &names(&["ours", "table"]), &names(&["mis"]), &at).unwrap().mean.value - 8.0).abs()
                < 1e-9
        );
    }

    #[test]
    fn ratio_is_none_if_preparation_takes_all_time() {
        let views = views_of(&records());
        let views: Vec<&ViewRuns> = views.iter().collect();
        let at = |seconds| Comparison::Time { seconds, counts_preparation: true };
        let [table, mis] = [names(&["table"]), names(&["mis"])];
        assert_eq!(Ratios::of(&views, &table, &mis, &at(0.5)), None);
        // Of the two seconds, 1.1 are left after preparation.
        let ratios = Ratios::of(&views, &table, &mis, &at(2.0)).unwrap();
        assert!((ratios.mean.value - 8.0 * 1.1 / 2.0).abs() < 1e-6, "{ratios:?}");
    }
}
