//! Microfacet BRDFs draw what their pdf says and reflect what the textbook says they do.
//!
//! The reference is written in f64 from the textbook's formulas and shares nothing with the code under test.

use glam::{DVec3, Vec2, Vec3A};
use headtail_render::{
    brdf::{Brdf, Ggx, Lambert, MetallicRoughness},
    frame::Frame,
    latlong,
    random::{Purpose, Stream},
    statistics::{Moments, SphereChiSquare, sidak},
};
use rayon::prelude::*;

/// The chance that any test of a group rejects a right BRDF.
const SIGNIFICANCE: f64 = 0.01;

const ALPHAS: [f32; 4] = [0.05, 0.2, 0.4, 1.0];
/// From normal incidence to grazing.
const COSINES: [f32; 5] = [1.0, 0.8, 0.4, 0.1, 0.02];

/// Every pair of a width and a cosine of `wo`.
fn pairs() -> Vec<(f32, f32)> {
    ALPHAS.iter().flat_map(|&alpha| COSINES.map(|cos| (alpha, cos))).collect()
}

/// A normal that is in no special place, and a direction at the given cosine from it.
fn oriented(cos: f32, index: usize) -> (Vec3A, Vec3A) {
    let mut random = Stream::new(11, Purpose::Test, index as u64);
    let normal = random.direction();
    let (sin_phi, cos_phi) = (std::f32::consts::TAU * random.uniform()).sin_cos();
    let sin = (1.0 - cos * cos).sqrt();
    (normal, Frame::from_normal(normal).to_world(Vec3A::new(sin * cos_phi, sin * sin_phi, cos)).normalize())
}

/// What the textbook says of a width and a cosine of `wo`, with F = 1.
struct Reference {
    /// Reflected share of the light of a white sky.
    albedo: f64,
    /// Share of the visible microfacets that reflect `wo` to above the horizon.
    above: f64,
}

impl Reference {
    /// By quadrature over microfacet normals, in proportion to `D(m) (n . m) s` with `1 - x = s^2` of the uniform `x` that stands
    /// for the elevation: the projected areas grow with `1 / s` towards the horizon.
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

/// The mean of a pdf over the sub-cell of a chi-square test around a direction: by `most x most` points where that is more than a
/// sample in 1e6, else by 4 x 4.
fn mean_over(pdf: &impl Fn(Vec3A) -> f32, w: Vec3A, rows: usize, most: usize) -> f32 {
    let centre = latlong::square(w);
    let extent = Vec2::new(0.5, 1.0) / rows as f32;
    let mean = |side: usize| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..side * side {
            let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32 - 0.5;
            let x = centre + inside * extent;
            let weight = latlong::sin_theta(x.y);
            sum += weight * pdf(latlong::direction(x));
            weights += weight;
        }
        sum / weights
    };
    let coarse = mean(4);
    let mass = coarse * extent.x * extent.y / latlong::solid_angle_factor(centre.y);
    if mass < 1e-6 { coarse } else { mean(most) }
}

/// What a chi-square test on the sphere finds wrong with the samples of one BRDF under the pdf of another.
fn draws_follow_pdf(drawn: &Brdf, claimed: &Brdf, normal: Vec3A, wo: Vec3A, side: usize, tests: usize) -> Vec<String> {
    let (rows, subcells, samples) = (51, 3, 300_000);
    // The share of draws that give a direction has a standard deviation of at most 1e-3.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 5e-3, ..SphereChiSquare::default() };
    let pdf = |w: Vec3A| claimed.pdf(normal, wo, w);
    let draw = |random: &mut Stream| drawn.sample(normal, wo, random.uniform2()).map(|sample| sample.0);
    test.run(draw, |w| mean_over(&pdf, w, rows * subcells, side)).failures
}

/// Points along a side of a sub-cell (0.02 rad): at grazing angles a lobe is `2 alpha cos` wide across the plane of incidence.
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
            let brdf = Brdf::Ggx(Ggx::new(alpha, Vec3A::ONE));
            let failures = draws_follow_pdf(&brdf, &brdf, normal, wo, points_for(alpha, cos), pairs.len());
            (!failures.is_empty()).then(|| format!("alpha {alpha}, cosine {cos}: {}", failures.join("; ")))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn a_width_that_is_off_by_five_percent_is_found_out() {
    for (k, &(alpha, cos)) in pairs().iter().enumerate().step_by(3) {
        let (normal, wo) = oriented(cos, k);
        let brdf = |alpha| Brdf::Ggx(Ggx::new(alpha, Vec3A::ONE));
        let failures = draws_follow_pdf(&brdf(0.95 * alpha), &brdf(alpha), normal, wo, points_for(alpha, cos), 20);
        assert!(!failures.is_empty(), "alpha {alpha}, cosine {cos}");
    }
}

/// Whether a mean is `truth`, as far as its standard error tells, at the significance of a group of `tests`; `slack` is the
/// error of the truth.
fn is_mean(values: &[f64], truth: f64, slack: f64, tests: usize) -> Result<(), String> {
    let Moments { count, mean, variance } = Moments::of(values).unwrap();
    let error = (variance / count as f64).sqrt();
    // A normal variable exceeds z standard deviations with probability at most exp(-z^2 / 2).
    let z = (-2.0 * sidak(SIGNIFICANCE, tests).ln()).sqrt();
    if (mean - truth).abs() <= z * error + slack { Ok(()) } else { Err(format!("{mean} +- {error}, truth {truth}")) }
}

#[test]
fn ggx_reflects_what_the_textbook_says() {
    let pairs = pairs();
    let failures: Vec<String> = pairs
        .par_iter()
        .enumerate()
        .flat_map(|(k, &(alpha, cos))| {
            let (normal, wo) = oriented(cos, k);
            let (brdf, reference) = (Ggx::new(alpha, Vec3A::ONE), Reference::new(alpha, cos));
            let mut random = Stream::new(12, Purpose::Test, k as u64);
            let draws: Vec<_> = (0..200_000).map(|_| brdf.sample(normal, wo, random.uniform2())).collect();
            let value = |wi| f64::from(brdf.lobe_cosine(normal, wo, wi));
            let weights: Vec<f64> =
                draws.iter().map(|d| d.map_or(0.0, |(wi, pdf)| value(wi) / f64::from(pdf))).collect();
            let above: Vec<f64> = draws.iter().map(|d| f64::from(u8::from(d.is_some()))).collect();
            // The same by uniform directions, which need no pdf.
            let uniform: Vec<f64> = (0..400_000)
                .map(|_| random.direction())
                .map(|wi| value(if normal.dot(wi) < 0.0 { -wi } else { wi }) * std::f64::consts::TAU)
                .collect();
            let tests = 3 * pairs.len();
            // The reference jumps at the horizon: where that runs along a row of its 1000, half of the row is in doubt.
            let checks = [
                ("albedo", is_mean(&weights, reference.albedo, 1.0 / 2000.0, tests)),
                ("share above the horizon", is_mean(&above, reference.above, 1.0 / 2000.0, tests)),
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
            let brdf = MetallicRoughness::new(Vec3A::new(0.7, 0.5, 0.3), metallic, roughness);
            let side = points_for(brdf.alpha(), cos);
            let brdf = Brdf::MetallicRoughness(brdf);
            let failures = draws_follow_pdf(&brdf, &brdf, normal, wo, side, cases.len());
            let name = format!("metallic {metallic}, roughness {roughness}, cosine {cos}");
            (!failures.is_empty()).then(|| format!("{name}: {}", failures.join("; ")))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The mean of a function over a square of stratified points.
fn mean_of_square(side: usize, value: impl Fn(Vec2) -> f64) -> f64 {
    let point = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
    (0..side * side).map(|k| value(point(k))).sum::<f64>() / (side * side) as f64
}

#[test]
fn metallic_roughness_reflects_no_more_than_it_receives() {
    let normal = Vec3A::Z;
    let lambert = Lambert { albedo: Vec3A::ONE };
    let albedo = |brdf: &MetallicRoughness, cos: f32| {
        let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        // White surfaces: the specular lobe's colour is between that of dielectrics and white.
        let specular = Ggx::new(brdf.alpha(), Vec3A::splat(0.04).lerp(brdf.base_color(), brdf.metallic()));
        let of_specular = mean_of_square(150, |u| {
            let drawn = specular.sample(normal, wo, u);
            drawn.map_or(0.0, |(wi, pdf)| f64::from(specular.evaluate_cosine(normal, wo, wi).y / pdf))
        });
        let of_diffuse = mean_of_square(200, |u| {
            let both = |wi| brdf.evaluate_cosine(normal, wo, wi) - specular.evaluate_cosine(normal, wo, wi);
            lambert.sample(normal, wo, u).map_or(0.0, |(wi, pdf)| f64::from(both(wi).y / pdf))
        });
        (of_diffuse, of_specular)
    };
    let roughnesses = (0..=20_u8).map(|step| f32::from(step) / 20.0).chain([0.025, 0.035, 0.075]);
    roughnesses.collect::<Vec<_>>().into_par_iter().for_each(|roughness| {
        for cos in [0.006, 0.008, 0.0125, 0.025, 0.04, 0.06, 0.085, 0.13, 0.25, 0.5, 1.0] {
            for metallic in [0.0, 0.5, 1.0] {
                let white = MetallicRoughness::new(Vec3A::ONE, metallic, roughness);
                let (diffuse, specular) = albedo(&white, cos);
                let total = diffuse + specular;
                // Rounding of weights that are 1.
                assert!(total <= 1.0 + 1e-5, "roughness {roughness}, cosine {cos}, metallic {metallic}: {total}");
                // Without metal, nothing but the margin for interpolation is lost.
                assert!(metallic > 0.0 || total >= 0.985, "roughness {roughness}, cosine {cos}: {total}");
            }
        }
    });
}
