//! The log-density of one spline and its analytic gradient with respect to the logits, for one point at a time on the host.
//!
//! The same mathematics as [`inverse`](super::inverse), which stays the reference: a training step evaluates this form outside of
//! the tensor library's graph and injects the gradient at the logits. The cost per point is one search and some sixty
//! operations; everything that depends on the spline alone is done once, in [`AnalyticSpline::prepare`] and
//! [`LogitGradient::finish`].

use super::{MIN_BIN, MIN_SLOPE, Topology, bin_count, slope_offset};

/// A spline with its constraints applied, ready for points.
#[derive(Clone, Debug)]
pub struct AnalyticSpline {
    topology: Topology,
    widths: Sizes,
    heights: Sizes,
    /// Left knots on the width axis.
    knots: Vec<f32>,
    /// Slope logits plus offset; `K + 1` of them, on the circle the last is the first.
    slope_arguments: Vec<f32>,
    shift: f32,
}

/// Bin sizes along one axis and the softmax that they come from.
#[derive(Clone, Debug, Default)]
struct Sizes {
    probabilities: Vec<f32>,
    sizes: Vec<f32>,
}

/// The log-density at one point and its derivatives with respect to the constrained parameters of its bin.
#[derive(Clone, Copy, Debug)]
pub struct LogDensity {
    /// `ln |dz/dy|`.
    pub value: f32,
    bin: usize,
    by_left_slope: f32,
    by_right_slope: f32,
    by_width: f32,
    by_height: f32,
    /// With respect to the knot at the left of the bin; with respect to the point and the shift it is the negative of this.
    by_left_knot: f32,
}

/// Weighted sums of derivatives over the points of one spline.
#[derive(Clone, Debug)]
pub struct LogitGradient {
    widths: Vec<f32>,
    heights: Vec<f32>,
    left_knots: Vec<f32>,
    slopes: Vec<f32>,
    shift: f32,
}

impl AnalyticSpline {
    /// An identity spline of `bins` bins whose buffers [`prepare`](Self::prepare) reuses.
    pub fn new(topology: Topology, bins: usize) -> Self {
        let mut spline = Self {
            topology,
            widths: Sizes::default(),
            heights: Sizes::default(),
            knots: Vec::with_capacity(bins),
            slope_arguments: Vec::with_capacity(bins + 1),
            shift: 0.0,
        };
        spline.prepare(&vec![0.0; super::logit_count(bins)]);
        spline
    }

    /// Takes the `3K + 1` logits of a spline, in the order of the [module](super)'s table.
    pub fn prepare(&mut self, logits: &[f32]) {
        let bins = bin_count(logits.len());
        self.widths.prepare(&logits[..bins]);
        self.heights.prepare(&logits[bins..2 * bins]);
        let mut left = 0.0;
        self.knots.clear();
        self.knots.extend(self.widths.sizes.iter().map(|width| {
            let knot = left;
            left += width;
            knot
        }));
        let offset = slope_offset() as f32;
        self.slope_arguments.clear();
        self.slope_arguments.extend(logits[2 * bins..].iter().map(|logit| logit + offset));
        self.shift = 0.0;
        if self.topology == Topology::Circle {
            let turns = logits[3 * bins];
            self.shift = turns - turns.round();
            self.slope_arguments[bins] = self.slope_arguments[0];
        }
    }

    /// The log-density at `y`, with derivatives.
    pub fn log_density(&self, y: f32) -> LogDensity {
        let x = match self.topology {
            Topology::Interval => y.clamp(0.0, 1.0),
            Topology::Circle => wrap(wrap(y) + self.shift),
        };
        let bin = self.knots[1..].iter().filter(|&&knot| x >= knot).count();
        let width = self.widths.sizes[bin];
        let t = ((x - self.knots[bin]) / width).clamp(0.0, 1.0);
        let o = 1.0 - t;
        let s = self.heights.sizes[bin] / width;
        let (d0, d1) = (slope(self.slope_arguments[bin]), slope(self.slope_arguments[bin + 1]));
        // N and D are positive: see `Segment::log_slope` and `Segment::denominator`.
        let n = d1 * t * t + 2.0 * s * t * o + d0 * o * o;
        let d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o;
        let by_secant = 2.0 / s + 2.0 * t * o / n - 2.0 * (1.0 - 2.0 * t * o) / d;
        let by_position =
            2.0 * (d1 * t + s * (1.0 - 2.0 * t) - d0 * o) / n - 2.0 * (d0 + d1 - 2.0 * s) * (1.0 - 2.0 * t) / d;
        LogDensity {
            value: 2.0 * s.ln() + n.ln() - 2.0 * d.ln(),
            bin,
            by_left_slope: o * o / n - 2.0 * t * o / d,
            by_right_slope: t * t / n - 2.0 * t * o / d,
            by_width: -(by_secant * s + by_position * t) / width,
            by_height: by_secant / width,
            by_left_knot: -by_position / width,
        }
    }
}

impl Sizes {
    fn prepare(&mut self, logits: &[f32]) {
        let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        self.probabilities.clear();
        self.probabilities.extend(logits.iter().map(|logit| (logit - largest).exp()));
        let total: f32 = self.probabilities.iter().sum();
        let free = free_fraction(logits.len());
        self.sizes.clear();
        for probability in &mut self.probabilities {
            *probability /= total;
            self.sizes.push(MIN_BIN as f32 + free * *probability);
        }
    }

    /// Chain rule through floor and softmax, added to `out`: `du_i = (1 - K m) p_i (g_i - sum_j p_j g_j)`.
    fn backward(&self, by_size: &[f32], out: &mut [f32]) {
        let mean: f32 = self.probabilities.iter().zip(by_size).map(|(p, g)| p * g).sum();
        let free = free_fraction(by_size.len());
        for ((out, p), g) in out.iter_mut().zip(&self.probabilities).zip(by_size) {
            *out += free * p * (g - mean);
        }
    }
}

impl LogitGradient {
    /// Zero sums for splines of `bins` bins.
    pub fn new(bins: usize) -> Self {
        Self {
            widths: vec![0.0; bins],
            heights: vec![0.0; bins],
            left_knots: vec![0.0; bins],
            slopes: vec![0.0; bins + 1],
            shift: 0.0,
        }
    }

    /// Adds `weight` times the derivatives at one point.
    pub fn add(&mut self, at: &LogDensity, weight: f32) {
        self.widths[at.bin] += weight * at.by_width;
        self.heights[at.bin] += weight * at.by_height;
        self.left_knots[at.bin] += weight * at.by_left_knot;
        self.slopes[at.bin] += weight * at.by_left_slope;
        self.slopes[at.bin + 1] += weight * at.by_right_slope;
        self.shift -= weight * at.by_left_knot;
    }

    /// Adds the sums, taken through the constraints of `spline`, to the gradient of its logits, and clears them.
    pub fn finish(&mut self, spline: &AnalyticSpline, out: &mut [f32]) {
        let bins = self.widths.len();
        // The left knot of bin k is the sum of the widths before k.
        let mut after = 0.0;
        for bin in (0..bins).rev() {
            self.widths[bin] += after;
            after += self.left_knots[bin];
        }
        spline.widths.backward(&self.widths, &mut out[..bins]);
        spline.heights.backward(&self.heights, &mut out[bins..2 * bins]);
        let (slopes, last) = out[2 * bins..].split_at_mut(bins);
        for ((out, g), argument) in slopes.iter_mut().zip(&self.slopes).zip(&spline.slope_arguments) {
            *out += g * sigmoid(*argument);
        }
        let by_end_slope = self.slopes[bins] * sigmoid(spline.slope_arguments[bins]);
        match spline.topology {
            Topology::Interval => last[0] += by_end_slope,
            Topology::Circle => {
                slopes[0] += by_end_slope;
                last[0] += self.shift;
            }
        }
        for sums in [&mut self.widths, &mut self.heights, &mut self.left_knots, &mut self.slopes] {
            sums.fill(0.0);
        }
        self.shift = 0.0;
    }
}

fn free_fraction(bins: usize) -> f32 {
    (1.0 - bins as f64 * MIN_BIN) as f32
}

fn slope(argument: f32) -> f32 {
    MIN_SLOPE as f32 + argument.max(0.0) + (-argument.abs()).exp().ln_1p()
}

fn sigmoid(x: f32) -> f32 {
    let e = (-x.abs()).exp();
    (if x >= 0.0 { 1.0 } else { e }) / (1.0 + e)
}

fn wrap(x: f32) -> f32 {
    let fraction = x - x.floor();
    if fraction >= 1.0 { 0.0 } else { fraction }
}
