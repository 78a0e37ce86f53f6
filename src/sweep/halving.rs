//! Asynchronous successive halving (Li et al. 2018): promotion of configurations to rungs.

/// Scores of a configuration at each rung that all of its trials have reached, in the order of the rungs.
/// Lower is better; a configuration with a failed trial has an infinite score.
pub type Scores = Vec<f64>;

/// Returns the configurations to promote, each with the index of its next rung, the most advanced first. A
/// configuration is promoted as soon as it is among the best 1 / `keep` of those that have reached its rung,
/// without waiting for the rung to be full.
pub fn promotions(scores: &[Scores], rungs: usize, keep: usize) -> Vec<(usize, usize)> {
    let mut promoted = Vec::new();
    for rung in (0..rungs.saturating_sub(1)).rev() {
        let mut reached: Vec<(usize, f64)> =
            scores.iter().enumerate().filter_map(|(index, own)| Some((index, *own.get(rung)?))).collect();
        reached.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let best = &reached[..reached.len() / keep];
        let goes_on = |(index, score): &&(usize, f64)| score.is_finite() && scores[*index].len() == rung + 1;
        promoted.extend(best.iter().filter(goes_on).map(|(index, _)| (*index, rung + 1)));
    }
    promoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_third_is_promoted_and_the_most_advanced_first() {
        let scores = [vec![3.0], vec![1.0], vec![2.0], vec![6.0], vec![5.0], vec![4.0]];
        assert_eq!(promotions(&scores, 3, 3), [(1, 1), (2, 1)]);
        let scores = [vec![3.0, 1.5], vec![1.0, 0.5], vec![2.0, 0.6], vec![6.0], vec![5.0], vec![4.0], vec![0.5]];
        assert_eq!(promotions(&scores, 3, 3), [(1, 2), (6, 1)]);
    }

    #[test]
    fn no_promotion_of_too_few_or_beyond_the_last_rung() {
        assert!(promotions(&[vec![1.0], vec![2.0]], 3, 3).is_empty());
        assert!(promotions(&[vec![1.0, 1.0], vec![2.0, 2.0]], 2, 2).is_empty());
    }

    #[test]
    fn failed_configurations_are_never_promoted() {
        assert!(promotions(&[vec![f64::INFINITY], vec![f64::INFINITY]], 2, 2).is_empty());
    }
}
