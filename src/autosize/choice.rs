//! Choice of a sampler by score and cost.

use super::score::mean;

/// The cheapest candidate within this factor of the winner is also chosen.
const NEAR: f64 = 1.05;

/// The chosen candidates.
#[derive(Debug, PartialEq, Eq)]
pub struct Choice {
    /// Index of the candidate with the lowest error.
    pub winner: usize,
    /// Index of the cheapest candidate within 5 % of it.
    pub cheapest: usize,
}

/// Summary of a candidate.
pub struct CandidateSummary {
    /// Expected error of each picture at the end of the time.
    pub scores: Vec<f64>,
    /// Whether it was ready in time.
    pub is_allowed: bool,
    /// Whether it is still in the contest.
    pub is_in: bool,
    /// Whether it needs preparation.
    pub is_prepared: bool,
    /// Size of its file.
    pub bytes: u64,
}

/// Returns the winner, and the cheapest candidate within 5 % of it: without preparation, then with the
/// smallest file, then in order of the candidates. `None` if nothing could be measured.
pub fn choose(summaries: &[CandidateSummary]) -> Option<Choice> {
    let scores: Vec<f64> = summaries.iter().map(|summary| mean(&summary.scores)).collect();
    let winner = least((0..summaries.len()).filter(|&index| summaries[index].is_in), |index| scores[index])?;
    let goal = NEAR * scores[winner];
    let near = (0..summaries.len()).filter(|&index| summaries[index].is_allowed && scores[index] <= goal);
    let cheapest = near.min_by_key(|&index| (summaries[index].is_prepared, summaries[index].bytes, index));
    Some(Choice { winner, cheapest: cheapest.unwrap_or(winner) })
}

/// Returns the index with the lowest score; `None` if no score is finite.
pub fn least(among: impl Iterator<Item = usize>, score: impl Fn(usize) -> f64) -> Option<usize> {
    let scored = among.map(|index| (index, score(index))).filter(|(_, score)| score.is_finite());
    scored.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::{super::score::at_time, *};

    /// A candidate with this error after 1 s of rendering, in a time of 60 s; `prepared` are seconds, `bytes`
    /// the size of its file.
    fn summary(error: f64, prepared: f64, bytes: u64) -> CandidateSummary {
        let scores = [0.99, 1.0, 1.01].map(|factor| at_time(factor * error, 1.0, prepared, 60.0)).into();
        CandidateSummary {
            scores,
            is_allowed: prepared <= 30.0,
            is_in: prepared <= 30.0,
            is_prepared: bytes > 0,
            bytes,
        }
    }

    fn chosen(summaries: &[CandidateSummary]) -> (usize, usize) {
        let Choice { winner, cheapest } = choose(summaries).unwrap();
        (winner, cheapest)
    }

    #[test]
    fn plain_sampler_wins_if_no_preparation_pays() {
        // The head has 0.8 times the error, but its training takes 1/3 of the time.
        assert_eq!(chosen(&[summary(2.0, 0.0, 0), summary(1.0, 0.0, 0), summary(0.8, 20.0, 9000)]), (1, 1));
    }

    #[test]
    fn table_or_head_wins_if_its_preparation_pays() {
        let (mis, table, head) = (summary(1.0, 0.0, 0), summary(0.7, 3.0, 50_000), summary(0.4, 20.0, 9000));
        assert_eq!(chosen(&[mis, table, head]), (2, 2));
        let (mis, table, late) = (summary(1.0, 0.0, 0), summary(0.7, 3.0, 50_000), summary(0.1, 31.0, 9000));
        assert_eq!(chosen(&[mis, table, late]), (1, 1), "beyond what preparation may take");
    }

    #[test]
    fn cheapest_is_within_5_percent() {
        let near = [summary(1.04, 0.0, 0), summary(1.0, 0.0, 0), summary(0.99, 0.1, 9000)];
        assert_eq!(chosen(&near), (2, 0), "the first of those without a file");
        assert_eq!(chosen(&[summary(1.06, 0.0, 0), summary(1.0, 0.1, 9000)]), (1, 1), "too far");
        assert_eq!(chosen(&[summary(0.99, 0.1, 9000), summary(1.0, 0.1, 900)]), (0, 1), "the smaller file");
        let mut dropped = [summary(1.0, 0.0, 0), summary(0.99, 0.0, 0)];
        dropped[1].is_in = false;
        assert_eq!(chosen(&dropped), (0, 0));
    }

    #[test]
    fn no_choice_without_measurements() {
        let unmeasured = CandidateSummary { scores: Vec::new(), ..summary(1.0, 0.0, 0) };
        assert_eq!(choose(&[unmeasured]), None);
        assert_eq!(choose(&[]), None);
    }
}
