//! Importance of settings: permutation importance over a random forest (Breiman 2001).

use std::collections::HashSet;

use rand::rngs::ChaCha8Rng;
use rand::{Rng, SeedableRng};

/// Number of trees in a forest.
pub const TREES: usize = 64;
const LEAST_LEAF: usize = 2;
const DEEPEST: usize = 12;
/// Maximum number of rows that a forest is fitted to; more add little for a handful of settings.
const MOST_ROWS: usize = 2000;

/// Returns the out-of-bag loss in explained variance of `values` when a column of `rows` is shuffled: an
/// importance per column, in units of the variance; and second, the fraction of variance that the forest
/// explains. `None` for too few rows, or if all values are equal.
///
/// `NAN` in a column stands for a setting that does not apply.
pub fn importance(rows: &[Vec<f64>], values: &[f64], seed: u64) -> Option<(Vec<f64>, f64)> {
    let step = rows.len().div_ceil(MOST_ROWS).max(1);
    let chosen: Vec<usize> = (0..rows.len()).step_by(step).filter(|&row| values[row].is_finite()).collect();
    let columns = rows.first()?.len();
    let mean = chosen.iter().map(|&row| values[row]).sum::<f64>() / chosen.len() as f64;
    let variance = chosen.iter().map(|&row| (values[row] - mean).powi(2)).sum::<f64>() / chosen.len() as f64;
    if chosen.len() < 8 || columns == 0 || variance <= 1e-12 * (1.0 + mean * mean) {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut lost, mut judged) = (vec![0.0; columns], 0.0);
    // Sum and number of predictions for each row by the trees that were not fitted to it.
    let mut said = vec![(0.0, 0.0); rows.len()];
    for _ in 0..TREES {
        let bag: Vec<usize> = chosen.iter().map(|_| chosen[below(&mut random, chosen.len())]).collect();
        let tree = Node::grow(rows, values, bag.clone(), 0, &mut random);
        let in_bag: HashSet<usize> = bag.iter().copied().collect();
        let out: Vec<usize> = chosen.iter().copied().filter(|row| !in_bag.contains(row)).collect();
        let loss = |row: usize, seen: &[f64]| (tree.predict(seen) - values[row]).powi(2);
        let plain: f64 = out.iter().map(|&row| loss(row, &rows[row])).sum();
        for &row in &out {
            said[row] = (said[row].0 + tree.predict(&rows[row]), said[row].1 + 1.0);
        }
        judged += out.len() as f64;
        for (column, lost) in lost.iter_mut().enumerate() {
            let mut order = out.clone();
            for place in (1..order.len()).rev() {
                order.swap(place, below(&mut random, place + 1));
            }
            let mut seen = Vec::new();
            for (&row, &other) in out.iter().zip(&order) {
                seen.clone_from(&rows[row]);
                seen[column] = rows[other][column];
                *lost += loss(row, &seen);
            }
            *lost -= plain;
        }
    }
    let scale = judged * variance;
    let known: Vec<usize> = chosen.into_iter().filter(|&row| said[row].1 > 0.0).collect();
    let error: f64 = known.iter().map(|&row| (said[row].0 / said[row].1 - values[row]).powi(2)).sum();
    let explained = 1.0 - error / (known.len() as f64 * variance);
    Some((lost.into_iter().map(|lost| (lost / scale).max(0.0)).collect(), explained))
}

fn below(random: &mut impl Rng, count: usize) -> usize {
    (random.next_u64() % count as u64) as usize
}

/// A regression tree.
enum Node {
    Leaf(f64),
    /// Rows whose column is at most the bound go to the first child, all others to the second.
    Split(usize, f64, Box<[Node; 2]>),
}

impl Node {
    fn grow(rows: &[Vec<f64>], values: &[f64], mut own: Vec<usize>, depth: usize, random: &mut impl Rng) -> Self {
        let mean = own.iter().map(|&row| values[row]).sum::<f64>() / own.len() as f64;
        if own.len() < 2 * LEAST_LEAF || depth == DEEPEST {
            return Self::Leaf(mean);
        }
        let columns = rows[own[0]].len();
        // 1/3 of the columns at each split, as is usual for regression, and at least two.
        let tried = columns.div_ceil(3).max(2.min(columns));
        let mut best: Option<(f64, usize, f64)> = None;
        for _ in 0..tried {
            let column = below(random, columns);
            if let Some((gain, bound)) = best_cut(rows, values, &mut own, column)
                && best.is_none_or(|(known, ..)| gain > known)
            {
                best = Some((gain, column, bound));
            }
        }
        let Some((_, column, bound)) = best else { return Self::Leaf(mean) };
        let (low, high) = own.into_iter().partition(|&row| rows[row][column] <= bound);
        let children = [low, high].map(|own| Self::grow(rows, values, own, depth + 1, random));
        Self::Split(column, bound, Box::new(children))
    }

    fn predict(&self, row: &[f64]) -> f64 {
        match self {
            Self::Leaf(value) => *value,
            Self::Split(column, bound, children) => children
                [usize::from(row[*column].partial_cmp(bound).is_none_or(std::cmp::Ordering::is_gt))]
            .predict(row),
        }
    }
}

/// Returns the cut of a column that lowers the sum of squares most: the reduction and the bound. Sorts the
/// rows.
fn best_cut(rows: &[Vec<f64>], values: &[f64], own: &mut [usize], column: usize) -> Option<(f64, f64)> {
    own.sort_by(|&a, &b| rows[a][column].total_cmp(&rows[b][column]));
    let (count, total) = (own.len() as f64, own.iter().map(|&row| values[row]).sum::<f64>());
    let (mut sum, mut best) = (0.0, None::<(f64, f64)>);
    for place in 1..own.len() {
        sum += values[own[place - 1]];
        let (before, here) = (rows[own[place - 1]][column], rows[own[place]][column]);
        if before == here || before.is_nan() || place < LEAST_LEAF || own.len() - place < LEAST_LEAF {
            continue;
        }
        let left = place as f64;
        let gain = sum * sum / left + (total - sum).powi(2) / (count - left) - total * total / count;
        if best.is_none_or(|(known, _)| gain > known) {
            best = Some((gain, if here.is_nan() { before } else { 0.5 * (before + here) }));
        }
    }
    best.filter(|(gain, _)| *gain > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn important_columns_are_found_and_others_are_near_zero() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let rows: Vec<Vec<f64>> =
            (0..300).map(|_| (0..4).map(|_| below(&mut random, 1000) as f64 / 1000.0).collect()).collect();
        // A step along the first column, a slope along the second that explains 1/12 as much, and a little
        // noise.
        let value = |row: &Vec<f64>| f64::from(u8::from(row[0] > 0.5)) + 0.5 * row[1] + 0.05 * row[3];
        let values: Vec<f64> = rows.iter().map(value).collect();
        let (found, explained) = importance(&rows, &values, 1).unwrap();
        assert!(found[0] > 4.0 * found[1] && found[1] > 2.0 * found[2] && found[2] < 0.05, "{found:?}");
        assert!(explained > 0.8, "{explained}");
    }

    #[test]
    fn importance_is_none_for_too_few_or_equal_values() {
        assert!(importance(&[vec![1.0], vec![2.0]], &[1.0, 2.0], 1).is_none());
        assert!(importance(&vec![vec![1.0]; 20], &[1.0; 20], 1).is_none());
        assert!(importance(&[], &[], 1).is_none());
    }
}
