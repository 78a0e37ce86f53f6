//! Points for integrals of light x BRDF x cosine over the sphere, with known densities.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use headtail_render::{
    color::luminance,
    latlong,
    random::{Purpose, Stream},
    sampler::EnvironmentLight,
    tail::TailWarp,
    tile::ShadingPoint,
};

/// Number of points, and their positions in the strata.
#[derive(Clone, Copy, Debug)]
pub struct QuadratureShape {
    /// Strata along a side of Y.
    pub strata: usize,
    /// Rows of strata of X, each with twice as many columns; 0 only if no light is dim for its solid angle.
    pub map_rows: usize,
    /// BRDF samples along a side of their square; 0 for surfaces without narrow lobes.
    pub brdf_strata: usize,
    /// `None` uses the centres of the strata of Y and X; with a seed, every point is jittered in its stratum.
    pub seed: Option<u64>,
}

/// Points of Y mapped to directions, points of X and BRDF samples, joined by the balance heuristic.
///
/// Through an exact tail the emitter's density is constant over Y, so a sun needs no more points than a sky.
/// But the dark parts of a map are strips of Y so thin that its points miss them; where a sampler has almost
/// no density there, they dominate its variance. The points of X cover these parts. Glossy lobes have points
/// of their own.
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
    /// Reciprocal density of the points (their number times their pdf), in steradians.
    pub weight: f64,
}

impl Quadrature {
    /// Places the points of Y and X. The tail of `light` must be exact.
    pub fn new(light: &EnvironmentLight, shape: QuadratureShape) -> Self {
        let mut random = Stream::new(11 + shape.seed.unwrap_or(0), Purpose::Test, 0);
        let mut strata = |columns: usize, rows: usize| -> Vec<Vec2> {
            let mut jitter = || if shape.seed.is_some() { random.uniform2() } else { Vec2::splat(0.5) };
            let corner = |k: usize| Vec2::new((k % columns) as f32, (k / columns) as f32);
            let size = Vec2::new(columns as f32, rows as f32);
            (0..columns * rows).map(|k| (corner(k) + jitter()) / size).collect()
        };
        let y = strata(shape.strata, shape.strata);
        let x = strata(2 * shape.map_rows, shape.map_rows);
        let environment = light.environment();
        let of_y = |(x, wi, emitter_pdf): (Vec2, Vec3A, f32)| {
            let radiance = environment.radiance_at(x);
            (emitter_pdf > 0.0 && emitter_pdf.is_finite()).then_some(Point { wi, radiance, emitter_pdf })
        };
        let of_x = |(&x, density): (&Vec2, f32)| Point {
            wi: latlong::direction(x),
            radiance: environment.radiance_at(x),
            emitter_pdf: density * latlong::solid_angle_factor(x.y),
        };
        let densities = |x: &[Vec2]| light.tail().inverse_points(x).into_iter().map(|(_, density)| density);
        let mut points: Vec<Point> =
            y.par_chunks(4096).flat_map_iter(|y| light.tail().forward_directions(y).filter_map(of_y)).collect();
        points.par_extend(x.par_chunks(4096).flat_map_iter(|x| x.iter().zip(densities(x)).map(of_x)));
        Self { light: light.clone(), shape, points }
    }

    /// Returns the points for a shading point; `index` selects the random numbers of the shading point.
    pub fn terms(&self, at: &ShadingPoint, index: u64) -> Vec<Term> {
        let (side, point) = (self.shape.brdf_strata, at.one());
        let (of_y, of_brdf) = ((self.shape.strata * self.shape.strata) as f64, (side * side) as f64);
        let of_x = (2 * self.shape.map_rows * self.shape.map_rows) as f64;
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
            // The points of X are uniform over it.
            let map_pdf = f64::from(latlong::solid_angle_factor(latlong::square(point.wi).y));
            let density = of_y * f64::from(point.emitter_pdf) + of_x * map_pdf + of_brdf * f64::from(brdf_pdf);
            (density > 0.0).then_some(Term { wi: point.wi, f, weight: 1.0 / density })
        };
        let values = point.brdf_cosines(&wi);
        points.into_iter().zip(values).zip(brdf_pdfs).filter_map(term).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use headtail_render::{
        brdf::{Ggx, Lambert, Surface},
        environment::built_in,
        tail::{Tail, TailKind},
    };

    /// Reflection of a constant map by a white diffuse and a mirror-like surface, and the solid angle of a
    /// hemisphere.
    #[test]
    fn integrals_over_a_constant_map_are_known() {
        let image = headtail_render::image::Image { width: 8, height: 5, pixels: vec![[2.0; 3]; 40] };
        let map = Arc::new(headtail_render::environment::Environment::from_image("constant", image).unwrap());
        let light = EnvironmentLight::new(map, TailKind::Hierarchical).unwrap();
        let quadrature =
            Quadrature::new(&light, QuadratureShape { strata: 100, map_rows: 50, brdf_strata: 40, seed: Some(1) });
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
            let quadrature =
                Quadrature::new(&light, QuadratureShape { strata: 128, map_rows: 64, brdf_strata: 0, seed });
            quadrature.terms(&at, 0).iter().map(|t| t.weight * t.f).sum::<f64>()
        };
        let centres = integral(None);
        assert!((integral(Some(3)) / centres - 1.0).abs() < 3e-3);
    }

    /// A half of the sphere that is 1e6 times dimmer than the other is a strip of Y of width 1e-6. The second
    /// moment there of a sampler with little density is found by points of X, not by those of Y alone.
    #[test]
    fn dim_parts_of_the_sphere_are_not_stepped_over() {
        let (width, height) = (64, 32);
        let value = |k: usize| if k % width < width / 2 { 1.0 } else { 1e-6 };
        let image = headtail_render::image::Image {
            width,
            height,
            pixels: (0..width * height).map(|k| [value(k); 3]).collect(),
        };
        let map = Arc::new(headtail_render::environment::Environment::from_image("halves", image).unwrap());
        let n = Vec3A::new(-0.8, 0.6, 0.0);
        let surface = Lambert { albedo: glam::Vec3::ONE }.into();
        let at = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
        // A density proportional to the light, except for a factor of 1e-6 where the map is dim.
        let ratio = |wi: Vec3A, f: f64| {
            let light = f64::from(luminance(map.radiance(wi)));
            f * f / (light * if light < 1e-3 { 1e-6 } else { 1.0 })
        };
        // Brute force: 16 x 16 points per texel.
        let (columns, rows) = (16 * width, 16 * (height - 1));
        let brute: f64 = (0..columns * rows)
            .into_par_iter()
            .map(|k| {
                let x = Vec2::new((k % columns) as f32 + 0.5, (k / columns) as f32 + 0.5)
                    / Vec2::new(columns as f32, rows as f32);
                let (wi, factor) = latlong::direction_and_factor(x);
                let f = f64::from(n.dot(wi).max(0.0)) / std::f64::consts::PI * f64::from(luminance(map.radiance(wi)));
                if f > 0.0 { ratio(wi, f) / f64::from(factor) / (columns * rows) as f64 } else { 0.0 }
            })
            .sum();
        for kind in [TailKind::Hierarchical, TailKind::RowColumn] {
            // In proportion to the light itself, which samplers of so uneven a map are not.
            let tail = Tail::new(kind, width, height, &(0..width * height).map(value).collect::<Vec<_>>()).unwrap();
            let light = EnvironmentLight::with_tail(map.clone(), Arc::new(tail));
            let integral = |map_rows, seed| {
                let quadrature =
                    Quadrature::new(&light, QuadratureShape { strata: 250, map_rows, brdf_strata: 0, seed });
                let terms = quadrature.terms(&at, 0);
                terms.iter().filter(|t| t.f > 0.0).map(|t| t.weight * ratio(t.wi, t.f)).sum::<f64>()
            };
            for seed in [None, Some(1)] {
                // The integrand jumps within a texel of the dim half's edges, 1/30 of its width, where a
                // point of X stands for 1/16 of a texel.
                let found = integral(256, seed);
                assert!((found / brute - 1.0).abs() < 0.02, "{} {seed:?}: {found} {brute}", kind.name());
            }
            let by_y = integral(0, None);
            assert!(by_y < 0.7 * brute, "{}: {by_y} {brute}", kind.name());
        }
    }
}
