//! The rational-quadratic map of a batch of points, in both directions, as branch-free tensor operations.

use burn::prelude::Tensor;

use super::{
    Topology,
    bins::{Axis, Bin, Bins},
};

/// Maps `y -> (z, ln |dz/dy|)`, the density direction, in closed form. All tensors are
/// `[conditions, samples]`.
///
/// `logits` are `[conditions, samples, 3K + 1]`, or `[conditions, 1, 3K + 1]` if the points of a condition
/// share a spline. Points outside `[0,1]` are clamped (interval) or wrapped (circle).
pub fn inverse(topology: Topology, y: Tensor<2>, logits: &Tensor<3>) -> (Tensor<2>, Tensor<2>) {
    let x = match topology {
        Topology::Interval => y.clamp(0.0, 1.0),
        Topology::Circle => wrap(wrap(y) + shift(logits)),
    };
    let bin = Bins::new(topology, logits).find(Axis::Widths, &x);
    let position = ((x - bin.left.clone()) / bin.width.clone()).clamp(0.0, 1.0);
    let segment = Segment::new(&bin);
    let z = bin.bottom + bin.height * segment.value(&position);
    (z.clamp(0.0, 1.0), segment.log_slope(&position))
}

/// Maps `z -> (y, ln |dz/dy|)`, the sampling direction, with the quadratic's root. Shapes as for [`inverse`].
///
/// The log-derivative is that of [`inverse`] at the returned point, i.e. the log-density of a sample; it is
/// computed from the same position in the bin as the value. `y` is in `[0,1]`, on the circle in `[0,1)`.
pub fn forward(topology: Topology, z: Tensor<2>, logits: &Tensor<3>) -> (Tensor<2>, Tensor<2>) {
    let z = z.clamp(0.0, 1.0);
    let bin = Bins::new(topology, logits).find(Axis::Heights, &z);
    let value = ((z - bin.bottom.clone()) / bin.height.clone()).clamp(0.0, 1.0);
    let segment = Segment::new(&bin);
    let position = segment.position(&value);
    let x = (bin.left + bin.width * position.clone()).clamp(0.0, 1.0);
    let y = match topology {
        Topology::Interval => x,
        Topology::Circle => wrap(x - shift(logits)),
    };
    (y, segment.log_slope(&position))
}

/// Returns the shift logit without whole turns, in `[-1/2, 1/2]`, `[conditions, samples]`.
fn shift(logits: &Tensor<3>) -> Tensor<2> {
    let last = logits.dims()[2] - 1;
    let turns = logits.clone().narrow(2, last, 1).squeeze_dim::<2>(2);
    turns.clone() - turns.round()
}

/// Wraps to `[0,1)`. The last step is needed: in floating point `x - floor(x)` is 1 for a tiny negative `x`.
fn wrap(x: Tensor<2>) -> Tensor<2> {
    let fraction = x.clone() - x.floor();
    let is_one = fraction.clone().greater_equal_elem(1.0);
    fraction.mask_fill(is_one, 0.0)
}

/// One bin's rational quadratic on the unit square: position `t` in the bin to value in the bin, both in
/// `[0,1]`.
struct Segment {
    /// Height over width of the bin.
    secant: Tensor<2>,
    left_slope: Tensor<2>,
    right_slope: Tensor<2>,
}

impl Segment {
    fn new(bin: &Bin) -> Self {
        Self {
            secant: bin.height.clone() / bin.width.clone(),
            left_slope: bin.left_slope.clone(),
            right_slope: bin.right_slope.clone(),
        }
    }

    /// Returns `D = s (1 - 2 t o) + (d0 + d1) t o` with `o = 1 - t`: since `t o <= 1/4`, `D >= s / 2 > 0`,
    /// and no term is negative.
    fn denominator(&self, position: &Tensor<2>) -> Tensor<2> {
        let product = position.clone() * one_minus(position);
        let ends = (self.left_slope.clone() + self.right_slope.clone()) * product.clone();
        ends + self.secant.clone() * product.mul_scalar(-2.0).add_scalar(1.0)
    }

    /// Returns `(s t^2 + d0 t o) / D` (Durkan et al. 2019, equation 4).
    fn value(&self, position: &Tensor<2>) -> Tensor<2> {
        let numerator =
            (self.secant.clone() * position.clone() + self.left_slope.clone() * one_minus(position)) * position.clone();
        numerator / self.denominator(position)
    }

    /// Returns the log-slope of the spline, `ln(s^2 N / D^2)` with `N = d1 t^2 + 2 s t o + d0 o^2` (ibid.,
    /// equation 5).
    ///
    /// All arguments of logs are positive: `s` is a ratio of positive sizes; the weights `t^2`, `2 t o`,
    /// `o^2` of `N` are at least 0 and sum to 1, so `N >= min(d0, d1, s) > 0`; `D >= s / 2`.
    fn log_slope(&self, position: &Tensor<2>) -> Tensor<2> {
        let rest = one_minus(position);
        let numerator = self.right_slope.clone() * position.clone().square()
            + self.secant.clone() * (position.clone() * rest.clone()).mul_scalar(2.0)
            + self.left_slope.clone() * rest.square();
        self.secant.clone().log().mul_scalar(2.0) + numerator.log() - self.denominator(position).log().mul_scalar(2.0)
    }

    /// Returns the position of `value`: the root in `[0,1]` of `a t^2 + b t - c = 0`.
    ///
    /// With `r` the value, `e = d0 + d1 - 2 s`, `b = d0 - e r`, `a = s - b`, `c = s r`. The discriminant
    /// `b^2 + 4 a c` equals `(d0 (1 - r) - d1 r)^2 + 4 s^2 r (1 - r)`, a sum of terms that stay non-negative
    /// after rounding. The form of the root without cancellation is used: `2 c / (b + R)` for `b >= 0`,
    /// `(R - b) / (2 a)` for `b < 0`; `|b|` keeps the other form's denominator positive and changes only the
    /// discarded value.
    fn position(&self, value: &Tensor<2>) -> Tensor<2> {
        let rest = one_minus(value);
        let excess = self.left_slope.clone() + self.right_slope.clone() - self.secant.clone().mul_scalar(2.0);
        let b = self.left_slope.clone() - excess * value.clone();
        let ends = self.left_slope.clone() * rest.clone() - self.right_slope.clone() * value.clone();
        let root = (ends.square() + self.secant.clone().square().mul_scalar(4.0) * value.clone() * rest).sqrt();
        let sum = root + b.clone().abs();
        let for_positive = (self.secant.clone() * value.clone()).mul_scalar(2.0) / sum.clone();
        let for_negative = sum / (self.secant.clone() + b.clone().abs()).mul_scalar(2.0);
        for_positive.mask_where(b.lower_elem(0.0), for_negative).clamp(0.0, 1.0)
    }
}

fn one_minus(x: &Tensor<2>) -> Tensor<2> {
    x.clone().neg().add_scalar(1.0)
}
