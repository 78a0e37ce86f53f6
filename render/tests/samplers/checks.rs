//! Checks of a sampler's properties at one shading point; each is a function that returns the failure.

use glam::{Vec2, Vec3A};
use headtail_render::{
    color::luminance,
    columns::Arena,
    environment::Environment,
    estimator::{Contributions, Estimator, Ris, Split, TwoSampleMis},
    latlong,
    one_point::OnePoint,
    points::{PointSet, Points},
    random::{Purpose, Stream},
    sampler::{AtPoint, BrdfSampler, Covering, Direction, EmitterSampler, Sampler},
    statistics::{ChiSquareReport, Moments, SphereChiSquare, TTest, sidak},
    tile::{ShadingPoint, Tile},
};

use super::{BRDFS, SIGNIFICANCE, truth::Dense, worlds::World};

pub type Verdict = Result<(), String>;

/// Rows of the chi-square test, and sub-cells along a side of its cells.
pub const ROWS: usize = 25;
pub const SUBCELLS: usize = 5;
/// Extent of a sub-cell in the lat-long square.
const EXTENT: Vec2 = Vec2::new(0.5 / (ROWS * SUBCELLS) as f32, 1.0 / (ROWS * SUBCELLS) as f32);
/// Maximum points along a side of a sub-cell.
pub const MOST_POINTS: usize = 16;

/// Returns uniform points.
pub fn uniforms(random: &mut Stream, count: usize) -> Vec<Vec2> {
    (0..count).map(|_| random.uniform2()).collect()
}

/// Performs a chi-square test on the sphere, and compares the integral of the pdf with the fraction of
/// accepted draws.
pub fn draws_follow_pdf(bound: &AtPoint<'_>, dense: Option<&Dense>, probes: usize, tests: usize) -> Verdict {
    let (rows, subcells, samples) = (ROWS, SUBCELLS, 100_000);
    // Discontinuities of a table in dim cells, with 2 x 2 points, change the integral by up to 0.5 %.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 8e-3, ..SphereChiSquare::default() };
    let draw = |random: &mut Stream, count: usize| {
        bound.sample_many(&uniforms(random, count)).into_iter().map(|drawn| Some(drawn?.wi)).collect()
    };
    let report = test.run(draw, |w| means_over(bound, dense, w, probes));
    if report.passed() { Ok(()) } else { Err(format!("{report}; {}", worst_cell(&report))) }
}

/// Describes the cell where observed and expected counts differ most.
fn worst_cell(report: &ChiSquareReport) -> String {
    let part = |cell: usize| (report.observed[cell] - report.expected[cell]).powi(2) / report.expected[cell].max(5.0);
    let worst = (0..report.observed.len()).max_by(|&a, &b| part(a).total_cmp(&part(b))).unwrap_or(0);
    let (row, column) = (worst / report.columns, worst % report.columns);
    let (observed, expected) = (report.observed[worst], report.expected[worst]);
    format!("worst at row {row}, column {column}: {observed} drawn, {expected:.1} expected")
}

/// Returns the means of the pdf over the sub-cells around directions.
///
/// Uses `probes x probes` points, and more where each would represent more than half an expected sample in
/// 1e5: the quadrature's error (at edges of lamps and of table cells) must be small against the noise of the
/// counts, or the test would reject correct samplers.
fn means_over(bound: &AtPoint<'_>, dense: Option<&Dense>, w: &[Vec3A], probes: usize) -> Vec<f32> {
    let centres: Vec<Vec2> = w.iter().map(|&w| latlong::square(w)).collect();
    let mut means = means_of(bound, &centres, probes);
    // Sub-cells by the required number of points along a side; each group is evaluated at once.
    let mut finer: Vec<Vec<usize>> = vec![Vec::new(); MOST_POINTS + 1];
    for (k, (mean, centre)) in means.iter_mut().zip(&centres).enumerate() {
        if let Some(own) = dense.and_then(|dense| dense.mean(bound, w[k])) {
            *mean = own;
            continue;
        }
        let mass = *mean * EXTENT.x * EXTENT.y / latlong::solid_angle_factor(centre.y);
        let side = (mass / 5e-6).sqrt() as usize;
        if side > probes {
            finer[side.min(MOST_POINTS)].push(k);
        }
    }
    for (side, members) in finer.iter().enumerate().filter(|(_, members)| !members.is_empty()) {
        let own: Vec<Vec2> = members.iter().map(|&k| centres[k]).collect();
        for (&k, mean) in members.iter().zip(means_of(bound, &own, side)) {
            means[k] = mean;
        }
    }
    means
}

/// Returns the means of the pdf over sub-cells around centres, by `side x side` points each.
fn means_of(bound: &AtPoint<'_>, centres: &[Vec2], side: usize) -> Vec<f32> {
    let point = |centre: Vec2, k: usize| {
        let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32 - 0.5;
        centre + inside * EXTENT
    };
    let points: Vec<Vec2> =
        centres.iter().flat_map(|&centre| (0..side * side).map(move |k| point(centre, k))).collect();
    let directions: Vec<Vec3A> = points.iter().map(|&x| latlong::direction(x)).collect();
    let pdfs = bound.pdf_many(&directions);
    let mean = |(points, pdfs): (&[Vec2], &[f32])| {
        let weights = points.iter().map(|x| latlong::sin_theta(x.y));
        let sum: f32 = weights.clone().zip(pdfs).map(|(weight, pdf)| weight * pdf).sum();
        sum / weights.sum::<f32>()
    };
    points.chunks_exact(side * side).zip(pdfs.chunks_exact(side * side)).map(mean).collect()
}

/// Checks that `pdf(sample) == sample.pdf` up to the rounding of the direction.
///
/// A direction determines x to about 1e-7; the effect on a steep pdf is measured by moving x as far. Where
/// the density over Y is constant per cell, a y rounded across an edge has the neighbour's density: with
/// errors of 2e-6 and at most 256 cells along both axes, this affects a fraction of 2 x 2 x 256 x 2e-6 = 2e-3
/// of the samples.
pub fn pdf_of_samples_agrees(bound: &AtPoint<'_>, samples: usize) -> Verdict {
    let mut random = Stream::new(3, Purpose::Test, 1);
    let drawn: Vec<Direction> = bound.sample_many(&uniforms(&mut random, samples)).into_iter().flatten().collect();
    let directions: Vec<Vec3A> = drawn.iter().map(|sample| sample.wi).collect();
    let error = |(sample, pdf): (&Direction, f32)| (pdf / sample.pdf - 1.0).abs();
    let errors: Vec<f32> = drawn.iter().zip(bound.pdf_many(&directions)).map(error).collect();
    let suspects: Vec<usize> = (0..drawn.len()).filter(|&k| errors[k].is_nan() || errors[k] > 1e-3).collect();
    let moved = |k: usize, axis: Vec2| {
        let x = latlong::square(drawn[k].wi);
        latlong::direction((x + 1.2e-7 * axis).clamp(Vec2::ZERO, Vec2::ONE))
    };
    let axes = [Vec2::X, -Vec2::X, Vec2::Y, -Vec2::Y];
    let around: Vec<Vec3A> = suspects.iter().flat_map(|&k| axes.map(|axis| moved(k, axis))).collect();
    let (mut wrong, mut example) = (0_usize, String::new());
    for (&k, pdfs) in suspects.iter().zip(bound.pdf_many(&around).chunks_exact(axes.len())) {
        let own = errors[k];
        let moved = pdfs.iter().map(|&pdf| error((&drawn[k], pdf)));
        let (least, most) = moved.fold((own, own), |(a, b), e| (a.min(e), b.max(e)));
        if own.is_nan() || own > 1e-3 + 2.0 * (most - least) {
            wrong += 1;
            example = format!("{} at {}, off by {own}", drawn[k].pdf, latlong::square(drawn[k].wi));
        }
    }
    let allowed = 2e-3 * drawn.len() as f64;
    if wrong as f64 <= allowed {
        Ok(())
    } else {
        Err(format!("{wrong} of {} pdfs differ, e.g. {example}", drawn.len()))
    }
}

/// Returns the luminance of light x BRDF x cosine.
fn integrands(point: &OnePoint, environment: &Environment, wi: &[Vec3A]) -> Vec<f32> {
    let radiances = point.map(wi, |wi, out: [_; 3]| environment.radiances(wi, out));
    let both = point.brdf_cosines(wi).into_iter().zip(radiances);
    both.map(|(reflected, radiance)| luminance(reflected * Vec3A::from_array(radiance))).collect()
}

/// Checks that the pdf is positive wherever the integrand is: at uniform directions, and at directions of
/// other samplers.
pub fn pdf_covers(bound: &AtPoint<'_>, world: &World) -> Verdict {
    const EACH: usize = 3000;
    let point = bound.point();
    let emitter = EmitterSampler::new(world.light.clone());
    let emitter = AtPoint::of_table(&emitter, &point.tile().point(0), &BRDFS);
    let mut random = Stream::new(4, Purpose::Test, 2);
    let mut wi: Vec<Vec3A> = (0..EACH).map(|_| random.direction()).collect();
    wi.extend(point.sample_brdf(&uniforms(&mut random, EACH)).into_iter().flatten().map(|(wi, _)| wi));
    wi.extend(emitter.sample_many(&uniforms(&mut random, EACH)).into_iter().flatten().map(|drawn| drawn.wi));
    let values = integrands(point, world.environment(), &wi);
    for ((wi, value), pdf) in wi.iter().zip(values).zip(bound.pdf_many(&wi)) {
        if value > 0.0 && (pdf.is_nan() || pdf <= 0.0) {
            return Err(format!("pdf {pdf} where the integrand is {value}: {wi}"));
        }
    }
    Ok(())
}

/// Checks by a t-test that the mean of estimates is the truth.
pub fn mean_is(truth: f64, estimates: &[f64], tests: usize) -> Verdict {
    let mut moments = Moments::of(estimates).unwrap();
    let mean = moments.mean;
    // Deviations up to 2e-4 may come from single precision in tables and pdfs, and from the quadrature.
    moments.mean -= (mean - truth).clamp(-2e-4 * truth, 2e-4 * truth);
    let exact = Moments { count: 2, mean: truth, variance: 0.0 };
    let test = TTest::welch(&moments, &exact);
    let (p, t) = (test.p_value, test.t);
    if p >= sidak(SIGNIFICANCE, tests) {
        Ok(())
    } else {
        Err(format!("mean {mean}, truth {truth}, t = {t:.2}, p = {p:.1e}"))
    }
}

/// Returns estimates with a sampler alone: the integrand over the pdf, 0 for rejected draws.
pub fn estimates_of_sampler(bound: &AtPoint<'_>, world: &World, stream: u64, samples: usize) -> Vec<f64> {
    let mut random = Stream::new(6, Purpose::Test, stream);
    let drawn: Vec<Direction> = bound.sample_many(&uniforms(&mut random, samples)).into_iter().flatten().collect();
    let wi: Vec<Vec3A> = drawn.iter().map(|sample| sample.wi).collect();
    let values = integrands(bound.point(), world.environment(), &wi);
    let mut estimates: Vec<f64> =
        drawn.iter().zip(values).map(|(sample, value)| f64::from(value / sample.pdf)).collect();
    estimates.resize(samples, 0.0);
    estimates
}

pub fn mean_of_sampler(bound: &AtPoint<'_>, world: &World, truth: f64, samples: usize, tests: usize) -> Verdict {
    mean_is(truth, &estimates_of_sampler(bound, world, 3, samples), tests)
}

/// Returns unshadowed estimates in tiles of copies of a point: the sum of the contributions of each copy.
pub fn estimates(estimator: &dyn Estimator, at: &ShadingPoint, samples: usize, seed: u64) -> Vec<f64> {
    /// Copies per tile, not a multiple of a strip.
    const COPIES: usize = 250;
    let (tile, arena) = (Tile::of_table(&[*at; COPIES], &BRDFS), Arena::default());
    let mut contributions = Contributions::default();
    let mut estimates = Vec::with_capacity(samples + COPIES);
    for sample in 0..samples.div_ceil(COPIES) {
        contributions.clear();
        let points = Points::new(PointSet::Independent, seed).at_sample(sample as u32);
        estimator.propose(&tile.rows(), &points, &mut contributions, &arena);
        let mut sums = [0.0; COPIES];
        for (&place, &radiance) in contributions.places().iter().zip(contributions.radiance()) {
            sums[usize::from(place)] += f64::from(luminance(radiance));
        }
        estimates.extend(sums);
    }
    estimates.truncate(samples);
    estimates
}

/// Builds RIS of a sampler and BRDF sampling.
pub fn ris(sampler: impl Sampler + 'static, candidates: u32, world: &World) -> Box<dyn Estimator> {
    let (first, second) = (Covering::new(sampler).unwrap(), Covering::new(BrdfSampler).unwrap());
    Box::new(Ris::new(first, second, candidates, world.environment().clone()).unwrap())
}

/// Builds an estimator with several directions of a sampler.
pub fn split(sampler: impl Sampler + 'static, directions: u32, world: &World) -> Box<dyn Estimator> {
    Box::new(Split::new(Covering::new(sampler).unwrap(), directions, world.environment().clone()).unwrap())
}

/// Builds two-sample MIS of a sampler and BRDF sampling.
pub fn mis2(sampler: impl Sampler + 'static, world: &World) -> Box<dyn Estimator> {
    Box::new(TwoSampleMis::new(sampler, BrdfSampler, world.environment().clone()).unwrap())
}
