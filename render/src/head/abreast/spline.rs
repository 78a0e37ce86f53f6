//! Rational-quadratic splines of [`LANES`] samples at once, each sample with a spline of its own: what
//! [`Spline`](crate::head::Spline) does, without a branch.

use crate::{
    head::{
        Topology,
        spline::{BELOW_ONE, MIN_BIN, MIN_SLOPE, SLOPE_OFFSET},
    },
    simd::{self, LANES, Lanes, Simd, Vectorized},
};

/// Which way a spline is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    /// `z -> y`, sampling.
    Forward,
    /// `y -> z`, the density direction.
    Inverse,
}

/// Each sample's bin: its left knot on both axes, its sizes, and the logits of the slopes at its two knots.
struct Bins {
    left: Lanes,
    bottom: Lanes,
    width: Lanes,
    height: Lanes,
    slopes: [Lanes; 2],
}

/// Carries `at` through the splines of the logits (`[3K + 1, LANES]`, which are overwritten); gives the images, and
/// `|dz/dy|` there.
#[inline(always)]
pub(super) fn evaluate<S: Simd>(
    simd: S,
    topology: Topology,
    direction: Direction,
    logits: &mut [Lanes],
    at: &Lanes,
) -> (Lanes, Lanes) {
    let mut out = ([0.0; LANES], [0.0; LANES]);
    simd::call(simd, Evaluate { topology, direction, logits, at, out: &mut out });
    out
}

struct Evaluate<'a> {
    topology: Topology,
    direction: Direction,
    logits: &'a mut [Lanes],
    at: &'a Lanes,
    out: &'a mut (Lanes, Lanes),
}

impl Vectorized for Evaluate<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        *self.out = warp(self.topology, self.direction, self.logits, self.at);
    }
}

#[inline(always)]
fn warp(topology: Topology, direction: Direction, logits: &mut [Lanes], at: &Lanes) -> (Lanes, Lanes) {
    let bins = (logits.len() - 1) / 3;
    let mut shift = [0.0; LANES];
    let mut at = *at;
    for l in 0..LANES {
        at[l] = at[l].clamp(0.0, 1.0);
    }
    if topology == Topology::Circle {
        let turns = &logits[3 * bins];
        for l in 0..LANES {
            shift[l] = turns[l] - turns[l].round_ties_even();
        }
        if direction == Direction::Inverse {
            for l in 0..LANES {
                at[l] = wrap(wrap(at[l]) + shift[l]);
            }
        }
        // The last knot is the first.
        logits[3 * bins] = logits[2 * bins];
    }
    let (widths, rest) = logits.split_at_mut(bins);
    let (heights, slopes) = rest.split_at_mut(bins);
    let (width_scale, height_scale) = (softmax(widths), softmax(heights));
    let bin = match direction {
        Direction::Forward => locate((heights, &height_scale), (widths, &width_scale), slopes, &at).swapped(),
        Direction::Inverse => locate((widths, &width_scale), (heights, &height_scale), slopes, &at),
    };
    match direction {
        Direction::Forward => bin.forward(topology, &at, &shift),
        Direction::Inverse => bin.inverse(&at),
    }
}

impl Bins {
    /// With the axes exchanged.
    #[inline(always)]
    fn swapped(self) -> Self {
        Self { left: self.bottom, bottom: self.left, width: self.height, height: self.width, slopes: self.slopes }
    }

    #[inline(always)]
    fn forward(&self, topology: Topology, z: &Lanes, shift: &Lanes) -> (Lanes, Lanes) {
        let (mut out, mut slopes) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let (d0, d1) = (slope(self.slopes[0][l]), slope(self.slopes[1][l]));
            let s = self.height[l] / self.width[l];
            let value = ((z[l] - self.bottom[l]) / self.height[l]).clamp(0.0, 1.0);
            // The root of a quadratic, in the form in which nothing cancels for either sign of `b`.
            let o = 1.0 - value;
            let b = d0 - (d0 + d1 - 2.0 * s) * value;
            let ends = d0 * o - d1 * value;
            let root = (ends * ends + 4.0 * s * s * value * o).sqrt();
            let (over, under) = if b >= 0.0 { (2.0 * s * value, b + root) } else { (root - b, 2.0 * (s - b)) };
            let t = (over / under).clamp(0.0, 1.0);
            let x = self.left[l] + self.width[l] * t;
            let x = if x > 1.0 { 1.0 } else { x };
            out[l] = match topology {
                Topology::Interval => {
                    if x > BELOW_ONE {
                        BELOW_ONE
                    } else {
                        x
                    }
                }
                Topology::Circle => wrap(x - shift[l]),
            };
            slopes[l] = evaluate_bin(t, s, d0, d1).1;
        }
        (out, slopes)
    }

    #[inline(always)]
    fn inverse(&self, x: &Lanes) -> (Lanes, Lanes) {
        let (mut out, mut slopes) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let (d0, d1) = (slope(self.slopes[0][l]), slope(self.slopes[1][l]));
            let t = ((x[l] - self.left[l]) / self.width[l]).clamp(0.0, 1.0);
            let (value, by_t) = evaluate_bin(t, self.height[l] / self.width[l], d0, d1);
            out[l] = (self.bottom[l] + self.height[l] * value).clamp(0.0, 1.0);
            slopes[l] = by_t;
        }
        (out, slopes)
    }
}

/// The value in a bin at `t`, both in `[0, 1]`, and the slope there (Durkan et al. 2019, eq. 4 and 5). `s` is the secant.
#[inline(always)]
fn evaluate_bin(t: f32, s: f32, d0: f32, d1: f32) -> (f32, f32) {
    let o = 1.0 - t;
    let n = d1 * t * t + 2.0 * s * t * o + d0 * o * o;
    let d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o;
    let by_d = 1.0 / d;
    let ratio = s * by_d;
    ((s * t + d0 * o) * t * by_d, ratio * ratio * n)
}

/// Replaces logits by their exponentials over the largest one's; gives what these are multiplied with to be sizes above the floor.
#[inline(always)]
fn softmax(logits: &mut [Lanes]) -> Lanes {
    let free = 1.0 - logits.len() as f32 * MIN_BIN;
    let mut largest = [f32::NEG_INFINITY; LANES];
    for logits in &*logits {
        for l in 0..LANES {
            largest[l] = if logits[l] > largest[l] { logits[l] } else { largest[l] };
        }
    }
    let mut total = [0.0; LANES];
    for logits in logits {
        for l in 0..LANES {
            let e = simd::exp(logits[l] - largest[l]);
            logits[l] = e;
            total[l] += e;
        }
    }
    let mut scale = [0.0; LANES];
    for l in 0..LANES {
        scale[l] = free / total[l];
    }
    scale
}

/// The bin in which `at` lies along the first axis: the last one whose start it has reached.
#[inline(always)]
fn locate(first: (&[Lanes], &Lanes), second: (&[Lanes], &Lanes), slopes: &[Lanes], at: &Lanes) -> Bins {
    let zero = [0.0; LANES];
    let mut bin = Bins { left: zero, bottom: zero, width: zero, height: zero, slopes: [zero; 2] };
    let (mut left, mut bottom) = (zero, zero);
    let knots = slopes.iter().zip(&slopes[1..]);
    for ((first_e, second_e), (slope, next)) in first.0.iter().zip(second.0).zip(knots) {
        for l in 0..LANES {
            let width = MIN_BIN + first_e[l] * first.1[l];
            let height = MIN_BIN + second_e[l] * second.1[l];
            let reached = at[l] >= left[l];
            bin.left[l] = if reached { left[l] } else { bin.left[l] };
            bin.bottom[l] = if reached { bottom[l] } else { bin.bottom[l] };
            bin.width[l] = if reached { width } else { bin.width[l] };
            bin.height[l] = if reached { height } else { bin.height[l] };
            bin.slopes[0][l] = if reached { slope[l] } else { bin.slopes[0][l] };
            bin.slopes[1][l] = if reached { next[l] } else { bin.slopes[1][l] };
            left[l] += width;
            bottom[l] += height;
        }
    }
    bin
}

/// Softplus with a floor, 1 for a zero logit.
#[inline(always)]
fn slope(logit: f32) -> f32 {
    MIN_SLOPE + simd::softplus(logit + SLOPE_OFFSET)
}

/// Onto `[0, 1)`.
#[inline(always)]
fn wrap(x: f32) -> f32 {
    let fraction = x - x.floor();
    if fraction >= 1.0 { 0.0 } else { fraction }
}
