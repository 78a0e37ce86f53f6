//! Variance and KL of every sampler under environment maps, without shadows: `cargo bench --bench quality -- [MAP ...]`.
//!
//! For 100 random normals the relative variance of one sample is integrated over 512 x 512 points of Y (through the exact tail the
//! emitter's density is constant there, so a sun costs no more points than a sky). Resampled samplers have no pdf: theirs is
//! measured from 20,000 draws per normal. Figures are ratios of the mean relative variance of one-sample MIS to the sampler's (higher
//! is better) and KL(product || sampler) in nats.

use std::{sync::Arc, time::Instant};

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::{Brdf, Lambert},
    color::luminance,
    environment::Environment,
    export::{ExportedSampler, Intermediate},
    integrator::{DirectEstimator, ResampledEstimator, Unshadowed},
    random::{Purpose, Stream},
    sampler::*,
    tail::TailKind,
};
use rayon::prelude::*;

const NORMALS: u64 = 100;
const SIDE: usize = 512;
const DRAWS: usize = 20_000;

/// Relative variance of one sample and KL, means over normals.
struct Quality {
    variance: f64,
    kl: f64,
}

fn shading_point(normal: Vec3A) -> ShadingPoint {
    let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, brdf }
}

/// Points of Y, the directions they are carried to, and the emitter's pdf there.
struct Quadrature(Vec<(Vec3A, f32)>);

impl Quadrature {
    fn new(light: &EnvironmentLight) -> Self {
        let points = (0..SIDE * SIDE).into_par_iter().filter_map(|k| {
            let y = Vec2::new((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5) / SIDE as f32;
            light.sample_through_tail(y, 1.0).map(|sample| (sample.wi, sample.pdf))
        });
        Self(points.collect())
    }

    fn measure<S: DirectionSampler>(&self, light: &EnvironmentLight, sampler: &S) -> Quality {
        let per_normal: Vec<_> = (0..NORMALS)
            .into_par_iter()
            .map(|k| {
                let at = shading_point(Stream::new(7, Purpose::Test, k).direction());
                let prepared = sampler.prepare(&at);
                let (mut first, mut second, mut entropy, mut n) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0);
                let mut logs = 0.0_f64;
                for &(wi, emitter) in &self.0 {
                    n += 1.0;
                    let f = luminance(at.brdf_cosine(wi) * light.environment().radiance(wi));
                    if f <= 0.0 {
                        continue;
                    }
                    let g = f64::from(f) / f64::from(emitter);
                    let pdf = f64::from(sampler.pdf(&prepared, &at, wi));
                    first += g;
                    second += f64::from(f) * g / pdf;
                    entropy += g * f64::from(f).ln();
                    logs += g * pdf.ln();
                }
                let mean = first / n;
                // A normal that sees no light has no variance to speak of.
                if mean <= 0.0 {
                    return None;
                }
                let kl = (entropy - logs) / first - mean.ln();
                Some((second / n / (mean * mean) - 1.0, kl))
            })
            .collect();
        average(per_normal.into_iter().flatten())
    }
}

fn average(values: impl Iterator<Item = (f64, f64)>) -> Quality {
    let (mut variance, mut kl, mut n) = (0.0, 0.0, 0.0);
    for (v, k) in values {
        variance += v;
        kl += k;
        n += 1.0;
    }
    Quality { variance: variance / n, kl: kl / n }
}

fn measure_by_draws(estimator: &dyn DirectEstimator) -> Quality {
    let per_normal: Vec<_> = (0..NORMALS)
        .into_par_iter()
        .map(|k| {
            let at = shading_point(Stream::new(7, Purpose::Test, k).direction());
            let mut random = Stream::new(8, Purpose::Test, k);
            let (mut first, mut second) = (0.0_f64, 0.0_f64);
            for _ in 0..DRAWS {
                let value = f64::from(luminance(estimator.estimate(&at, &Unshadowed, &mut random).radiance));
                first += value;
                second += value * value;
            }
            (first > 0.0).then(|| (second * DRAWS as f64 / (first * first) - 1.0, f64::NAN))
        })
        .collect();
    average(per_normal.into_iter().flatten())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let (maps, files): (Vec<_>, Vec<_>) = arguments.into_iter().partition(|a| !a.ends_with(".safetensors"));
    let extra = std::env::var("VARIANTS").is_ok();
    for name in maps {
        let environment = Arc::new(Environment::open(&name)?);
        for kind in [TailKind::Hierarchical, TailKind::RowColumn] {
            let light = EnvironmentLight::new(environment.clone(), kind)?;
            let quadrature = Quadrature::new(&light);
            let emitter = EmitterSampler::new(light.clone());
            let cosine = BrdfSampler::new(environment.clone());
            let mis = quadrature.measure(&light, &OneSampleMis::new(emitter.clone(), cosine.clone()));
            let report = |label: &str, quality: &Quality| {
                println!(
                    "{:24} {:14} {:22} {:10.2} {:10.4} {:10.4}",
                    environment.name(),
                    kind.name(),
                    label,
                    mis.variance / quality.variance,
                    quality.variance,
                    quality.kl
                );
            };
            report("mis", &mis);
            if kind == TailKind::Hierarchical {
                report("cosine", &quadrature.measure(&light, &cosine));
                report("emitter", &quadrature.measure(&light, &emitter));
                let compensated = CompensatedEmitterSampler::new(&light)?;
                report("mis-comp", &quadrature.measure(&light, &OneSampleMis::new(compensated, cosine.clone())));
                let ris = Resampled::new(emitter.clone(), cosine.clone(), 4)?;
                report("ris:4", &measure_by_draws(&ResampledEstimator::new(ris)));
                let oracle = Oracle::new(light.tail());
                report("oracle", &quadrature.measure(&light, &ProductSampler::new(light.clone(), oracle)));
            }
            let sizes: &[(usize, usize, usize, usize)] = if extra {
                &[
                    (16, 32, 8, 8),
                    (16, 32, 16, 16),
                    (16, 32, 32, 32),
                    (24, 48, 32, 32),
                    (32, 64, 32, 32),
                    (16, 32, 64, 64),
                ]
            } else {
                &[(16, 32, 32, 32)]
            };
            for &(p, a, r, c) in sizes {
                let start = Instant::now();
                let table = direct_bake(light.tail(), NormalGrid::new(p, a)?, CellGrid::new(r, c)?)?;
                let time = start.elapsed().as_secs_f64();
                report(
                    &format!("direct {p}x{a} {r}x{c} {time:.2}s"),
                    &quadrature.measure(&light, &ProductSampler::new(light.clone(), table)),
                );
            }
            for file in &files {
                let exported = ExportedSampler::read(file.as_ref())?;
                if exported.check_environment(&environment).is_err() || exported.tail.kind() != kind {
                    continue;
                }
                let short = std::path::Path::new(file).file_stem().unwrap().to_string_lossy().into_owned();
                let quality = match exported.intermediate {
                    Intermediate::Head(head) => quadrature.measure(&light, &ProductSampler::new(light.clone(), head)),
                    Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
                        quadrature.measure(&light, &ProductSampler::new(light.clone(), table))
                    }
                };
                report(&short, &quality);
            }
        }
    }
    Ok(())
}
