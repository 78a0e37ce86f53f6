//! The example's sampler passes the tests of this crate's samplers.

#[path = "../examples/own_sampler.rs"]
#[expect(dead_code)]
mod own_sampler;

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{Ggx, Lambert, MetallicRoughness},
    environment::built_in,
    random::{Purpose, Stream},
    sampler::{AtPoint, BrdfSampler, OneSampleMis, Sampler},
    statistics::{Moments, SphereChiSquare, TTest, sidak},
    tile::{ShadingPoint, Tile},
};
use own_sampler::{SkySampler, estimate, estimators};

/// Returns points with pairwise different normals and surfaces.
fn points() -> Vec<ShadingPoint> {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let point = |k: usize| {
        let ns = random.direction();
        let wo = (ns + 0.9 * random.direction()).normalize();
        let surface = match k % 3 {
            0 => Lambert { albedo: Vec3::splat(0.5) }.into(),
            1 => Ggx::new(0.3 + 0.5 * random.uniform(), Vec3::ONE).into(),
            _ => MetallicRoughness::new(Vec3::splat(0.7), random.uniform(), 0.7).into(),
        };
        ShadingPoint { p: Vec3A::ZERO, ng: ns, ns, wo, surface }
    };
    (0..37).map(point).collect()
}

#[test]
fn the_example_is_short() {
    let lines = include_str!("../examples/own_sampler.rs").lines().count();
    assert!(lines < 60, "docs/rust.md says that it is one in under 60 lines: {lines}");
}

#[test]
fn directions_follow_the_pdf() {
    let mixture = OneSampleMis::new(SkySampler, BrdfSampler);
    let samplers: [(&str, &dyn Sampler); 2] = [("own_sampler", &SkySampler), ("mixture_with_own_sampler", &mixture)];
    let points = &points()[..3];
    let tests = samplers.len() * points.len();
    // Lobes are at least 0.3 wide; cells are 0.06 wide and have 4 x 4 points.
    let test = SphereChiSquare { samples: 300_000, tests, ..SphereChiSquare::default() };
    for (name, sampler) in samplers {
        for point in points {
            let at = AtPoint::new(sampler, point);
            let draw = |random: &mut Stream, count: usize| {
                let u: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
                at.sample_many(&u).into_iter().map(|drawn| Some(drawn?.wi)).collect()
            };
            test.run(draw, |wi| at.pdf_many(wi)).assert_passed(name);
        }
    }
}

#[test]
fn single_samples_mixtures_and_ris_estimate_the_same_mean() {
    let map = Arc::new(built_in("window").unwrap());
    let tile = Tile::of(&points());
    let moments = estimators(&map).unwrap().map(|(name, estimator)| {
        let estimates: Vec<f64> = (0..20_000).map(|k| estimate(&*estimator, &tile, k)).collect();
        (name, Moments::of(&estimates).unwrap())
    });
    for (k, (first, a)) in moments.iter().enumerate() {
        // Means must be precise to 1 % for the comparison to be meaningful.
        assert!((a.variance / a.count as f64).sqrt() < 0.01 * a.mean, "{first}: {a:?}");
        for (second, b) in &moments[k + 1..] {
            let p = TTest::welch(a, b).p_value;
            assert!(p >= sidak(0.01, 3), "{first} has {}, {second} {}, p = {p:.1e}", a.mean, b.mean);
        }
    }
}
