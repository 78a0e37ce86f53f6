//! The lobes for sampling: a cosine lobe, and mirror directions for slopes of a shifted
//! Trowbridge-Reitz distribution.
//!
//! With `h` the half vector and `p = -(h.x, h.y) / h.z` its slope, the second lobe has `p` distributed
//! as `1 / (pi a.x a.y (1 + q)^2)` with `q = ((p.x - t.x) / a.x)^2 + ((p.y - t.y) / a.y)^2`: a
//! Trowbridge-Reitz distribution of widths `a` whose highlight is shifted by the slope `t`. The
//! Jacobian from slopes to directions is `1 / (4 h.z^3 (h . wo))`.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use crate::simd;

/// Outputs of the network: weight, widths and shift of the second lobe; then weight and width of the
/// closest lobe without shift.
pub(super) const OUTPUTS: usize = 7;

/// The least weight of the cosine lobe: sample weights are at most `1 / COSINE_FLOOR` times those of
/// cosine sampling.
pub const COSINE_FLOOR: f32 = 0.05;
/// The least weight of the other lobe.
pub const LOBE_FLOOR: f32 = 0.02;
/// The least width, and the range of widths above it.
pub const WIDTHS: [f32; 2] = [0.04, 1.2];
/// The largest shift, as a slope.
pub const FARTHEST: f32 = 1.0;

/// A mixture of lobes in the tangent frame.
#[derive(Clone, Copy, Debug)]
pub struct Mixture {
    /// Selection probability of the second lobe.
    pub lobe_weight: f32,
    /// Widths of that lobe along u and v.
    pub widths: Vec2,
    /// The slope by which that lobe is shifted.
    pub shift: Vec2,
}

impl Mixture {
    /// Makes the mixture of the network's first five outputs.
    #[inline(always)]
    pub fn of(raw: [f32; 5]) -> Self {
        Self {
            lobe_weight: lobe_weight(raw[0]),
            widths: Vec2::new(width(raw[1]), width(raw[2])),
            shift: Vec2::new(shift(raw[3]), shift(raw[4])),
        }
    }

    /// The density of the second lobe in solid angle.
    #[inline(always)]
    fn lobe(&self, wo: Vec3, wi: Vec3) -> f32 {
        // Not normalised: for the unit half vector, h . wo is half of this length.
        let h = wo + wi;
        let squared = h.dot(h);
        let slope_x = -h.x / h.z - self.shift.x;
        let slope_y = -h.y / h.z - self.shift.y;
        let (x, y) = (slope_x / self.widths.x, slope_y / self.widths.y);
        let q = 1.0 + x * x + y * y;
        let slopes = FRAC_1_PI / (self.widths.x * self.widths.y * q * q);
        slopes * squared / (2.0 * h.z * h.z * h.z)
    }

    /// The density of the mixture in solid angle; 0 where either direction is below the horizon.
    #[inline(always)]
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let mixed = self.lobe_weight * self.lobe(wo, wi) + (1.0 - self.lobe_weight) * FRAC_1_PI * wi.z;
        if (wi.z > 0.0) & (wo.z > 0.0) { mixed } else { 0.0 }
    }

    /// Draws a direction from the second lobe; z is 0 if there is no sample.
    #[inline(always)]
    pub fn mirrored(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let radius = (u.x / (1.0 - u.x)).sqrt();
        let (cos, sin) = simd::cos_sin_turns(u.y);
        let x = self.shift.x + self.widths.x * radius * cos;
        let y = self.shift.y + self.widths.y * radius * sin;
        let h = Vec3::new(-x, -y, 1.0);
        let h = h * (1.0 / h.dot(h).sqrt());
        let cos = wo.dot(h);
        let wi = h * (2.0 * cos) - wo;
        let length = wi.dot(wi);
        let wi = wi * (1.0 / if length > 0.5 { length } else { 1.0 }.sqrt());
        let above = (cos > 0.0) & (wi.z > 0.0);
        Vec3::new(wi.x, wi.y, if above { wi.z } else { 0.0 })
    }
}

/// The weight of a lobe from its logit.
#[inline(always)]
pub(super) fn lobe_weight(raw: f32) -> f32 {
    LOBE_FLOOR + (1.0 - LOBE_FLOOR - COSINE_FLOOR) * simd::sigmoid(raw)
}

/// The width of a lobe from its logit.
#[inline(always)]
pub(super) fn width(raw: f32) -> f32 {
    WIDTHS[0] + WIDTHS[1] * simd::sigmoid(raw)
}

/// The shift of a lobe from its logit.
#[inline(always)]
fn shift(raw: f32) -> f32 {
    FARTHEST * (2.0 * simd::sigmoid(raw) - 1.0)
}
