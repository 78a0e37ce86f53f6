//! Rough mirrors: microfacets with the Trowbridge-Reitz (GGX) distribution of normals.
//!
//! With `m` the half vector of `wo` and `wi`, `f_r = F(wo . m) D(m) G2(wo, wi) / (4 (n . wo) (n . wi))` (Walter et al. 2007):
//! `D` of Trowbridge and Reitz, `G2` the height-correlated masking-shadowing of Smith (Heitz 2014, eq. 99), `F` of Schlick (1994).
//!
//! Nothing is computed as a difference of nearly equal numbers. Squares of sines come from cross products, and each quotient is
//! reduced until no cosine is left in a denominator. With `|w|_a = sqrt((n . w)^2 + alpha^2 |n x w|^2)`, the length of a unit
//! vector whose tangential part is scaled by `alpha`:
//!
//! - `D = alpha^2 / (pi |m|_a^4)`
//! - `G1(w) / (n . w) = 2 / (n . w + |w|_a)`
//! - `G2 / ((n . wo) (n . wi)) = 2 / ((n . wo) |wi|_a + (n . wi) |wo|_a)`

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::{Vec2, Vec3A};

use crate::frame::Frame;

/// The Trowbridge-Reitz BRDF of isotropic roughness. Light that would be reflected more than once is lost, so even with `f0 = 1`
/// rough surfaces are not white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    alpha: f32,
    f0: Vec3A,
}

impl Ggx {
    /// The smallest width: at a tenth of it, rounding of directions (1e-7) is seen in the shape of the lobe.
    pub const MIN_ALPHA: f32 = 1e-3;

    /// The BRDF of width `alpha`, brought into `MIN_ALPHA..=1`, and reflectance `f0` per channel at normal incidence, brought
    /// into `0..=1`. `f0 = 1` reflects everything at every angle: F = 1 exactly.
    pub fn new(alpha: f32, f0: Vec3A) -> Self {
        // `max` turns NaN into a number, which `clamp` alone would not.
        let alpha = alpha.max(Self::MIN_ALPHA).clamp(Self::MIN_ALPHA, 1.0);
        Self { alpha, f0: f0.max(Vec3A::ZERO).min(Vec3A::ONE) }
    }

    /// The width of the distribution of normals.
    pub fn alpha(&self) -> f32 {
        self.alpha
    }

    /// Reflectance per channel at normal incidence.
    pub fn f0(&self) -> Vec3A {
        self.f0
    }

    /// `f_r max(0, n . wi)` per channel, in 1/sr; zero where either direction is below the horizon.
    pub fn evaluate_cosine(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> Vec3A {
        let lobe = self.lobe_cosine(normal, wo, wi);
        if lobe > 0.0 { schlick(self.f0, half_angle_cosine(wo, wi)) * lobe } else { Vec3A::ZERO }
    }

    /// [`Self::evaluate_cosine`] with F = 1: the part that all channels share, in 1/sr.
    pub fn lobe_cosine(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> f32 {
        let (cos_o, cos_i) = (normal.dot(wo), normal.dot(wi));
        if !(cos_o > 0.0 && cos_i > 0.0) {
            return 0.0;
        }
        // D G2 / (4 cos_o), with the cosine of wi moved to where its smallness makes the value 0 and not 0 / 0.
        let shadowing = cos_o * (self.scaled_length(normal, wi, cos_i) / cos_i) + self.scaled_length(normal, wo, cos_o);
        self.normal_density(normal, wo + wi) / (2.0 * shadowing)
    }

    /// Draws a microfacet in proportion to what `wo` sees of it and reflects `wo` at it: `(wi, solid-angle pdf)`; `None` where
    /// `wi` is below the horizon.
    ///
    /// `lobe_cosine / pdf = G2 / G1` is at most 1.
    pub fn sample(&self, normal: Vec3A, wo: Vec3A, u: Vec2) -> Option<(Vec3A, f32)> {
        if normal.dot(wo) <= 0.0 {
            return None;
        }
        let frame = Frame::from_normal(normal);
        let m = frame.to_world(self.visible_normal(frame.to_local(wo), u));
        let wi = (2.0 * wo.dot(m) * m - wo).normalize();
        let pdf = self.pdf(normal, wo, wi);
        (pdf > 0.0).then_some((wi, pdf))
    }

    /// The solid-angle pdf of [`Self::sample`], `G1(wo) D(m) / (4 n . wo)`; 0 below the horizon.
    ///
    /// It integrates to 1 less the share of visible microfacets that reflect `wo` to below the horizon. At normal incidence that is
    /// 0.003, 0.04, 0.14 and 0.5 for `alpha` = 0.05, 0.2, 0.4 and 1; at grazing angles it tends to 0.
    pub fn pdf(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> f32 {
        let cos_o = normal.dot(wo);
        if !(cos_o > 0.0 && normal.dot(wi) > 0.0) {
            return 0.0;
        }
        self.normal_density(normal, wo + wi) / (2.0 * (cos_o + self.scaled_length(normal, wo, cos_o)))
    }

    /// `|w|_a` of a unit vector of cosine `cos`.
    fn scaled_length(&self, normal: Vec3A, w: Vec3A, cos: f32) -> f32 {
        (cos * cos + self.alpha * self.alpha * normal.cross(w).length_squared()).sqrt()
    }

    /// The density of normals `D` in the direction of `h` (of any length, above the horizon), in 1/sr.
    fn normal_density(&self, normal: Vec3A, h: Vec3A) -> f32 {
        let squared_alpha = self.alpha * self.alpha;
        let (cos, sin_squared) = (normal.dot(h), normal.cross(h).length_squared());
        let cos_squared = cos * cos;
        // |h|^2 / |h|_a^2 is in 1 ..= 1 / alpha^2. Below: wo = -wi in the horizon, where both squares underflow.
        let scaled = (sin_squared + squared_alpha * cos_squared).max(f32::MIN_POSITIVE);
        let ratio = (sin_squared + cos_squared) / scaled;
        FRAC_1_PI * squared_alpha * ratio * ratio
    }

    /// A microfacet normal in proportion to `D(m) max(0, wo . m)`, in the local frame, with `wo` above the horizon.
    ///
    /// Scaled to `alpha` = 1, microfacets form a hemisphere, and those that `wo` sees reflect it uniformly into a spherical cap
    /// (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps").
    fn visible_normal(&self, wo: Vec3A, u: Vec2) -> Vec3A {
        let scale = Vec3A::new(self.alpha, self.alpha, 1.0);
        let scaled = (wo * scale).normalize();
        // The cap reaches from the zenith down to -scaled.z; 1 - z is uniform, and sin^2 = (1 - z) (1 + z).
        let below_zenith = u.y * (1.0 + scaled.z);
        let radius = (below_zenith * (2.0 - below_zenith)).max(0.0).sqrt();
        let (sin, cos) = (TAU * u.x).sin_cos();
        // z + scaled.z, without cancellation at the cap's edge.
        let height = (1.0 + scaled.z) * (1.0 - u.y);
        let h = Vec3A::new(radius * cos + scaled.x, radius * sin + scaled.y, height);
        (h * scale).normalize()
    }
}

/// Schlick's Fresnel reflectance, `f0 + (1 - f0) (1 - cos)^5`.
pub(super) fn schlick(f0: Vec3A, cos: f32) -> Vec3A {
    f0 + (Vec3A::ONE - f0) * schlick_weight(cos)
}

/// `(1 - cos)^5`.
pub(super) fn schlick_weight(cos: f32) -> f32 {
    let x = (1.0 - cos).clamp(0.0, 1.0);
    let squared = x * x;
    squared * squared * x
}

/// The cosine between a direction and the half vector of both.
fn half_angle_cosine(wo: Vec3A, wi: Vec3A) -> f32 {
    // |wo + wi| = 2 cos for unit vectors.
    0.5 * (wo + wi).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    fn above(normal: Vec3A, w: Vec3A) -> Vec3A {
        if normal.dot(w) < 0.0 { -w } else { w }
    }

    #[test]
    fn widths_and_reflectances_are_brought_into_their_range() {
        assert_eq!(Ggx::new(0.0, Vec3A::ONE).alpha(), Ggx::MIN_ALPHA);
        assert_eq!(Ggx::new(f32::NAN, Vec3A::ONE).alpha(), Ggx::MIN_ALPHA);
        assert_eq!(Ggx::new(3.0, Vec3A::ONE).alpha(), 1.0);
        assert_eq!(Ggx::new(0.3, Vec3A::new(-1.0, 0.5, 2.0)).f0(), Vec3A::new(0.0, 0.5, 1.0));
    }

    #[test]
    fn a_perfect_mirror_reflects_the_same_in_every_channel() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        for _ in 0..10_000 {
            let normal = random.direction();
            let (wo, wi) = (above(normal, random.direction()), above(normal, random.direction()));
            let ggx = Ggx::new(random.uniform(), Vec3A::ONE);
            let value = ggx.evaluate_cosine(normal, wo, wi);
            assert_eq!(value, Vec3A::splat(ggx.lobe_cosine(normal, wo, wi)));
        }
    }

    #[test]
    fn light_may_run_either_way() {
        let mut random = Stream::new(2, Purpose::Test, 0);
        for _ in 0..10_000 {
            let normal = random.direction();
            let (wo, wi) = (above(normal, random.direction()), above(normal, random.direction()));
            let ggx = Ggx::new(random.uniform(), Vec3A::new(0.04, 0.5, 1.0));
            let there = ggx.evaluate_cosine(normal, wo, wi) * normal.dot(wo);
            let back = ggx.evaluate_cosine(normal, wi, wo) * normal.dot(wi);
            // Some ten roundings on either way.
            assert!((there - back).abs().max_element() <= 2e-6 * there.max_element(), "{ggx:?} {there} {back}");
        }
    }

    #[test]
    fn below_the_horizon_there_is_nothing() {
        let ggx = Ggx::new(0.3, Vec3A::ONE);
        let (up, down) = (Vec3A::new(0.6, 0.8, 0.0), Vec3A::new(0.6, -0.8, 0.0));
        for (wo, wi) in [(up, down), (down, up), (down, down), (Vec3A::X, up), (up, Vec3A::X)] {
            assert_eq!(ggx.evaluate_cosine(Vec3A::Y, wo, wi), Vec3A::ZERO);
            assert_eq!(ggx.pdf(Vec3A::Y, wo, wi), 0.0);
        }
        assert!(ggx.sample(Vec3A::Y, down, Vec2::splat(0.3)).is_none());
    }

    #[test]
    fn extreme_directions_and_widths_give_numbers() {
        let cosines = [1.0, 0.5, 1e-2, 1e-4, 1e-7, 1e-20, 1e-38, 1e-44];
        let vector = |cos: f32, phi: f32| Vec3A::new(phi.cos(), cos, phi.sin()).normalize();
        let corners = [0.0, 1e-7, 0.25, 0.5, 1.0 - 1.0 / 16_777_216.0];
        for alpha in [1e-3, 0.01, 0.05, 0.4, 1.0] {
            let ggx = Ggx::new(alpha, Vec3A::splat(0.04));
            for wo in cosines.map(|cos| vector(cos, 0.3)) {
                for wi in
                    cosines.iter().flat_map(|&cos| [0.3, 0.3 + std::f32::consts::PI, 2.0].map(|phi| vector(cos, phi)))
                {
                    let (value, pdf) = (ggx.evaluate_cosine(Vec3A::Y, wo, wi), ggx.pdf(Vec3A::Y, wo, wi));
                    assert!(value.is_finite() && value.min_element() >= 0.0, "{alpha} {wo} {wi}: {value}");
                    assert!(pdf.is_finite() && pdf >= 0.0, "{alpha} {wo} {wi}: {pdf}");
                }
                for u in corners.iter().flat_map(|&x| corners.map(|y| Vec2::new(x, y))) {
                    let Some((wi, pdf)) = ggx.sample(Vec3A::Y, wo, u) else { continue };
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
            let normal = random.direction();
            let wo = above(normal, random.direction());
            let ggx = Ggx::new(random.uniform().powi(3), Vec3A::ONE);
            let Some((wi, pdf)) = ggx.sample(normal, wo, random.uniform2()) else { continue };
            let weight = ggx.lobe_cosine(normal, wo, wi) / pdf;
            // |wi|_a >= n . wi makes the quotient at most 1 but for a few roundings.
            assert!(weight <= 1.0 + 1e-6, "{ggx:?} {wo} {wi}: {weight}");
        }
    }
}
