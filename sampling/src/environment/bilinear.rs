//! Sampling of linear densities on the interval and bilinear densities on the square.

use glam::Vec2;

use crate::discrete::BELOW_ONE;

/// Samples the linear density from `a` to `b` (not both 0): returns the `t` in `[0, 1)` at which its
/// cumulative distribution is `u`.
///
/// There is no cancellation: both terms of the denominator are non-negative.
#[inline(always)]
pub fn sample_linear(u: f32, a: f32, b: f32) -> f32 {
    let root = (a * a + u * (b * b - a * a)).max(0.0).sqrt();
    let denominator = a + root;
    if denominator > 0.0 { (u * (a + b) / denominator).min(BELOW_ONE) } else { 0.0 }
}

/// The cumulative distribution at `t` of the linear density from `a` to `b`: the inverse of
/// [`sample_linear`].
#[inline(always)]
pub fn invert_linear(t: f32, a: f32, b: f32) -> f32 {
    let sum = a + b;
    if sum > 0.0 { (t * (a * (2.0 - t) + b * t) / sum).min(BELOW_ONE) } else { t }
}

/// The values of a bilinear function at the corners of a cell,
/// `[upper left, upper right, lower left, lower right]`.
#[derive(Clone, Copy, Debug)]
pub struct Corners(pub [f32; 4]);

impl Corners {
    /// The function's value.
    #[inline(always)]
    pub fn evaluate(&self, t: Vec2) -> f32 {
        let (left, right) = self.edges(t.y);
        (1.0 - t.x) * left + t.x * right
    }

    /// The mean over the cell.
    pub fn mean(&self) -> f32 {
        0.25 * self.0.iter().sum::<f32>()
    }

    /// Maps a uniform point to one with density proportional to the function.
    #[inline(always)]
    pub fn sample(&self, u: Vec2) -> Vec2 {
        let [a, b, c, d] = self.0;
        let y = sample_linear(u.y, a + b, c + d);
        let (left, right) = self.edges(y);
        Vec2::new(sample_linear(u.x, left, right), y)
    }

    /// The inverse of [`Self::sample`].
    #[inline(always)]
    pub fn invert(&self, t: Vec2) -> Vec2 {
        let [a, b, c, d] = self.0;
        let (left, right) = self.edges(t.y);
        Vec2::new(invert_linear(t.x, left, right), invert_linear(t.y, a + b, c + d))
    }

    #[inline(always)]
    fn edges(&self, y: f32) -> (f32, f32) {
        let [a, b, c, d] = self.0;
        ((1.0 - y) * a + y * c, (1.0 - y) * b + y * d)
    }
}
