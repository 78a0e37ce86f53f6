//! Value and log-slope of one spline and their analytic gradients with respect to the logits, for one point at a time on the
//! host.
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
    lefts: Vec<f32>,
    /// Left knots on the height axis.
    bottoms: Vec<f32>,
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

/// A spline at one point, in the density direction.
#[derive(Clone, Copy, Debug)]
pub struct Evaluation {
    /// The value.
    pub z: f32,
    /// `ln |dz/dy|`.
    pub log_slope: f32,
    /// Derivatives of `z`.
    pub of_z: Derivatives,
    /// Derivatives of `log_slope`.
    pub of_log_slope: Derivatives,
}

/// Derivatives of a number at one point with respect to the constrained parameters of the point's bin.
#[derive(Clone, Copy, Debug, Default)]
pub struct Derivatives {
    bin: usize,
    by_left_slope: f32,
    by_right_slope: f32,
    by_width: f32,
    by_height: f32,
    /// With respect to the knot at the left of the bin; with respect to the point and the shift it is the negative of this.
    by_left: f32,
    /// With respect to the value at that knot.
    by_bottom: f32,
}

/// Weighted sums of derivatives over the points of one spline.
#[derive(Clone, Debug)]
pub struct LogitGradient {
    widths: Vec<f32>,
    heights: Vec<f32>,
    lefts: Vec<f32>,
    bottoms: Vec<f32>,
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
            lefts: Vec::with_capacity(bins),
            bottoms: Vec::with_capacity(bins),
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
        exclusive_sum(&self.widths.sizes, &mut self.lefts);
        exclusive_sum(&self.heights.sizes, &mut self.bottoms);
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

    /// The spline at `y`, with derivatives. Names are those of the tensor form, `o = 1 - t`.
    pub fn evaluate(&self, y: f32) -> Evaluation {
        let x = match self.topology {
            Topology::Interval => y.clamp(0.0, 1.0),
            Topology::Circle => wrap(wrap(y) + self.shift),
        };
        let bin = self.lefts[1..].iter().filter(|&&left| x >= left).count();
        let (width, height) = (self.widths.sizes[bin], self.heights.sizes[bin]);
        let t = ((x - self.lefts[bin]) / width).clamp(0.0, 1.0);
        let o = 1.0 - t;
        let s = height / width;
        let (d0, d1) = (slope(self.slope_arguments[bin]), slope(self.slope_arguments[bin + 1]));
        // N and D are positive: see `Segment::log_slope` and `Segment::denominator`.
        let n = d1 * t * t + 2.0 * s * t * o + d0 * o * o;
        let d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o;
        let value = (s * t + d0 * o) * t / d;
        let of_value = BinDerivatives {
            by_left_slope: t * o * (1.0 - value) / d,
            by_right_slope: -t * o * value / d,
            by_secant: (t * t - value * (1.0 - 2.0 * t * o)) / d,
            by_position: s * n / (d * d),
        };
        let of_log_slope = BinDerivatives {
            by_left_slope: o * o / n - 2.0 * t * o / d,
            by_right_slope: t * t / n - 2.0 * t * o / d,
            by_secant: 2.0 / s + 2.0 * t * o / n - 2.0 * (1.0 - 2.0 * t * o) / d,
            by_position: 2.0 * (d1 * t + s * (1.0 - 2.0 * t) - d0 * o) / n
                - 2.0 * (d0 + d1 - 2.0 * s) * (1.0 - 2.0 * t) / d,
        };
        let mut of_z = of_value.to_bin(bin, width, s, t).scaled(height);
        of_z.by_height += value;
        of_z.by_bottom = 1.0;
        Evaluation {
            z: (self.bottoms[bin] + height * value).clamp(0.0, 1.0),
            log_slope: 2.0 * s.ln() + n.ln() - 2.0 * d.ln(),
            of_z,
            of_log_slope: of_log_slope.to_bin(bin, width, s, t),
        }
    }
}

/// Derivatives with respect to the numbers that a bin's formula is written in.
struct BinDerivatives {
    by_left_slope: f32,
    by_right_slope: f32,
    by_secant: f32,
    by_position: f32,
}

impl BinDerivatives {
    /// Chain rule through `s = height / width` and `t = (x - left) / width`.
    fn to_bin(&self, bin: usize, width: f32, s: f32, t: f32) -> Derivatives {
        Derivatives {
            bin,
            by_left_slope: self.by_left_slope,
            by_right_slope: self.by_right_slope,
            by_width: -(self.by_secant * s + self.by_position * t) / width,
            by_height: self.by_secant / width,
            by_left: -self.by_position / width,
            by_bottom: 0.0,
        }
    }
}

impl Derivatives {
    /// The derivative by the point itself: it and the knot at its left move each other the opposite way.
    pub fn by_point(&self) -> f32 {
        -self.by_left
    }

    fn scaled(self, factor: f32) -> Self {
        Self {
            bin: self.bin,
            by_left_slope: self.by_left_slope * factor,
            by_right_slope: self.by_right_slope * factor,
            by_width: self.by_width * factor,
            by_height: self.by_height * factor,
            by_left: self.by_left * factor,
            by_bottom: self.by_bottom * factor,
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
            lefts: vec![0.0; bins],
            bottoms: vec![0.0; bins],
            slopes: vec![0.0; bins + 1],
            shift: 0.0,
        }
    }

    /// Adds `weight` times the derivatives at one point.
    pub fn add(&mut self, at: &Derivatives, weight: f32) {
        self.widths[at.bin] += weight * at.by_width;
        self.heights[at.bin] += weight * at.by_height;
        self.lefts[at.bin] += weight * at.by_left;
        self.bottoms[at.bin] += weight * at.by_bottom;
        self.slopes[at.bin] += weight * at.by_left_slope;
        self.slopes[at.bin + 1] += weight * at.by_right_slope;
        self.shift -= weight * at.by_left;
    }

    /// Adds the sums, taken through the constraints of `spline`, to the gradient of its logits, and clears them.
    pub fn finish(&mut self, spline: &AnalyticSpline, out: &mut [f32]) {
        let bins = self.widths.len();
        add_sums_after(&mut self.widths, &self.lefts);
        add_sums_after(&mut self.heights, &self.bottoms);
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
        for sums in [&mut self.widths, &mut self.heights, &mut self.lefts, &mut self.bottoms, &mut self.slopes] {
            sums.fill(0.0);
        }
        self.shift = 0.0;
    }
}

/// Sums of the sizes before each bin: its left knot.
fn exclusive_sum(sizes: &[f32], knots: &mut Vec<f32>) {
    let mut knot = 0.0;
    knots.clear();
    for size in sizes {
        knots.push(knot);
        knot += size;
    }
}

/// Adds to each bin's derivative by its size those by the left knots of the bins after it, all of which contain that size.
fn add_sums_after(by_size: &mut [f32], by_knot: &[f32]) {
    let mut after = 0.0;
    for (size, knot) in by_size.iter_mut().zip(by_knot).rev() {
        *size += after;
        after += knot;
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
