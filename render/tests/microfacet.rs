//! Tests of microfacet BRDFs: samples follow their pdf, and reflectance matches the textbook.
//!
//! The reference implements the textbook's formulas in f64, independently of the code under test.

use glam::{DVec3, Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{Ggx, Kernel, Lambert, MetallicRoughness, Surface},
    frame::Frame,
    latlong,
    one_point::OnePoint,
    random::{Purpose, Stream},
    statistics::{Moments, SphereChiSquare, sidak},
    tile::ShadingPoint,
};
use rayon::prelude::*;

/// Probability that any test of a group rejects a correct BRDF.
const SIGNIFICANCE: f64 = 0.01;

const ALPHAS: [f32; 4] = [0.05, 0.2, 0.4, 1.0];
/// From normal incidence to grazing.
const COSINES: [f32; 5] = [1.0, 0.8, 0.4, 0.1, 0.02];

/// Returns all pairs of a width and a cosine of `wo`.
fn pairs() -> Vec<(f32, f32)> {
    ALPHAS.iter().flat_map(|&alpha| COSINES.map(|cos| (alpha, cos))).collect()
}

/// Returns a random normal, and a direction at the given cosine to it.
fn oriented(cos: f32, index: usize) -> (Vec3, Vec3) {
    let mut random = Stream::new(11, Purpose::Test, index as u64);
    let normal = Vec3::from(random.direction());
    let (sin_phi, cos_phi) = (std::f32::consts::TAU * random.uniform()).sin_cos();
    let sin = (1.0 - cos * cos).sqrt();
    (normal, Frame::from_normal(normal).to_world(Vec3::new(sin * cos_phi, sin * sin_phi, cos)).normalize())
}

/// Returns copies of a point of a surface.
fn point(surface: impl Into<Surface>, normal: Vec3, wo: Vec3) -> OnePoint {
    let (n, wo) = (normal.into(), wo.into());
    ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface: surface.into() }.one()
}

/// Returns uniform points.
fn uniforms(random: &mut Stream, count: usize) -> Vec<Vec2> {
    (0..count).map(|_| random.uniform2()).collect()
}

/// Textbook values for a width and a cosine of `wo`, with F = 1.
struct Reference {
    /// Reflected fraction of the light of a white sky.
    albedo: f64,
    /// Fraction of the visible microfacets that reflect `wo` to above the horizon.
    above: f64,
}

impl Reference {
    /// Integrates over microfacet normals in proportion to `D(m) (n . m) s`, where `1 - x = s^2` for the
    /// uniform elevation variable `x`: the projected areas grow with `1 / s` towards the horizon.
    fn new(alpha: f32, cos: f32) -> Self {
        const SIDE: usize = 1000;
        let (alpha, cos) = (f64::from(alpha), f64::from(cos));
        let wo = DVec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
        // Lambda of Smith's masking (Heitz 2014, eq. 72).
        let lambda = |w: DVec3| {
            let tan_squared = (1.0 - w.z * w.z).max(0.0) / (w.z * w.z);
            0.5 * (-1.0 + (1.0 + alpha * alpha * tan_squared).sqrt())
        };
        let lambda_o = lambda(wo);
        let (mut albedo, mut above) = (0.0, 0.0);
        for i in 0..SIDE {
            let s = (i as f64 + 0.5) / SIDE as f64;
            let theta = (alpha * (1.0 - s * s).sqrt() / s).atan();
            for j in 0..SIDE {
                let phi = std::f64::consts::TAU * (j as f64 + 0.5) / SIDE as f64;
                let m = DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
                let wi = 2.0 * wo.dot(m) * m - wo;
                if wo.dot(m) <= 0.0 || wi.z <= 0.0 {
                    continue;
                }
                let projected = 2.0 * s * wo.dot(m) / (cos * m.z);
                albedo += projected / (1.0 + lambda_o + lambda(wi));
                above += projected / (1.0 + lambda_o);
            }
        }
        let points = (SIDE * SIDE) as f64;
        Self { albedo: albedo / points, above: above / points }
    }
}

/// Returns the means of a pdf over the sub-cells of a chi-square test around directions: by `most x most`
/// points where the mass exceeds one sample in 1e6, else by 4 x 4.
fn means_over(point: &OnePoint, w: &[Vec3A], rows: usize, most: usize) -> Vec<f32> {
    let centres: Vec<Vec2> = w.iter().map(|&w| latlong::square(w)).collect();
    let extent = Vec2::new(0.5, 1.0) / rows as f32;
    let mut means = means_of(point, &centres, extent, 4);
    let mass = |k: usize| means[k] * extent.x * extent.y / latlong::solid_angle_factor(centres[k].y);
    // NaN uses the finer points, too.
    let finer: Vec<usize> = (0..centres.len()).filter(|&k| mass(k).is_nan() || mass(k) >= 1e-6).collect();
    let own: Vec<Vec2> = finer.iter().map(|&k| centres[k]).collect();
    for (&k, mean) in finer.iter().zip(means_of(point, &own, extent, most)) {
        means[k] = mean;
    }
    means
}

/// Returns the means of a pdf over sub-cells around centres, by `side x side` points each.
fn means_of(point: &OnePoint, centres: &[Vec2], extent: Vec2, side: usize) -> Vec<f32> {
    let place = |centre: Vec2, k: usize| {
        let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32 - 0.5;
        centre + inside * extent
    };
    let points: Vec<Vec2> =
        centres.iter().flat_map(|&centre| (0..side * side).map(move |k| place(centre, k))).collect();
    let directions: Vec<Vec3A> = points.iter().map(|&x| latlong::direction(x)).collect();
    let pdfs = point.brdf_pdfs(&directions);
    let mean = |(points, pdfs): (&[Vec2], &[f32])| {
        let weights = points.iter().map(|x| latlong::sin_theta(x.y));
        let sum: f32 = weights.clone().zip(pdfs).map(|(weight, pdf)| weight * pdf).sum();
        sum / weights.sum::<f32>()
    };
    points.chunks_exact(side * side).zip(pdfs.chunks_exact(side * side)).map(mean).collect()
}

/// Returns the failures of a chi-square test of the samples of one BRDF against the pdf of another.
fn draws_follow_pdf(drawn: &OnePoint, claimed: &OnePoint, side: usize, tests: usize) -> Vec<String> {
    let (rows, subcells, samples) = (51, 3, 300_000);
    // The fraction of accepted draws has a standard deviation of at most 1e-3.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 5e-3, ..SphereChiSquare::default() };
    let draw = |random: &mut Stream, count: usize| {
        drawn.sample_brdf(&uniforms(random, count)).into_iter().map(|sample| Some(sample?.0)).collect()
    };
    test.run(draw, |w| means_over(claimed, w, rows * subcells, side)).failures
}

/// Returns the points along a side of a sub-cell (0.02 rad): at grazing angles a lobe is `2 alpha cos` wide
/// across the plane of incidence.
fn points_for(alpha: f32, cos: f32) -> usize {
    if alpha * cos.max(0.1) < 0.03 { 14 } else { 5 }
}

#[test]
fn ggx_directions_are_drawn_with_the_claimed_density() {
    let pairs = pairs();
    let failures: Vec<String> = pairs
        .par_iter()
        .enumerate()
        .filter_map(|(k, &(alpha, cos))| {
            let (normal, wo) = oriented(cos, k);
            let point = point(Ggx::new(alpha, Vec3::ONE), normal, wo);
            let failures = draws_follow_pdf(&point, &point, points_for(alpha, cos), pairs.len());
            (!failures.is_empty()).then(|| format!("alpha {alpha}, cosine {cos}: {}", failures.join("; ")))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn a_width_error_of_five_percent_is_detected() {
    for (k, &(alpha, cos)) in pairs().iter().enumerate().step_by(3) {
        let (normal, wo) = oriented(cos, k);
        let of_width = |alpha| point(Ggx::new(alpha, Vec3::ONE), normal, wo);
        let failures = draws_follow_pdf(&of_width(0.95 * alpha), &of_width(alpha), points_for(alpha, cos), 20);
        assert!(!failures.is_empty(), "alpha {alpha}, cosine {cos}");
    }
}

/// Tests that a mean is `truth`, up to its standard error at the significance of a group of `tests`; `slack`
/// is the error of `truth`.
fn is_mean(values: &[f64], truth: f64, slack: f64, tests: usize) -> Result<(), String> {
    let Moments { count, mean, variance } = Moments::of(values).unwrap();
    let error = (variance / count as f64).sqrt();
    // A normal variable exceeds z standard deviations with probability at most exp(-z^2 / 2).
    let z = (-2.0 * sidak(SIGNIFICANCE, tests).ln()).sqrt();
    if (mean - truth).abs() <= z * error + slack { Ok(()) } else { Err(format!("{mean} +- {error}, truth {truth}")) }
}

#[test]
fn ggx_matches_the_textbook() {
    let pairs = pairs();
    let failures: Vec<String> = pairs
        .par_iter()
        .enumerate()
        .flat_map(|(k, &(alpha, cos))| {
            let (normal, wo) = oriented(cos, k);
            let (point, reference) = (point(Ggx::new(alpha, Vec3::ONE), normal, wo), Reference::new(alpha, cos));
            // With F = 1, the BRDF is the lobe.
            let values = |wi: &[Vec3A]| point.brdf_cosines(wi).into_iter().map(|value| f64::from(value.x));
            let mut random = Stream::new(12, Purpose::Test, k as u64);
            let draws = point.sample_brdf(&uniforms(&mut random, 200_000));
            let (directions, pdfs): (Vec<Vec3A>, Vec<f32>) = draws.iter().flatten().copied().unzip();
            let mut weights: Vec<f64> =
                values(&directions).zip(pdfs).map(|(value, pdf)| value / f64::from(pdf)).collect();
            weights.resize(draws.len(), 0.0);
            let above: Vec<f64> = draws.iter().map(|d| f64::from(u8::from(d.is_some()))).collect();
            // Also by uniform directions, which need no pdf.
            let upper = |wi: Vec3A| if wi.dot(normal.into()) < 0.0 { -wi } else { wi };
            let directions: Vec<Vec3A> = (0..400_000).map(|_| upper(random.direction())).collect();
            let uniform: Vec<f64> = values(&directions).map(|value| value * std::f64::consts::TAU).collect();
            let tests = 3 * pairs.len();
            // The reference is discontinuous at the horizon: if that runs along one of 1000 rows, half of the
            // row is uncertain.
            let checks = [
                ("albedo", is_mean(&weights, reference.albedo, 1.0 / 2000.0, tests)),
                ("fraction above the horizon", is_mean(&above, reference.above, 1.0 / 2000.0, tests)),
                ("albedo by uniform directions", is_mean(&uniform, reference.albedo, 1.0 / 2000.0, tests)),
            ];
            let failed = |(name, check): (&str, Result<(), String>)| {
                check.err().map(|reason| format!("alpha {alpha}, cosine {cos}, {name}: {reason}"))
            };
            checks.into_iter().filter_map(failed).collect::<Vec<_>>()
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn mixed_directions_are_drawn_with_the_claimed_density() {
    let mixtures = [(0.0, 0.25), (0.0, 0.7), (0.5, 0.4), (1.0, 0.6)];
    let cases: Vec<_> = mixtures.iter().flat_map(|&mixture| [1.0, 0.5, 0.05].map(|cos| (mixture, cos))).collect();
    let failures: Vec<String> = cases
        .par_iter()
        .enumerate()
        .filter_map(|(k, &((metallic, roughness), cos))| {
            let (normal, wo) = oriented(cos, k);
            let brdf = MetallicRoughness::new(Vec3::new(0.7, 0.5, 0.3), metallic, roughness);
            let point = point(brdf, normal, wo);
            let failures = draws_follow_pdf(&point, &point, points_for(brdf.alpha(), cos), cases.len());
            let name = format!("metallic {metallic}, roughness {roughness}, cosine {cos}");
            (!failures.is_empty()).then(|| format!("{name}: {}", failures.join("; ")))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Returns stratified points.
fn square(side: usize) -> Vec<Vec2> {
    let point = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
    (0..side * side).map(point).collect()
}

/// Returns the fraction of a white sky that `of` reflects (in its green channel), by `side x side` directions
/// sampled by `drawn`.
fn reflected(drawn: &OnePoint, side: usize, of: impl Fn(&[Vec3A]) -> Vec<Vec3A>) -> f64 {
    let (wi, pdfs): (Vec<Vec3A>, Vec<f32>) = drawn.sample_brdf(&square(side)).into_iter().flatten().unzip();
    let weights = of(&wi).into_iter().zip(pdfs).map(|(value, pdf)| f64::from(value.y / pdf));
    weights.sum::<f64>() / (side * side) as f64
}

#[test]
fn metallic_roughness_reflects_no_more_than_it_receives() {
    let normal = Vec3::Z;
    let albedo = |brdf: &MetallicRoughness, cos: f32| {
        let wo = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        // White surfaces: the specular colour is between that of dielectrics and white.
        let f0 = Vec3::splat(0.04).lerp(brdf.base_color(), brdf.metallic());
        let specular = point(Ggx::new(brdf.alpha(), f0), normal, wo);
        let (whole, lambert) = (point(*brdf, normal, wo), point(Lambert { albedo: Vec3::ONE }, normal, wo));
        let diffuse = |wi: &[Vec3A]| {
            let both = whole.brdf_cosines(wi).into_iter().zip(specular.brdf_cosines(wi));
            both.map(|(whole, specular)| whole - specular).collect()
        };
        (reflected(&lambert, 200, diffuse), reflected(&specular, 150, |wi| specular.brdf_cosines(wi)))
    };
    let roughnesses = (0..=20_u8).map(|step| f32::from(step) / 20.0).chain([0.025, 0.035, 0.075]);
    roughnesses.collect::<Vec<_>>().into_par_iter().for_each(|roughness| {
        for cos in [0.006, 0.008, 0.0125, 0.025, 0.04, 0.06, 0.085, 0.13, 0.25, 0.5, 1.0] {
            for metallic in [0.0, 0.5, 1.0] {
                let white = MetallicRoughness::new(Vec3::ONE, metallic, roughness);
                let (diffuse, specular) = albedo(&white, cos);
                let total = diffuse + specular;
                // Rounding of weights equal to 1.
                assert!(total <= 1.0 + 1e-5, "roughness {roughness}, cosine {cos}, metallic {metallic}: {total}");
                // Dielectrics lose only the margin for interpolation.
                assert!(metallic > 0.0 || total >= 0.985, "roughness {roughness}, cosine {cos}: {total}");
            }
        }
    });
}
