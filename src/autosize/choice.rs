//! Who is chosen, by what every candidate is worth and costs.

use super::score::mean;

/// Within this factor of the winner, the cheapest is named.
const NEAR: f64 = 1.05;

/// Who was chosen.
#[derive(Debug, PartialEq, Eq)]
pub struct Choice {
    /// Index of the one with the least error.
    pub winner: usize,
    /// Index of the cheapest within 5 % of it.
    pub cheapest: usize,
}

/// What the choice knows of a candidate.
pub struct Standing {
    /// Error of each picture, as it would be once the time is up.
    pub scores: Vec<f64>,
    /// Whether it was ready in time.
    pub is_allowed: bool,
    /// Whether it was not dropped.
    pub is_in: bool,
    /// Whether there is work before its first sample.
    pub is_prepared: bool,
    /// Of its file.
    pub bytes: u64,
}

/// The winner, and the cheapest within 5 % of it: without preparation, then with the smallest file, then in the order of the candidates. `None` if
/// nothing could be measured.
pub fn choose(standings: &[Standing]) -> Option<Choice> {
    let scores: Vec<f64> = standings.iter().map(|standing| mean(&standing.scores)).collect();
    let winner = least((0..standings.len()).filter(|&index| standings[index].is_in), |index| scores[index])?;
    let goal = NEAR * scores[winner];
    let near = (0..standings.len()).filter(|&index| standings[index].is_allowed && scores[index] <= goal);
    let cheapest = near.min_by_key(|&index| (standings[index].is_prepared, standings[index].bytes, index));
    Some(Choice { winner, cheapest: cheapest.unwrap_or(winner) })
}

/// The one with the least score; `None` where no score is finite.
pub fn least(among: impl Iterator<Item = usize>, score: impl Fn(usize) -> f64) -> Option<usize> {
    let scored = among.map(|index| (index, score(index))).filter(|(_, score)| score.is_finite());
    scored.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::{super::score::at_time, *};

    /// A candidate with this error after a second of rendering, within a minute in all, that takes so long to be prepared and has so large a file.
    fn standing(error: f64, prepared: f64, bytes: u64) -> Standing {
        let scores = [0.99, 1.0, 1.01].map(|factor| at_time(factor * error, 1.0, prepared, 60.0)).into();
        Standing { scores, is_allowed: prepared <= 30.0, is_in: prepared <= 30.0, is_prepared: bytes > 0, bytes }
    }

    fn chosen(standings: &[Standing]) -> (usize, usize) {
        let Choice { winner, cheapest } = choose(standings).unwrap();
        (winner, cheapest)
    }

    #[test]
    fn a_sampler_that_is_ready_at_once_wins_where_no_preparation_pays() {
        // The head has 0.8 times the error, and a third of the time is gone once it is trained.
        assert_eq!(chosen(&[standing(2.0, 0.0, 0), standing(1.0, 0.0, 0), standing(0.8, 20.0, 9000)]), (1, 1));
    }

    #[test]
    fn a_table_or_a_head_wins_that_earns_its_preparation() {
        let (mis, table, head) = (standing(1.0, 0.0, 0), standing(0.7, 3.0, 50_000), standing(0.4, 20.0, 9000));
        assert_eq!(chosen(&[mis, table, head]), (2, 2));
        let (mis, table, late) = (standing(1.0, 0.0, 0), standing(0.7, 3.0, 50_000), standing(0.1, 31.0, 9000));
        assert_eq!(chosen(&[mis, table, late]), (1, 1), "beyond what preparation may take");
    }

    #[test]
    fn the_cheapest_is_within_a_twentieth() {
        let near = [standing(1.04, 0.0, 0), standing(1.0, 0.0, 0), standing(0.99, 0.1, 9000)];
        assert_eq!(chosen(&near), (2, 0), "the first of those without a file");
        assert_eq!(chosen(&[standing(1.06, 0.0, 0), standing(1.0, 0.1, 9000)]), (1, 1), "too far");
        assert_eq!(chosen(&[standing(0.99, 0.1, 9000), standing(1.0, 0.1, 900)]), (0, 1), "the smaller file");
        let mut dropped = [standing(1.0, 0.0, 0), standing(0.99, 0.0, 0)];
        dropped[1].is_in = false;
        assert_eq!(chosen(&dropped), (0, 0));
    }

    #[test]
    fn nothing_is_chosen_of_nothing() {
        let unmeasured = Standing { scores: Vec::new(), ..standing(1.0, 0.0, 0) };
        assert_eq!(choose(&[unmeasured]), None);
        assert_eq!(choose(&[]), None);
    }
}
