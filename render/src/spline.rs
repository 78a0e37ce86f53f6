//! Rational-quadratic splines of [`LANES`] samples at once, each sample with a spline of its own.

use crate::{
    discrete::BELOW_ONE,
    simd::{self, LANES, Lanes, Simd, Vectorized},
};

/// Floor of a bin's width and height.
const MIN_BIN: f32 = 1e-4;
/// Floor of a slope.
const MIN_SLOPE: f32 = 1e-4;
/// `ln(e^(1 - MIN_SLOPE) - 1)`: makes a zero logit the slope 1.
const SLOPE_OFFSET: f32 = 0.541_166_65;

/// What a coordinate's two ends are to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topology {
    /// Two ends, with slopes of their own.
    Interval,
    /// One point.
    Circle,
}

/// Which way a spline is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
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
pub fn evaluate<S: Simd>(
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
    fn run<S: Simd>(self, simd: S) {
        *self.out = warp(simd, self.topology, self.direction, self.logits, self.at);
    }
}

#[inline(always)]
fn warp<S: Simd>(
    simd: S,
    topology: Topology,
    direction: Direction,
    logits: &mut [Lanes],
    at: &Lanes,
) -> (Lanes, Lanes) {
    let bins = (logits.len() - 1) / 3;
    let mut shift = [0.0; LANES];
    let mut at = *at;
    for at in &mut at {
        *at = at.clamp(0.0, 1.0);
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
    let across = Axis { exponentials: widths, scale: &width_scale };
    let up = Axis { exponentials: heights, scale: &height_scale };
    let bin = match direction {
        Direction::Forward => locate(simd, up, across, slopes, &at).swapped(),
        Direction::Inverse => locate(simd, across, up, slopes, &at),
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

/// Exponentials of an axis's logits, and what makes them sizes above the floor.
#[derive(Clone, Copy)]
struct Axis<'a> {
    exponentials: &'a [Lanes],
    scale: &'a Lanes,
}

/// The bin in which `at` lies along the first axis: the last one whose start it has reached.
#[inline(always)]
fn locate<S: Simd>(simd: S, first: Axis<'_>, second: Axis<'_>, slopes: &[Lanes], at: &Lanes) -> Bins {
    let zero = [0.0; LANES];
    let mut bins = Bins { left: zero, bottom: zero, width: zero, height: zero, slopes: [zero; 2] };
    for register in 0..LANES / S::F32_LANES {
        locate_in_register(simd, register, (first, second), slopes, at, &mut bins);
    }
    bins
}

/// [`locate`] for the lanes of one register. Written with explicit instructions: compilers make a choice between seven pairs of arrays a
/// branch for each lane.
#[inline(always)]
fn locate_in_register<S: Simd>(
    simd: S,
    register: usize,
    (first, second): (Axis<'_>, Axis<'_>),
    slopes: &[Lanes],
    at: &Lanes,
    out: &mut Bins,
) {
    let load = |lanes: &Lanes| S::as_simd_f32s(lanes).0[register];
    let zero = simd.splat_f32s(0.0);
    let least = simd.splat_f32s(MIN_BIN);
    let (at, first_scale, second_scale) = (load(at), load(first.scale), load(second.scale));
    let (mut left, mut bottom) = (zero, zero);
    let mut bin = [zero; 6];
    let knots = slopes.iter().zip(&slopes[1..]);
    for ((of_first, of_second), (slope, next)) in first.exponentials.iter().zip(second.exponentials).zip(knots) {
        let width = simd.mul_add_e_f32s(load(of_first), first_scale, least);
        let height = simd.mul_add_e_f32s(load(of_second), second_scale, least);
        let reached = simd.greater_than_or_equal_f32s(at, left);
        let here = [left, bottom, width, height, load(slope), load(next)];
        for k in 0..6 {
            bin[k] = simd.select_f32s(reached, here[k], bin[k]);
        }
        left = simd.add_f32s(left, width);
        bottom = simd.add_f32s(bottom, height);
    }
    let [d0, d1] = &mut out.slopes;
    for (lanes, found) in [&mut out.left, &mut out.bottom, &mut out.width, &mut out.height, d0, d1].into_iter().zip(bin)
    {
        S::as_mut_simd_f32s(lanes).0[register] = found;
    }
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
