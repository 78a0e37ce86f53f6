//! Knots of a batch of splines, and the bin that contains each point.

use burn::{
    prelude::{Int, Tensor},
    tensor::activation::{softmax, softplus},
};

use headtail_render::spline::{MIN_BIN, MIN_SLOPE, SLOPE_OFFSET, Topology, bin_count};

/// Constrained parameters of a batch of splines; `samples` may be 1 if all points of a condition share a
/// spline.
pub(super) struct Bins {
    /// Raw widths, `[conditions, samples, K]`, each at least `MIN_BIN`.
    widths: Tensor<3>,
    /// Raw heights, likewise.
    heights: Tensor<3>,
    /// Slope logits at the left knot of each bin, `[conditions, samples, K]`.
    left_slopes: Tensor<3>,
    /// Slope logits at the right knot of each bin.
    right_slopes: Tensor<3>,
}

/// Which axis of the spline a point lies on.
#[derive(Clone, Copy)]
pub(super) enum Axis {
    /// The argument of the closed form, divided into widths.
    Widths,
    /// Its value, divided into heights.
    Heights,
}

/// The bin of each point, every field `[conditions, samples]`.
pub(super) struct Bin {
    /// Position of the left knot on the width axis.
    pub left: Tensor<2>,
    /// Position of the left knot on the height axis.
    pub bottom: Tensor<2>,
    /// Width, at least `MIN_BIN`.
    pub width: Tensor<2>,
    /// Height, at least `MIN_BIN`.
    pub height: Tensor<2>,
    /// Slope at the left knot, at least `MIN_SLOPE`.
    pub left_slope: Tensor<2>,
    /// Slope at the right knot, at least `MIN_SLOPE`.
    pub right_slope: Tensor<2>,
}

impl Bins {
    /// Builds the bins from logits `[conditions, samples, 3K + 1]` in the order of
    /// [`headtail_render::spline`]'s table.
    pub fn new(topology: Topology, logits: &Tensor<3>) -> Self {
        let bins = bin_count(logits.dims()[2]);
        let columns = |start: usize, length: usize| logits.clone().narrow(2, start, length);
        let right_slopes = match topology {
            Topology::Interval => columns(2 * bins + 1, bins),
            Topology::Circle => Tensor::cat(vec![columns(2 * bins + 1, bins - 1), columns(2 * bins, 1)], 2),
        };
        Self {
            widths: normalize_bin_sizes(columns(0, bins)),
            heights: normalize_bin_sizes(columns(bins, bins)),
            left_slopes: columns(2 * bins, bins),
            right_slopes,
        }
    }

    /// Returns the bin that contains each point of `points` (`[conditions, samples]`, in `[0,1]`) along an
    /// axis.
    pub fn find(&self, axis: Axis, points: &Tensor<2>) -> Bin {
        let left_knots = exclusive_sum(&self.widths);
        let bottom_knots = exclusive_sum(&self.heights);
        let index = match axis {
            Axis::Widths => index_of(points, &left_knots),
            Axis::Heights => index_of(points, &bottom_knots),
        };
        let samples = points.dims()[1];
        let select = |values: Tensor<3>| {
            // A spline that all points of a condition share is repeated.
            let values = if values.dims()[1] == samples { values } else { values.repeat_dim(1, samples) };
            values.gather(2, index.clone()).squeeze_dim::<2>(2)
        };
        Bin {
            left: select(left_knots),
            bottom: select(bottom_knots),
            width: select(self.widths.clone()),
            height: select(self.heights.clone()),
            left_slope: normalize_slope(select(self.left_slopes.clone())),
            right_slope: normalize_slope(select(self.right_slopes.clone())),
        }
    }
}

/// Maps logits to sizes that are at least `MIN_BIN` and sum to 1.
fn normalize_bin_sizes(logits: Tensor<3>) -> Tensor<3> {
    let free = 1.0 - logits.dims()[2] as f64 * MIN_BIN;
    softmax(logits, 2).mul_scalar(free).add_scalar(MIN_BIN)
}

/// Maps a logit to a slope that is at least `MIN_SLOPE`, and 1 for a zero logit.
fn normalize_slope(logits: Tensor<2>) -> Tensor<2> {
    softplus(logits.add_scalar(SLOPE_OFFSET), 1.0).add_scalar(MIN_SLOPE)
}

/// Returns exclusive prefix sums: the left knots of bins of these sizes; the first is 0.
fn exclusive_sum(sizes: &Tensor<3>) -> Tensor<3> {
    let [conditions, samples, bins] = sizes.dims();
    let zero = Tensor::zeros([conditions, samples, 1], (&sizes.device(), sizes.dtype()));
    Tensor::cat(vec![zero, sizes.clone().narrow(2, 0, bins - 1).cumsum(2)], 2)
}

/// Returns the bin of each point, `[conditions, samples, 1]`: the number of *interior* knots at or below it, so that it
/// is in `0..K` for any point.
fn index_of(points: &Tensor<2>, left_knots: &Tensor<3>) -> Tensor<3, Int> {
    let bins = left_knots.dims()[2];
    let points = points.clone().detach().unsqueeze_dim::<3>(2);
    let passed = points.greater_equal(left_knots.clone().detach().narrow(2, 1, bins - 1));
    passed.int().sum_dim(2)
}
