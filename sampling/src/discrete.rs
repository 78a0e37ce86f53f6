//! Inversion of discrete distributions, with reuse of the uniform number inside the chosen cell.

/// The largest f32 below 1, which keeps coordinates of the unit square in `[0, 1)`.
pub const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Returns the position of `at` between `from` and `to`, in `[0, 1)`: remaps a uniform number that chose this
/// interval to a new uniform number (as pbrt's `SampleDiscrete`). An empty interval gives 0.
#[inline(always)]
pub fn remap(at: f32, from: f32, to: f32) -> f32 {
    let inside = (at - from) / (to - from);
    // In this form NaN becomes 0.
    let inside = if inside > 0.0 { inside } else { 0.0 };
    if inside < BELOW_ONE { inside } else { BELOW_ONE }
}

/// Returns the last index in `0..count` whose value is at most `target`, or 0 if there is none, by branchless
/// bisection. Values do not decrease with the index; `value(0)` is not called.
#[inline(always)]
pub fn last_at_most(count: usize, target: f32, value: impl Fn(usize) -> f32) -> usize {
    let (mut low, mut size) = (0, count);
    while size > 1 {
        let half = size / 2;
        low += if value(low + half) <= target { half } else { 0 };
        size -= half;
    }
    low
}

/// Finds the cell in which inclusive running sums (not empty, non-decreasing, last one positive) pass
/// `u` times their total: `(cell, position inside in [0, 1))`.
#[inline(always)]
pub fn invert_running_sums(sums: &[f32], u: f32) -> (usize, f32) {
    let target = u * sums[sums.len() - 1];
    let cell = last_at_most(sums.len(), target, |cell| sums[cell - 1]);
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    (cell, remap(target, before, sums[cell]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_hit_in_proportion_to_their_mass() {
        let sums = [0.0, 1.0, 1.0, 4.0];
        for k in 0..1000 {
            let u = k as f32 / 1000.0;
            let (cell, inside) = invert_running_sums(&sums, u);
            assert_eq!(cell, if u < 0.25 { 1 } else { 3 });
            let expected = if cell == 1 { 4.0 * u } else { (4.0 * u - 1.0) / 3.0 };
            assert!((inside - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn lists_of_every_length_are_searched_to_both_ends() {
        for length in 1..70_usize {
            let sums: Vec<f32> = (1..=length).map(|k| k as f32).collect();
            for cell in 0..length {
                let (found, inside) = invert_running_sums(&sums, (cell as f32 + 0.5) / length as f32);
                assert!(found == cell && (inside - 0.5).abs() < 1e-4, "{length}: {cell} {found} {inside}");
            }
            assert_eq!(invert_running_sums(&sums, BELOW_ONE).0, length - 1);
        }
    }

    #[test]
    fn remapped_numbers_stay_below_one() {
        assert_eq!(remap(1.0, 0.0, 1.0), BELOW_ONE);
        assert_eq!(remap(0.5, 0.5, 0.5), 0.0);
        assert_eq!(remap(f32::NAN, 0.0, 1.0), 0.0);
        assert_eq!(remap(0.75, 0.5, 1.0), 0.5);
    }
}
