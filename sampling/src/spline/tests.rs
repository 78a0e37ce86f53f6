use std::fmt::Debug;

use super::*;
use crate::{
    random::{Purpose, Stream},
    simd::{self, LANES, Lanes, Simd, Vectorized},
};

const BOTH: [Topology; 2] = [Topology::Interval, Topology::Circle];

/// A number type in a test.
trait Number: Real + Debug + Into<f64> {
    /// Rounding error of a spline's knots: two roundings of a number up to 1.
    const ROUNDING: f64;
}

impl Number for f32 {
    const ROUNDING: f64 = 1.2e-7;
}

impl Number for f64 {
    const ROUNDING: f64 = 2.3e-16;
}

/// `L` splines, `[3K + 1, L]`.
fn splines<R: Number, const L: usize>(random: &mut Stream, bins: usize, scale: f64) -> Vec<[R; L]> {
    let mut logit = || {
        let sum: f32 = (0..3).map(|_| random.uniform()).sum();
        R::of(scale * (f64::from(sum) - 1.5))
    };
    (0..logit_count(bins)).map(|_| std::array::from_fn(|_| logit())).collect()
}

fn scratch<R: Real, const L: usize>(logits: &[[R; L]]) -> Vec<[R; L]> {
    vec![[R::ZERO; L]; 2 * bin_count(logits.len())]
}

fn forward_of<R: Number, const L: usize>(topology: Topology, logits: &[[R; L]], z: &[R; L]) -> ([R; L], [R; L]) {
    forward(topology, Logits::strip(logits), &mut scratch(logits), z)
}

fn inverse_of<R: Number, const L: usize>(topology: Topology, logits: &[[R; L]], y: &[R; L]) -> ([R; L], [R; L]) {
    inverse(topology, Logits::strip(logits), &mut scratch(logits), y)
}

fn points<R: Number, const L: usize>(random: &mut Stream) -> [R; L] {
    std::array::from_fn(|_| R::of(f64::from(random.uniform())))
}

/// Returns the distance on the circle, which also serves on the interval: its ends are never confused below.
fn distance(a: f64, b: f64) -> f64 {
    (a - b).abs().min(1.0 - (a - b).abs())
}

fn zero_logits_are_the_identity<R: Number, const L: usize>() {
    for topology in BOTH {
        for k in 0..1000 {
            let y = f64::from(k) / 1000.0;
            for direction in [inverse_of::<R, L>, forward_of] {
                let (values, slopes) = direction(topology, &[[R::ZERO; L]; 13], &[R::of(y); L]);
                for (value, slope) in values.into_iter().zip(slopes) {
                    // A slope is the product of about 10 rounded factors, with SLOPE_OFFSET's rounding.
                    let (value, slope): (f64, f64) = (value.into(), slope.into());
                    assert!(
                        (value - y).abs() < 8.0 * R::ROUNDING && (slope - 1.0).abs() < 16.0 * R::ROUNDING,
                        "{y}: {value} {slope}"
                    );
                }
            }
        }
    }
}

fn inversions_return_to_their_start<R: Number, const L: usize>() {
    let mut random = Stream::new(3, Purpose::Test, 0);
    for round in 0..20_000 / L {
        let bins = [2, 3, 4, 8, 32][round % 5];
        let (topology, logits) = (BOTH[round % 2], splines::<R, L>(&mut random, bins, 3.0));
        for _ in 0..50 {
            let z = points(&mut random);
            let (y, slopes) = forward_of(topology, &logits, &z);
            let (back, densities) = inverse_of(topology, &logits, &y);
            for l in 0..L {
                let [z, y, slope, back, density]: [f64; 5] =
                    [z[l], y[l], slopes[l], back[l], densities[l]].map(Into::into);
                assert!((0.0..1.0).contains(&y));
                // y is rounded by the shift and the knots, and the slope propagates that to z. The density
                // changes by a factor of about e^10 over a bin, the narrowest of which is 1e-4.
                let tolerance = R::ROUNDING * (16.0 + 4.0 * slope);
                assert!(distance(back, z) < tolerance, "{z} -> {y} -> {back}, slope {slope}");
                assert!((density / slope - 1.0).abs() < 8e3 * R::ROUNDING + 1e5 * tolerance, "{density} {slope}");
            }
        }
    }
}

fn extreme_logits_stay_finite_and_inside<R: Number, const L: usize>() {
    let mut random = Stream::new(4, Purpose::Test, 0);
    for round in 0..20_000 / L {
        let logits = splines::<R, L>(&mut random, 8, 100.0);
        let [a, b] = points(&mut random);
        for x in [R::ZERO, R::of(f64::from(f32::MIN_POSITIVE)), a, b, R::BELOW_ONE, R::ONE] {
            for direction in [inverse_of::<R, L>, forward_of] {
                let (values, slopes) = direction(BOTH[round % 2], &logits, &[x; L]);
                for (value, slope) in values.into_iter().zip(slopes) {
                    let log: f64 = slope.ln().into();
                    assert!(value >= R::ZERO && value <= R::ONE && log.is_finite(), "{x:?}: {value:?} {slope:?}");
                }
            }
        }
    }
}

fn the_circle_has_no_seam<R: Number, const L: usize>() {
    let mut random = Stream::new(5, Purpose::Test, 0);
    for _ in 0..2000 / L {
        let logits = splines::<R, L>(&mut random, 6, 3.0);
        let at = |y| inverse_of(Topology::Circle, &logits, &[y; L]);
        let (left, right) = (at(R::BELOW_ONE), at(R::ZERO));
        assert_eq!(right, at(R::ONE));
        for l in 0..L {
            let ratio: f64 = (left.1[l] / right.1[l]).into();
            assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        }
    }
}

fn densities_integrate_to_one<R: Number, const L: usize>() {
    let mut random = Stream::new(6, Purpose::Test, 0);
    for round in 0..40 / L.min(20) {
        let logits = splines::<R, L>(&mut random, 6, 2.0);
        let (count, mut sums) = (100_000, [0.0; L]);
        for k in 0..count {
            let y = R::of((f64::from(k) + 0.5) / f64::from(count));
            for (sum, slope) in sums.iter_mut().zip(inverse_of(BOTH[round % 2], &logits, &[y; L]).1) {
                *sum += slope.into() / f64::from(count);
            }
        }
        assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-4), "{sums:?}");
    }
}

macro_rules! for_all_numbers {
    ($($test:ident),*) => {
        mod one { $(#[test] fn $test() { super::$test::<f32, 1>(); })* }
        mod lanes { $(#[test] fn $test() { super::$test::<f32, { super::LANES }>(); })* }
        mod double { $(#[test] fn $test() { super::$test::<f64, 1>(); })* }
    };
}

for_all_numbers!(
    zero_logits_are_the_identity,
    inversions_return_to_their_start,
    extreme_logits_stay_finite_and_inside,
    the_circle_has_no_seam,
    densities_integrate_to_one
);

#[test]
fn zero_logits_have_slope_one() {
    assert!((SLOPE_OFFSET - (1.0 - MIN_SLOPE).exp_m1().ln()).abs() < 1e-15);
}

/// Computes both directions and all outputs of the gradient, `[3K + 1, LANES]` of each.
fn everything<const L: usize>(topology: Topology, logits: &[[f32; L]], at: &[f32; L]) -> Vec<[f32; L]> {
    let (y, density) = forward_of(topology, logits, at);
    let (z, slope) = inverse_of(topology, logits, at);
    let mut scratch = scratch(logits);
    let found = inverse_with_gradient(topology, Logits::strip(logits), &mut scratch, at);
    let mut all = vec![y, density, z, slope, found.values, found.log_slopes];
    for of in [Gradient::Value, Gradient::LogSlope] {
        all.push(found.d_point(of));
        let mut rows = vec![[f32::NAN; L]; logits.len()];
        found.write(of, &scratch, rows.as_flattened_mut(), L, 0);
        all.extend(rows);
    }
    all
}

struct Everything<'a>(Topology, &'a [Lanes], &'a Lanes, &'a mut Vec<Lanes>);

impl Vectorized for Everything<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        *self.3 = everything(self.0, self.1, self.2);
    }
}

#[test]
fn lanes_match_single_splines_bit_for_bit() {
    let mut random = Stream::new(7, Purpose::Test, 0);
    for round in 0..200 {
        let (topology, bins) = (BOTH[round % 2], [2, 4, 7, 32][round % 4]);
        let (logits, at) = (splines::<f32, LANES>(&mut random, bins, 4.0), points(&mut random));
        let mut found = Vec::new();
        simd::dispatch(Everything(topology, &logits, &at, &mut found));
        for l in 0..LANES {
            let column: Vec<[f32; 1]> = logits.iter().map(|row| [row[l]]).collect();
            let one = everything(topology, &column, &[at[l]]);
            assert!(
                one.iter().zip(&found).all(|(one, many)| one[0].to_bits() == many[l].to_bits()),
                "{topology:?} {bins}"
            );
        }
    }
}

/// Central differences in f64: their error is the square of the step, 1e-10, times a third derivative, below 1e4 for splines
/// with bins this wide, and rounding over the step, 1e-16 / 1e-5.
#[test]
fn gradients_match_central_differences() {
    const STEP: f64 = 1e-5;
    let mut random = Stream::new(8, Purpose::Test, 0);
    for round in 0..400 {
        let (topology, bins) = (BOTH[round % 2], [2, 4, 8][round % 3]);
        let logits = splines::<f64, 1>(&mut random, bins, 1.0);
        let [at]: [f64; 1] = points(&mut random);
        let value = |logits: &[[f64; 1]], at: f64| {
            let ([z], [slope]) = inverse_of(topology, logits, &[at]);
            [z, slope.ln()]
        };
        let mut scratch = scratch(&logits);
        let found = inverse_with_gradient(topology, Logits::strip(&logits), &mut scratch, &[at]);
        let [z, log_slope] = value(&logits, at);
        assert!((found.values[0] - z).abs() < 1e-14 && (found.log_slopes[0] - log_slope).abs() < 1e-12);
        for (index, of) in [Gradient::Value, Gradient::LogSlope].into_iter().enumerate() {
            let difference = |low: [f64; 2], high: [f64; 2]| (high[index] - low[index]) / (2.0 * STEP);
            let expected = difference(value(&logits, at - STEP), value(&logits, at + STEP));
            let close = |found: f64, expected: f64| (found - expected).abs() < 1e-5 * (1.0 + expected.abs());
            // A knot between the two has a kink in the slope's derivative.
            let kinks = index == 1 && !close(found.d_point(of)[0], expected);
            let mut rows = vec![[f64::NAN]; logits.len()];
            found.write(of, &scratch, rows.as_flattened_mut(), 1, 0);
            for k in 0..logits.len() {
                let moved = |by: f64| {
                    let mut logits = logits.clone();
                    logits[k][0] += by;
                    value(&logits, at)
                };
                let expected = difference(moved(-STEP), moved(STEP));
                assert!(close(rows[k][0], expected) || kinks, "{topology:?} {bins} {k}: {} {expected}", rows[k][0]);
            }
        }
    }
}

#[test]
fn gradients_in_f32_match_f64() {
    let mut random = Stream::new(9, Purpose::Test, 0);
    for round in 0..400 {
        let (topology, bins) = (BOTH[round % 2], [2, 4, 8, 32][round % 4]);
        let (logits, at) = (splines::<f32, 1>(&mut random, bins, 1.0), points::<f32, 1>(&mut random));
        let wide: Vec<[f64; 1]> = logits.iter().map(|row| [f64::from(row[0])]).collect();
        let (mut narrow_scratch, mut wide_scratch) = (scratch(&logits), scratch(&wide));
        let narrow = inverse_with_gradient(topology, Logits::strip(&logits), &mut narrow_scratch, &at);
        let expected = inverse_with_gradient(topology, Logits::strip(&wide), &mut wide_scratch, &[f64::from(at[0])]);
        for of in [Gradient::Value, Gradient::LogSlope] {
            let (mut found, mut rows) = (vec![[f32::NAN]; logits.len()], vec![[f64::NAN]; logits.len()]);
            narrow.write(of, &narrow_scratch, found.as_flattened_mut(), 1, 0);
            expected.write(of, &wide_scratch, rows.as_flattened_mut(), 1, 0);
            let size = rows.iter().fold(1.0_f64, |size, row| size.max(row[0].abs()));
            // A position is rounded by 1.2e-7 over its bin's width, at least 1/200 here, and the second
            // derivatives by it are of the order of 10 derivatives.
            for (found, row) in found.iter().zip(&rows) {
                assert!((f64::from(found[0]) - row[0]).abs() < 2.4e-4 * size, "{topology:?} {bins}: {found:?} {row:?}");
            }
        }
    }
}

#[test]
fn gradients_are_finite_at_edges_and_outside() {
    let mut random = Stream::new(10, Purpose::Test, 0);
    for topology in BOTH {
        for scale in [0.0, 3.0, 60.0] {
            for at in [-1e-7, 0.0, 1e-45, 0.25, 0.5, 1.0_f32.next_down(), 1.0, 1.0 + 1e-6] {
                let logits = splines::<f32, LANES>(&mut random, 4, scale);
                assert!(everything(topology, &logits, &[at; LANES]).as_flattened().iter().all(|g| g.is_finite()));
            }
        }
    }
}

#[test]
fn nan_logits_give_nan() {
    for topology in BOTH {
        for k in 0..8 {
            let mut logits = [[0.0_f32]; 13];
            logits[k][0] = f32::NAN;
            let mut scratch = scratch(&logits);
            let found = inverse_with_gradient(topology, Logits::strip(&logits), &mut scratch, &[0.3]);
            assert!(found.values[0].is_nan() || found.log_slopes[0].is_nan(), "{topology:?} {k}");
        }
    }
}
