//! Scaling of time and memory with triangles, resolution, samples and threads.
//!
//! ```sh
//! cargo bench --bench scaling
//! cargo bench --bench scaling -- --sampler mis2 --most 100000
//! ```
//!
//! The scene is a field of balls under the built-in map `studio`; balls and their tessellation grow with the
//! number of triangles. Each line is the best of three renderings. `Mrays/s` counts camera and shadow rays;
//! memory is the growth of the process from building the scene. The forest is a glTF file that instances one
//! tree by `EXT_mesh_gpu_instancing`; `--forest FILE` keeps its largest.

mod forest;

use std::{
    fs,
    path::Path,
    process::Command,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    environment::{Environment, built_in},
    estimator::Estimator,
    integrator::{Budget, Rendering, View, render},
    points::{PointSet, Points},
    scene::{Camera, Material, Mesh, Scene},
    spec::SamplerSpec,
};

/// Defaults: triangles, width (4 : 3), samples per pixel.
const BASE: (usize, usize, u32) = (100_000, 320, 16);

fn main() {
    let argument = |name: &str, default: &str| {
        let mut arguments = std::env::args();
        arguments.by_ref().find(|argument| argument == name).and_then(|_| arguments.next()).unwrap_or(default.into())
    };
    let loaded = argument("--load", "");
    if !loaded.is_empty() {
        let before = resident();
        let scene = Scene::load(loaded.as_ref()).expect("a scene");
        let memory = resident() - before;
        drop(scene);
        println!("{memory}");
        return;
    }
    let sampler: SamplerSpec = argument("--sampler", "mis").parse().expect("a sampler");
    let most: usize = argument("--most", "1000000").parse().expect("a number of triangles");
    let environment = Arc::new(built_in("studio").expect("a built-in map"));
    let estimator = sampler.build(&environment).expect("the sampler");
    let (triangles, width, spp) = BASE;
    let measure = |scene: &Scene, width: usize, spp: u32| best(scene, &environment, &*estimator, width, spp);

    println!(
        "sampler {sampler}, {} threads; {triangles} triangles, {width} wide, {spp} spp unless said otherwise",
        rayon::current_num_threads()
    );
    println!("\n{:>10} {:>9} {:>9} {:>9} {:>9} {:>9}", "triangles", "balls", "build s", "MB", "render s", "Mrays/s");
    for wanted in [1_000, 10_000, 100_000, 1_000_000].into_iter().filter(|&wanted| wanted <= most) {
        let (before, start) = (resident(), Instant::now());
        let (scene, balls) = field(wanted);
        let (built, memory) = (start.elapsed().as_secs_f64(), resident() - before);
        report(&scene, balls, [built, memory], &measure(&scene, width, spp));
    }

    let folder = tempfile::tempdir().expect("a temporary folder");
    let kept = argument("--forest", "");
    let path = if kept.is_empty() { folder.path().join("forest.glb") } else { kept.into() };
    println!("\n{:>10} {:>9} {:>9} {:>9} {:>9} {:>9}", "forest of", "trees", "build s", "MB", "render s", "Mrays/s");
    for trees in [10, 100, 1_000, 10_000].into_iter().filter(|trees| trees * forest::TRIANGLES <= 100 * most) {
        forest::write(&path, trees);
        let start = Instant::now();
        let scene = Scene::load(&path).expect("a scene");
        let (built, memory) = (start.elapsed().as_secs_f64(), footprint(&path));
        report(&scene, trees, [built, memory], &measure(&scene, width, spp));
    }

    let (scene, _) = field(triangles);
    println!("\n{:>10} {:>9} {:>9} {:>9}", "width", "spp", "render s", "Mrays/s");
    for (width, spp) in [(80, 16), (160, 16), (320, 16), (640, 16), (320, 1), (320, 4), (320, 64)] {
        let rendering = measure(&scene, width, spp);
        println!("{width:>10} {spp:>9} {:>9.3} {:>9.2}", rendering.seconds, rate(&rendering));
    }

    println!("\n{:>10} {:>9} {:>9}", "threads", "render s", "Mrays/s");
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        let rendering = pool.install(|| measure(&scene, width, spp));
        println!("{threads:>10} {:>9.3} {:>9.2}", rendering.seconds, rate(&rendering));
    }
}

/// Prints a scene's number of objects, its seconds and megabytes, and its rendering rate.
fn report(scene: &Scene, objects: usize, [built, memory]: [f64; 2], rendering: &Rendering) {
    println!(
        "{:>10} {objects:>9} {built:>9.3} {memory:>9.1} {:>9.3} {:>9.2}",
        scene.triangle_count(),
        rendering.seconds,
        rate(rendering)
    );
}

/// Returns the fastest of three renderings.
fn best(scene: &Scene, environment: &Environment, estimator: &dyn Estimator, width: usize, spp: u32) -> Rendering {
    let camera = scene.camera();
    let view = View { scene, camera: &camera, environment, width, height: width * 3 / 4, unshadowed: false, depth: 1 };
    let points = |seed| Points::new(PointSet::Sobol, seed);
    let once = |seed| render(view, estimator, Budget::Spp(spp), points(seed), &AtomicBool::new(false), &|_| {});
    (0..3).map(once).min_by(|a, b| a.seconds.total_cmp(&b.seconds)).expect("three renderings")
}

/// Returns camera and shadow rays in millions per second.
fn rate(rendering: &Rendering) -> f64 {
    let covered: f64 = rendering.coverage.iter().map(|&fraction| f64::from(fraction)).sum();
    let rays = f64::from(rendering.spp) * (rendering.coverage.len() as f64 + rendering.rays_per_sample * covered);
    1e-6 * rays / rendering.seconds
}

/// Returns about `triangles` triangles in a square of balls on the ground, and the number of balls.
fn field(triangles: usize) -> (Scene, usize) {
    // Balls and triangles per ball grow alike: the cube root of the total across, its square root around.
    let across = ((triangles as f64 / 10.0).cbrt().round() as usize).max(2);
    let segments = (((triangles / (across * across)) as f64).sqrt().round() as usize).max(4);
    let mut meshes: Vec<Mesh> = (0..across * across)
        .map(|i| {
            let place = Vec2::new((i % across) as f32 + 0.5, (i / across) as f32 + 0.5) / across as f32 * 10.0 - 5.0;
            ball(Vec3::new(place.x, 4.0 / across as f32, place.y), 4.0 / across as f32, segments)
        })
        .collect();
    let corners = [[-30.0, 30.0], [30.0, 30.0], [30.0, -30.0], [-30.0, -30.0]].map(|[x, z]| Vec3::new(x, 0.0, z));
    meshes.push(Mesh::new(corners.into(), vec![], vec![], vec![[0, 1, 2], [0, 2, 3]], 0).expect("two triangles"));
    let material = Material::diffuse(Vec3A::splat(0.6));
    let camera = Camera::new(Vec3A::new(0.0, 5.0, 11.0), Vec3A::new(0.0, 0.0, 0.5), 40.0).expect("a direction");
    (Scene::new("field", meshes, vec![material], Some(camera)).expect("one material"), across * across)
}

/// Returns a ball of `segments` segments around and half as many rings, with smooth normals.
fn ball(center: Vec3, radius: f32, segments: usize) -> Mesh {
    let rings = segments.div_ceil(2);
    let mut normals = Vec::new();
    for ring in 0..=rings {
        for segment in 0..=segments {
            let latitude = std::f32::consts::PI * (ring as f32 / rings as f32 - 0.5);
            let (sin, cos) = (std::f32::consts::TAU * segment as f32 / segments as f32).sin_cos();
            normals.push(Vec3::new(latitude.cos() * sin, latitude.sin(), latitude.cos() * cos));
        }
    }
    let at = |ring: usize, segment: usize| (ring * (segments + 1) + segment) as u32;
    let quads = (0..rings).flat_map(|ring| (0..segments).map(move |segment| (ring, segment)));
    let triangles = quads.flat_map(|(r, s)| {
        let [a, b, c, d] = [at(r, s), at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)];
        [[a, b, c], [a, c, d]]
    });
    let positions = normals.iter().map(|n| center + radius * *n).collect();
    Mesh::new(positions, normals.clone(), vec![], triangles.collect(), 0).expect("a ball's own indices")
}

/// Returns the memory in MB that a separate process gains by loading a scene: this process would reuse memory
/// of earlier scenes.
fn footprint(path: &Path) -> f64 {
    let program = std::env::current_exe().expect("a program");
    let output = Command::new(program).arg("--load").arg(path).output().expect("a process");
    String::from_utf8_lossy(&output.stdout).trim().parse().expect("a number")
}

/// Returns the memory of this process in MB; 0 if the system does not report it.
fn resident() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}
