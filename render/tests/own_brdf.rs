//! The example's BRDF passes the tests of this crate's BRDFs, and works with every sampler.

#[path = "../examples/own_brdf.rs"]
#[expect(dead_code)]
mod own_brdf;

use std::sync::Arc;

use glam::{Vec3, Vec3A};
use headtail_render::{
    brdf::Kernel,
    environment::built_in,
    points::PointSet,
    random::Stream,
    spec::SamplerSpec,
    statistics::{Moments, SphereChiSquare, TTest, sidak},
};
use own_brdf::{Phong, estimate, tile};

const PHONG: Phong = Phong { diffuse: 0.3, specular: 0.4, exponent: 20.0 };

#[test]
fn directions_follow_the_pdf() {
    let (n, views) = (Vec3::Y, [Vec3::Y, Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.0, 0.1, -1.0).normalize()]);
    let test = SphereChiSquare { samples: 300_000, tests: views.len(), ..SphereChiSquare::default() };
    for wo in views {
        let draw = |random: &mut Stream, count: usize| {
            (0..count).map(|_| Some(Vec3A::from(PHONG.sample(n, wo, random.uniform2()).0))).collect()
        };
        let pdf = |wi: &[Vec3A]| wi.iter().map(|&wi| PHONG.pdf(n, wo, wi.into())).collect();
        test.run(draw, pdf).assert_passed("phong");
    }
}

#[test]
fn all_samplers_estimate_the_same_mean() {
    let (map, tile) = (Arc::new(built_in("studio").unwrap()), tile(PHONG));
    let moments = ["mis", "brdf", "ris:4", "mis2", "patches", "split:4:patches"].map(|sampler| {
        let estimator = sampler.parse::<SamplerSpec>().unwrap().build(&map).unwrap();
        let estimates: Vec<f64> = (0..4000).map(|k| estimate(&*estimator, &tile, (PointSet::Independent, k))).collect();
        (sampler, Moments::of(&estimates).unwrap())
    });
    let pairs = moments.len() * (moments.len() - 1) / 2;
    for (k, (first, a)) in moments.iter().enumerate() {
        // Means must be precise to 2 % for the comparison to be meaningful.
        assert!((a.variance / a.count as f64).sqrt() < 0.02 * a.mean, "{first}: {a:?}");
        for (second, b) in &moments[k + 1..] {
            let p = TTest::welch(a, b).p_value;
            assert!(p >= sidak(0.01, pairs), "{first} has {}, {second} {}, p = {p:.1e}", a.mean, b.mean);
        }
    }
}
