//! Splines of many samples in SIMD lanes: value, log-slope and the analytic gradients of both.
//!
//! The mathematics is that of [`headtail_model::spline::analytic`], which takes one spline at a time. Here every sample has a
//! spline of its own, matrices are `[logits, samples]`, and [`LANES`] samples go through each operation together.

use headtail_model::spline::{MIN_BIN, MIN_SLOPE, Topology, slope_offset};
use headtail_render::simd::{self, LANES, Lanes};

/// Splines of `samples` samples, a whole number of [`LANES`].
pub(super) struct Splines<'a> {
    pub topology: Topology,
    pub bins: usize,
    pub samples: usize,
    /// Where each spline is evaluated: coordinates of the unit square.
    pub points: &'a [f32],
    /// `[3K + 1, samples]`; logits before, the derivatives of the log-slope by the logits after.
    pub logits: &'a mut [f32],
    /// `[3K + 1, samples]`, or empty where the value's derivatives by the logits are not wanted.
    pub of_values: &'a mut [f32],
    /// The splines' values.
    pub values: &'a mut [f32],
    /// Logarithms of the splines' slopes.
    pub log_slopes: &'a mut [f32],
    /// Derivatives of values and log-slopes by the points, or empty where they are not wanted.
    pub by_points: [&'a mut [f32]; 2],
    /// Exponentials of the logits of widths and heights, then the knots of both axes.
    pub scratch: &'a mut Vec<Lanes>,
}

/// Softmax of one axis, not normalised yet.
struct Softmax {
    /// What an exponential is multiplied with to give a bin's size above the floor.
    scale: Lanes,
}

/// The bin that each sample falls into along one axis.
struct Bin {
    start: Lanes,
    size: Lanes,
}

/// Derivatives by the constrained parameters of each sample's bin, see [`headtail_model::spline::analytic::Derivatives`].
struct Derivatives {
    left_slope: Lanes,
    right_slope: Lanes,
    width: Lanes,
    height: Lanes,
    left: Lanes,
    bottom: Lanes,
}

impl Splines<'_> {
    /// Evaluates all; to be inlined into a function that is compiled for the processor's SIMD instructions.
    #[inline(always)]
    pub fn evaluate(mut self) {
        self.scratch.resize(4 * self.bins, [0.0; LANES]);
        for first in (0..self.samples).step_by(LANES) {
            self.strip(first);
        }
    }
}

impl Splines<'_> {
    /// One strip of [`LANES`] samples.
    #[inline(always)]
    fn strip(&mut self, first: usize) {
        let (bins, samples) = (self.bins, self.samples);
        let x = self.positions(first);
        let widths = self.softmax(first, 0);
        let heights = self.softmax(first, bins);
        let (exponentials, knots) = self.scratch.split_at_mut(2 * bins);
        let (lefts, bottoms) = knots.split_at_mut(bins);
        let index = locate(&exponentials[..bins], &widths, &x, lefts);
        accumulate(&exponentials[bins..], &heights, bottoms);
        let across = pick(&exponentials[..bins], &widths, lefts, &index);
        let up = pick(&exponentials[bins..], &heights, bottoms, &index);
        let (mut left_arguments, mut right_arguments) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let left = index[l] as usize;
            let right = if self.topology == Topology::Circle && left + 1 == bins { 0 } else { left + 1 };
            left_arguments[l] = self.logits[(2 * bins + left) * samples + first + l];
            right_arguments[l] = self.logits[(2 * bins + right) * samples + first + l];
        }
        let (mut of_log_slope, mut of_value) = (Derivatives::zero(), Derivatives::zero());
        // Not written to memory in the loop: an index that could be out of range would keep it from being one over SIMD lanes.
        let (mut values, mut log_slopes) = ([0.0; LANES], [0.0; LANES]);
        let offset = slope_offset() as f32;
        for l in 0..LANES {
            let (left_argument, right_argument) = (left_arguments[l] + offset, right_arguments[l] + offset);
            let d0 = MIN_SLOPE as f32 + simd::softplus(left_argument);
            let d1 = MIN_SLOPE as f32 + simd::softplus(right_argument);
            let (width, height) = (across.size[l], up.size[l]);
            let t = (x[l] - across.start[l]) / width;
            let t = if t < 0.0 { 0.0 } else { t };
            let t = if t > 1.0 { 1.0 } else { t };
            let o = 1.0 - t;
            let s = height / width;
            // Both are sums of non-negative terms of which one is positive.
            let n = d1 * t * t + 2.0 * s * t * o + d0 * o * o;
            let d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o;
            let (by_n, by_d, by_width) = (1.0 / n, 1.0 / d, 1.0 / width);
            let value = (s * t + d0 * o) * t * by_d;
            let z = up.start[l] + height * value;
            let z = if z > 1.0 { 1.0 } else { z };
            values[l] = z;
            log_slopes[l] = 2.0 * simd::ln(s) + simd::ln(n) - 2.0 * simd::ln(d);
            let (of_d0, of_d1) = (simd::sigmoid(left_argument), simd::sigmoid(right_argument));

            let by_secant = 2.0 / s + 2.0 * t * o * by_n - 2.0 * (1.0 - 2.0 * t * o) * by_d;
            let by_position = 2.0 * (d1 * t + s * (1.0 - 2.0 * t) - d0 * o) * by_n
                - 2.0 * (d0 + d1 - 2.0 * s) * (1.0 - 2.0 * t) * by_d;
            of_log_slope.left_slope[l] = of_d0 * (o * o * by_n - 2.0 * t * o * by_d);
            of_log_slope.right_slope[l] = of_d1 * (t * t * by_n - 2.0 * t * o * by_d);
            of_log_slope.width[l] = -(by_secant * s + by_position * t) * by_width;
            of_log_slope.height[l] = by_secant * by_width;
            of_log_slope.left[l] = -by_position * by_width;

            let by_secant = (t * t - value * (1.0 - 2.0 * t * o)) * by_d;
            let by_position = s * n * by_d * by_d;
            of_value.left_slope[l] = height * of_d0 * (t * o * (1.0 - value) * by_d);
            of_value.right_slope[l] = -height * of_d1 * (t * o * value * by_d);
            of_value.width[l] = -height * (by_secant * s + by_position * t) * by_width;
            of_value.height[l] = height * by_secant * by_width + value;
            of_value.left[l] = -height * by_position * by_width;
            of_value.bottom[l] = 1.0;
        }
        *lanes_mut(self.values, first) = values;
        *lanes_mut(self.log_slopes, first) = log_slopes;
        if !self.by_points[0].is_empty() {
            for l in 0..LANES {
                // A point and the knot at its left move each other the opposite way.
                self.by_points[0][first + l] = -of_value.left[l];
                self.by_points[1][first + l] = -of_log_slope.left[l];
            }
        }
        let (width_at, height_at) = (&self.scratch[..bins], &self.scratch[bins..2 * bins]);
        let rows = Rows { topology: self.topology, bins, samples, first, index: &index };
        for (out, derivatives) in [(&mut *self.logits, &of_log_slope), (&mut *self.of_values, &of_value)] {
            if !out.is_empty() {
                rows.softmax(out, 0, width_at, &widths, &across, (&derivatives.width, &derivatives.left));
                rows.softmax(out, bins, height_at, &heights, &up, (&derivatives.height, &derivatives.bottom));
                rows.slopes(out, derivatives);
            }
        }
    }

    /// Where each sample lies on the width axis, in `[0, 1]`.
    #[inline(always)]
    fn positions(&self, first: usize) -> Lanes {
        let mut x = *lanes(self.points, first);
        if self.topology == Topology::Interval {
            for x in &mut x {
                *x = x.clamp(0.0, 1.0);
            }
        } else {
            let turns = lanes(self.logits, 3 * self.bins * self.samples + first);
            for l in 0..LANES {
                x[l] = wrap(wrap(x[l]) + (turns[l] - turns[l].round_ties_even()));
            }
        }
        x
    }

    /// Exponentials of `K` rows of logits from `row` on, into the scratch rows from `row` on.
    #[inline(always)]
    fn softmax(&mut self, first: usize, row: usize) -> Softmax {
        let bins = self.bins;
        let mut largest = [f32::NEG_INFINITY; LANES];
        for k in row..row + bins {
            let logits = lanes(self.logits, k * self.samples + first);
            for l in 0..LANES {
                largest[l] = largest[l].max(logits[l]);
            }
        }
        let mut total = [0.0; LANES];
        for k in row..row + bins {
            let logits = lanes(self.logits, k * self.samples + first);
            let out = &mut self.scratch[k];
            for l in 0..LANES {
                let e = simd::exp(logits[l] - largest[l]);
                out[l] = e;
                total[l] += e;
            }
        }
        let free = free_fraction(bins);
        let mut scale = [0.0; LANES];
        for l in 0..LANES {
            scale[l] = free / total[l];
        }
        Softmax { scale }
    }
}

/// The index of the bin of each `x`, and the knots at the left of all bins.
///
/// Counting, not selecting: a conditional write to memory is slow on many processors.
#[inline(always)]
fn locate(exponentials: &[Lanes], softmax: &Softmax, x: &Lanes, lefts: &mut [Lanes]) -> [u32; LANES] {
    let mut left = [0.0; LANES];
    let mut reached = [0_u32; LANES];
    for (e, out) in exponentials.iter().zip(lefts) {
        *out = left;
        for l in 0..LANES {
            reached[l] += u32::from(x[l] >= left[l]);
            left[l] += MIN_BIN as f32 + softmax.scale[l] * e[l];
        }
    }
    // Every `x` has reached the first knot, which is 0, except what is not a number: that is for the loss to find.
    for reached in &mut reached {
        *reached = reached.saturating_sub(1);
    }
    reached
}

/// The knots at the start of all bins.
#[inline(always)]
fn accumulate(exponentials: &[Lanes], softmax: &Softmax, starts: &mut [Lanes]) {
    let mut start = [0.0; LANES];
    for (e, out) in exponentials.iter().zip(starts) {
        *out = start;
        for l in 0..LANES {
            start[l] += MIN_BIN as f32 + softmax.scale[l] * e[l];
        }
    }
}

/// The place of the bins of given indices along an axis.
#[inline(always)]
fn pick(exponentials: &[Lanes], softmax: &Softmax, starts: &[Lanes], index: &[u32; LANES]) -> Bin {
    let mut bin = Bin { start: [0.0; LANES], size: [0.0; LANES] };
    for l in 0..LANES {
        bin.start[l] = starts[index[l] as usize][l];
        bin.size[l] = exponentials[index[l] as usize][l];
    }
    for l in 0..LANES {
        bin.size[l] = MIN_BIN as f32 + softmax.scale[l] * bin.size[l];
    }
    bin
}

/// Where a strip's derivatives go.
struct Rows<'a> {
    topology: Topology,
    bins: usize,
    samples: usize,
    first: usize,
    index: &'a [u32; LANES],
}

impl Rows<'_> {
    /// Through floor and softmax: `dL/du_k = free p_k (g_k - sum_j p_j g_j)`, where `g` is `by_size` in the sample's bin, `by_start`
    /// in those before it and 0 after.
    #[inline(always)]
    fn softmax(
        &self,
        out: &mut [f32],
        row: usize,
        exponentials: &[Lanes],
        softmax: &Softmax,
        bin: &Bin,
        (by_size, by_start): (&Lanes, &Lanes),
    ) {
        let by_free = 1.0 / free_fraction(self.bins);
        let mut mean = [0.0; LANES];
        for l in 0..LANES {
            let own = (bin.size[l] - MIN_BIN as f32) * by_free;
            let before = (bin.start[l] - self.index[l] as f32 * MIN_BIN as f32) * by_free;
            mean[l] = own * by_size[l] + before * by_start[l];
        }
        for (k, e) in exponentials.iter().enumerate() {
            let out = lanes_mut(out, (row + k) * self.samples + self.first);
            for l in 0..LANES {
                let k = k as u32;
                let g = if k < self.index[l] { by_start[l] } else { 0.0 };
                let g = if k == self.index[l] { by_size[l] } else { g };
                out[l] = softmax.scale[l] * e[l] * (g - mean[l]);
            }
        }
    }

    #[inline(always)]
    fn slopes(&self, out: &mut [f32], derivatives: &Derivatives) {
        let bins = self.bins;
        for row in 2 * bins..=3 * bins {
            *lanes_mut(out, row * self.samples + self.first) = [0.0; LANES];
        }
        for l in 0..LANES {
            let left = self.index[l] as usize;
            let circle = self.topology == Topology::Circle;
            let right = if circle && left + 1 == bins { 0 } else { left + 1 };
            out[(2 * bins + left) * self.samples + self.first + l] += derivatives.left_slope[l];
            out[(2 * bins + right) * self.samples + self.first + l] += derivatives.right_slope[l];
            if circle {
                // The shift moves the point, and with it the knot the other way.
                out[3 * bins * self.samples + self.first + l] = -derivatives.left[l];
            }
        }
    }
}

impl Derivatives {
    #[inline(always)]
    fn zero() -> Self {
        let zero = [0.0; LANES];
        Self { left_slope: zero, right_slope: zero, width: zero, height: zero, left: zero, bottom: zero }
    }
}

/// What the floors of all bins leave.
#[inline(always)]
fn free_fraction(bins: usize) -> f32 {
    (1.0 - bins as f64 * MIN_BIN) as f32
}

/// `x` modulo 1, in `[0, 1)`.
#[inline(always)]
fn wrap(x: f32) -> f32 {
    let fraction = x - x.floor();
    if fraction >= 1.0 { 0.0 } else { fraction }
}

#[inline(always)]
fn lanes(values: &[f32], at: usize) -> &Lanes {
    values[at..at + LANES].try_into().expect("a slice of LANES numbers")
}

#[inline(always)]
fn lanes_mut(values: &mut [f32], at: usize) -> &mut Lanes {
    (&mut values[at..at + LANES]).try_into().expect("a slice of LANES numbers")
}

#[cfg(test)]
mod tests {
    use headtail_model::spline::{
        analytic::{AnalyticSpline, LogitGradient},
        logit_count,
    };
    use headtail_render::random::{Purpose, Stream};

    use super::*;

    #[test]
    fn lanes_agree_with_one_spline_at_a_time() {
        let samples = 4 * LANES;
        for topology in [Topology::Interval, Topology::Circle] {
            for bins in [2, 4, 8, 32] {
                let count = logit_count(bins);
                let mut random = Stream::new(7, Purpose::Test, bins as u64);
                let logits: Vec<f32> = (0..count * samples).map(|_| 3.0 * random.uniform() - 1.5).collect();
                let mut points: Vec<f32> = (0..samples).map(|_| random.uniform()).collect();
                points[..3].copy_from_slice(&[0.0, 1.0, 0.5]);
                let (mut of_log, mut of_values) = (logits.clone(), vec![0.0; count * samples]);
                let (mut values, mut log_slopes) = (vec![0.0; samples], vec![0.0; samples]);
                let mut by_points = (vec![0.0; samples], vec![0.0; samples]);
                Splines {
                    topology,
                    bins,
                    samples,
                    points: &points,
                    logits: &mut of_log,
                    of_values: &mut of_values,
                    values: &mut values,
                    log_slopes: &mut log_slopes,
                    by_points: [&mut by_points.0, &mut by_points.1],
                    scratch: &mut Vec::new(),
                }
                .evaluate();
                let (mut spline, mut sums) = (AnalyticSpline::new(topology, bins), LogitGradient::new(bins));
                for sample in 0..samples {
                    let column =
                        |matrix: &[f32]| -> Vec<f32> { (0..count).map(|k| matrix[k * samples + sample]).collect() };
                    spline.prepare(&column(&logits));
                    let at = spline.evaluate(points[sample]);
                    // A position is known to some 1e-7, which the slope magnifies.
                    let bound = 5e-7 * (1.0 + at.log_slope.exp());
                    assert!((at.z - values[sample]).abs() < bound, "{} {}", at.z, values[sample]);
                    assert!(
                        (at.log_slope - log_slopes[sample]).abs() < 2e-5 * bins as f32,
                        "{} {}",
                        at.log_slope,
                        log_slopes[sample]
                    );
                    for (derivatives, found) in [(&at.of_z, &by_points.0), (&at.of_log_slope, &by_points.1)] {
                        let expected = derivatives.by_point();
                        assert!((expected - found[sample]).abs() < 1e-3 * (1.0 + expected.abs()), "{expected}");
                    }
                    for (derivatives, found) in [(&at.of_log_slope, &of_log), (&at.of_z, &of_values)] {
                        let mut expected = vec![0.0; count];
                        sums.add(derivatives, 1.0);
                        sums.finish(&spline, &mut expected);
                        let size = expected.iter().map(|g| g * g).sum::<f32>().sqrt();
                        // Positions inside a bin of width 1e-2 are known to 1e-5.
                        for (expected, found) in expected.iter().zip(column(found)) {
                            assert!((expected - found).abs() < 5e-4 * (1.0 + size), "{topology:?} {expected} {found}");
                        }
                    }
                }
            }
        }
    }
}
