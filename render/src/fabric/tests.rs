use super::*;
use crate::{
    brdf::{Ggx, Kernel, Lambert},
    fabric::{
        SourceKind,
        layered::{Base, Layered, Layers},
    },
};

/// Samples a direction with cosine above `least`, uniform in the projected disk.
fn direction(random: &mut Stream, least: f32) -> Vec3 {
    let u = random.uniform2();
    let squared = u.x * (1.0 - least * least);
    (squared.sqrt() * Vec2::from_angle(TAU * u.y)).extend((1.0 - squared).sqrt())
}

/// Estimates the albedo for one view by cosine sampling; returns mean and standard error.
fn albedo(source: &dyn Source, wo: Vec3, count: usize) -> (f32, f32) {
    let mut random = Stream::new(5, Purpose::Test, 0);
    let queries: Vec<Query> =
        (0..count).map(|_| Query { uv: random.uniform2(), width: 0.0, wo, wi: direction(&mut random, 0.0) }).collect();
    let values = source.reflect(&queries, 1, 3);
    let each: Vec<f64> =
        queries.iter().zip(values).map(|(q, f)| f64::from(f.x * std::f32::consts::PI / q.wi.z)).collect();
    let mean = each.iter().sum::<f64>() / count as f64;
    let variance = each.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count as f64;
    (mean as f32, (variance / count as f64).sqrt() as f32)
}

#[test]
fn white_fibres_reflect_everything() {
    let white = Material::diffuse(Vec3A::ONE);
    for (view, wo) in [Vec3::Z, Vec3::new(0.8, 0.0, 0.6)].into_iter().enumerate() {
        let fabric = SourceKind::Satin.fabric().unwrap().with_material(white.clone());
        let (mean, error) = albedo(&fabric, wo, 30_000);
        // About 0.14^2 is lost below `MIN_COSINE`, where rays leave the neighbouring tiles before the yarns.
        assert!((mean - 1.0).abs() < 5.0 * error + 0.02, "view {view}: {mean} +- {error}");
    }
}

/// Estimates the mean over the tile of `f_r` between two directions; returns mean and squared standard error.
fn mean_brdf(source: &dyn Source, wo: Vec3, wi: Vec3, count: usize, seed: u64) -> (f64, f64) {
    let mut random = Stream::new(seed, Purpose::Test, 1);
    let queries: Vec<Query> = (0..count).map(|_| Query { uv: random.uniform2(), width: 0.0, wo, wi }).collect();
    let each: Vec<f64> = source.reflect(&queries, 1, seed).iter().map(|f| f64::from(f.y / wi.z)).collect();
    let mean = each.iter().sum::<f64>() / count as f64;
    (mean, each.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (count * count) as f64)
}

#[test]
fn every_source_is_reciprocal() {
    for kind in SourceKind::ALL {
        let source = kind.build().unwrap();
        let mut random = Stream::new(1, Purpose::Test, 2);
        for _ in 0..3 {
            let (a, b) = (direction(&mut random, 0.3), direction(&mut random, 0.3));
            let there = mean_brdf(&*source, a, b, 12_000, 1);
            let back = mean_brdf(&*source, b, a, 12_000, 2);
            // Five standard errors of the difference, and 3 % because interpolated normals break reciprocity.
            let allowed = 5.0 * (there.1 + back.1).sqrt() + 0.03 * there.0;
            assert!((there.0 - back.0).abs() < allowed, "{} {a} {b}: {there:?} {back:?}", kind.name());
        }
    }
}

#[test]
fn a_smooth_coat_over_white_conserves_energy() {
    let layered = Layered::of(|_| Layers {
        coat_alpha: 0.05,
        absorption: Vec3::ZERO,
        base: Base::Diffuse(Lambert { albedo: Vec3::ONE }),
    });
    let (mean, error) = albedo(&layered, Vec3::new(0.6, 0.0, 0.8), 1_000_000);
    // Masked light is lost at each interaction with the coat: for a width of 0.05, 1 - G1 averages 0.4 %
    // over cosine-distributed directions, and light from the base meets the coat three or four times.
    assert!(mean < 1.0 + 5.0 * error && mean > 0.98 - 5.0 * error, "{mean} +- {error}");
    assert!(error < 0.02, "{error}");
}

#[test]
fn a_coat_over_black_reflects_as_the_dielectric_alone() {
    let layered = Layered::of(|_| Layers {
        coat_alpha: 0.3,
        absorption: Vec3::ZERO,
        base: Base::Metal(Ggx::new(0.3, Vec3::ZERO)),
    });
    // Schlick's Fresnel of a metal of f0 = 0 is 0 at normal incidence and reaches 0.002 at half angles of 40 degrees.
    let wo = Vec3::new(0.3, 0.0, 0.91_f32).normalize();
    let query = Query { uv: Vec2::ZERO, width: 0.0, wo, wi: Vec3::Z };
    let found = layered.reflect(&[query], 1000, 1)[0].x;
    let expected = Ggx::new(0.3, Vec3::splat(0.04)).evaluate_cosine(Vec3::Z, wo, Vec3::Z).x;
    assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
}

#[test]
fn equal_seeds_give_equal_numbers() {
    let fabric = SourceKind::Velvet.fabric().unwrap();
    let mut random = Stream::new(9, Purpose::Test, 0);
    let mut query = || Query {
        uv: random.uniform2(),
        width: 0.01,
        wo: direction(&mut random, MIN_COSINE),
        wi: direction(&mut random, MIN_COSINE),
    };
    let queries: Vec<Query> = (0..500).map(|_| query()).collect();
    assert_eq!(fabric.reflect(&queries, 2, 7), fabric.reflect(&queries, 2, 7));
    assert_ne!(fabric.reflect(&queries, 2, 7), fabric.reflect(&queries, 2, 8));
}
