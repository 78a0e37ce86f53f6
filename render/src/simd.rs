//! Elementary functions that compilers turn into SIMD instructions, and the dispatch to the best instruction set.
//!
//! The functions have no branch and no table: in a loop over an array of fixed length they become a few vector instructions on
//! every processor, with the same result on each. Code that uses them is run through [`dispatch`]. It must be made of plain loops and
//! `#[inline(always)]` functions: closures are not compiled for the processor that is found.

pub use pulp::Simd;
use pulp::{Arch, WithSimd};

/// Numbers that are worked on side by side: one AVX-512 register, or two AVX2 registers.
pub const LANES: usize = 16;

/// One number of each of [`LANES`] samples.
pub type Lanes = [f32; LANES];

/// Work that is compiled for every instruction set.
pub trait Vectorized {
    /// Does the work; implementations are `#[inline(always)]`.
    fn run<S: Simd>(self, simd: S);
}

struct Op<W>(W);

impl<W: Vectorized> WithSimd for Op<W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.run(simd);
    }
}

/// Runs work with the best instructions that the processor has.
pub fn dispatch(work: impl Vectorized) {
    Arch::new().dispatch(Op(work));
}

/// Runs work that is part of other work as a function of its own, compiled once for each instruction set.
#[inline(always)]
pub fn call<S: Simd>(simd: S, work: impl Vectorized) {
    simd.vectorize(Op(work));
}

/// `e^x` with a relative error below 2e-7 for `x` in `[-87, 88]`; arguments beyond are moved there.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    exp_to_88(if x > 88.0 { 88.0 } else { x })
}

/// [`exp`] of what is known to be at most 88.
#[inline(always)]
pub fn exp_to_88(x: f32) -> f32 {
    /// Adding it rounds to an integer, which is then in the low bits.
    const ROUND: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = x - n * LN_2_HIGH - n * LN_2_LOW;
    // Taylor's polynomial about 0 with the last coefficients moved for |r| <= ln 2 / 2 (Cephes, expf).
    let p = 1.987_569_1e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let value = p * r * r + r + 1.0;
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    value * f32::from_bits(exponent)
}

/// `ln x` with an absolute error below 2e-7 (relative where |ln x| > 1) for normal positive `x`, NaN for what is not finite.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let bits = x.to_bits();
    // The exponent that leaves the mantissa in [sqrt(1/2), sqrt(2)).
    let exponent = (bits.wrapping_sub(SQRT_HALF_BITS) as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((exponent as u32) << 23)) - 1.0;
    let e = exponent as f32;
    // Cephes, logf.
    let p = 7.037_683_6e-2;
    let p = p * m - 1.151_461e-1;
    let p = p * m + 1.167_699_9e-1;
    let p = p * m - 1.242_014_1e-1;
    let p = p * m + 1.424_932_3e-1;
    let p = p * m - 1.666_805_8e-1;
    let p = p * m + 2.000_071_5e-1;
    let p = p * m - 2.499_999_4e-1;
    let p = p * m + 3.333_333e-1;
    let square = m * m;
    let tail = m * square * p + e * LN_2_LOW - 0.5 * square;
    // The last term is 0, or NaN.
    m + tail + e * LN_2_HIGH + 0.0 * x
}

/// `ln(1 + e^x)`.
#[inline(always)]
pub fn softplus(x: f32) -> f32 {
    let positive = if x > 0.0 { x } else { 0.0 };
    positive + ln(1.0 + exp(-x.abs()))
}

/// `1 / (1 + e^-x)`.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// Cosine and sine of `turns` whole turns, with an absolute error below 2e-7 for `|turns| < 1000`.
#[inline(always)]
pub fn cos_sin_turns(turns: f32) -> (f32, f32) {
    /// Adding it rounds to an integer, which is then in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = 4.0 * turns + ROUND;
    let quadrant = shifted.to_bits();
    // Within an eighth of a turn of the nearest quadrant; the difference is exact.
    let x = (turns - 0.25 * (shifted - ROUND)) * std::f32::consts::TAU;
    let square = x * x;
    // Cephes, sinf and cosf.
    let p = -1.951_529_6e-4;
    let p = p * square + 8.332_161e-3;
    let p = p * square - 1.666_665_5e-1;
    let sin = p * square * x + x;
    let p = 2.443_315_7e-5;
    let p = p * square - 1.388_731_6e-3;
    let p = p * square + 4.166_664_6e-2;
    let cos = p * square * square - 0.5 * square + 1.0;
    let odd = quadrant & 1 != 0;
    let (c, s) = (if odd { sin } else { cos }, if odd { cos } else { sin });
    let cos_sign = quadrant.wrapping_add(1) & 2;
    let sin_sign = quadrant & 2;
    (f32::from_bits(c.to_bits() ^ (cos_sign << 30)), f32::from_bits(s.to_bits() ^ (sin_sign << 30)))
}

/// The angle of the point `(x, y)` in whole turns, in `[-1/2, 1/2]`, with a relative error below 3e-7; 0 at the origin.
#[inline(always)]
pub fn atan2_turns(y: f32, x: f32) -> f32 {
    const TAN_OF_EIGHTH: f32 = 0.414_213_57;
    let (height, width) = (y.abs(), x.abs());
    let steep = height > width;
    let (small, large) = (if steep { width } else { height }, if steep { height } else { width });
    // Beyond an eighth of a half turn, the angle against the diagonal.
    let beyond = small > TAN_OF_EIGHTH * large;
    let numerator = if beyond { small - large } else { small };
    let denominator = if beyond { small + large } else { large };
    let t = numerator / if denominator == 0.0 { 1.0 } else { denominator };
    let square = t * t;
    // Cephes, atanf.
    let p = 8.053_744_5e-2;
    let p = p * square - 1.387_768_6e-1;
    let p = p * square + 1.997_771e-1;
    let p = p * square - 3.333_295e-1;
    let turns = (p * square * t + t) * (0.5 * std::f32::consts::FRAC_1_PI);
    let turns = if beyond { 0.125 + turns } else { turns };
    let turns = if steep { 0.25 - turns } else { turns };
    let turns = if x < 0.0 { 0.5 - turns } else { turns };
    turns.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(from: f64, to: f64) -> impl Iterator<Item = f32> {
        (0..=200_000).map(move |k| (from + (to - from) * f64::from(k) / 200_000.0) as f32)
    }

    #[test]
    fn exponential_and_logarithm_are_those_of_the_library() {
        for x in grid(-86.9, 87.9) {
            let expected = f64::from(x).exp();
            assert!((f64::from(exp(x)) - expected).abs() < 2e-7 * expected, "{x}");
        }
        for x in grid(-86.0, 88.0).map(|x| f64::from(x).exp() as f32).chain(grid(0.5, 2.0)) {
            let expected = f64::from(x).ln();
            assert!((f64::from(ln(x)) - expected).abs() < 2e-7 * expected.abs().max(1.0), "{x} {} {expected}", ln(x));
        }
    }

    #[test]
    fn arguments_out_of_range_stay_finite() {
        for x in [-1e30, -88.0, 89.0, 1e30] {
            assert!(exp(x).is_finite() && exp(x) > 0.0 && softplus(x).is_finite() && sigmoid(x).is_finite());
        }
        for function in [exp, ln, softplus, sigmoid] {
            assert!(function(f32::NAN).is_nan());
        }
        for x in grid(-20.0, 20.0) {
            let expected = f64::from(x).exp().ln_1p();
            assert!((f64::from(softplus(x)) - expected).abs() < 2e-7 * expected.max(1.0));
            assert!((f64::from(sigmoid(x)) - 1.0 / (1.0 + (-f64::from(x)).exp())).abs() < 2e-7);
        }
    }

    #[test]
    fn cosine_and_sine_are_those_of_the_library() {
        for turns in grid(-2.0, 2.0).chain([0.25, 0.5, 0.75, 1.0, 999.9]) {
            let (cos, sin) = cos_sin_turns(turns);
            let (expected_sin, expected_cos) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
            assert!((f64::from(cos) - expected_cos).abs() < 2e-7, "{turns}: {cos} {expected_cos}");
            assert!((f64::from(sin) - expected_sin).abs() < 2e-7, "{turns}: {sin} {expected_sin}");
        }
    }

    #[test]
    fn angles_are_those_of_the_library() {
        for turns in grid(-0.499_999, 0.499_999).chain([1e-9, 1e-30, 0.25, 0.125, 0.062_5, 0.5]) {
            let (sin, cos) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
            for scale in [1.0, 1e-18, 1e18] {
                let (y, x) = ((scale * sin) as f32, (scale * cos) as f32);
                let expected = f64::from(y).atan2(f64::from(x)) / std::f64::consts::TAU;
                let angle = f64::from(atan2_turns(y, x));
                assert!((angle - expected).abs() <= 3e-7 * expected.abs(), "{y} {x}: {angle} {expected}");
            }
        }
        assert_eq!(atan2_turns(0.0, 0.0), 0.0);
        assert!(atan2_turns(f32::NAN, 1.0).is_nan() && atan2_turns(1.0, f32::NAN).is_nan());
    }

    #[test]
    fn dispatched_work_is_done() {
        struct Fill<'a>(&'a mut Lanes);
        impl Vectorized for Fill<'_> {
            #[inline(always)]
            fn run<S: Simd>(self, _simd: S) {
                for (k, x) in self.0.iter_mut().enumerate() {
                    *x = exp(k as f32);
                }
            }
        }
        let mut values = [0.0; LANES];
        dispatch(Fill(&mut values));
        assert_eq!(values[3], exp(3.0));
    }
}
