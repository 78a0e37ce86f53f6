//! The next configuration of adaptive search, by tree-structured Parzen estimators (Bergstra et al. 2011),
//! one per axis.

use anyhow::{Result, anyhow};
use tpe::{TpeOptimizer, categorical_range, histogram_estimator, parzen_estimator, range};

use super::{
    axis::{Axis, Values},
    plan::{drawn, stream},
    space::{Assignment, Space},
};

/// Number of configurations that are drawn at random first.
pub const RANDOM_FIRST: u64 = 10;

/// Returns configuration `number`, from the scores of those before it (lower is better). The same history
/// gives the same configuration.
///
/// # Errors
/// If an axis cannot be searched.
pub fn suggest(space: &Space, history: &[(Assignment, f64)], number: u64) -> Result<Assignment> {
    if number < RANDOM_FIRST || history.is_empty() {
        return Ok(space.active(drawn(space, number)));
    }
    let mut random = stream(space.search.seed, number);
    let mut assignment = Assignment::new();
    for axis in space.searched() {
        let wrong = |error: &dyn std::fmt::Display| anyhow!("axes: `{}`: {error}", axis.key);
        let (mut estimator, is_list) = estimator(axis).map_err(|error| wrong(&error))?;
        for (known, score) in history {
            // An axis that a configuration did not set is told as one without a value.
            let place = known.get(&axis.key).and_then(|value| axis.place(value));
            // A finite number represents a failure: estimators only rank scores.
            let score = if score.is_finite() { *score } else { f64::MAX };
            estimator.tell(told(place, is_list), score).map_err(|error| wrong(&error))?;
        }
        let place = estimator.ask(&mut random).map_err(|error| wrong(&error))?;
        let value = match &axis.values {
            Values::List(values) => values[(place as usize).min(values.len() - 1)].clone(),
            Values::Range { .. } => axis.at(place),
        };
        assignment.insert(axis.key.clone(), value);
    }
    Ok(space.active(assignment))
}

/// Returns the value of an axis as its estimator is told it: NaN if there is none, and below 1 for a range, which excludes its end.
fn told(place: Option<f64>, is_list: bool) -> f64 {
    place.map_or(f64::NAN, |place| if is_list { place } else { place.min(1.0 - 1e-9) })
}

fn estimator(axis: &Axis) -> Result<(TpeOptimizer, bool), tpe::range::RangeError> {
    Ok(match &axis.values {
        Values::List(values) => (TpeOptimizer::new(histogram_estimator(), categorical_range(values.len())?), true),
        Values::Range { .. } => (TpeOptimizer::new(parzen_estimator(), range(0.0, 1.0)?), false),
    })
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;

    /// A minimum at learning rate 1e-2 and 16 bins.
    fn score(assignment: &Assignment) -> f64 {
        let rate = assignment["learning_rate"].as_float().unwrap();
        let bins = if assignment["head.bins"] == Value::Integer(16) { 0.0 } else { 1.0 };
        (rate / 1e-2).ln().powi(2) + bins
    }

    #[test]
    fn adaptive_search_beats_random_draws() {
        let text = "objectives = ['kl']\n[run]\nenv = 'studio'\n[axes]\nlearning_rate = { log = [1e-4, 1.0] }\n\
                    head.bins = [4, 8, 16, 32]\n[search]\nmethod = 'tpe'\nn = 60\n";
        let mut better = 0;
        for seed in 0..10 {
            let mut space = Space::parse(text).unwrap();
            space.search.seed = seed;
            let best = |adaptive: bool| {
                let mut history = Vec::new();
                for number in 0..60 {
                    let next =
                        if adaptive { suggest(&space, &history, number).unwrap() } else { drawn(&space, number) };
                    let score = score(&next);
                    history.push((next, score));
                }
                history.iter().map(|(_, score)| *score).fold(f64::INFINITY, f64::min)
            };
            better += u32::from(best(true) < best(false));
        }
        // With ten fair coins, the probability of eight or more heads is about 1/18.
        assert!(better >= 8, "{better} of 10");
    }

    #[test]
    fn missing_values_are_told_as_missing() {
        assert!(told(None, false).is_nan() && told(None, true).is_nan());
        assert!(told(Some(1.0), false) < 1.0 && told(Some(2.0), true) == 2.0);
    }

    #[test]
    fn the_same_history_gives_the_same_configuration() {
        let text = "objectives = ['kl']\n[run]\nenv = 'studio'\n[axes]\nlearning_rate = { log = [1e-4, 1.0] }\n[search]\nmethod = 'tpe'\nn = 60\n";
        let space = Space::parse(text).unwrap();
        let history: Vec<_> = (0..12).map(|number| (drawn(&space, number), number as f64)).collect();
        assert_eq!(suggest(&space, &history, 12).unwrap(), suggest(&space, &history, 12).unwrap());
        assert_ne!(suggest(&space, &history, 12).unwrap(), suggest(&space, &history, 13).unwrap());
    }
}
