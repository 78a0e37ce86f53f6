//! The density direction with its derivatives.

use super::{
    Axis, Bin, Logits, MIN_BIN, MIN_SLOPE, Real, SLOPE_OFFSET, Topology, axes, free_fraction, locate, right_knot,
    turned, unit,
};

/// Splines evaluated at one point each, with the intermediate results for derivatives by their logits.
pub struct Evaluation<R, const L: usize> {
    /// The splines' values.
    pub values: [R; L],
    /// Logarithms of the splines' slopes.
    pub log_slopes: [R; L],
    topology: Topology,
    bins: usize,
    index: [u32; L],
    scales: [[R; L]; 2],
    bin: Bin<R, L>,
    d_value: Derivatives<R, L>,
    d_log_slope: Derivatives<R, L>,
}

/// The quantity that is differentiated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gradient {
    /// The spline's value.
    Value,
    /// The logarithm of its slope.
    LogSlope,
}

/// Derivatives by the logits of the slopes at the bin's knots, by the bin's sizes, and by its left knot on
/// both axes.
struct Derivatives<R, const L: usize> {
    slopes: [[R; L]; 2],
    width: [R; L],
    height: [R; L],
    left: [R; L],
    bottom: [R; L],
}

/// Evaluates the density direction `y -> (z, ln dz/dy)` as [`inverse`](super::inverse), with the intermediate
/// results for derivatives.
///
/// `scratch` has at least `2 K` rows; [`Evaluation::write`] reads what this function leaves there.
///
/// # Panics
/// If the logits or the scratch rows are too few.
#[inline(always)]
pub fn inverse_with_gradient<R: Real, const L: usize>(
    topology: Topology,
    logits: Logits<'_, R>,
    scratch: &mut [[R; L]],
    y: &[R; L],
) -> Evaluation<R, L> {
    let x = turned(topology, logits, y);
    let [across, up] = axes(logits, scratch);
    let index = count_reached(across, &x);
    let bin = locate(topology, logits, [across, up], &x);
    let (mut values, mut log_slopes) = ([R::ZERO; L], [R::ZERO; L]);
    let (mut d_value, mut d_log_slope) = (Derivatives::zero(), Derivatives::zero());
    let (one, two) = (R::ONE, R::of(2.0));
    for l in 0..L {
        let (d0, d0_d_logit) = slope_with_derivative(bin.slopes[0][l]);
        let (d1, d1_d_logit) = slope_with_derivative(bin.slopes[1][l]);
        let (width, height) = (bin.width[l], bin.height[l]);
        let over_width = one / width;
        let t = unit((x[l] - bin.left[l]) * over_width);
        let (o, s) = (one - t, height * over_width);
        let to = t * o;
        let middle = one - two * to;
        // As in `rational_quadratic`.
        let n = d1 * t * t + two * s * to + d0 * o * o;
        let over_d = one / (s * middle + (d0 + d1) * to);
        let (over_n, ratio) = (one / n, s * over_d);
        let value = (s * t + d0 * o) * t * over_d;
        values[l] = unit(bin.bottom[l] + height * value);
        log_slopes[l] = (ratio * ratio * n).ln();

        let d_secant = two / s + two * to * over_n - two * middle * over_d;
        let d_position = two * (d1 * t + s * (one - two * t) - d0 * o) * over_n
            - two * (d0 + d1 - two * s) * (one - two * t) * over_d;
        d_log_slope.slopes[0][l] = d0_d_logit * (o * o * over_n - two * to * over_d);
        d_log_slope.slopes[1][l] = d1_d_logit * (t * t * over_n - two * to * over_d);
        d_log_slope.width[l] = -(d_secant * s + d_position * t) * over_width;
        d_log_slope.height[l] = d_secant * over_width;
        d_log_slope.left[l] = -d_position * over_width;

        let d_secant = (t * t - value * middle) * over_d;
        let d_position = ratio * n * over_d;
        d_value.slopes[0][l] = height * d0_d_logit * to * (one - value) * over_d;
        d_value.slopes[1][l] = -height * d1_d_logit * to * value * over_d;
        d_value.width[l] = -s * (d_secant * s + d_position * t);
        d_value.height[l] = s * d_secant + value;
        d_value.left[l] = -s * d_position;
        d_value.bottom[l] = one;
    }
    let scales = [across.scale, up.scale];
    Evaluation { values, log_slopes, topology, bins: logits.bins, index, scales, bin, d_value, d_log_slope }
}

impl<R: Real, const L: usize> Evaluation<R, L> {
    /// Returns the derivative by the point, the negative of that by the knot at its left.
    #[inline(always)]
    pub fn d_point(&self, of: Gradient) -> [R; L] {
        let mut d_point = self.derivatives(of).left;
        for d_point in &mut d_point {
            *d_point = -*d_point;
        }
        d_point
    }

    /// Writes the derivatives by all logits: by logit `k` of spline `l` to `out[k * stride + first + l]`.
    ///
    /// `scratch` is what [`inverse_with_gradient`] left there.
    #[inline(always)]
    pub fn write(&self, of: Gradient, scratch: &[[R; L]], out: &mut [R], stride: usize, first: usize) {
        let derivatives = self.derivatives(of);
        let (widths, heights) = scratch[..2 * self.bins].split_at(self.bins);
        let across = Axis { exponentials: widths, scale: self.scales[0] };
        let up = Axis { exponentials: heights, scale: self.scales[1] };
        let mut rows = Rows { values: out, stride, first };
        let (left, bottom) = (&derivatives.left, &derivatives.bottom);
        self.softmax_backward(across, (&self.bin.width, &self.bin.left), (&derivatives.width, left), 0, &mut rows);
        let place = (&self.bin.height, &self.bin.bottom);
        self.softmax_backward(up, place, (&derivatives.height, bottom), self.bins, &mut rows);
        self.write_slopes(derivatives, &mut rows);
    }

    #[inline(always)]
    fn derivatives(&self, of: Gradient) -> &Derivatives<R, L> {
        match of {
            Gradient::Value => &self.d_value,
            Gradient::LogSlope => &self.d_log_slope,
        }
    }

    /// Propagates through floor and softmax: `free p_k (g_k - sum_j p_j g_j)`, where `g` is `d_size` in the
    /// point's bin, `d_start` in those before it and 0 after.
    #[inline(always)]
    fn softmax_backward(
        &self,
        axis: Axis<'_, R, L>,
        (size, start): (&[R; L], &[R; L]),
        (d_size, d_start): (&[R; L], &[R; L]),
        row: usize,
        out: &mut Rows<'_, R>,
    ) {
        let (least, over_free) = (R::of(MIN_BIN), R::ONE / free_fraction(self.bins));
        let mut mean = [R::ZERO; L];
        for l in 0..L {
            let own = (size[l] - least) * over_free;
            let before = (start[l] - R::of(f64::from(self.index[l])) * least) * over_free;
            mean[l] = own * d_size[l] + before * d_start[l];
        }
        for (k, e) in axis.exponentials.iter().enumerate() {
            let out = out.row::<L>(row + k);
            for l in 0..L {
                let k = k as u32;
                let g = if k < self.index[l] { d_start[l] } else { R::ZERO };
                let g = if k == self.index[l] { d_size[l] } else { g };
                out[l] = axis.scale[l] * e[l] * (g - mean[l]);
            }
        }
    }

    #[inline(always)]
    fn write_slopes(&self, derivatives: &Derivatives<R, L>, out: &mut Rows<'_, R>) {
        let bins = self.bins;
        for row in 2 * bins..=3 * bins {
            *out.row(row) = [R::ZERO; L];
        }
        for l in 0..L {
            let left = self.index[l] as usize;
            let right = right_knot(self.topology, bins, left);
            for (knot, derivative) in [left, right].into_iter().zip(&derivatives.slopes) {
                let out = out.at(2 * bins + knot, l);
                *out = *out + derivative[l];
            }
            if self.topology == Topology::Circle {
                // The shift moves the point, which is equivalent to moving the knot the other way.
                *out.at(3 * bins, l) = -derivatives.left[l];
            }
        }
    }
}

/// The output of derivatives.
struct Rows<'a, R> {
    values: &'a mut [R],
    stride: usize,
    first: usize,
}

impl<R> Rows<'_, R> {
    #[inline(always)]
    fn row<const L: usize>(&mut self, k: usize) -> &mut [R; L] {
        self.values[k * self.stride + self.first..].first_chunk_mut().expect("one column per lane")
    }

    #[inline(always)]
    fn at(&mut self, k: usize, lane: usize) -> &mut R {
        &mut self.values[k * self.stride + self.first + lane]
    }
}

impl<R: Real, const L: usize> Derivatives<R, L> {
    #[inline(always)]
    fn zero() -> Self {
        let zero = [R::ZERO; L];
        Self { slopes: [zero; 2], width: zero, height: zero, left: zero, bottom: zero }
    }
}

/// Returns the index of each point's bin: the number of knots that it has reached, less the first knot at 0.
/// NaN counts as in the first bin; the loss detects it.
#[inline(always)]
fn count_reached<R: Real, const L: usize>(axis: Axis<'_, R, L>, at: &[R; L]) -> [u32; L] {
    let mut left = [R::ZERO; L];
    let mut reached = [0_u32; L];
    for e in axis.exponentials {
        for l in 0..L {
            reached[l] += u32::from(at[l] >= left[l]);
            left[l] = left[l] + (R::of(MIN_BIN) + e[l] * axis.scale[l]);
        }
    }
    for reached in &mut reached {
        *reached = reached.saturating_sub(1);
    }
    reached
}

/// Returns a slope from its logit, and its derivative.
#[inline(always)]
fn slope_with_derivative<R: Real>(logit: R) -> (R, R) {
    let argument = logit + R::of(SLOPE_OFFSET);
    (R::of(MIN_SLOPE) + argument.softplus(), argument.sigmoid())
}
