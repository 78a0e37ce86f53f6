//! Learned visibility in hard scenes with little memory: a million triangles, blades thinner than cells,
//! ground to the horizon. It stays within its memory, and the mean equals that of `mis`.

use glam::Vec3;
use headtail_render::scene::{Camera, Mesh};

use super::*;

/// Memory limits, at 5 kB a cell: three cells of each size, some hundred, and the default.
const MEMORIES: [usize; 3] = [100_000, 1 << 20, LearnedVisibility::MEMORY];

fn scene_of(name: &str, positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, camera: Camera) -> Scene {
    let mesh = Mesh::new(positions, Vec::new(), Vec::new(), triangles, 0).unwrap();
    Scene::new(name, vec![mesh], vec![Material::diffuse(Vec3A::splat(0.7))], Some(camera)).unwrap()
}

/// Returns hills of 10 m with `side` x `side` squares of two triangles, which shadow each other.
fn hills(side: u32) -> Scene {
    let height = |x: f32, z: f32| {
        let ridges = (3.1 * x).sin() * (2.3 * z + x).cos() + 0.5 * (9.7 * x + 4.0 * z).sin() * (8.3 * z).cos();
        0.25 * ridges
    };
    let at = |k: u32| 10.0 * (k as f32 / side as f32 - 0.5);
    let vertices = (0..=side).flat_map(|row| (0..=side).map(move |column| (at(column), at(row))));
    let positions = vertices.map(|(x, z)| Vec3::new(x, height(x, z), z)).collect();
    let corner = |row: u32, column: u32| row * (side + 1) + column;
    let squares = (0..side).flat_map(|row| (0..side).map(move |column| (row, column)));
    let triangles = squares.flat_map(|(row, column)| {
        let [a, b, c, d] =
            [corner(row, column), corner(row, column + 1), corner(row + 1, column + 1), corner(row + 1, column)];
        [[a, c, b], [a, d, c]]
    });
    let camera = Camera::new(Vec3A::new(0.0, 3.0, 8.0), Vec3A::ZERO, 0.8).unwrap();
    scene_of("hills", positions, triangles.collect(), camera)
}

/// Returns two-sided blades of 2 mm by 40 cm on a 4 m square of ground.
fn blades(count: u64) -> Scene {
    let mut positions =
        [[-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0], [2.0, -2.0]].map(|[x, z]| Vec3::new(x, 0.0, z)).to_vec();
    let mut triangles = vec![[0, 1, 2], [0, 2, 3]];
    let mut random = Stream::new(11, Purpose::Weights, 0);
    for _ in 0..count {
        let mut between = |a: f32, b: f32| a + (b - a) * random.uniform();
        let foot = Vec3::new(between(-2.0, 2.0), 0.0, between(-2.0, 2.0));
        let turn = between(0.0, std::f32::consts::TAU);
        let top = foot + Vec3::new(between(-0.1, 0.1), 0.4, between(-0.1, 0.1));
        let across = 1e-3 * Vec3::new(turn.cos(), 0.0, turn.sin());
        let first = positions.len() as u32;
        positions.extend([foot - across, foot + across, top]);
        triangles.push([first, first + 1, first + 2]);
    }
    let camera = Camera::new(Vec3A::new(0.0, 1.0, 3.0), Vec3A::new(0.0, 0.1, 0.0), 0.9).unwrap();
    scene_of("blades", positions, triangles, camera)
}

/// Returns a temple on a plane to the horizon that fills half of the picture.
fn horizon() -> Scene {
    let temple = Scene::built_in("temple").unwrap();
    let bounds = temple.bounds();
    let width = bounds.extent().max_element();
    let eye = Vec3A::new(bounds.center().x, bounds.min.y + 0.05 * width, bounds.max.z + 0.3 * width);
    let camera = Camera::new(eye, eye - Vec3A::Z, 1.0).unwrap();
    let positions: Vec<Vec3> = temple.triangles().flatten().collect();
    let triangles = (0..positions.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    let mut scene = scene_of("horizon", positions, triangles, camera);
    scene.add_ground();
    scene
}

#[test]
fn learned_visibility_stays_within_its_memory_and_is_unbiased() {
    let environment = Arc::new(built_in("studio").unwrap());
    let mis = SamplerSpec::mis().build(&environment).unwrap();
    let scenes = [hills(708), blades(4000), horizon()];
    assert!(scenes[0].triangle_count() >= 1_000_000);
    // One of 18 normal deviates exceeds 4.1 with a probability below 1e-3.
    for scene in scenes {
        let name = scene.name().to_owned();
        let environment = environment.clone();
        let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
        let (truth, error) = learning::mean_of(&setting, &*mis, 256, 6);
        let mut cells = Vec::new();
        for memory in MEMORIES {
            let plain = LearnedVisibility::new(setting.environment.clone(), Detail::Leaves, memory).unwrap().always();
            let learned = learning::learn_with(&setting, &plain, 8, None);
            let (mean, own) = learning::mean_of(&setting, &plain, 64, 6);
            let rendering = setting.estimate_until(&plain, 64, 5, &AtomicBool::new(false), &|_| {});
            let size = rendering.learned.expect("it learns");
            println!(
                "{name}, {memory} bytes: {size:?}, {:.1e} +- {:.1e}",
                mean / truth - 1.0,
                error.hypot(own) / truth
            );
            assert!(size.bytes <= memory && size.cells > 0, "{name}: {size:?}, allowed {memory}");
            assert!((mean - truth).abs() < 4.1 * error.hypot(own), "{name}: {mean} {truth} +- {}", error.hypot(own));
            assert!(error.hypot(own) < 5e-3 * truth, "{name}: the test is not sharp");
            // Precomputed visibility is used within the same memory.
            let informed = plain.with_precomputed(&learned).unwrap();
            let (mean, own) = learning::mean_of(&setting, &informed, 64, 6);
            let size = setting.estimate_until(&informed, 64, 5, &AtomicBool::new(false), &|_| {}).learned.unwrap();
            assert!(size.bytes <= memory && size.pays, "{name}, known: {size:?}, allowed {memory}");
            assert!((mean - truth).abs() < 4.1 * error.hypot(own), "{name}, known: {mean} {truth}");
            assert!(size.unknown < 0.5, "{name}: coarser cells stand in for those that have no room, {size:?}");
            cells.push(size.cells);
        }
        assert!(cells[0] < cells[2], "{name}: {cells:?}");
    }
}
