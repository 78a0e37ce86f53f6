//! Relative variance and KL of a sampler, as means over random conditions.

use glam::{Vec3, Vec3A};
use headtail_render::{
    brdf::{Ggx, Lambert},
    color::luminance,
    columns::Arena,
    estimator::{Contributions, Estimator},
    points::{PointSet, Points},
    random::{Purpose, Stream},
    sampler::{AtPoint, EnvironmentLight, Sampler},
    statistics::{Quadrature, QuadratureShape, Term},
    tile::{ShadingPoint, Tile},
};
use headtail_train::{Material, Viewpoints};
use rayon::prelude::*;

/// Means over conditions.
#[derive(Clone, Copy)]
pub struct Quality {
    pub relative_variance: f64,
    /// NaN where the sampler has no pdf.
    pub kl: f64,
    /// The largest weight over its mean, at any condition and point of the quadrature; NaN where the sampler has no pdf.
    pub largest_weight: f64,
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
        let ([wo, n], surface) = match self.material {
            Material::Lambert => ([stream.direction(); 2], Lambert { albedo: Vec3::ONE }.into()),
            Material::Ggx { low, high } => {
                let directions = Viewpoints::Sphere.draw(&mut stream);
                (directions, Ggx::new(low + (high - low) * stream.uniform(), Vec3::ONE).into())
            }
            Material::Measured(_) => unreachable!("main refuses it"),
        };
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
    }
}

/// One quadrature for a diffuse surface (a jittered point in each of 250 x 250 cells of Y and of 512 x 1024 cells of X), two independent ones for a glossy
/// one (a jittered point in each of 160 x 160 cells of Y and of 128 x 256 cells of X, and 112 x 112 BRDF samples).
pub fn quadratures(conditions: Conditions, light: &EnvironmentLight) -> Vec<Quadrature> {
    let shapes = match conditions.material {
        Material::Lambert => vec![QuadratureShape { strata: 250, map_rows: 512, brdf_strata: 0, seed: Some(1) }],
        Material::Ggx { .. } | Material::Measured(_) => {
            let shape = |seed| QuadratureShape { strata: 160, map_rows: 128, brdf_strata: 112, seed: Some(seed) };
            [0, 1].map(shape).to_vec()
        }
    };
    shapes.into_iter().map(|shape| Quadrature::new(light, shape)).collect()
}

/// By quadrature.
pub fn measure(conditions: Conditions, quadratures: &[Quadrature], sampler: &dyn Sampler) -> Quality {
    both(quadratures.iter().map(|quadrature| {
        mean((0..conditions.count).into_par_iter().map(|index| {
            let at = conditions.shading_point(index);
            let mut terms = quadrature.terms(&at, index);
            terms.retain(|term| term.f > 0.0);
            let wi: Vec<Vec3A> = terms.iter().map(|term| term.wi).collect();
            let pdfs = AtPoint::new(sampler, &at).pdf_many(&wi);
            let (mut first, mut second, mut logs, mut largest) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
            for (Term { f, weight, .. }, pdf) in terms.into_iter().zip(pdfs) {
                let pdf = f64::from(pdf);
                first += weight * f;
                second += weight * f * f / pdf;
                logs += weight * f * (f / pdf).ln();
                largest = largest.max(f / pdf);
            }
            // A condition that sees no light has no variance to speak of.
            (first > 0.0).then(|| [second / (first * first) - 1.0, logs / first - first.ln(), largest / first])
        }))
    }))
}

/// By draws, 8,000 for each condition: for estimators without a pdf.
pub fn measure_by_draws(conditions: Conditions, estimator: &dyn Estimator) -> Quality {
    let (runs, draws) = if conditions.material == Material::Lambert { (1, 8_000_usize) } else { (2, 4_000) };
    both((0..runs).map(|run| {
        mean((0..conditions.count).into_par_iter().map(|index| {
            let at = conditions.shading_point(index);
            // Copies of the point, whose keys tell their random numbers apart.
            let (tile, arena, mut drawn) = (Tile::of(&vec![at; draws]), Arena::default(), Contributions::default());
            let seed = 8 + run + (index << 8);
            estimator.propose(&tile.rows(), &Points::new(PointSet::Independent, seed), &mut drawn, &arena);
            let (mut first, mut second) = (0.0_f64, 0.0_f64);
            // One contribution for each draw at most.
            for &radiance in drawn.radiance() {
                let value = f64::from(luminance(radiance));
                first += value;
                second += value * value;
            }
            (first > 0.0).then(|| [second * draws as f64 / (first * first) - 1.0, f64::NAN, f64::NAN])
        }))
    }))
}

/// Mean variance and KL, and the largest weight of all.
fn mean(values: impl ParallelIterator<Item = Option<[f64; 3]>>) -> [f64; 3] {
    let values: Vec<_> = values.flatten().collect();
    let of = |figure: usize| values.iter().map(move |value| value[figure]);
    let n = values.len() as f64;
    let largest = of(2).fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) });
    [of(0).sum::<f64>() / n, of(1).sum::<f64>() / n, largest]
}

/// The mean of one or two measurements.
fn both(measurements: impl Iterator<Item = [f64; 3]>) -> Quality {
    let all: Vec<[f64; 3]> = measurements.collect();
    let ([first, first_kl, first_largest], [last, last_kl, last_largest]) = (all[0], all[all.len() - 1]);
    let relative_variance = 0.5 * (first + last);
    let error = if all.len() == 1 { f64::NAN } else { 0.5 * (first - last).abs() / relative_variance };
    let largest_weight = if first_largest > last_largest { first_largest } else { last_largest };
    Quality { relative_variance, kl: 0.5 * (first_kl + last_kl), largest_weight, error }
}
