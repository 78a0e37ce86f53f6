//! One sample of every pixel of a tile at a time: camera rays, light estimates, shadow rays and further bounces all work on many points.

use glam::{DVec3, Vec3A};

use super::view::View;
use crate::{
    color::luminance,
    columns::Arena,
    estimator::{Contributions, Estimator, Learner},
    morton::morton,
    points::{Dimension, Points},
    scene::Ray,
    simd::{LANES, Lanes},
    tile::Tile,
    timings::{Stage, timed},
};

/// From this bounce on, paths end at random.
const ROULETTE_FROM: u32 = 3;

/// The largest chance to go on: also a path between white walls ends.
const MOST_SURVIVAL: f32 = 0.95;

/// By how many radians rays of further bounces count as apart: what they see is blurred anyway, and less detail is less noise.
const BOUNCE_SPREAD: f32 = 0.05;

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pixel {
    pub surfaces: DVec3,
    pub background: DVec3,
    pub estimates: u64,
    pub rays: u64,
    /// The luminance of the largest single contribution before the visibility test: what makes fireflies.
    pub max_weight: f32,
}

/// The pixels of one tile.
pub(super) struct TilePixels<'a> {
    /// Column and row of each.
    pub places: &'a [(u16, u16)],
    pub sums: &'a mut [Pixel],
}

/// What light is estimated with.
#[derive(Clone, Copy)]
pub(super) struct Estimate<'a> {
    pub estimator: &'a dyn Estimator,
    /// Who is told what was visible.
    pub learner: Option<&'a dyn Learner>,
}

/// What a thread works with, kept from tile to tile.
#[derive(Default)]
pub(super) struct Workspace {
    arena: Arena,
    /// The shading points of the current bounce, and of the next one.
    tiles: [Tile; 2],
    paths: [Vec<Path>; 2],
    rays: Vec<Ray>,
    /// Keys of the points that the rays of a further bounce leave.
    keys: Vec<u32>,
    hits: Vec<usize>,
    /// Radiance that surfaces emit where rays hit them, in a scene where some do.
    emission: Vec<Vec3A>,
    contributions: Contributions,
    visible: Vec<bool>,
}

/// The path that leads to a shading point.
#[derive(Clone, Copy, Debug)]
struct Path {
    /// Its pixel in the tile.
    pixel: usize,
    throughput: Vec3A,
}

impl Workspace {
    /// Adds one sample to every pixel.
    pub fn sample(&mut self, view: &View<'_>, estimate: Estimate<'_>, points: Points, pixels: &mut TilePixels<'_>) {
        timed(Stage::CameraRays, || self.trace_camera(view, points, pixels));
        let depth = view.depth.max(1);
        for bounce in 0..depth {
            if self.tiles[0].is_empty() {
                break;
            }
            let points = points.at_bounce(bounce);
            self.estimate(view, estimate, points, pixels);
            if bounce + 1 < depth {
                self.continue_paths(view, points, bounce + 1, pixels);
            }
        }
    }

    /// One camera ray through each pixel: shading points where it hits a surface, the background elsewhere.
    fn trace_camera(&mut self, view: &View<'_>, points: Points, pixels: &mut TilePixels<'_>) {
        let Self { arena, tiles: [tile, _], paths: [paths, _], rays, hits, emission, .. } = self;
        let strips = pixels.places.len().div_ceil(LANES);
        let key = |place: usize| {
            let (x, y) = pixels.places[place];
            morton(x, y)
        };
        let mut jitter = arena.columns::<2>(strips);
        points.draw_keyed(Dimension::Camera, pixels.places.len(), key, jitter.get_mut());
        let [across, down] = jitter.get().map(<[Lanes]>::as_flattened);
        rays.clear();
        rays.extend(pixels.places.iter().zip(across).zip(down).map(|((&(x, y), across), down)| {
            view.camera.ray(f32::from(x) + across, f32::from(y) + down, view.width, view.height)
        }));
        hits.clear();
        paths.clear();
        emission.clear();
        let emitted = view.scene.is_emissive().then_some(&mut *emission);
        view.scene.intersect_and_emit(rays, view.camera.pixel_spread(view.height), key, tile, hits, emitted);
        paths.extend(hits.iter().map(|&pixel| Path { pixel, throughput: Vec3A::ONE }));
        add_emission(paths, emission, pixels);
        let mut seen = hits.iter().peekable();
        let mut past = arena.list();
        past.extend((0..rays.len()).filter(|k| seen.next_if_eq(&k).is_none()).map(|k| k as u16));
        let mut columns = arena.columns::<6>(past.len().div_ceil(LANES));
        let [x, y, z, red, green, blue] = columns.get_mut();
        for (k, &ray) in past.iter().enumerate() {
            let [own_x, own_y, own_z] = rays[ray as usize].direction.to_array();
            (x[k / LANES][k % LANES], y[k / LANES][k % LANES], z[k / LANES][k % LANES]) = (own_x, own_y, own_z);
        }
        view.environment.radiances([x, y, z], [red, green, blue]);
        for (k, &ray) in past.iter().enumerate() {
            let (strip, lane) = (k / LANES, k % LANES);
            let radiance = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
            pixels.sums[ray as usize].background += radiance.as_dvec3();
        }
        for path in paths {
            pixels.sums[path.pixel].estimates += 1;
        }
    }

    /// Light estimates at the current shading points, with shadow rays.
    fn estimate(&mut self, view: &View<'_>, estimate: Estimate<'_>, points: Points, pixels: &mut TilePixels<'_>) {
        let Self { arena, tiles: [tile, _], paths: [paths, _], rays, contributions, visible, .. } = self;
        contributions.clear();
        estimate.estimator.propose(&tile.rows(), &points, contributions, arena);
        visible.clear();
        visible.resize(contributions.places().len(), true);
        if !view.unshadowed {
            timed(Stage::ShadowRays, || {
                rays.clear();
                let all = contributions.places().iter().zip(contributions.wi());
                rays.extend(all.map(|(&place, &wi)| {
                    let (p, ng) = tile.position_and_normal(place as usize);
                    view.scene.leaving(p, ng, wi)
                }));
                view.scene.visible_batch(rays, visible);
            });
        }
        if let Some(learner) = estimate.learner {
            // What is sent to learn from adds nothing.
            return timed(Stage::Learning, || learner.observe(&tile.rows(), contributions, visible));
        }
        let all = contributions.places().iter().zip(contributions.radiance()).zip(&*visible);
        for ((&place, &radiance), &visible) in all {
            let path = &paths[place as usize];
            let pixel = &mut pixels.sums[path.pixel];
            let radiance = path.throughput * radiance;
            pixel.rays += 1;
            pixel.max_weight = pixel.max_weight.max(luminance(radiance));
            if visible {
                pixel.surfaces += radiance.as_dvec3();
            }
        }
    }

    /// Light that reaches a surface over other surfaces: paths go on by BRDF sampling. One that leaves the scene adds nothing: the estimator
    /// at its last surface stands for all light from the environment.
    fn continue_paths(&mut self, view: &View<'_>, points: Points, bounces: u32, pixels: &mut TilePixels<'_>) {
        let Self { arena, tiles: [tile, next_tile], paths: [paths, next_paths], rays, keys, hits, emission, .. } = self;
        let at = tile.rows();
        let mut columns = arena.columns::<10>(at.strips());
        let [u, v, roulette, x, y, z, pdf, red, green, blue] = columns.get_mut();
        points.draw(Dimension::Path, &at, [&mut *u, &mut *v, &mut *roulette]);
        at.sample_brdf([u, v], [&mut *x, &mut *y, &mut *z], pdf, arena);
        at.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], arena);
        rays.clear();
        next_paths.clear();
        keys.clear();
        for (place, path) in paths.iter().enumerate() {
            let (strip, lane) = (place / LANES, place % LANES);
            let pdf = pdf[strip][lane];
            let f = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
            let mut throughput = path.throughput * if pdf > 0.0 { f / pdf } else { Vec3A::ZERO };
            if bounces >= ROULETTE_FROM {
                let survival = throughput.max_element().min(MOST_SURVIVAL);
                throughput = if roulette[strip][lane] < survival { throughput / survival } else { Vec3A::ZERO };
            }
            if throughput.max_element() > 0.0 {
                let (p, ng) = tile.position_and_normal(place);
                rays.push(view.scene.leaving(p, ng, Vec3A::new(x[strip][lane], y[strip][lane], z[strip][lane])));
                next_paths.push(Path { throughput, ..*path });
                keys.push(tile.keys()[place]);
            }
        }
        hits.clear();
        emission.clear();
        let emitted = view.scene.is_emissive().then_some(&mut *emission);
        timed(Stage::CameraRays, || {
            view.scene.intersect_and_emit(rays, BOUNCE_SPREAD, |k| keys[k], next_tile, hits, emitted);
        });
        paths.clear();
        paths.extend(hits.iter().map(|&k| next_paths[k]));
        add_emission(paths, emission, pixels);
        self.tiles.swap(0, 1);
    }
}

/// Adds what surfaces emit where paths hit them; nothing where no surface does.
fn add_emission(paths: &[Path], emission: &[Vec3A], pixels: &mut TilePixels<'_>) {
    for (path, &emission) in paths.iter().zip(emission) {
        pixels.sums[path.pixel].surfaces += (path.throughput * emission).as_dvec3();
    }
}
