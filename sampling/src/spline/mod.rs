//! Monotone rational-quadratic splines on `[0,1]` (Durkan et al. 2019, after Gregory and Delbourgo 1982) and
//! on the circle (Rezende et al. 2020), implemented without a tensor library.
//!
//! `L` splines are evaluated at one point each: one, [`LANES`](crate::simd::LANES) of f32 in SIMD registers,
//! or f64 for checks. Inline the functions into work that [`simd::dispatch`](crate::simd::dispatch) runs, so
//! that the loops over lanes become vector instructions.
//!
//! # Logits
//!
//! A spline of `K` bins has `3K + 1` logits, in this order:
//!
//! | topology | `0..K` | `K..2K` | then | last |
//! |---|---|---|---|---|
//! | [`Topology::Interval`] | widths | heights | `2K..3K+1`: slopes at the knots `0..=K` | |
//! | [`Topology::Circle`] | widths | heights | `2K..3K`: slopes at the knots `0..K`; knot `K` has the slope of knot 0 | `3K`: shift |
//!
//! - widths and heights: `MIN_BIN + (1 - K MIN_BIN) softmax(logits)`; left knots are their exclusive running sums;
//! - slopes: `MIN_SLOPE + softplus(logit + SLOPE_OFFSET)`, so that a zero logit is slope 1;
//! - shift: the circle is turned by `x = wrap(wrap(y) + (logit - round(logit)))` before the spline, in whole turns per unit.
//!
//! **All-zero logits are the identity.** The shift is the logit itself, not a bounded function of it, so that
//! a lobe can travel around the circle any number of times and the gradient never saturates. Subtracting the
//! nearest integer is exact in floating point and keeps the sum in a range where its rounding error is below
//! 1.2e-7.

mod gradient;
mod real;
#[cfg(test)]
mod tests;

pub use gradient::{Evaluation, Gradient, inverse_with_gradient};
pub use real::Real;

/// Floor of a bin's width and height: it caps a one-dimensional density at about 1e4 and leaves dark bins small.
pub const MIN_BIN: f64 = 1e-4;
/// Floor of a slope at a knot.
pub const MIN_SLOPE: f64 = 1e-4;
/// `ln(e^(1 - MIN_SLOPE) - 1)`: makes a zero logit the slope 1.
pub const SLOPE_OFFSET: f64 = 0.541_166_652_338_531_1;

/// How the two ends of a coordinate are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topology {
    /// Two ends, each with its own slope.
    Interval,
    /// The ends are one point: the density is continuous across it.
    Circle,
}

/// Number of logits of a spline of `bins` bins, the same for both topologies.
pub const fn logit_count(bins: usize) -> usize {
    3 * bins + 1
}

/// Number of bins of a spline that has `logits` logits.
pub const fn bin_count(logits: usize) -> usize {
    (logits - 1) / 3
}

/// The logits of several splines, columns of a row-major matrix.
#[derive(Clone, Copy, Debug)]
pub struct Logits<'a, R> {
    /// Number of bins of each spline.
    pub bins: usize,
    /// Logit `k` of spline `l` is `values[k * stride + first + l]`.
    pub values: &'a [R],
    /// Distance from one logit of a spline to the next.
    pub stride: usize,
    /// The first spline's column.
    pub first: usize,
}

impl<'a, R> Logits<'a, R> {
    /// `L` splines of `3K + 1` logits each, `[3K + 1, L]`.
    #[inline(always)]
    pub fn strip<const L: usize>(logits: &'a [[R; L]]) -> Self {
        Self { bins: bin_count(logits.len()), values: logits.as_flattened(), stride: L, first: 0 }
    }

    #[inline(always)]
    fn row<const L: usize>(&self, k: usize) -> &'a [R; L] {
        self.values[k * self.stride + self.first..].first_chunk().expect("one column per lane")
    }
}

/// Evaluates the density direction `y -> (z, dz/dy)`, in closed form. `y` is clamped (interval) or wrapped
/// (circle).
///
/// `scratch` has at least `2 K` rows, and is overwritten.
///
/// # Panics
/// If the logits or the scratch rows are too few.
#[inline(always)]
pub fn inverse<R: Real, const L: usize>(
    topology: Topology,
    logits: Logits<'_, R>,
    scratch: &mut [[R; L]],
    y: &[R; L],
) -> ([R; L], [R; L]) {
    let x = turned(topology, logits, y);
    let [across, up] = axes(logits, scratch);
    let bin = locate(topology, logits, [across, up], &x);
    let (mut z, mut slopes) = ([R::ZERO; L], [R::ZERO; L]);
    for l in 0..L {
        let (d0, d1) = (slope(bin.slopes[0][l]), slope(bin.slopes[1][l]));
        let t = unit((x[l] - bin.left[l]) / bin.width[l]);
        let (value, by_t) = rational_quadratic(t, bin.height[l] / bin.width[l], d0, d1);
        z[l] = unit(bin.bottom[l] + bin.height[l] * value);
        slopes[l] = by_t;
    }
    (z, slopes)
}

/// Evaluates the sampling direction `z -> (y, dz/dy)`, by the quadratic's root. The derivative is the density
/// at `y`. `z` is clamped; `y` is in `[0, 1)`.
///
/// `scratch` has at least `2 K` rows, and is overwritten.
///
/// # Panics
/// If the logits or the scratch rows are too few.
#[inline(always)]
pub fn forward<R: Real, const L: usize>(
    topology: Topology,
    logits: Logits<'_, R>,
    scratch: &mut [[R; L]],
    z: &[R; L],
) -> ([R; L], [R; L]) {
    let mut at = [R::ZERO; L];
    for l in 0..L {
        at[l] = unit(z[l]);
    }
    let [across, up] = axes(logits, scratch);
    // With the axes exchanged: the bin's left end is its bottom.
    let bin = locate(topology, logits, [up, across], &at);
    let (mut y, mut slopes) = ([R::ZERO; L], [R::ZERO; L]);
    for l in 0..L {
        let (d0, d1) = (slope(bin.slopes[0][l]), slope(bin.slopes[1][l]));
        let (width, height) = (bin.height[l], bin.width[l]);
        let s = height / width;
        let t = solve(unit((at[l] - bin.left[l]) / height), s, d0, d1);
        y[l] = bin.bottom[l] + width * t;
        slopes[l] = rational_quadratic(t, s, d0, d1).1;
    }
    match topology {
        Topology::Interval => {
            for y in &mut y {
                *y = if *y > R::BELOW_ONE { R::BELOW_ONE } else { *y };
            }
        }
        Topology::Circle => {
            let shift = shift::<R, L>(logits);
            for l in 0..L {
                let x = if y[l] > R::ONE { R::ONE } else { y[l] };
                y[l] = wrap(x - shift[l]);
            }
        }
    }
    (y, slopes)
}

/// Returns the position of each point on the width axis, in `[0, 1]`.
#[inline(always)]
fn turned<R: Real, const L: usize>(topology: Topology, logits: Logits<'_, R>, y: &[R; L]) -> [R; L] {
    let mut x = [R::ZERO; L];
    match topology {
        Topology::Interval => {
            for l in 0..L {
                x[l] = unit(y[l]);
            }
        }
        Topology::Circle => {
            let shift = shift::<R, L>(logits);
            for l in 0..L {
                x[l] = wrap(wrap(y[l]) + shift[l]);
            }
        }
    }
    x
}

/// Returns the rotation of the circle, in turns.
#[inline(always)]
fn shift<R: Real, const L: usize>(logits: Logits<'_, R>) -> [R; L] {
    let mut shift = *logits.row(3 * logits.bins);
    for turns in &mut shift {
        *turns = *turns - turns.round();
    }
    shift
}

/// Bin sizes along one axis: exponentials relative to the largest, and the scale that makes them sizes above
/// the floor.
#[derive(Clone, Copy)]
struct Axis<'a, R, const L: usize> {
    exponentials: &'a [[R; L]],
    scale: [R; L],
}

/// Computes widths and heights; their exponentials are in the scratch rows.
#[inline(always)]
fn axes<'a, R: Real, const L: usize>(logits: Logits<'_, R>, scratch: &'a mut [[R; L]]) -> [Axis<'a, R, L>; 2] {
    let (widths, heights) = scratch[..2 * logits.bins].split_at_mut(logits.bins);
    let scales = [softmax(logits, 0, widths), softmax(logits, logits.bins, heights)];
    [Axis { exponentials: widths, scale: scales[0] }, Axis { exponentials: heights, scale: scales[1] }]
}

/// Computes the exponentials of the rows from `row` on; returns their scale.
#[inline(always)]
fn softmax<R: Real, const L: usize>(logits: Logits<'_, R>, row: usize, out: &mut [[R; L]]) -> [R; L] {
    let mut largest = *logits.row::<L>(row);
    for k in 1..out.len() {
        let logits = logits.row::<L>(row + k);
        for l in 0..L {
            largest[l] = if logits[l] > largest[l] { logits[l] } else { largest[l] };
        }
    }
    let mut total = [R::ZERO; L];
    for (k, out) in out.iter_mut().enumerate() {
        // A copy, because compilers would otherwise check whether the two overlap.
        let mut e = *logits.row::<L>(row + k);
        for l in 0..L {
            e[l] = (e[l] - largest[l]).exp_of_negative();
            total[l] = total[l] + e[l];
        }
        *out = e;
    }
    let free = free_fraction::<R>(out.len());
    let mut scale = [R::ZERO; L];
    for l in 0..L {
        scale[l] = free / total[l];
    }
    scale
}

/// Returns the fraction that the floors of all bins leave.
#[inline(always)]
fn free_fraction<R: Real>(bins: usize) -> R {
    R::of(1.0 - bins as f64 * MIN_BIN)
}

/// Each point's bin: its first knot on both axes, its sizes, and the logits of the slopes at its two knots.
struct Bin<R, const L: usize> {
    left: [R; L],
    bottom: [R; L],
    width: [R; L],
    height: [R; L],
    slopes: [[R; L]; 2],
}

/// Number of lanes for which the search for bins fits the registers of AVX2.
const PART: usize = 8;

/// Finds the bin of each point along the first axis.
#[inline(always)]
fn locate<R: Real, const L: usize>(
    topology: Topology,
    logits: Logits<'_, R>,
    axes: [Axis<'_, R, L>; 2],
    at: &[R; L],
) -> Bin<R, L> {
    let zero = [R::ZERO; L];
    let mut bin = Bin { left: zero, bottom: zero, width: zero, height: zero, slopes: [zero; 2] };
    let mut lane = 0;
    while lane + PART <= L {
        locate_part::<R, L, PART>(topology, logits, axes, at, lane, &mut bin);
        lane += PART;
    }
    while lane < L {
        locate_part::<R, L, 1>(topology, logits, axes, at, lane, &mut bin);
        lane += 1;
    }
    bin
}

/// Performs [`locate`] for `P` points from `lane` on: each takes the last bin whose start it has reached.
#[inline(always)]
fn locate_part<R: Real, const L: usize, const P: usize>(
    topology: Topology,
    logits: Logits<'_, R>,
    [first, second]: [Axis<'_, R, L>; 2],
    at: &[R; L],
    lane: usize,
    out: &mut Bin<R, L>,
) {
    // Local arrays, because compilers keep them in registers, unlike fields.
    let zero = [R::ZERO; P];
    let (mut left, mut bottom) = (zero, zero);
    let (mut bin_left, mut bin_bottom, mut bin_width, mut bin_height) = (zero, zero, zero, zero);
    let (mut bin_slope, mut bin_next) = (zero, zero);
    let (at, first_scale, second_scale): ([R; P], [R; P], [R; P]) =
        (*part(at, lane), *part(&first.scale, lane), *part(&second.scale, lane));
    let (bins, least) = (logits.bins, R::of(MIN_BIN));
    let first_slope = 2 * bins * logits.stride + logits.first + lane;
    for k in 0..bins {
        let own: &[R; P] = part(logits.values, first_slope + k * logits.stride);
        let next: &[R; P] = part(logits.values, first_slope + right_knot(topology, bins, k) * logits.stride);
        let of_first: &[R; P] = part(&first.exponentials[k], lane);
        let of_second: &[R; P] = part(&second.exponentials[k], lane);
        for l in 0..P {
            let width = least + of_first[l] * first_scale[l];
            let height = least + of_second[l] * second_scale[l];
            let reached = at[l] >= left[l];
            bin_left[l] = R::select(reached, left[l], bin_left[l]);
            bin_bottom[l] = R::select(reached, bottom[l], bin_bottom[l]);
            bin_width[l] = R::select(reached, width, bin_width[l]);
            bin_height[l] = R::select(reached, height, bin_height[l]);
            bin_slope[l] = R::select(reached, own[l], bin_slope[l]);
            bin_next[l] = R::select(reached, next[l], bin_next[l]);
            left[l] = left[l] + width;
            bottom[l] = bottom[l] + height;
        }
    }
    let lanes = lane..lane + P;
    out.left[lanes.clone()].copy_from_slice(&bin_left);
    out.bottom[lanes.clone()].copy_from_slice(&bin_bottom);
    out.width[lanes.clone()].copy_from_slice(&bin_width);
    out.height[lanes.clone()].copy_from_slice(&bin_height);
    out.slopes[0][lanes.clone()].copy_from_slice(&bin_slope);
    out.slopes[1][lanes].copy_from_slice(&bin_next);
}

/// Returns `P` numbers from `first` on.
#[inline(always)]
fn part<R, const P: usize>(numbers: &[R], first: usize) -> &[R; P] {
    numbers[first..].first_chunk().expect("enough numbers")
}

/// Returns the knot at the right of a bin: on the circle, the last is the first.
#[inline(always)]
fn right_knot(topology: Topology, bins: usize, bin: usize) -> usize {
    if topology == Topology::Circle && bin + 1 == bins { 0 } else { bin + 1 }
}

/// Returns the value in a bin at `t`, both in `[0, 1]`, and the slope there (Durkan et al. 2019, eq. 4 and
/// 5); `s` is the secant.
///
/// Denominator and slope are positive: the weights of `n` are non-negative and sum to 1 over three positive
/// values, and `d >= s / 2`, because `t (1 - t) <= 1/4`.
#[inline(always)]
fn rational_quadratic<R: Real>(t: R, s: R, d0: R, d1: R) -> (R, R) {
    let two = R::of(2.0);
    let o = R::ONE - t;
    let n = d1 * t * t + two * s * t * o + d0 * o * o;
    let d = s * (R::ONE - two * t * o) + (d0 + d1) * t * o;
    let by_d = R::ONE / d;
    let ratio = s * by_d;
    ((s * t + d0 * o) * t * by_d, ratio * ratio * n)
}

/// Returns the position at which a bin has a value, both in `[0, 1]`: the root of `a t^2 + b t - c` in the
/// form without cancellation for either sign of `b`. The discriminant is written as a sum of non-negative
/// terms.
#[inline(always)]
fn solve<R: Real>(value: R, s: R, d0: R, d1: R) -> R {
    let two = R::of(2.0);
    let o = R::ONE - value;
    let b = d0 - (d0 + d1 - two * s) * value;
    let ends = d0 * o - d1 * value;
    let root = (ends * ends + R::of(4.0) * s * s * value * o).sqrt();
    let positive = b >= R::ZERO;
    let over = R::select(positive, two * s * value, root - b);
    let under = R::select(positive, b + root, two * (s - b));
    unit(over / under)
}

/// Returns the softplus with a floor, 1 for a zero logit.
#[inline(always)]
fn slope<R: Real>(logit: R) -> R {
    R::of(MIN_SLOPE) + (logit + R::of(SLOPE_OFFSET)).softplus()
}

/// Clamps to `[0, 1]`.
#[inline(always)]
fn unit<R: Real>(x: R) -> R {
    let x = if x < R::ZERO { R::ZERO } else { x };
    if x > R::ONE { R::ONE } else { x }
}

/// Wraps to `[0, 1)`; the last step is needed because `x - floor(x)` rounds to 1 for a tiny negative `x`.
#[inline(always)]
fn wrap<R: Real>(x: R) -> R {
    let fraction = x - x.floor();
    if fraction >= R::ONE { R::ZERO } else { fraction }
}
