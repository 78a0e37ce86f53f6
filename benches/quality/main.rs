//! Variance and KL of every sampler on Lambert surfaces without shadows: `cargo bench --bench quality -- [MAP ...]`.
//!
//! For 100 random normals the relative variance of one sample is integrated over 250 x 250 points of the intermediate square:
//! through an exact tail the emitter's density is constant there, so a sun costs no more points than a sky. Resampled
//! samplers have no pdf: theirs is measured from 8,000 draws per normal. A head is trained for each map with the defaults
//! of `headtail fit`. Prints two tables: mean relative variance of one-sample MIS over that of the sampler (at one shadow
//! ray each; higher is better), and KL(product || sampler) in nats. Without arguments it takes the built-in environments.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::{Brdf, Lambert},
    color::luminance,
    environment::{BUILT_IN_NAMES, Environment},
    head::Head,
    integrator::{DirectEstimator, ResampledEstimator, Unshadowed},
    random::{Purpose, Stream},
    sampler::{
        BrdfSampler, CompensatedEmitterSampler, DirectionSampler, EmitterSampler, EnvironmentLight, OneSampleMis,
        Oracle, ProductSampler, Resampled, ShadingPoint,
    },
    tail::TailKind,
};
use headtail_train::{CosineTarget, FitConfig, fit, learned_bake, native_head};
use rayon::prelude::*;

const NORMALS: u64 = 100;
const SIDE: usize = 250;
const DRAWS: usize = 8_000;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// Means over normals.
struct Quality {
    relative_variance: f64,
    /// NaN where the sampler has no pdf.
    kl: f64,
}

fn shading_point(index: u64) -> ShadingPoint {
    let normal = Stream::new(7, Purpose::Test, index).direction();
    let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, brdf }
}

/// A direction for each point of Y, and what its integrals need.
struct Point {
    wi: Vec3A,
    radiance: Vec3A,
    emitter_pdf: f32,
}

fn quadrature(light: &EnvironmentLight) -> Vec<Point> {
    let point = |k: usize| {
        let y = Vec2::new((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5) / SIDE as f32;
        let sample = light.sample_through_tail(y, 1.0)?;
        Some(Point { wi: sample.wi, radiance: sample.radiance, emitter_pdf: sample.pdf })
    };
    (0..SIDE * SIDE).into_par_iter().filter_map(point).collect()
}

fn measure<S: DirectionSampler>(points: &[Point], sampler: &S) -> Quality {
    mean((0..NORMALS).into_par_iter().map(|index| {
        let at = shading_point(index);
        let prepared = sampler.prepare(&at);
        let (mut first, mut second, mut logs) = (0.0_f64, 0.0_f64, 0.0_f64);
        for point in points {
            let f = f64::from(luminance(at.brdf_cosine(point.wi) * point.radiance));
            if f > 0.0 {
                let g = f / f64::from(point.emitter_pdf);
                let pdf = f64::from(sampler.pdf(&prepared, &at, point.wi));
                first += g;
                second += g * f / pdf;
                logs += g * (f / pdf).ln();
            }
        }
        let n = points.len() as f64;
        // A normal that sees no light has no variance to speak of.
        (first > 0.0).then(|| (second * n / (first * first) - 1.0, logs / first - (first / n).ln()))
    }))
}

fn measure_by_draws(estimator: &dyn DirectEstimator) -> Quality {
    mean((0..NORMALS).into_par_iter().map(|index| {
        let at = shading_point(index);
        let mut random = Stream::new(8, Purpose::Test, index);
        let (mut first, mut second) = (0.0_f64, 0.0_f64);
        for _ in 0..DRAWS {
            let value = f64::from(luminance(estimator.estimate(&at, &Unshadowed, &mut random).radiance));
            first += value;
            second += value * value;
        }
        (first > 0.0).then(|| (second * DRAWS as f64 / (first * first) - 1.0, f64::NAN))
    }))
}

fn mean(values: impl ParallelIterator<Item = Option<(f64, f64)>>) -> Quality {
    let values: Vec<_> = values.flatten().collect();
    let n = values.len() as f64;
    let (variance, kl) = values.iter().fold((0.0, 0.0), |(a, b), (variance, kl)| (a + variance, b + kl));
    Quality { relative_variance: variance / n, kl: kl / n }
}

fn train(light: &EnvironmentLight) -> Fallible<(Head, f64)> {
    let start = Instant::now();
    let direction = |y: [f32; 2]| light.tail().forward_direction(Vec2::from_array(y)).1.to_array();
    let fitted = fit(&FitConfig::default(), &CosineTarget::new(&direction), &mut |_| {}, &AtomicBool::new(false))?;
    Ok((native_head(&fitted.head)?, start.elapsed().as_secs_f64()))
}

/// Every sampler on one map, in the order of the tables' columns.
fn measure_map(environment: &Arc<Environment>) -> Fallible<Vec<(&'static str, Quality)>> {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let row_column = EnvironmentLight::new(environment.clone(), TailKind::RowColumn)?;
    let (points, row_column_points) = (quadrature(&light), quadrature(&row_column));
    let emitter = EmitterSampler::new(light.clone());
    let brdf = BrdfSampler::new(environment.clone());
    let ris = |candidates| Resampled::new(emitter.clone(), brdf.clone(), candidates).map(ResampledEstimator::new);
    let normals = NormalGrid::new(16, 32)?;
    let direct = |light: &EnvironmentLight, side: usize| -> Fallible<_> {
        Ok(ProductSampler::new(light.clone(), direct_bake(light.tail(), normals, CellGrid::new(side, side)?)?))
    };
    let (head, seconds) = train(&light)?;
    let baked = learned_bake(&head, light.tail(), normals, CellGrid::new(32, 32)?)?;
    println!("{}: trained for {seconds:.1} s", environment.name());
    let compensated = CompensatedEmitterSampler::new(&light)?;
    Ok(vec![
        ("mis", measure(&points, &OneSampleMis::new(emitter.clone(), brdf.clone()))),
        ("cosine", measure(&points, &brdf)),
        ("emitter", measure(&points, &emitter)),
        ("mis-comp", measure(&points, &OneSampleMis::new(compensated, brdf.clone()))),
        ("ris:4", measure_by_draws(&ris(4)?)),
        ("ris:16", measure_by_draws(&ris(16)?)),
        ("head", measure(&points, &ProductSampler::new(light.clone(), head))),
        ("baked 32x32", measure(&points, &ProductSampler::new(light.clone(), baked))),
        ("direct 8x8", measure(&points, &direct(&light, 8)?)),
        ("direct 32x32", measure(&points, &direct(&light, 32)?)),
        ("direct 64x64", measure(&points, &direct(&light, 64)?)),
        ("direct 32x32 row-column", measure(&row_column_points, &direct(&row_column, 32)?)),
        ("oracle", measure(&points, &ProductSampler::new(light.clone(), Oracle::new(light.tail())))),
    ])
}

fn main() -> Fallible<()> {
    // Cargo passes `--bench`.
    let mut maps: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if maps.is_empty() {
        maps = BUILT_IN_NAMES.map(str::to_owned).to_vec();
    }
    let mut results = Vec::new();
    for map in &maps {
        let environment = Arc::new(Environment::open(map)?);
        results.push((environment.name().to_owned(), measure_map(&environment)?));
    }
    let ratio =
        |qualities: &[(&str, Quality)], k: usize| qualities[0].1.relative_variance / qualities[k].1.relative_variance;
    print_table("relative variance of mis over that of the sampler", &results, ratio);
    print_table("KL(product || sampler) in nats", &results, |qualities, k| qualities[k].1.kl);
    Ok(())
}

type Results = [(String, Vec<(&'static str, Quality)>)];

/// A Markdown table of one figure, with the median over maps last.
fn print_table(title: &str, results: &Results, figure: impl Fn(&[(&str, Quality)], usize) -> f64) {
    let columns: Vec<_> = results[0].1.iter().map(|(name, _)| *name).collect();
    println!("\n{title}\n\n| map | {} |\n|---|{}", columns.join(" | "), "---|".repeat(columns.len()));
    let line = |name: &str, values: &[f64]| {
        let cell = |value: &f64| if value.is_nan() { "-".into() } else { format!("{value:.3}") };
        println!("| {name} | {} |", values.iter().map(cell).collect::<Vec<_>>().join(" | "));
    };
    let rows: Vec<Vec<f64>> =
        results.iter().map(|(_, qualities)| (0..columns.len()).map(|k| figure(qualities, k)).collect()).collect();
    for ((name, _), row) in results.iter().zip(&rows) {
        line(name, row);
    }
    let medians: Vec<f64> = (0..columns.len())
        .map(|k| {
            let mut values: Vec<f64> = rows.iter().map(|row| row[k]).collect();
            values.sort_by(f64::total_cmp);
            0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
        })
        .collect();
    line("median", &medians);
}
