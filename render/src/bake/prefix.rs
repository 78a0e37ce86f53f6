//! Inversion of a tabulated distribution given by its running sums.

/// The largest share of a cell: positions inside stay below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Finds the cell in which a non-decreasing list of inclusive running sums (not empty, last one positive) reaches the share
/// `u` of its total; `(cell, position inside in [0, 1))`.
///
/// Small lists are counted rather than bisected: no branch to predict, and the loop runs in SIMD lanes.
pub fn search_prefix(sums: &[f32], u: f32) -> (usize, f32) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let cell = if sums.len() <= 64 {
        sums[..last].iter().map(|&sum| u32::from(sum <= target)).sum::<u32>() as usize
    } else {
        sums[..last].partition_point(|&sum| sum <= target)
    };
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    let size = sums[cell] - before;
    let inside = if size > 0.0 { ((target - before) / size).clamp(0.0, BELOW_ONE) } else { 0.0 };
    (cell, inside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_hit_in_proportion_and_empty_cells_never() {
        let sums = [0.0, 1.0, 1.0, 4.0];
        for k in 0..1000 {
            let u = k as f32 / 1000.0;
            let (cell, inside) = search_prefix(&sums, u);
            assert_eq!(cell, if u < 0.25 { 1 } else { 3 });
            let expected = if cell == 1 { 4.0 * u } else { (4.0 * u - 1.0) / 3.0 };
            assert!((inside - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn counting_and_bisecting_agree() {
        let long: Vec<f32> = (0..200)
            .map(|k| ((k * k) % 7 * k) as f32)
            .scan(0.0, |s, x| {
                *s += x;
                Some(*s)
            })
            .collect();
        for k in 0..500 {
            let u = k as f32 / 500.0;
            let counted = long[..199].iter().filter(|&&sum| sum <= u * long[199]).count();
            assert_eq!(search_prefix(&long, u).0, counted);
        }
    }
}
