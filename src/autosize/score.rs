//! Score of a sampler: its expected error at the end of the time, preparation included.

use headtail_render::statistics::RatioInterval;

/// Returns the error after `total` seconds of a sampler with this error after `seconds` of rendering, if
/// preparation takes `prepared` of the total. Errors fall as the reciprocal of time, or faster. Infinite if
/// preparation takes all the time.
pub fn at_time(error: f64, seconds: f64, prepared: f64, total: f64) -> f64 {
    if prepared >= total { f64::INFINITY } else { error * seconds / (total - prepared) }
}

/// Returns the mean; infinite without values.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { f64::INFINITY } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Returns the ratio of the paired scores of two samplers.
pub fn ratio(own: &[f64], best: &[f64]) -> Option<RatioInterval> {
    let count = own.len().min(best.len());
    RatioInterval::paired(&own[..count], &best[..count])
}

/// Whether a sampler is dropped: certainly behind, or so far behind that its interval does not matter.
pub fn is_out(ratio: Option<RatioInterval>) -> bool {
    const FAR: f64 = 3.0;
    ratio.is_none_or(|ratio| ratio.ratio > FAR || ratio.ends().is_some_and(|(low, _)| low > 1.0))
}

/// Whether a sampler is certainly not better than the best by more than a factor.
pub fn cannot_be_better(ratio: Option<RatioInterval>, factor: f64) -> bool {
    ratio.is_none_or(|ratio| ratio.ends().is_some_and(|(low, _)| low > 1.0 / factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_includes_preparation() {
        // Half the error, but half the time is gone.
        assert_eq!(at_time(0.5, 1.0, 30.0, 60.0), at_time(1.0, 1.0, 0.0, 60.0));
        assert!(at_time(0.5, 1.0, 20.0, 60.0) < at_time(1.0, 1.0, 0.0, 60.0));
        assert_eq!(at_time(0.5, 1.0, 60.0, 60.0), f64::INFINITY);
    }

    #[test]
    fn only_certain_losers_are_dropped() {
        let best = [1.0, 1.1, 0.9, 1.0];
        assert!(!is_out(ratio(&best, &best)));
        assert!(!is_out(ratio(&[1.0, 1.3, 1.0, 1.1], &best)), "within its interval");
        assert!(is_out(ratio(&best.map(|error| 1.2 * error), &best)), "certainly behind");
        assert!(is_out(ratio(&[2.5, 9.0, 1.0, 1.1], &best)), "far behind");
        assert!(is_out(ratio(&[f64::INFINITY; 2], &best)));
    }

    #[test]
    fn contest_is_decided_if_none_can_be_much_better() {
        let best = [1.0, 1.1, 0.9, 1.0];
        assert!(cannot_be_better(ratio(&best.map(|error| 1.01 * error), &best), 1.08));
        assert!(!cannot_be_better(ratio(&[1.5, 0.8, 1.2, 0.9], &best), 1.08), "its interval reaches below");
        assert!(!cannot_be_better(ratio(&best.map(|error| 0.9 * error), &best), 1.08));
    }
}
