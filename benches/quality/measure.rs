//! Relative variance and KL of a sampler, as means over random conditions.

use glam::Vec3A;
use headtail_render::{
    brdf::{Brdf, Ggx, Lambert},
    color::luminance,
    integrator::{DirectEstimator, Unshadowed},
    random::{Purpose, Stream},
    sampler::{DirectionSampler, EnvironmentLight, ShadingPoint},
    statistics::{Quadrature, QuadratureShape, Term},
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

/// One quadrature for a diffuse surface (the centres of 250 x 250 cells of Y), two independent ones for a glossy one (a jittered
/// point in each of 160 x 160 cells, and 112 x 112 BRDF samples).
pub fn quadratures(conditions: Conditions, light: &EnvironmentLight) -> Vec<Quadrature> {
    let shapes = match conditions.material {
        Material::Lambert => vec![QuadratureShape { strata: 250, brdf_strata: 0, seed: None }],
        Material::Ggx { .. } => {
            [0, 1].map(|seed| QuadratureShape { strata: 160, brdf_strata: 112, seed: Some(seed) }).to_vec()
        }
    };
    shapes.into_iter().map(|shape| Quadrature::new(light, shape)).collect()
}

/// By quadrature.
pub fn measure<S: DirectionSampler>(conditions: Conditions, quadratures: &[Quadrature], sampler: &S) -> Quality {
    both(quadratures.iter().map(|quadrature| {
        mean((0..conditions.count).into_par_iter().map(|index| {
            let at = conditions.shading_point(index);
            let prepared = sampler.prepare(&at);
            let (mut first, mut second, mut logs) = (0.0_f64, 0.0_f64, 0.0_f64);
            for Term { wi, f, weight } in quadrature.terms(&at, index).into_iter().filter(|term| term.f > 0.0) {
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
