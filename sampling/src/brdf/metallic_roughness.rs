//! The metallic-roughness material of glTF 2.0: a diffuse lobe below a specular one.
//!
//! As in appendix B.3 of the specification, `alpha` is the square of the roughness, `f0` goes from 0.04
//! (dielectrics) to the base colour (metals), and the diffuse colour is the base colour times
//! `1 - metallic`. One thing differs. The appendix scales the diffuse lobe by 1 minus the Fresnel term
//! at the half vector, so that at grazing angles both lobes reflect nearly everything, together up to
//! 1.9 times the incident light. Here it is scaled by 1 minus the specular lobe's directional albedo,
//! at `wo` and at `wi` (Kelemen and Szirmay-Kalos 2001). This is reciprocal and conserves energy; a
//! white dielectric reflects 99.4 %.

use glam::{Vec2, Vec3};

use super::{Ggx, Kernel, Lambert, Lobes, lobe_albedo::LobeAlbedo, luminance, parameters::MAX_PARAMETERS};
use crate::discrete::BELOW_ONE;

/// Reflectance of dielectrics at normal incidence: an index of refraction of 1.5.
const DIELECTRIC_F0: f32 = 0.04;

/// The least selection probability of each lobe where both reflect: albedos do not account for the
/// light's direction.
const LEAST_LOBE_WEIGHT: f32 = 0.1;

/// Added to the albedo of the specular lobe: interpolation is off by up to 0.005 for near mirrors at
/// grazing angles.
const MARGIN: f32 = 0.006;

/// A mixture of a diffuse and a specular lobe, sampled by one-sample MIS with the exact pdf of the
/// mixture. Parameters: base colour, metalness, roughness.
#[derive(Clone, Copy, Debug)]
pub struct MetallicRoughness {
    base_color: Vec3,
    metallic: f32,
    roughness: f32,
    diffuse: Lambert,
    specular: Ggx,
    albedo: LobeAlbedo,
}

impl MetallicRoughness {
    /// Makes the BRDF of a base colour per channel, a metalness and a roughness, all clamped to `[0, 1]`.
    pub fn new(base_color: Vec3, metallic: f32, roughness: f32) -> Self {
        // `max` turns NaN into a number, which `clamp` alone would not.
        let unit = |value: f32| value.max(0.0).clamp(0.0, 1.0);
        Self::of(base_color.max(Vec3::ZERO).min(Vec3::ONE), unit(metallic), unit(roughness))
    }

    #[inline(always)]
    fn of(base_color: Vec3, metallic: f32, roughness: f32) -> Self {
        let f0 = Vec3::splat(DIELECTRIC_F0) * (1.0 - metallic) + base_color * metallic;
        let alpha = roughness * roughness;
        let specular = Ggx::of(if alpha > Ggx::MIN_ALPHA { alpha } else { Ggx::MIN_ALPHA }, f0);
        let diffuse = Lambert { albedo: base_color * (1.0 - metallic) };
        Self { base_color, metallic, roughness, diffuse, specular, albedo: LobeAlbedo::new(specular.alpha()) }
    }

    /// Base colour per channel, linear Rec.709.
    pub fn base_color(&self) -> Vec3 {
        self.base_color
    }

    /// Metalness.
    pub fn metallic(&self) -> f32 {
        self.metallic
    }

    /// Roughness, the square root of `alpha`.
    pub fn roughness(&self) -> f32 {
        self.roughness
    }

    /// The fraction of light that a dielectric's specular lobe does not reflect, at a cosine.
    #[inline(always)]
    fn left(&self, cos: f32) -> f32 {
        let left = 1.0 - MARGIN - self.albedo.at(cos, DIELECTRIC_F0);
        if left > 0.0 { left } else { 0.0 }
    }

    /// The selection probability of the specular lobe: its fraction of the luminance that both reflect
    /// under a white sky, between [`LEAST_LOBE_WEIGHT`] and 1 minus that; 1 where the diffuse lobe is black.
    #[inline(always)]
    fn specular_weight(&self, cos_o: f32) -> f32 {
        let diffuse = luminance(self.diffuse.albedo) * self.left(cos_o);
        let specular = self.albedo.at(cos_o, luminance(self.specular.f0()));
        let sum = specular + diffuse;
        let weight = specular / if sum > f32::MIN_POSITIVE { sum } else { f32::MIN_POSITIVE };
        let weight = if weight > LEAST_LOBE_WEIGHT { weight } else { LEAST_LOBE_WEIGHT };
        let weight = if weight < 1.0 - LEAST_LOBE_WEIGHT { weight } else { 1.0 - LEAST_LOBE_WEIGHT };
        let albedo = self.diffuse.albedo;
        let is_black = (albedo.x == 0.0) & (albedo.y == 0.0) & (albedo.z == 0.0);
        if is_black { 1.0 } else { weight }
    }
}

impl Kernel for MetallicRoughness {
    const PARAMETERS: usize = 5;

    #[inline(always)]
    fn of_parameters(parameters: &[f32; MAX_PARAMETERS]) -> Self {
        let [red, green, blue, metallic, roughness, ..] = *parameters;
        Self::of(Vec3::new(red, green, blue), metallic, roughness)
    }

    fn parameters(&self) -> [f32; MAX_PARAMETERS] {
        let [red, green, blue] = self.base_color.to_array();
        let mut parameters = [0.0; MAX_PARAMETERS];
        parameters[..Self::PARAMETERS].copy_from_slice(&[red, green, blue, self.metallic, self.roughness]);
        parameters
    }

    /// The sum of both lobes; zero where either direction is below the horizon.
    #[inline(always)]
    fn evaluate_cosine(&self, n: Vec3, wo: Vec3, wi: Vec3) -> Vec3 {
        let (cos_o, cos_i) = (n.dot(wo), n.dot(wi));
        let mean = 1.0 - MARGIN - self.albedo.mean(DIELECTRIC_F0);
        let left = self.left(cos_o) * self.left(cos_i) / mean;
        let left = if (cos_o > 0.0) & (cos_i > 0.0) { left } else { 0.0 };
        self.diffuse.evaluate_cosine(n, wo, wi) * left + self.specular.evaluate_cosine(n, wo, wi)
    }

    /// Draws from one of the lobes, chosen by `u.x`; no sample where the specular lobe reflects to
    /// below the horizon.
    #[inline(always)]
    fn sample(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        let weight = self.specular_weight(n.dot(wo));
        let is_specular = u.x < weight;
        // Stretches the chosen part of u.x to the whole interval; the second quotient may round up to 1.
        let x = if is_specular { u.x / weight } else { (u.x - weight) / (1.0 - weight) };
        let stretched = Vec2::new(if x < BELOW_ONE { x } else { BELOW_ONE }, u.y);
        let (specular, _) = self.specular.sample(n, wo, stretched);
        let (diffuse, _) = self.diffuse.sample(n, wo, stretched);
        let pick = |a: f32, b: f32| if is_specular { a } else { b };
        let wi = Vec3::new(pick(specular.x, diffuse.x), pick(specular.y, diffuse.y), pick(specular.z, diffuse.z));
        (wi, self.pdf(n, wo, wi))
    }

    /// It integrates to 1 minus the specular lobe's selection probability times its loss below the horizon.
    #[inline(always)]
    fn pdf(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        let cos_o = n.dot(wo);
        let weight = self.specular_weight(cos_o);
        let mixed = weight * self.specular.pdf(n, wo, wi) + (1.0 - weight) * self.diffuse.pdf(n, wo, wi);
        if (cos_o > 0.0) & (n.dot(wi) > 0.0) { mixed } else { 0.0 }
    }

    #[inline(always)]
    fn alpha(&self) -> f32 {
        self.specular.alpha()
    }

    #[inline(always)]
    fn lobes(&self, cos_o: f32) -> Lobes {
        let diffuse = luminance(self.diffuse.albedo) * self.left(cos_o);
        Lobes { diffuse, ..self.specular.lobes(cos_o) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    fn anything(random: &mut Stream) -> (MetallicRoughness, Vec3, Vec3, Vec3) {
        let color = Vec3::new(random.uniform(), random.uniform(), random.uniform());
        let brdf = MetallicRoughness::new(color, random.uniform(), random.uniform());
        let normal = Vec3::from(random.direction());
        let mut above = || {
            let w = Vec3::from(random.direction());
            if normal.dot(w) < 0.0 { -w } else { w }
        };
        (brdf, normal, above(), above())
    }

    #[test]
    fn values_are_reciprocal() {
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
    fn both_lobes_are_sampled_wherever_both_reflect() {
        for metallic in [0.0, 0.5, 0.9999] {
            for color in [1e-6, 0.5, 1.0] {
                for cos in [1e-3, 0.1, 1.0] {
                    let weight = MetallicRoughness::new(Vec3::splat(color), metallic, 0.3).specular_weight(cos);
                    assert!(
                        (LEAST_LOBE_WEIGHT..=1.0 - LEAST_LOBE_WEIGHT).contains(&weight),
                        "{metallic} {color} {cos}: {weight}"
                    );
                }
            }
        }
    }

    #[test]
    fn extreme_parameters_and_directions_give_finite_values() {
        let corners = [0.0, 1e-7, 0.1, 0.5, 0.9, BELOW_ONE];
        for color in [f32::NAN, 0.0, 1.0, f32::INFINITY] {
            for metallic in [f32::NAN, 0.0, 0.3, 1.0] {
                for roughness in [f32::NAN, 0.0, 0.1, 1.0] {
                    let brdf = MetallicRoughness::new(Vec3::splat(color), metallic, roughness);
                    for cos in [1e-30_f32, 1e-5, 0.5, 1.0] {
                        let wo = Vec3::new((1.0 - cos * cos).sqrt(), cos, 0.0);
                        for u in corners.iter().flat_map(|&x| corners.map(|y| Vec2::new(x, y))) {
                            let (wi, pdf) = brdf.sample(Vec3::Y, wo, u);
                            if pdf == 0.0 {
                                continue;
                            }
                            let value = brdf.evaluate_cosine(Vec3::Y, wo, wi);
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
