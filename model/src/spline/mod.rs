//! Monotone rational-quadratic splines on `[0,1]` (Durkan et al. 2019, after Gregory and Delbourgo 1982) and on the circle
//! (Rezende et al. 2020).
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
//! - slopes: `MIN_SLOPE + softplus(logit + ln(e^(1 - MIN_SLOPE) - 1))`, so that a zero logit is slope 1;
//! - shift: the circle is turned by `x = wrap(wrap(y) + (logit - round(logit)))` before the spline, in whole turns per unit.
//!
//! **All-zero logits are the identity.** The shift takes the logit as it is, not through a bounded function: a lobe can then
//! travel round and round the circle, and the gradient never saturates. Subtracting the nearest whole number is exact in
//! floating point and keeps the sum in a range where its rounding error is below 1.2e-7.

pub mod analytic;
mod bins;
mod rational_quadratic;
#[cfg(test)]
mod tests;

pub use rational_quadratic::{forward, inverse};

/// Floor of a bin's width and height: it caps a one-dimensional density at about 1e4 and leaves dark bins small.
pub const MIN_BIN: f64 = 1e-4;

/// Floor of a slope at a knot.
pub const MIN_SLOPE: f64 = 1e-4;

/// Largest number of bins: the floors of all bins together then take less than a tenth of the square.
pub const MAX_BINS: usize = 512;

/// What a coordinate's two ends are to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topology {
    /// Two ends, with slopes of their own.
    Interval,
    /// One point: the density is continuous across it.
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

/// The offset that makes a zero slope logit the slope 1: `ln(e^(1 - MIN_SLOPE) - 1)`.
pub fn slope_offset() -> f64 {
    (1.0 - MIN_SLOPE).exp_m1().ln()
}
