//! The metallic-roughness material of glTF 2.0: a diffuse lobe below a specular one.
//!
//! After appendix B.3 of the specification: `alpha` is the square of the roughness, `f0` goes from 0.04 (dielectrics) to the base
//! colour (metals), and the diffuse colour is the base colour times `1 - metallic`. One thing differs. The appendix lets the
//! diffuse lobe have what Fresnel's term leaves at the half vector, so that at grazing angles both lobes reflect nearly
//! everything, together up to 1.9 times the light that arrives. Here it has what the specular lobe leaves over all directions, at `wo`
//! and at `wi` (Kelemen and Szirmay-Kalos 2001): reciprocal, a white dielectric reflects 99.4 %, and nothing reflects more than
//! it receives.

use glam::{Vec2, Vec3A};

use super::{Ggx, Lambert, lobe_albedo::LobeAlbedo};
use crate::color::luminance;

/// Reflectance of dielectrics at normal incidence: an index of refraction of 1.5.
const DIELECTRIC_F0: f32 = 0.04;

/// Each lobe is drawn from with at least this probability where both reflect: their albedos say nothing of where the light is.
const LEAST_SHARE: f32 = 0.1;

/// Added to the albedo of the specular lobe: it is interpolated, and off by up to 0.005 where near mirrors are seen at grazing angles.
const MARGIN: f32 = 0.006;

/// The largest number below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A mixture of a diffuse and a specular lobe, drawn from by one-sample MIS with the exact pdf of the mixture.
#[derive(Clone, Copy, Debug)]
pub struct MetallicRoughness {
    base_color: Vec3A,
    metallic: f32,
    roughness: f32,
    diffuse: Lambert,
    specular: Ggx,
    albedo: LobeAlbedo,
}

impl MetallicRoughness {
    /// The BRDF of a base colour per channel, a metalness and a roughness, all brought into `[0, 1]`.
    pub fn new(base_color: Vec3A, metallic: f32, roughness: f32) -> Self {
        // `max` turns NaN into a number, which `clamp` alone would not.
        let unit = |value: f32| value.max(0.0).clamp(0.0, 1.0);
        let (metallic, roughness) = (unit(metallic), unit(roughness));
        let base_color = base_color.max(Vec3A::ZERO).min(Vec3A::ONE);
        let f0 = Vec3A::splat(DIELECTRIC_F0).lerp(base_color, metallic);
        let specular = Ggx::new(roughness * roughness, f0);
        let diffuse = Lambert { albedo: base_color * (1.0 - metallic) };
        Self { base_color, metallic, roughness, diffuse, specular, albedo: LobeAlbedo::new(specular.alpha()) }
    }

    /// Base colour per channel, linear Rec.709.
    pub fn base_color(&self) -> Vec3A {
        self.base_color
    }

    /// Metalness.
    pub fn metallic(&self) -> f32 {
        self.metallic
    }

    /// Roughness, the root of `alpha`.
    pub fn roughness(&self) -> f32 {
        self.roughness
    }

    /// The width `alpha` of the specular lobe.
    pub fn alpha(&self) -> f32 {
        self.specular.alpha()
    }

    /// `f_r max(0, n . wi)` of both lobes per channel, in 1/sr; zero where either direction is below the horizon.
    pub fn evaluate_cosine(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> Vec3A {
        let (cos_o, cos_i) = (normal.dot(wo), normal.dot(wi));
        if !(cos_o > 0.0 && cos_i > 0.0) {
            return Vec3A::ZERO;
        }
        let mean = 1.0 - MARGIN - self.albedo.mean(DIELECTRIC_F0);
        let left = self.left(cos_o) * self.left(cos_i) / mean;
        self.diffuse.evaluate_cosine(normal, wo, wi) * left + self.specular.evaluate_cosine(normal, wo, wi)
    }

    /// Draws from one of the lobes, chosen by `u.x`: `(wi, solid-angle pdf of the mixture)`; `None` where the specular lobe
    /// reflects to below the horizon.
    pub fn sample(&self, normal: Vec3A, wo: Vec3A, u: Vec2) -> Option<(Vec3A, f32)> {
        let cos_o = normal.dot(wo);
        if cos_o <= 0.0 {
            return None;
        }
        let share = self.specular_share(cos_o);
        // Either branch stretches its part of u.x to the whole interval; a quotient of the second may round up to 1.
        let (wi, _) = if u.x < share {
            self.specular.sample(normal, wo, Vec2::new(u.x / share, u.y))?
        } else {
            self.diffuse.sample(normal, wo, Vec2::new(((u.x - share) / (1.0 - share)).min(BELOW_ONE), u.y))?
        };
        let pdf = self.pdf(normal, wo, wi);
        (pdf > 0.0).then_some((wi, pdf))
    }

    /// The solid-angle pdf of [`Self::sample`]; it integrates to 1 less what the specular lobe's loses below the horizon, times
    /// that lobe's share.
    pub fn pdf(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> f32 {
        let cos_o = normal.dot(wo);
        if !(cos_o > 0.0 && normal.dot(wi) > 0.0) {
            return 0.0;
        }
        let share = self.specular_share(cos_o);
        share * self.specular.pdf(normal, wo, wi) + (1.0 - share) * self.diffuse.pdf(normal, wo, wi)
    }

    /// What the specular lobe of a dielectric leaves of the light at a cosine.
    fn left(&self, cos: f32) -> f32 {
        (1.0 - MARGIN - self.albedo.at(cos, DIELECTRIC_F0)).max(0.0)
    }

    /// The probability of the specular lobe: its share of the luminance that both reflect under a white sky, between
    /// [`LEAST_SHARE`] and 1 less that; 1 where the diffuse lobe is black.
    fn specular_share(&self, cos_o: f32) -> f32 {
        if self.diffuse.albedo == Vec3A::ZERO {
            return 1.0;
        }
        let diffuse = luminance(self.diffuse.albedo) * self.left(cos_o);
        let specular = self.albedo.at(cos_o, luminance(self.specular.f0()));
        (specular / (specular + diffuse).max(f32::MIN_POSITIVE)).clamp(LEAST_SHARE, 1.0 - LEAST_SHARE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    fn anything(random: &mut Stream) -> (MetallicRoughness, Vec3A, Vec3A, Vec3A) {
        let color = Vec3A::new(random.uniform(), random.uniform(), random.uniform());
        let brdf = MetallicRoughness::new(color, random.uniform(), random.uniform());
        let normal = random.direction();
        let mut above = || {
            let w = random.direction();
            if normal.dot(w) < 0.0 { -w } else { w }
        };
        (brdf, normal, above(), above())
    }

    #[test]
    fn light_may_run_either_way() {
        let mut random = Stream::new(2, Purpose::Test, 0);
        for _ in 0..10_000 {
            let (brdf, normal, wo, wi) = anything(&mut random);
            let there = brdf.evaluate_cosine(normal, wo, wi) * normal.dot(wo);
            let back = brdf.evaluate_cosine(normal, wi, wo) * normal.dot(wi);
            assert!((there - back).abs().max_element() <= 2e-6 * there.max_element(), "{brdf:?} {there} {back}");
        }
    }

    #[test]
    fn metals_are_mirrors_of_their_color() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for _ in 0..1000 {
            let (brdf, normal, wo, wi) = anything(&mut random);
            let metal = MetallicRoughness::new(brdf.base_color(), 1.0, brdf.roughness());
            let mirror = Ggx::new(brdf.roughness().powi(2), brdf.base_color());
            assert_eq!(metal.evaluate_cosine(normal, wo, wi), mirror.evaluate_cosine(normal, wo, wi));
            assert_eq!(metal.pdf(normal, wo, wi), mirror.pdf(normal, wo, wi));
        }
    }

    #[test]
    fn both_lobes_are_drawn_from_wherever_both_reflect() {
        for metallic in [0.0, 0.5, 0.9999] {
            for color in [1e-6, 0.5, 1.0] {
                for cos in [1e-3, 0.1, 1.0] {
                    let share = MetallicRoughness::new(Vec3A::splat(color), metallic, 0.3).specular_share(cos);
                    assert!((LEAST_SHARE..=1.0 - LEAST_SHARE).contains(&share), "{metallic} {color} {cos}: {share}");
                }
            }
        }
    }

    #[test]
    fn extreme_parameters_and_points_give_numbers() {
        let corners = [0.0, 1e-7, 0.1, 0.5, 0.9, BELOW_ONE];
        for color in [f32::NAN, 0.0, 1.0, f32::INFINITY] {
            for metallic in [f32::NAN, 0.0, 0.3, 1.0] {
                for roughness in [f32::NAN, 0.0, 0.1, 1.0] {
                    let brdf = MetallicRoughness::new(Vec3A::splat(color), metallic, roughness);
                    for cos in [1e-30_f32, 1e-5, 0.5, 1.0] {
                        let wo = Vec3A::new((1.0 - cos * cos).sqrt(), cos, 0.0);
                        for u in corners.iter().flat_map(|&x| corners.map(|y| Vec2::new(x, y))) {
                            let Some((wi, pdf)) = brdf.sample(Vec3A::Y, wo, u) else { continue };
                            let value = brdf.evaluate_cosine(Vec3A::Y, wo, wi);
                            assert!(
                                wi.is_normalized() && pdf > 0.0 && pdf.is_finite(),
                                "{brdf:?} {wo} {u}: {wi} {pdf}"
                            );
                            assert!(value.is_finite() && value.min_element() >= 0.0, "{brdf:?} {wo} {u}: {value}");
                        }
                    }
                }
            }
        }
    }
}
