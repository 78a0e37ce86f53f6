//! Inversion of tabulated distributions that are given by their running sums.

/// The largest share of a cell: positions inside stay below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Sums that are compared at once, in SIMD lanes.
const LANES: usize = 8;

/// Floats that the running sums of `cells` masses take: padded to whole lanes with the total.
pub(super) fn padded_length(cells: usize) -> usize {
    cells.next_multiple_of(LANES)
}

/// Appends the inclusive running sums of `masses`, padded; the total.
pub(super) fn push_running_sums(masses: impl ExactSizeIterator<Item = f64>, out: &mut Vec<f32>) -> f64 {
    let end = out.len() + padded_length(masses.len());
    let mut sum = 0.0;
    out.extend(masses.map(|mass| {
        sum += mass;
        sum as f32
    }));
    out.resize(end, sum as f32);
    sum
}

/// Finds the cell in `0..cells` of padded running sums in which they pass `target`; `(cell, position inside in [0, 1))`.
///
/// All sums are compared rather than bisected: no branch to predict, no load that waits for another, and whole SIMD lanes.
#[inline(always)]
pub(super) fn search_padded(sums: &[f32], cells: usize, target: f32) -> (usize, f32) {
    let mut passed = [0_u32; LANES];
    let (chunks, _) = sums.as_chunks::<LANES>();
    for chunk in chunks {
        for (passed, &sum) in passed.iter_mut().zip(chunk) {
            *passed += u32::from(sum <= target);
        }
    }
    // The total is not passed but by rounding.
    let cell = (passed.iter().sum::<u32>() as usize).min(cells - 1);
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    (cell, share(target, before, sums[cell]))
}

/// Finds the cell in which a non-decreasing list of inclusive running sums (not empty, last one positive) reaches the share
/// `u` of its total; `(cell, position inside in [0, 1))`. For long lists.
pub fn search_prefix(sums: &[f32], u: f32) -> (usize, f32) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let cell = sums[..last].partition_point(|&sum| sum <= target);
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    (cell, share(target, before, sums[cell]))
}

/// The share of the way from `start` to `end`, in `[0, 1)`.
#[inline(always)]
fn share(target: f32, start: f32, end: f32) -> f32 {
    let size = end - start;
    if size > 0.0 { ((target - start) / size).clamp(0.0, BELOW_ONE) } else { 0.0 }
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
    fn comparing_all_sums_finds_what_bisection_finds() {
        for cells in [1, 2, 7, 8, 9, 16, 31, 32, 64] {
            let mut sums = Vec::new();
            let total = push_running_sums((0..cells).map(|k| ((k * 7) % 11) as f64 + 0.1), &mut sums) as f32;
            assert_eq!(sums.len(), padded_length(cells));
            for u in (0..1000).map(|k| k as f32 / 1000.0).chain([BELOW_ONE]) {
                assert_eq!(search_padded(&sums, cells, u * total), search_prefix(&sums[..cells], u), "{cells} {u}");
            }
        }
    }
}
