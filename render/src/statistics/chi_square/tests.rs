use super::*;
use crate::frame::Frame;
use glam::Vec3;

const UNIFORM: f32 = 0.25 / std::f32::consts::PI;

fn cosine(frame: &Frame, u: Vec2) -> Vec3A {
    let (r, (sin, cos)) = (u.x.sqrt(), (std::f32::consts::TAU * u.y).sin_cos());
    frame.to_world(Vec3::new(r * cos, r * sin, (1.0 - u.x).max(0.0).sqrt())).normalize().into()
}

/// Turns a sampler of one direction into a sampler of many.
fn many(mut one: impl FnMut(&mut Stream) -> Option<Vec3A>) -> impl FnMut(&mut Stream, usize) -> Vec<Option<Vec3A>> {
    move |random, count| (0..count).map(|_| one(random)).collect()
}

/// Turns a density of one direction into a density of many.
fn each(one: impl Fn(Vec3A) -> f32) -> impl Fn(&[Vec3A]) -> Vec<f32> {
    move |directions| directions.iter().map(|&w| one(w)).collect()
}

fn uniform(random: &mut Stream, count: usize) -> Vec<Option<Vec3A>> {
    (0..count).map(|_| Some(random.direction())).collect()
}

fn cosine_pdf(n: Vec3A, w: Vec3A) -> f32 {
    n.dot(w).max(0.0) / std::f32::consts::PI
}

fn small() -> SphereChiSquare {
    SphereChiSquare { samples: 200_000, ..SphereChiSquare::default() }
}

#[test]
fn correct_densities_pass_in_every_orientation() {
    let test = SphereChiSquare { tests: 6, ..SphereChiSquare::default() };
    let report = test.run(uniform, each(|_| UNIFORM));
    report.assert_passed("uniform");
    assert_eq!(report.degrees_of_freedom, 51 * 102 - 1);
    for n in [Vec3A::Y, -Vec3A::Y, Vec3A::X, -Vec3A::Z, Vec3A::new(1.0, -2.0, 0.5).normalize()] {
        let frame = Frame::from_normal(n.into());
        let report = test.run(many(|random| Some(cosine(&frame, random.uniform2()))), each(|w| cosine_pdf(n, w)));
        report.assert_passed("cosine");
        assert!((report.integral - 1.0).abs() < 1e-3, "{report}");
    }
}

#[test]
fn p_values_of_a_correct_density_are_uniform() {
    let test = |seed| SphereChiSquare { rows: 11, samples: 20_000, seed, ..SphereChiSquare::default() };
    let mut p: Vec<f64> = (0..200).map(|seed| test(seed).run(uniform, each(|_| UNIFORM)).p_value).collect();
    p.sort_by(f64::total_cmp);
    // Kolmogorov-Smirnov at 0.001: 1.95 / sqrt(200).
    let distance = p.iter().enumerate().map(|(i, p)| (p - (i as f64 + 0.5) / 200.0).abs()).fold(0.0, f64::max);
    assert!(distance < 0.138, "{distance}");
}

#[test]
fn wrong_densities_fail() {
    let frame = Frame::from_normal(Vec3::Y);
    // A cosine drawn as if it were uniform, 3 % of another density mixed in, a frame turned by one degree.
    let cosines = || many(|random| Some(cosine(&frame, random.uniform2())));
    assert!(!small().run(cosines(), each(|_| UNIFORM)).passed());
    let mixed = |random: &mut Stream| {
        let uniform = random.uniform() < 0.03;
        Some(if uniform { random.direction() } else { cosine(&frame, random.uniform2()) })
    };
    let pdf = |w: Vec3A| 0.999 * cosine_pdf(Vec3A::Y, w) + 0.001 * UNIFORM;
    assert!(!small().run(many(mixed), each(pdf)).passed());
    let tilted = Vec3A::new(0.05, 1.0, 0.0).normalize();
    assert!(!small().run(cosines(), each(|w| cosine_pdf(tilted, w))).passed());
}

#[test]
fn a_density_of_correct_shape_and_wrong_mass_fails() {
    let report = small().run(uniform, each(|_| 1.02 * UNIFORM));
    assert!(!report.passed() && report.p_value > 0.01, "{report}");
    assert!(report.failures[0].contains("integrates to 1.02"), "{report}");
}

#[test]
fn rejected_draws_lower_the_required_mass() {
    let half = |random: &mut Stream| Some(random.direction()).filter(|w| w.y > 0.0);
    let pdf = |w: Vec3A| if w.y > 0.0 { UNIFORM } else { 0.0 };
    small().run(many(half), each(pdf)).assert_passed("half");
    assert!(!small().run(many(half), each(|w| 2.0 * pdf(w))).passed());
}

#[test]
fn a_single_direction_of_zero_density_fails() {
    let frame = Frame::from_normal(Vec3::Y);
    let mut first = true;
    let strays = |random: &mut Stream| {
        let w = cosine(&frame, random.uniform2());
        Some(if std::mem::take(&mut first) { -w } else { w })
    };
    let report = small().run(many(strays), each(|w| cosine_pdf(Vec3A::Y, w)));
    assert!(report.failures.iter().any(|f| f.starts_with("1 directions were drawn")), "{report}");
}

#[test]
fn broken_densities_and_directions_fail() {
    for broken in [f32::NAN, f32::INFINITY, -UNIFORM] {
        let report = small().run(uniform, each(|w| if w.x > 0.9 { broken } else { UNIFORM }));
        assert!(report.failures.iter().any(|f| f.starts_with("the density is negative")), "{report}");
    }
    assert!(!small().run(many(|random| Some(1.01 * random.direction())), each(|_| UNIFORM)).passed());
    assert!(!small().run(many(|_| Some(Vec3A::NAN)), each(|_| UNIFORM)).passed());
    assert!(!small().run(many(|_| None), each(|_| 0.0)).passed(), "a sampler that never samples has nothing to show");
}

#[test]
fn the_picture_shows_three_maps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let report = small().run(uniform, each(|_| UNIFORM));
    report.write_picture(&path).unwrap();
    let picture = image::open(&path).unwrap();
    assert_eq!((picture.width(), picture.height()), (4 * 102, 4 * 3 * 51));
}
