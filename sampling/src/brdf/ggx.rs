//! Rough mirrors: microfacets with the Trowbridge-Reitz (GGX) distribution of normals.
//!
//! With `m` the half vector of `wo` and `wi`, `f_r = F(wo . m) D(m) G2(wo, wi) / (4 (n . wo) (n . wi))`
//! (Walter et al. 2007): `D` of Trowbridge and Reitz, `G2` the height-correlated masking-shadowing of
//! Smith (Heitz 2014, eq. 99), `F` of Schlick (1994).
//!
//! No value is a difference of nearly equal numbers. Squared sines come from cross products, and
//! quotients are reduced until no cosine remains in a denominator. With
//! `|w|_a = sqrt((n . w)^2 + alpha^2 |n x w|^2)`, the length of a unit vector whose tangential part is
//! scaled by `alpha`:
//!
//! - `D = alpha^2 / (pi |m|_a^4)`
//! - `G1(w) / (n . w) = 2 / (n . w + |w|_a)`
//! - `G2 / ((n . wo) (n . wi)) = 2 / ((n . wo) |wi|_a + (n . wi) |wo|_a)`

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::{Kernel, Lobes, luminance, parameters::MAX_PARAMETERS};
use crate::{frame::Frame, simd};

/// The isotropic Trowbridge-Reitz BRDF. It has no multiple scattering, so even with `f0 = 1` rough
/// surfaces are not white. Parameters: alpha, f0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    alpha: f32,
    f0: Vec3,
}

impl Ggx {
    /// The smallest width: at 10 % of it, rounding of directions (1e-7) distorts the lobe.
    pub const MIN_ALPHA: f32 = 1e-3;

    /// Makes the BRDF of width `alpha`, clamped to `MIN_ALPHA..=1`, and reflectance `f0` per channel at
    /// normal incidence, clamped to `0..=1`. With `f0 = 1`, F is exactly 1 at every angle.
    pub fn new(alpha: f32, f0: Vec3) -> Self {
        // `max` turns NaN into a number, which `clamp` alone would not.
        let alpha = alpha.max(Self::MIN_ALPHA).clamp(Self::MIN_ALPHA, 1.0);
        Self { alpha, f0: f0.max(Vec3::ZERO).min(Vec3::ONE) }
    }

    /// Makes the BRDF of parameters that are in range.
    #[inline(always)]
    pub(super) fn of(alpha: f32, f0: Vec3) -> Self {
        Self { alpha, f0 }
    }

    /// Reflectance per channel at normal incidence.
    #[inline(always)]
    pub fn f0(&self) -> Vec3 {
        self.f0
    }

    /// [`Kernel::evaluate_cosine`] with F = 1: the part that all channels share, in 1/sr.
    #[inline(always)]
    pub fn lobe_cosine(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        let (cos_o, cos_i) = (n.dot(wo), n.dot(wi));
        let above = (cos_o > 0.0) & (cos_i > 0.0);
        // Below the horizon the value is discarded; 1 avoids divisions by 0.
        let (cos_o, cos_i) = (if above { cos_o } else { 1.0 }, if above { cos_i } else { 1.0 });
        // D G2 / (4 cos_o), with the cosine of wi placed where a tiny one gives 0 instead of 0 / 0.
        let shadowing = cos_o * (self.scaled_length(n, wi, cos_i) / cos_i) + self.scaled_length(n, wo, cos_o);
        let value = self.normal_density(n, wo + wi) / (2.0 * shadowing);
        if above { value } else { 0.0 }
    }

    /// `|w|_a` of a unit vector of cosine `cos`.
    #[inline(always)]
    fn scaled_length(&self, n: Vec3, w: Vec3, cos: f32) -> f32 {
        let tangential = n.cross(w);
        (cos * cos + self.alpha * self.alpha * tangential.dot(tangential)).sqrt()
    }

    /// The density of normals `D` in the direction of `h` (of any length, above the horizon), in 1/sr.
    #[inline(always)]
    fn normal_density(&self, n: Vec3, h: Vec3) -> f32 {
        let squared_alpha = self.alpha * self.alpha;
        let (cos, tangential) = (n.dot(h), n.cross(h));
        let (sin_squared, cos_squared) = (tangential.dot(tangential), cos * cos);
        // |h|^2 / |h|_a^2 is in 1 ..= 1 / alpha^2, except for wo = -wi at the horizon: both squares underflow.
        let scaled = sin_squared + squared_alpha * cos_squared;
        let scaled = if scaled > f32::MIN_POSITIVE { scaled } else { f32::MIN_POSITIVE };
        let ratio = (sin_squared + cos_squared) / scaled;
        FRAC_1_PI * squared_alpha * ratio * ratio
    }

    /// Draws a microfacet normal in proportion to `D(m) max(0, wo . m)`, in the local frame, with `wo`
    /// above the horizon.
    ///
    /// Scaled to `alpha` = 1, microfacets form a hemisphere, and those visible from `wo` reflect it
    /// uniformly into a spherical cap (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
    /// Spherical Caps").
    #[inline(always)]
    fn visible_normal(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let scale = Vec3::new(self.alpha, self.alpha, 1.0);
        let scaled = unit(wo * scale);
        // The cap reaches from the zenith down to -scaled.z; 1 - z is uniform, and sin^2 = (1 - z) (1 + z).
        let below_zenith = u.y * (1.0 + scaled.z);
        let sin_squared = below_zenith * (2.0 - below_zenith);
        let radius = if sin_squared > 0.0 { sin_squared } else { 0.0 }.sqrt();
        let (cos, sin) = simd::cos_sin_turns(u.x);
        // z + scaled.z, without cancellation at the cap's edge.
        let height = (1.0 + scaled.z) * (1.0 - u.y);
        let h = Vec3::new(radius * cos + scaled.x, radius * sin + scaled.y, height);
        unit(h * scale)
    }
}

impl Kernel for Ggx {
    const PARAMETERS: usize = 4;

    #[inline(always)]
    fn of_parameters(parameters: &[f32; MAX_PARAMETERS]) -> Self {
        Self { alpha: parameters[0], f0: Vec3::new(parameters[1], parameters[2], parameters[3]) }
    }

    fn parameters(&self) -> [f32; MAX_PARAMETERS] {
        let mut parameters = [0.0; MAX_PARAMETERS];
        parameters[0] = self.alpha;
        parameters[1..4].copy_from_slice(&self.f0.to_array());
        parameters
    }

    /// Zero where either direction is below the horizon.
    #[inline(always)]
    fn evaluate_cosine(&self, n: Vec3, wo: Vec3, wi: Vec3) -> Vec3 {
        schlick(self.f0, half_angle_cosine(wo, wi)) * self.lobe_cosine(n, wo, wi)
    }

    /// Draws a visible microfacet normal and reflects `wo` about it; no sample where `wi` is below the
    /// horizon.
    ///
    /// `lobe_cosine / pdf = G2 / G1` is at most 1.
    #[inline(always)]
    fn sample(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        let frame = Frame::from_normal(n);
        let m = frame.to_world(self.visible_normal(frame.to_local(wo), u));
        let wi = unit(2.0 * wo.dot(m) * m - wo);
        (wi, self.pdf(n, wo, wi))
    }

    /// `G1(wo) D(m) / (4 n . wo)`; 0 below the horizon.
    ///
    /// It integrates to 1 minus the fraction of visible microfacets that reflect `wo` to below the
    /// horizon. At normal incidence that is 0.003, 0.04, 0.14 and 0.5 for `alpha` = 0.05, 0.2, 0.4 and
    /// 1; at grazing angles it tends to 0.
    #[inline(always)]
    fn pdf(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        let cos_o = n.dot(wo);
        let above = (cos_o > 0.0) & (n.dot(wi) > 0.0);
        let cos_o = if above { cos_o } else { 1.0 };
        let value = self.normal_density(n, wo + wi) / (2.0 * (cos_o + self.scaled_length(n, wo, cos_o)));
        if above { value } else { 0.0 }
    }

    #[inline(always)]
    fn alpha(&self) -> f32 {
        self.alpha
    }

    #[inline(always)]
    fn lobes(&self, _cos_o: f32) -> Lobes {
        Lobes { diffuse: 0.0, specular: 1.0, f0: luminance(self.f0), alpha: self.alpha }
    }
}

/// `v` over its length; 0 for the zero vector.
#[inline(always)]
fn unit(v: Vec3) -> Vec3 {
    let squared = v.dot(v);
    v * (1.0 / if squared > f32::MIN_POSITIVE { squared } else { f32::MIN_POSITIVE }.sqrt())
}

/// Schlick's Fresnel reflectance, `f0 + (1 - f0) (1 - cos)^5`.
#[inline(always)]
pub(super) fn schlick(f0: Vec3, cos: f32) -> Vec3 {
    f0 + (Vec3::ONE - f0) * schlick_weight(cos)
}

/// `(1 - cos)^5`.
#[inline(always)]
pub(super) fn schlick_weight(cos: f32) -> f32 {
    let x = 1.0 - cos;
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < 1.0 { x } else { 1.0 };
    let squared = x * x;
    squared * squared * x
}

/// The cosine between a direction and the half vector of both.
#[inline(always)]
fn half_angle_cosine(wo: Vec3, wi: Vec3) -> f32 {
    // |wo + wi| = 2 cos for unit vectors.
    let sum = wo + wi;
    0.5 * sum.dot(sum).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    fn above(normal: Vec3, w: Vec3) -> Vec3 {
        if normal.dot(w) < 0.0 { -w } else { w }
    }

    #[test]
    fn parameters_are_clamped() {
        assert_eq!(Ggx::new(0.0, Vec3::ONE).alpha(), Ggx::MIN_ALPHA);
        assert_eq!(Ggx::new(f32::NAN, Vec3::ONE).alpha(), Ggx::MIN_ALPHA);
        assert_eq!(Ggx::new(3.0, Vec3::ONE).alpha(), 1.0);
        assert_eq!(Ggx::new(0.3, Vec3::new(-1.0, 0.5, 2.0)).f0(), Vec3::new(0.0, 0.5, 1.0));
    }

    #[test]
    fn a_perfect_mirror_reflects_the_same_in_every_channel() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        for _ in 0..10_000 {
            let normal = Vec3::from(random.direction());
            let (wo, wi) =
                (above(normal, Vec3::from(random.direction())), above(normal, Vec3::from(random.direction())));
            let ggx = Ggx::new(random.uniform(), Vec3::ONE);
            let value = ggx.evaluate_cosine(normal, wo, wi);
            assert_eq!(value, Vec3::splat(ggx.lobe_cosine(normal, wo, wi)));
        }
    }

    #[test]
    fn values_are_reciprocal() {
        let mut random = Stream::new(2, Purpose::Test, 0);
        for _ in 0..10_000 {
            let normal = Vec3::from(random.direction());
            let (wo, wi) =
                (above(normal, Vec3::from(random.direction())), above(normal, Vec3::from(random.direction())));
            let ggx = Ggx::new(random.uniform(), Vec3::new(0.04, 0.5, 1.0));
            let there = ggx.evaluate_cosine(normal, wo, wi) * normal.dot(wo);
            let back = ggx.evaluate_cosine(normal, wi, wo) * normal.dot(wi);
            // About ten roundings in each direction.
            assert!((there - back).abs().max_element() <= 2e-6 * there.max_element(), "{ggx:?} {there} {back}");
        }
    }

    #[test]
    fn values_and_pdfs_below_the_horizon_are_zero() {
        let ggx = Ggx::new(0.3, Vec3::ONE);
        let (up, down) = (Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.6, -0.8, 0.0));
        for (wo, wi) in [(up, down), (down, up), (down, down), (Vec3::X, up), (up, Vec3::X)] {
            assert_eq!(ggx.evaluate_cosine(Vec3::Y, wo, wi), Vec3::ZERO);
            assert_eq!(ggx.pdf(Vec3::Y, wo, wi), 0.0);
        }
        assert!(ggx.sample(Vec3::Y, down, Vec2::splat(0.3)).1 == 0.0);
    }

    #[test]
    fn extreme_directions_and_widths_give_finite_values() {
        let cosines = [1.0, 0.5, 1e-2, 1e-4, 1e-7, 1e-20, 1e-38, 1e-44];
        let vector = |cos: f32, phi: f32| Vec3::new(phi.cos(), cos, phi.sin()).normalize();
        let corners = [0.0, 1e-7, 0.25, 0.5, 1.0 - 1.0 / 16_777_216.0];
        for alpha in [1e-3, 0.01, 0.05, 0.4, 1.0] {
            let ggx = Ggx::new(alpha, Vec3::splat(0.04));
            for wo in cosines.map(|cos| vector(cos, 0.3)) {
                for wi in
                    cosines.iter().flat_map(|&cos| [0.3, 0.3 + std::f32::consts::PI, 2.0].map(|phi| vector(cos, phi)))
                {
                    let (value, pdf) = (ggx.evaluate_cosine(Vec3::Y, wo, wi), ggx.pdf(Vec3::Y, wo, wi));
                    assert!(value.is_finite() && value.min_element() >= 0.0, "{alpha} {wo} {wi}: {value}");
                    assert!(pdf.is_finite() && pdf >= 0.0, "{alpha} {wo} {wi}: {pdf}");
                }
                for u in corners.iter().flat_map(|&x| corners.map(|y| Vec2::new(x, y))) {
                    let (wi, pdf) = ggx.sample(Vec3::Y, wo, u);
                    if pdf == 0.0 {
                        continue;
                    }
                    assert!(
                        wi.is_normalized() && wi.y > 0.0 && pdf > 0.0 && pdf.is_finite(),
                        "{alpha} {wo} {u}: {wi} {pdf}"
                    );
                }
            }
        }
    }

    #[test]
    fn weights_of_samples_are_at_most_one() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for _ in 0..100_000 {
            let normal = Vec3::from(random.direction());
            let wo = above(normal, Vec3::from(random.direction()));
            let ggx = Ggx::new(random.uniform().powi(3), Vec3::ONE);
            let (wi, pdf) = ggx.sample(normal, wo, random.uniform2());
            if pdf == 0.0 {
                continue;
            }
            let weight = ggx.lobe_cosine(normal, wo, wi) / pdf;
            // |wi|_a >= n . wi makes the quotient at most 1, up to rounding.
            assert!(weight <= 1.0 + 1e-6, "{ggx:?} {wo} {wi}: {weight}");
        }
    }
}
