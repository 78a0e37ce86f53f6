//! Inversion of tabulated distributions that are given by their running sums.

/// The largest share of a cell: positions inside stay below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Finds the cell in which a non-decreasing list of inclusive running sums (not empty, last one positive) reaches the share
/// `u` of its total; `(cell, position inside in [0, 1))`. For long lists.
pub fn search_prefix(sums: &[f32], u: f32) -> (usize, f32) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let cell = sums[..last].partition_point(|&sum| sum <= target);
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    (cell, share(target - before, sums[cell] - before))
}

/// How far `distance` is of the way through a cell of mass `size`, in `[0, 1)`.
#[inline(always)]
pub(super) fn share(distance: f32, size: f32) -> f32 {
    if size > 0.0 { (distance / size).clamp(0.0, BELOW_ONE) } else { 0.0 }
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
}
