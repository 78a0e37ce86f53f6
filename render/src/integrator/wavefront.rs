//! One sample of every pixel of a tile at a time: camera rays, light estimates, shadow rays and further
//! bounces each work on many points.

use glam::{DVec3, Vec3A};

use super::{
    path::{BOUNCE_SPREAD, bounce, camera_rays, key_of, shadow_rays},
    tiles::TilePixels,
    view::View,
};
use crate::{
    color::luminance,
    columns::Arena,
    estimator::{Contributions, Estimator, LearningSession},
    points::Points,
    scene::{Ray, RayKind},
    simd::LANES,
    tile::Tile,
    timings::{Stage, timed},
};

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pixel {
    pub surfaces: DVec3,
    pub background: DVec3,
    pub estimates: u64,
    pub rays: u64,
    /// Largest luminance of a single contribution before the visibility test, an indicator of fireflies.
    pub max_weight: f32,
}

/// The light estimator and its optional session.
#[derive(Clone, Copy)]
pub(super) struct Estimate<'a> {
    pub estimator: &'a dyn Estimator,
    /// Receives the visibility of contributions.
    pub session: Option<&'a LearningSession<'a>>,
}

/// Buffers of one thread, reused from tile to tile.
#[derive(Default)]
pub(super) struct Workspace {
    arena: Arena,
    /// The shading points of the current bounce, and of the next one.
    tiles: [Tile; 2],
    paths: [Vec<Path>; 2],
    rays: Vec<Ray>,
    /// Keys of the points that the rays of a further bounce start from.
    keys: Vec<u32>,
    hits: Vec<usize>,
    /// Radiance emitted where rays hit surfaces; empty in scenes without emission.
    emission: Vec<Vec3A>,
    contributions: Contributions,
    visible: Vec<bool>,
}

/// The path that leads to a shading point.
#[derive(Clone, Copy, Debug)]
struct Path {
    /// Index of the pixel in the tile.
    pixel: usize,
    throughput: Vec3A,
}

impl Workspace {
    /// Adds one sample to every pixel.
    pub fn sample(
        &mut self,
        view: &View<'_>,
        estimate: Estimate<'_>,
        points: Points,
        pixels: &mut TilePixels<'_, Pixel>,
    ) {
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

    /// Traces one camera ray per pixel: adds a shading point where it hits a surface, the background
    /// elsewhere.
    fn trace_camera(&mut self, view: &View<'_>, points: Points, pixels: &mut TilePixels<'_, Pixel>) {
        let Self { arena, tiles: [tile, _], paths: [paths, _], rays, hits, emission, .. } = self;
        camera_rays(view.camera, (view.width, view.height), pixels.places, &points, rays, arena);
        let key = |place: usize| key_of(pixels.places[place]);
        hits.clear();
        paths.clear();
        emission.clear();
        let emitted = view.scene.is_emissive().then_some(&mut *emission);
        let spread = view.camera.pixel_spread(view.height);
        view.scene.intersect_and_emit((RayKind::Camera, rays), spread, key, tile, hits, emitted);
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

    /// Estimates light at the current shading points, with shadow rays.
    fn estimate(
        &mut self,
        view: &View<'_>,
        estimate: Estimate<'_>,
        points: Points,
        pixels: &mut TilePixels<'_, Pixel>,
    ) {
        let Self { arena, tiles: [tile, _], paths: [paths, _], rays, contributions, visible, .. } = self;
        contributions.clear();
        estimate.estimator.propose(&tile.rows(), &points, contributions, arena);
        visible.clear();
        visible.resize(contributions.places().len(), true);
        if !view.unshadowed {
            timed(Stage::ShadowRays, || {
                shadow_rays(view.scene, tile, contributions, rays);
                view.scene.visible_batch(rays, visible);
            });
        }
        if let Some(session) = estimate.session {
            // Training samples do not contribute to the picture.
            return timed(Stage::Learning, || session.observe(&tile.rows(), contributions, visible));
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

    /// Continues paths by BRDF sampling. A path that leaves the scene adds nothing: the estimator at its last
    /// surface covers all light from the environment.
    fn continue_paths(&mut self, view: &View<'_>, points: Points, bounces: u32, pixels: &mut TilePixels<'_, Pixel>) {
        let Self { arena, tiles: [tile, next_tile], paths: [paths, next_paths], rays, keys, hits, emission, .. } = self;
        rays.clear();
        next_paths.clear();
        keys.clear();
        let throughput = |place: usize, weight: Vec3A| paths[place].throughput * weight;
        bounce(view.scene, tile, (&points, bounces), arena, throughput, |place, throughput, ray| {
            rays.push(ray);
            next_paths.push(Path { throughput, ..paths[place] });
            keys.push(tile.keys()[place]);
        });
        hits.clear();
        emission.clear();
        let emitted = view.scene.is_emissive().then_some(&mut *emission);
        timed(Stage::CameraRays, || {
            let key = |k: usize| keys[k];
            view.scene.intersect_and_emit((RayKind::Bounce, rays), BOUNCE_SPREAD, key, next_tile, hits, emitted);
        });
        paths.clear();
        paths.extend(hits.iter().map(|&k| next_paths[k]));
        add_emission(paths, emission, pixels);
        self.tiles.swap(0, 1);
    }
}

/// Adds the emission of the surfaces that paths hit.
fn add_emission(paths: &[Path], emission: &[Vec3A], pixels: &mut TilePixels<'_, Pixel>) {
    for (path, &emission) in paths.iter().zip(emission) {
        pixels.sums[path.pixel].surfaces += (path.throughput * emission).as_dvec3();
    }
}
