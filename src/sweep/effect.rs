//! Effect of each value of a setting on an objective, with intervals over seeds.

use std::collections::{BTreeMap, BTreeSet};

use headtail_render::statistics::MeanInterval;
use serde::Serialize;
use toml::Value;

use super::{
    Sweep,
    axis::{Axis, Values},
    collect::{Row, plain},
};
use crate::report::number;

/// Effect of one value, or of a part of a range.
#[derive(Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Value as text.
    pub value: String,
    /// Geometric mean of the objective relative to that of all trials.
    pub ratio: f64,
    /// 95 % interval of `ratio`; absent for a single seed.
    pub ends: Option<(f64, f64)>,
    /// Number of trials.
    pub trials: usize,
}

/// Number of parts of a range.
const PARTS: usize = 5;

/// Returns the effects of an axis on an objective; empty if it has only one value.
///
/// Trials are compared with the geometric mean of those with the same map, so that differences between maps,
/// which are the largest, cancel; if every seed has trials of the same settings, also with those of the same
/// seed. The trials of one seed are one observation; without an axis `seed`, every trial is one.
pub fn effects(sweep: &Sweep, rows: &[Row<'_>], axis: &Axis, objective: &str) -> Vec<Effect> {
    let mut known = relative(sweep, rows, objective);
    if axis.key != "seed" {
        take_off_luck(&mut known);
    }
    let parts =
        parts(axis, &known.iter().filter_map(|(row, _)| row.trial.assignment.get(&axis.key)).collect::<Vec<_>>());
    let mut found = Vec::new();
    for (name, holds) in &parts {
        let mut seeds: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        let mut trials = 0;
        for (index, (row, log)) in known.iter().enumerate() {
            if row.trial.assignment.get(&axis.key).is_none_or(|value| !holds(value)) {
                continue;
            }
            let seed = row.trial.assignment.get("seed").filter(|_| axis.key != "seed");
            let sums = seeds.entry(seed.map_or_else(|| format!("#{index}"), plain)).or_default();
            *sums = (sums.0 + log, sums.1 + 1.0);
            trials += 1;
        }
        let means: Vec<f64> = seeds.values().map(|(sum, count)| sum / count).collect();
        let Some(interval) = MeanInterval::of(&means) else { continue };
        let ends = interval.half_width.is_finite().then(|| (interval.low().exp(), interval.high().exp()));
        found.push(Effect { value: name.clone(), ratio: interval.mean.exp(), ends, trials });
    }
    if found.len() > 1 { found } else { Vec::new() }
}

/// Subtracts from each logarithm the mean of its seed, if every seed has trials of the same settings, which
/// leaves differences of paired trials. With different settings, a seed's mean would depend on them.
fn take_off_luck(known: &mut [(&Row<'_>, f64)]) {
    let seed = |row: &Row<'_>| row.trial.assignment.get("seed").map(plain);
    let mut of_seed: BTreeMap<Option<String>, (BTreeSet<String>, f64)> = BTreeMap::new();
    for (row, log) in known.iter() {
        let others = row.trial.assignment.iter().filter(|(key, _)| *key != "seed");
        let settings = others.map(|(key, value)| format!("{key} = {}\n", plain(value))).collect();
        let (settings_of, sum) = of_seed.entry(seed(row)).or_default();
        settings_of.insert(settings);
        *sum += log;
    }
    let mut all = of_seed.values().map(|(settings, _)| settings);
    let Some(first) = all.next() else { return };
    if all.all(|settings| settings == first) {
        let count = first.len() as f64;
        known.iter_mut().for_each(|(row, log)| *log -= of_seed[&seed(row)].1 / count);
    }
}

/// Returns logarithms of an objective for the trials that have one, minus their mean over the trials of the
/// same map (every aggregated axis except `seed`).
fn relative<'a>(sweep: &Sweep, rows: &'a [Row<'a>], objective: &str) -> Vec<(&'a Row<'a>, f64)> {
    let known: Vec<(&Row<'_>, f64)> = rows
        .iter()
        .filter_map(|row| Some((row, row.measures?.get(objective).copied()?.ln())))
        .filter(|(_, log)| log.is_finite())
        .collect();
    let map = |row: &Row<'_>| {
        let axes = sweep.space.axes.iter().filter(|axis| is_map(sweep, axis));
        axes.map(|axis| row.trial.assignment.get(&axis.key).map_or(String::new(), plain)).collect::<Vec<_>>()
    };
    let mut of_map: BTreeMap<Vec<String>, (f64, f64)> = BTreeMap::new();
    for (row, log) in &known {
        let sum = of_map.entry(map(row)).or_default();
        *sum = (sum.0 + log, sum.1 + 1.0);
    }
    let less = |(row, log): (&'a Row<'a>, f64)| {
        let (sum, count) = of_map[&map(row)];
        (row, log - sum / count)
    };
    known.into_iter().map(less).collect()
}

/// Whether trials with different values of an axis are not comparable: an aggregated axis other than the
/// seed.
pub fn is_map(sweep: &Sweep, axis: &Axis) -> bool {
    axis.key != "seed" && sweep.space.replicated().any(|other| other.key == axis.key)
}

/// Formats a number in few digits.
fn short(value: &Value) -> String {
    value.as_float().map_or_else(|| plain(value), number::text)
}

type Part = (String, Box<dyn Fn(&Value) -> bool>);

/// Returns the values of a list, or parts of a range with equal numbers of trials.
fn parts(axis: &Axis, seen: &[&Value]) -> Vec<Part> {
    if let Values::List(values) = &axis.values {
        let part = |value: &Value| {
            let own = value.clone();
            (plain(value), Box::new(move |other: &Value| *other == own) as _)
        };
        return values.iter().map(part).collect();
    }
    let mut places: Vec<f64> = seen.iter().filter_map(|value| axis.place(value)).collect();
    places.sort_by(f64::total_cmp);
    let mut bounds: Vec<f64> = (1..PARTS).filter_map(|part| places.get(part * places.len() / PARTS).copied()).collect();
    bounds.dedup();
    let ends =
        |index: usize| (if index == 0 { 0.0 } else { bounds[index - 1] }, bounds.get(index).copied().unwrap_or(1.0));
    let part = |index: usize| {
        let (low, high) = ends(index);
        let is_last = index == bounds.len();
        let own = axis.clone();
        let holds =
            move |value: &Value| own.place(value).is_some_and(|place| place >= low && (place < high || is_last));
        (format!("{} to {}", short(&axis.at(low)), short(&axis.at(high))), Box::new(holds) as _)
    };
    (0..=bounds.len()).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::{plan::Trial, status::State};

    fn trial(bins: i64, seed: i64) -> Trial {
        let assignment = [("bins".to_owned(), bins.into()), ("seed".to_owned(), seed.into())].into();
        Trial { id: format!("{bins} {seed}"), assignment, configuration: 0 }
    }

    fn less_luck(trials: &[Trial], logs: &[f64]) -> Vec<f64> {
        let row = |trial| Row { trial, state: State::Done, measures: None, seconds: 0.0, error: String::new() };
        let rows: Vec<Row<'_>> = trials.iter().map(row).collect();
        let mut known: Vec<_> = rows.iter().zip(logs.iter().copied()).collect();
        take_off_luck(&mut known);
        known.into_iter().map(|(_, log)| log).collect()
    }

    #[test]
    fn seed_means_are_subtracted_if_settings_match() {
        let trials = [trial(4, 0), trial(8, 0), trial(4, 1), trial(8, 1)];
        assert_eq!(less_luck(&trials, &[1.0, 2.0, 5.0, 6.0]), [-0.5, 0.5, -0.5, 0.5]);
        // If a seed has other settings than the others, its mean depends on them.
        let trials = [trial(4, 0), trial(8, 0), trial(4, 1)];
        assert_eq!(less_luck(&trials, &[1.0, 2.0, 5.0]), [1.0, 2.0, 5.0]);
    }
}
