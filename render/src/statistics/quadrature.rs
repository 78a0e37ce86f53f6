//! Points for integrals of light x BRDF x cosine over the sphere, with known densities.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use crate::{
    color::luminance,
    random::{Purpose, Stream},
    sampler::EnvironmentLight,
    tile::ShadingPoint,
};

/// How many points, and where in their strata.
#[derive(Clone, Copy, Debug)]
pub struct QuadratureShape {
    /// Strata along a side of Y.
    pub strata: usize,
    /// BRDF samples along a side of their square; 0 for surfaces without narrow lobes.
    pub brdf_strata: usize,
    /// `None` takes the centres of the strata of Y; with a seed every point is jittered in its stratum.
    pub seed: Option<u64>,
}

/// Points of Y carried to directions, joined by BRDF samples with the balance heuristic.
///
/// Through an exact tail the emitter's density is constant over Y, so a sun costs no more points than a sky; a glossy lobe gets points
/// of its own.
pub struct Quadrature {
    light: EnvironmentLight,
    shape: QuadratureShape,
    points: Vec<Point>,
}

#[derive(Clone, Copy)]
struct Point {
    wi: Vec3A,
    radiance: Vec3A,
    emitter_pdf: f32,
}

/// One point of an integral over directions: `sum of weight g(wi)` estimates the integral of `g` over solid angle.
#[derive(Clone, Copy, Debug)]
pub struct Term {
    /// Unit direction.
    pub wi: Vec3A,
    /// Luminance of light x BRDF x cosine, per steradian; may be 0.
    pub f: f64,
    /// One over the density of the points (their number times their pdf), in steradians.
    pub weight: f64,
}

impl Quadrature {
    /// Places the points of Y. The tail of `light` must be exact.
    pub fn new(light: &EnvironmentLight, shape: QuadratureShape) -> Self {
        let side = shape.strata;
        let mut random = Stream::new(11 + shape.seed.unwrap_or(0), Purpose::Test, 0);
        let mut jitter = || if shape.seed.is_some() { random.uniform2() } else { Vec2::splat(0.5) };
        let stratum = |k: usize| Vec2::new((k % side) as f32, (k / side) as f32);
        let y: Vec<Vec2> = (0..side * side).map(|k| (stratum(k) + jitter()) / side as f32).collect();
        let point = |(x, wi, emitter_pdf): (Vec2, Vec3A, f32)| {
            let radiance = light.environment().radiance_at(x);
            (emitter_pdf > 0.0 && emitter_pdf.is_finite()).then_some(Point { wi, radiance, emitter_pdf })
        };
        let points =
            y.par_chunks(4096).flat_map_iter(|y| light.tail().forward_directions(y).filter_map(point)).collect();
        Self { light: light.clone(), shape, points }
    }

    /// The points for a shading point; `index` tells apart the random numbers of several shading points.
    pub fn terms(&self, at: &ShadingPoint, index: u64) -> Vec<Term> {
        let (side, point) = (self.shape.brdf_strata, at.one());
        let counts = ((self.shape.strata * self.shape.strata) as f64, (side * side) as f64);
        let mut random = Stream::new(13 + self.shape.seed.unwrap_or(0), Purpose::Test, index);
        let stratum = |k: usize| (Vec2::new((k % side) as f32, (k / side) as f32) + random.uniform2()) / side as f32;
        let u: Vec<Vec2> = (0..side * side).map(stratum).collect();
        let of_lobe: Vec<Vec3A> = point.sample_brdf(&u).into_iter().flatten().map(|drawn| drawn.0).collect();
        let emitter_pdfs = self.light.pdfs(&of_lobe);
        let of_lobe = of_lobe.into_iter().zip(emitter_pdfs);
        let points: Vec<Point> = self
            .points
            .iter()
            .copied()
            .chain(of_lobe.map(|(wi, emitter_pdf)| Point {
                wi,
                radiance: self.light.environment().radiance(wi),
                emitter_pdf,
            }))
            .collect();
        let wi: Vec<Vec3A> = points.iter().map(|point| point.wi).collect();
        let brdf_pdfs = if side > 0 { point.brdf_pdfs(&wi) } else { vec![0.0; wi.len()] };
        let term = |((point, brdf_cosine), brdf_pdf): ((Point, Vec3A), f32)| {
            let f = f64::from(luminance(brdf_cosine * point.radiance));
            let weight = 1.0 / (counts.0 * f64::from(point.emitter_pdf) + counts.1 * f64::from(brdf_pdf));
            weight.is_finite().then_some(Term { wi: point.wi, f, weight })
        };
        let values = point.brdf_cosines(&wi);
        points.into_iter().zip(values).zip(brdf_pdfs).filter_map(term).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{
        brdf::{Ggx, Lambert, Surface},
        environment::built_in,
        tail::TailKind,
    };

    /// What a white diffuse surface and a mirror-like one reflect of a constant map, and the solid angle of a hemisphere.
    #[test]
    fn integrals_over_a_constant_map_are_known() {
        let image = crate::image::Image { width: 8, height: 5, pixels: vec![[2.0; 3]; 40] };
        let map = Arc::new(crate::environment::Environment::from_image("constant", image).unwrap());
        let light = EnvironmentLight::new(map, TailKind::Hierarchical).unwrap();
        let quadrature = Quadrature::new(&light, QuadratureShape { strata: 100, brdf_strata: 40, seed: Some(1) });
        let n = Vec3A::new(0.6, 0.8, 0.0);
        let at = |surface: Surface| ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
        let diffuse = quadrature.terms(&at(Lambert { albedo: glam::Vec3::ONE }.into()), 0);
        let sum = |terms: &[Term], g: &dyn Fn(&Term) -> f64| terms.iter().map(|t| t.weight * g(t)).sum::<f64>();
        assert!((sum(&diffuse, &|t| t.f) - 2.0).abs() < 5e-3);
        let above = sum(&diffuse, &|t| f64::from(u8::from(t.wi.dot(n) > 0.0)));
        assert!((above - std::f64::consts::TAU).abs() < 0.03, "{above}");
        let mirror = quadrature.terms(&at(Ggx::new(0.02, glam::Vec3::ONE).into()), 0);
        assert!((sum(&mirror, &|t| t.f) - 2.0).abs() < 1e-2);
    }

    /// Jittered points and centres estimate the same integrals.
    #[test]
    fn jitter_does_not_change_integrals() {
        let light = EnvironmentLight::new(Arc::new(built_in("studio").unwrap()), TailKind::Hierarchical).unwrap();
        let n = Vec3A::Y;
        let surface = Lambert { albedo: glam::Vec3::ONE }.into();
        let at = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
        let integral = |seed| {
            let quadrature = Quadrature::new(&light, QuadratureShape { strata: 128, brdf_strata: 0, seed });
            quadrature.terms(&at, 0).iter().map(|t| t.weight * t.f).sum::<f64>()
        };
        let centres = integral(None);
        assert!((integral(Some(3)) / centres - 1.0).abs() < 3e-3);
    }
}
