//! Relative variance and KL of a sampler, as means over random conditions.

use glam::{Vec2, Vec3A};
use headtail_render::{
    brdf::{Brdf, Ggx, Lambert},
    color::luminance,
    integrator::{DirectEstimator, Unshadowed},
    random::{Purpose, Stream},
    sampler::{DirectionSampler, EnvironmentLight, ShadingPoint},
};
use headtail_train::{Material, Viewpoints};
use rayon::prelude::*;

/// Means over conditions.
#[derive(Clone, Copy)]
pub struct Quality {
    pub relative_variance: f64,
    /// NaN where the sampler has no pdf.
    pub kl: f64,
    /// Relative error of the variance: half the difference between two independent measurements, if there are two.
    pub error: f64,
}

/// Random conditions of a material, as in training.
#[derive(Clone, Copy)]
pub struct Conditions {
    material: Material,
    count: u64,
}

impl Conditions {
    /// 100 normals of a diffuse surface; 60 views and normals of a microfacet surface.
    pub fn of(material: Material) -> Self {
        Self { material, count: if material == Material::Lambert { 100 } else { 60 } }
    }

    fn shading_point(&self, index: u64) -> ShadingPoint {
        let mut stream = Stream::new(7, Purpose::Test, index);
        let ([wo, n], brdf) = match self.material {
            Material::Lambert => ([stream.direction(); 2], Brdf::Lambert(Lambert { albedo: Vec3A::ONE })),
            Material::Ggx { low, high } => {
                let directions = Viewpoints::Sphere.draw(&mut stream);
                (directions, Brdf::Ggx(Ggx::new(low + (high - low) * stream.uniform(), Vec3A::ONE)))
            }
        };
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, brdf }
    }
}

/// A direction for each point of Y, and what its integrals need.
struct Point {
    wi: Vec3A,
    radiance: Vec3A,
    emitter_pdf: f32,
}

/// Points for integrals over the sphere: through an exact tail the emitter's density is constant over Y, so a sun costs no more
/// points than a sky; a glossy lobe gets points of its own from BRDF sampling, joined by the balance heuristic.
pub struct Quadrature {
    light: EnvironmentLight,
    points: Vec<Point>,
    /// BRDF samples along a side of their square.
    brdf_side: usize,
    /// Where in its stratum a BRDF sample lies.
    seed: u64,
}

/// A point at which the integrand is not zero.
struct Term {
    wi: Vec3A,
    /// Luminance of light x BRDF x cosine.
    f: f64,
    /// One over the density of the points (their number times their pdf).
    weight: f64,
}

impl Quadrature {
    /// One quadrature for a diffuse surface (the centres of 250 x 250 cells of Y), two independent ones for a glossy one (a jittered
    /// point in each of 160 x 160 cells, and 112 x 112 BRDF samples).
    pub fn of(conditions: Conditions, light: &EnvironmentLight) -> Vec<Self> {
        match conditions.material {
            Material::Lambert => vec![Self::new(light, 250, 0, &mut || Vec2::splat(0.5), 0)],
            Material::Ggx { .. } => [0, 1]
                .into_iter()
                .map(|seed| {
                    let mut random = Stream::new(11 + seed, Purpose::Test, 0);
                    Self::new(light, 160, 112, &mut || random.uniform2(), seed)
                })
                .collect(),
        }
    }

    fn new(
        light: &EnvironmentLight,
        side: usize,
        brdf_side: usize,
        jitter: &mut dyn FnMut() -> Vec2,
        seed: u64,
    ) -> Self {
        let stratum = |k: usize| Vec2::new((k % side) as f32, (k / side) as f32);
        let y: Vec<Vec2> = (0..side * side).map(|k| (stratum(k) + jitter()) / side as f32).collect();
        let point = |&y: &Vec2| {
            let sample = light.sample_through_tail(y, 1.0)?;
            Some(Point { wi: sample.wi, radiance: sample.radiance, emitter_pdf: sample.pdf })
        };
        Self { light: light.clone(), points: y.par_iter().filter_map(point).collect(), brdf_side, seed }
    }

    fn terms(&self, at: &ShadingPoint, index: u64) -> Vec<Term> {
        let counts = (self.points.len() as f64, (self.brdf_side * self.brdf_side) as f64);
        let term = |wi: Vec3A, radiance: Vec3A, emitter_pdf: f32| {
            let f = f64::from(luminance(at.brdf_cosine(wi) * radiance));
            let brdf_pdf = if counts.1 > 0.0 { f64::from(at.brdf.pdf(at.ns, at.wo, wi)) } else { 0.0 };
            let weight = 1.0 / (counts.0 * f64::from(emitter_pdf) + counts.1 * brdf_pdf);
            (f > 0.0).then_some(Term { wi, f, weight })
        };
        let mut random = Stream::new(13 + self.seed, Purpose::Test, index);
        let mut from_brdf = |k: usize| {
            let side = self.brdf_side;
            let u = (Vec2::new((k % side) as f32, (k / side) as f32) + random.uniform2()) / side as f32;
            let (wi, _) = at.brdf.sample(at.ns, at.wo, u)?;
            term(wi, self.light.environment().radiance(wi), self.light.pdf(wi))
        };
        let of_lobe: Vec<Term> = (0..self.brdf_side * self.brdf_side).filter_map(&mut from_brdf).collect();
        let of_light = self.points.iter().filter_map(|point| term(point.wi, point.radiance, point.emitter_pdf));
        of_light.chain(of_lobe).collect()
    }
}

/// By quadrature.
pub fn measure<S: DirectionSampler>(conditions: Conditions, quadratures: &[Quadrature], sampler: &S) -> Quality {
    both(quadratures.iter().map(|quadrature| {
        mean((0..conditions.count).into_par_iter().map(|index| {
            let at = conditions.shading_point(index);
            let prepared = sampler.prepare(&at);
            let (mut first, mut second, mut logs) = (0.0_f64, 0.0_f64, 0.0_f64);
            for Term { wi, f, weight } in quadrature.terms(&at, index) {
                let pdf = f64::from(sampler.pdf(&prepared, &at, wi));
                first += weight * f;
                second += weight * f * f / pdf;
                logs += weight * f * (f / pdf).ln();
            }
            // A condition that sees no light has no variance to speak of.
            (first > 0.0).then(|| (second / (first * first) - 1.0, logs / first - first.ln()))
        }))
    }))
}

/// By draws, 8,000 for each condition: for estimators without a pdf.
pub fn measure_by_draws(conditions: Conditions, estimator: &dyn DirectEstimator) -> Quality {
    let (runs, draws) = if conditions.material == Material::Lambert { (1, 8_000) } else { (2, 4_000) };
    both((0..runs).map(|run| {
        mean((0..conditions.count).into_par_iter().map(|index| {
            let at = conditions.shading_point(index);
            let mut random = Stream::new(8 + run, Purpose::Test, index);
            let (mut first, mut second) = (0.0_f64, 0.0_f64);
            for _ in 0..draws {
                let value = f64::from(luminance(estimator.estimate(&at, &Unshadowed, &mut random).radiance));
                first += value;
                second += value * value;
            }
            (first > 0.0).then(|| (second * f64::from(draws) / (first * first) - 1.0, f64::NAN))
        }))
    }))
}

fn mean(values: impl ParallelIterator<Item = Option<(f64, f64)>>) -> (f64, f64) {
    let values: Vec<_> = values.flatten().collect();
    let n = values.len() as f64;
    let (variance, kl) = values.iter().fold((0.0, 0.0), |(a, b), (variance, kl)| (a + variance, b + kl));
    (variance / n, kl / n)
}

/// The mean of one or two measurements.
fn both(measurements: impl Iterator<Item = (f64, f64)>) -> Quality {
    let all: Vec<(f64, f64)> = measurements.collect();
    let ((first, first_kl), (last, last_kl)) = (all[0], all[all.len() - 1]);
    let relative_variance = 0.5 * (first + last);
    let error = if all.len() == 1 { f64::NAN } else { 0.5 * (first - last).abs() / relative_variance };
    Quality { relative_variance, kl: 0.5 * (first_kl + last_kl), error }
}
