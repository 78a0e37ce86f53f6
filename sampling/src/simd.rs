//! Elementary functions that compilers vectorize, and the dispatch to the best instruction set.
//!
//! The functions have neither branches nor tables: in a loop over an array of fixed length they become
//! a few vector instructions on every processor. They consist of additions, multiplications, divisions
//! and comparisons, each rounded separately, so their results are bit-identical on all processors and
//! instruction sets. Only fused multiply-adds differ: the matrix products and the scaling of spline
//! bins in heads ([`Simd::mul_add_e_f32s`]), and the masses of patches of sky ([`fused`]), are fused
//! with `avx2`, `avx512` and `neon`, and rounded twice with `portable`.
//!
//! Code that uses them runs through [`dispatch`]. It must consist of plain loops and `#[inline(always)]`
//! functions: closures are not compiled for the detected processor.

use std::{ffi::OsStr, sync::LazyLock};

use glam::{Mat4, Vec4};
pub use pulp::Simd;
use pulp::{Arch, WithSimd};

use crate::error::{Error, Result};

/// The environment variable that selects the instruction set: `portable`, `avx2` or `avx512` on x86-64,
/// `portable` or `neon` on aarch64. It is read once, at the first [`dispatch`] or [`instruction_set`].
/// By default, the best set is used.
pub const VARIABLE: &str = "HEADTAIL_SIMD";

/// Samples per strip: one AVX-512 register, or two AVX2 registers.
pub const LANES: usize = 16;

/// One number of each of [`LANES`] samples.
pub type Lanes = [f32; LANES];

/// A list of quadruples, gathered at one index per sample.
pub trait Quads {
    /// Loads the first, second, third and fourth numbers of the entries at `index`; `N` is a multiple of 4.
    fn load<const N: usize>(&self, index: &[u32; N]) -> [[f32; N]; 4];
}

impl Quads for [[f32; 4]] {
    /// Four entries at a time: four loads and a transposition instead of sixteen loads.
    #[inline(always)]
    fn load<const N: usize>(&self, index: &[u32; N]) -> [[f32; N]; 4] {
        let mut out = [[0.0; N]; 4];
        for k in (0..N).step_by(4) {
            let entry = |lane: usize| Vec4::from_array(self[index[k + lane] as usize]);
            let entries = Mat4::from_cols(entry(0), entry(1), entry(2), entry(3)).transpose();
            for (out, entries) in out.iter_mut().zip([entries.x_axis, entries.y_axis, entries.z_axis, entries.w_axis]) {
                out[k..k + 4].copy_from_slice(&entries.to_array());
            }
        }
        out
    }
}

impl Quads for [[u16; 4]] {
    /// Two numbers per 32-bit word, which are unpacked for all lanes together.
    #[inline(always)]
    fn load<const N: usize>(&self, index: &[u32; N]) -> [[f32; N]; 4] {
        let (mut first, mut second) = ([0_u32; N], [0_u32; N]);
        for k in 0..N {
            let [a, b, c, d] = self[index[k] as usize].map(u32::from);
            first[k] = a | b << 16;
            second[k] = c | d << 16;
        }
        let mut out = [[0.0; N]; 4];
        for k in 0..N {
            // Through signed integers: there is no SIMD conversion of unsigned ones.
            out[0][k] = (first[k] & 0xffff) as i32 as f32;
            out[1][k] = (first[k] >> 16) as i32 as f32;
            out[2][k] = (second[k] & 0xffff) as i32 as f32;
            out[3][k] = (second[k] >> 16) as i32 as f32;
        }
        out
    }
}

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

/// An instruction set of this processor.
#[derive(Clone, Copy)]
struct InstructionSet {
    name: &'static str,
    arch: Arch,
}

/// The set that work is dispatched to, and the error in [`VARIABLE`], if any: the best set is used then.
static CHOSEN: LazyLock<(InstructionSet, Option<String>)> =
    LazyLock::new(|| match choose(std::env::var_os(VARIABLE).as_deref()) {
        Ok(set) => (set, None),
        Err(reason) => (available()[0], Some(reason)),
    });

/// The instruction sets of this processor, the best first.
fn available() -> Vec<InstructionSet> {
    let mut found = Vec::new();
    #[cfg(target_arch = "x86_64")]
    {
        found.extend(pulp::x86::V4::try_new().map(|v4| InstructionSet { name: "avx512", arch: Arch::V4(v4) }));
        found.extend(pulp::x86::V3::try_new().map(|v3| InstructionSet { name: "avx2", arch: Arch::V3(v3) }));
    }
    #[cfg(target_arch = "aarch64")]
    found.extend(pulp::aarch64::Neon::try_new().map(|neon| InstructionSet { name: "neon", arch: Arch::Neon(neon) }));
    found.push(InstructionSet { name: "portable", arch: Arch::Scalar });
    found
}

/// Returns the set called `wanted`, or the best one; the error describes what is wrong with [`VARIABLE`].
fn choose(wanted: Option<&OsStr>) -> std::result::Result<InstructionSet, String> {
    let found = available();
    let Some(wanted) = wanted else { return Ok(found[0]) };
    found.iter().copied().find(|set| wanted == set.name).ok_or_else(|| {
        let names: Vec<_> = found.iter().map(|set| set.name).collect();
        format!("{wanted:?} is not an instruction set of this processor; choose one of {}", names.join(", "))
    })
}

/// The name of the instruction set that work is dispatched to; see [`VARIABLE`].
///
/// # Errors
/// [`Error::Argument`] if [`VARIABLE`] names a set that is unknown or that this processor lacks.
/// Programs should call this first: [`dispatch`] cannot report the error and uses the best set.
pub fn instruction_set() -> Result<&'static str> {
    match &*CHOSEN {
        (set, None) => Ok(set.name),
        (_, Some(reason)) => Err(Error::argument(VARIABLE, reason)),
    }
}

/// Runs work with the processor's best instruction set, or the one that [`VARIABLE`] names.
pub fn dispatch(work: impl Vectorized) {
    CHOSEN.0.arch.dispatch(Op(work));
}

/// Runs part of other work as a separate function, compiled once per instruction set.
#[inline(always)]
pub fn call<S: Simd>(simd: S, work: impl Vectorized) {
    simd.vectorize(Op(work));
}

/// `a * b + c`, rounded once if the instruction set has a fused multiply-add, else twice.
#[inline(always)]
pub fn fused<S: Simd>(_simd: S, a: f32, b: f32, c: f32) -> f32 {
    // Without the instruction, `mul_add` is a function call.
    if S::F32_LANES > 1 { a.mul_add(b, c) } else { a * b + c }
}

/// `e^x` with a relative error below 2e-7 for `x` in `[-87, 88]`; other arguments are clamped.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    exp_to_88(if x > 88.0 { 88.0 } else { x })
}

/// [`exp`] of arguments of at most 88.
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
    // Taylor polynomial about 0 with the last coefficients adjusted for |r| <= ln 2 / 2 (Cephes, expf).
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

/// `ln x` with an absolute error below 2e-7 (relative where |ln x| > 1) for normal positive `x`; NaN
/// for `x` that is not finite.
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
    // Within 1/8 turn of the nearest quadrant; the difference is exact.
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

/// The angle of the point `(x, y)` in whole turns, in `[-1/2, 1/2]`, with a relative error below 3e-7;
/// 0 at the origin.
#[inline(always)]
pub fn atan2_turns(y: f32, x: f32) -> f32 {
    const TAN_OF_EIGHTH: f32 = 0.414_213_57;
    let (height, width) = (y.abs(), x.abs());
    let steep = height > width;
    let (small, large) = (if steep { width } else { height }, if steep { height } else { width });
    // Beyond 22.5 degrees, use the angle to the diagonal.
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
mod tests;
