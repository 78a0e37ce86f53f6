//! Rays per second on one core: `cargo bench -p headtail-render --bench rays`.
//!
//! Camera rays come in tiles of 16 x 16 pixels of a 640 x 480 picture, as in the integrator. Shadow rays
//! start at their hits, in directions sampled from the map or from the cosine about the normal.
//! HEADTAIL_SCENES (comma-separated) and HEADTAIL_MAP name files or built-in scenes and maps. Batched and
//! single rays are traced in alternation; the fastest of several rounds counts.

use std::{env, hint::black_box, sync::Arc, time::Instant};

use headtail_render::{
    environment::Environment,
    random::{Purpose, Stream},
    sampler::EnvironmentLight,
    scene::{Bvh, Camera, Hit, Ray, Scene},
    tail::TailKind,
    tile::{ShadingPoint, Tile},
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Edge of a tile, and of the squares that order its pixels.
const TILE: usize = 16;
const SQUARE: usize = 4;

/// Number of rounds, of which the fastest counts.
const ROUNDS: usize = 7;

/// Rays by tile, one batch per tile.
type Batches = Vec<Vec<Ray>>;

/// Returns the rays of all tiles, through a random point of each pixel, and the surface points that they hit.
fn camera_rays(scene: &Scene, camera: &Camera) -> (Batches, Vec<Vec<ShadingPoint>>) {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let (mut batches, mut points) = (Vec::new(), Vec::new());
    for tile in 0..(WIDTH / TILE) * (HEIGHT / TILE) {
        let (left, top) = (tile % (WIDTH / TILE) * TILE, tile / (WIDTH / TILE) * TILE);
        let rays: Vec<Ray> = (0..TILE * TILE)
            .map(|k| {
                let (square, place) = (k / (SQUARE * SQUARE), k % (SQUARE * SQUARE));
                let (row, column) = (square / (TILE / SQUARE) * SQUARE, square % (TILE / SQUARE) * SQUARE);
                let (x, y) = (left + column + place % SQUARE, top + row + place / SQUARE);
                camera.ray(x as f32 + random.uniform(), y as f32 + random.uniform(), WIDTH, HEIGHT)
            })
            .collect();
        let mut surfaces = Tile::default();
        scene.intersect_batch(&rays, 0.0, |k| k as u32, &mut surfaces, &mut Vec::new());
        batches.push(rays);
        points.push((0..surfaces.len()).map(|row| surfaces.point(row)).collect());
    }
    (batches, points)
}

/// Returns one ray per point whose direction is above the surface.
fn shadow_rays(
    scene: &Scene,
    points: &[Vec<ShadingPoint>],
    mut direction: impl FnMut(&ShadingPoint, &mut Stream) -> Option<glam::Vec3A>,
) -> Batches {
    let mut random = Stream::new(2, Purpose::Test, 0);
    let mut batch = |points: &Vec<ShadingPoint>| -> Vec<Ray> {
        let mut ray = |at: &ShadingPoint| {
            let wi = direction(at, &mut random)?;
            (at.ng.dot(wi) > 0.0).then(|| scene.leaving(at.p, at.ng, wi))
        };
        points.iter().filter_map(&mut ray).collect()
    };
    points.iter().map(&mut batch).collect()
}

/// A name and a function that traces rays and returns the number of hits.
type Variant<'a> = (&'a str, Box<dyn Fn(&[Ray]) -> usize + 'a>);

/// Prints millions of rays per second of each variant, and its ratio to the first.
fn compare(rays: &str, batches: &Batches, variants: &[Variant<'_>]) {
    let count: usize = batches.iter().map(Vec::len).sum();
    let mut fastest = vec![vec![f64::INFINITY; batches.len()]; variants.len()];
    let mut hits = vec![0; variants.len()];
    for _ in 0..ROUNDS {
        for (k, (_, trace)) in variants.iter().enumerate() {
            hits[k] = 0;
            for (rays, fastest) in batches.iter().zip(&mut fastest[k]) {
                let start = Instant::now();
                hits[k] += trace(black_box(rays));
                *fastest = fastest.min(start.elapsed().as_secs_f64());
            }
        }
    }
    let seconds: Vec<f64> = fastest.iter().map(|batches| batches.iter().sum()).collect();
    let percent = 100.0 * hits[0] as f64 / count as f64;
    print!("  {rays:24} {count:7} rays, {percent:5.1} % hit:");
    for (k, (name, _)) in variants.iter().enumerate() {
        print!("  {name} {:.2} M/s (x {:.2})", count as f64 / seconds[k] / 1e6, seconds[0] / seconds[k]);
    }
    println!();
}

fn closest_variants(bvh: &Bvh) -> Vec<Variant<'_>> {
    let batch = |rays: &[Ray]| {
        let mut hits: Vec<Option<Hit>> = vec![None; rays.len()];
        bvh.closest_batch(rays, &mut hits);
        hits.iter().flatten().count()
    };
    let single = |rays: &[Ray]| rays.iter().filter_map(|ray| bvh.closest(ray)).count();
    vec![("alone", Box::new(single)), ("batch", Box::new(batch))]
}

fn occluded_variants(bvh: &Bvh) -> Vec<Variant<'_>> {
    let batch = |rays: &[Ray]| {
        let mut occluded = vec![false; rays.len()];
        bvh.occluded_batch(rays, &mut occluded);
        occluded.iter().filter(|&&occluded| occluded).count()
    };
    let single = |rays: &[Ray]| rays.iter().filter(|ray| bvh.occluded(ray.origin, ray.direction)).count();
    vec![("alone", Box::new(single)), ("batch", Box::new(batch))]
}

fn main() {
    let scenes = env::var("HEADTAIL_SCENES").unwrap_or_else(|_| "temple,dishes".to_owned());
    let map = env::var("HEADTAIL_MAP").unwrap_or_else(|_| "studio".to_owned());
    let environment = Arc::new(Environment::open(&map).expect("the map of HEADTAIL_MAP can be read"));
    let light = EnvironmentLight::new(environment, TailKind::Hierarchical).expect("the map is lit");
    for name in scenes.split(',') {
        let mut scene = Scene::open(name).expect("the scenes of HEADTAIL_SCENES can be read");
        scene.add_ground();
        let triangles: Vec<_> = scene.triangles().collect();
        let start = Instant::now();
        let bvh = Bvh::build(&triangles);
        println!("{name}: {} triangles, built in {:.2} s", triangles.len(), start.elapsed().as_secs_f64());
        let (camera, points) = camera_rays(&scene, &scene.camera());
        let towards_map =
            shadow_rays(&scene, &points, |_, random| Some(light.tail().forward_direction(random.uniform2()).1));
        let towards_cosine = shadow_rays(&scene, &points, |at, random| {
            // Cosine-distributed: a uniform point on the unit sphere that touches the plane from above.
            (at.ns + random.direction()).try_normalize()
        });
        compare("camera", &camera, &closest_variants(&bvh));
        compare("closest to the map", &towards_map, &closest_variants(&bvh));
        compare("shadow to the map", &towards_map, &occluded_variants(&bvh));
        compare("shadow by the cosine", &towards_cosine, &occluded_variants(&bvh));
    }
}
