//! Lamps that outshine the sky by many orders of magnitude, hidden from all that the camera sees: the sky's light is
//! not lost.

use std::sync::Arc;

use glam::{Vec3, Vec3A};
use headtail_render::{
    environment::Environment,
    image::Image,
    points::PointSet,
    scene::{Camera, Material, Mesh, Scene},
    spec::SamplerSpec,
    statistics::{Moments, sidak},
};

use super::{SIGNIFICANCE, Setting, samplers};

const COLUMNS: usize = 64;
const ROWS: usize = 32;
const SPP: u32 = 64;

/// A sky of 1 with a lamp in the texels from `column` and `row` on.
fn map(name: &str, lamp: f32, (column, row): (usize, usize), side: usize) -> Environment {
    let mut pixels = vec![[1.0; 3]; COLUMNS * ROWS];
    for k in 0..side * side {
        pixels[(row + k / side) * COLUMNS + (column + k % side) % COLUMNS] = [lamp; 3];
    }
    Environment::from_image(name, Image { width: COLUMNS, height: ROWS, pixels }).unwrap()
}

/// Parallelograms of a corner and two sides, white on the side from which the second is to the left of the first.
fn scene(sides: &[[Vec3; 3]], eye: Vec3A, target: Vec3A) -> Scene {
    let corners = |&[corner, a, b]: &[Vec3; 3]| [corner, corner + a, corner + a + b, corner + b];
    let positions: Vec<Vec3> = sides.iter().flat_map(corners).collect();
    let triangles = (0..positions.len() as u32).step_by(4).flat_map(|k| [[k, k + 1, k + 2], [k, k + 2, k + 3]]);
    let mesh = Mesh::new(positions, Vec::new(), Vec::new(), triangles.collect(), 0).unwrap();
    let camera = Camera::new(eye, target, 20.0).unwrap();
    Scene::new("parallelograms", vec![mesh], vec![Material::diffuse(Vec3A::ONE)], Some(camera)).unwrap()
}

#[test]
fn light_beside_hidden_lamps_is_kept() {
    let floor = [Vec3::new(-9.0, 0.0, 9.0), Vec3::new(18.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -18.0)];
    // Behind the floor, towards -z.
    let wall = [Vec3::new(-99.0, 0.0, -2.0), Vec3::new(198.0, 0.0, 0.0), Vec3::new(0.0, 99.0, 0.0)];
    let eye = Vec3A::new(0.0, 2.0, 3.0);
    let (below, behind) = ((20, 24), (0, 12));
    let views = [
        ("below the horizon", vec![floor], below, Vec3A::ZERO),
        ("behind the card", vec![wall], behind, Vec3A::new(0.0, 2.0, -2.0)),
        ("behind the wall", vec![floor, wall], behind, Vec3A::ZERO),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (lamp, side) in [(1e6, 1), (1e6, 4), (1e9, 1), (1e12, 2)] {
        for (name, sides, place, target) in &views {
            let environment = Arc::new(map(&format!("lamp-{lamp:e}-{side}-{}", name.len()), lamp, *place, side));
            let tested = samplers(folder.path(), &environment);
            let scene = scene(sides, eye, *target);
            let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
            let moments = |sampler: &SamplerSpec, seed: u64| {
                let image = setting.render(sampler, SPP, seed).surfaces;
                let values: Vec<f64> = image.pixels.iter().map(|pixel| f64::from(pixel[1])).collect();
                let moments = Moments::of(&values).unwrap();
                (moments.mean, moments.variance / values.len() as f64)
            };
            // It never meets the lamp.
            let (expected, uncertainty) = moments(&SamplerSpec::brdf(), 1);
            if !name.contains("wall") {
                assert!((expected - 1.0).abs() < 1e-3, "{name}: {expected}");
            }
            for (k, sampler) in tested.iter().enumerate() {
                let (mean, variance) = moments(sampler, 2 + k as u64);
                // 4.5 standard errors are the two-sided normal quantile of 0.01 / 1500 tests. The fewest samples go to
                // the sky where no floor is needed yet: one in 800, of 98,304; of RIS, whose weights have the cosine
                // to the lamp, one in 3000.
                assert!(sidak(SIGNIFICANCE, 4 * views.len() * tested.len()) > 6.7e-6);
                let error = (variance + uncertainty).sqrt();
                assert!(error < 0.4, "{sampler}, {lamp:e} {name}: {mean} +- {error}");
                assert!(
                    (mean - expected).abs() < 4.5 * error + 1e-3,
                    "{sampler}, {lamp:e} {name}: {mean} +- {error}, not {expected}"
                );
            }
        }
    }
}
