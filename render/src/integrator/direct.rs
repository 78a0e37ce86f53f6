//! The integrator: camera rays through a box filter, one light estimate (or path) at each hit.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    estimator::{DirectEstimator, Unshadowed, Visibility},
    path::reflected,
    timings::{Stage, flush, timed},
};
use crate::{
    environment::Environment,
    image::Image,
    random::{Purpose, Stream, Streams},
    sampler::ShadingPoint,
    scene::{Camera, Ray, Scene},
};

/// Edge of a tile in pixels.
const TILE: usize = 16;

/// Edge of the squares in which the pixels of a tile are numbered: neighbours in a batch are neighbours in space.
const BLOCK: usize = 4;

/// Samples per pixel and pass: a random stream serves one pixel of one pass.
const PASS: u32 = 16;
/// The same where time is the budget: a pass should end close to the limit.
const SHORT_PASS: u32 = 1;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// After this many samples per pixel; 0 counts as 1.
    Spp(u32),
    /// After this much wall-clock time, at the end of the pass over all pixels that comes nearest to it.
    Time(Duration),
}

/// What to render.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The camera.
    pub camera: &'a Camera,
    /// The environment.
    pub environment: &'a Environment,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Leave out shadow rays: the environment is seen from everywhere.
    pub unshadowed: bool,
    /// Surfaces that light may visit on its way to the camera: 1 is direct light, and 0 counts as 1.
    pub depth: u32,
}

/// A finished or interrupted image.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Light reflected by surfaces; black where the camera sees past them.
    pub surfaces: Image,
    /// The environment where the camera sees it; black elsewhere.
    pub background: Image,
    /// Share of each pixel's camera rays that hit a surface, `[height * width]`.
    pub coverage: Vec<f32>,
    /// Samples per pixel that were taken.
    pub spp: u32,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Shadow rays over light estimates.
    pub rays_per_sample: f64,
    /// The largest luminance of a single contribution before its shadow ray.
    pub max_weight: f32,
}

impl Rendering {
    /// Surfaces before the environment.
    pub fn composite(&self) -> Image {
        let add = |(a, b): (&[f32; 3], &[f32; 3])| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        Image { pixels: self.surfaces.pixels.iter().zip(&self.background.pixels).map(add).collect(), ..self.surfaces }
    }
}

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Pixel {
    surfaces: DVec3,
    background: DVec3,
    estimates: u64,
    rays: u64,
    max_weight: f32,
}

/// Renders until the budget is spent or `stop` is set; an interrupted image holds the passes that were finished (at least one).
///
/// `progress` is called after every pass with the share of the budget that is spent. Same seed and same number of samples: same
/// bytes, on any number of threads.
pub fn render(
    view: View<'_>,
    estimator: &dyn DirectEstimator,
    budget: Budget,
    seed: u64,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Rendering {
    view.scene.prepare_materials();
    let start = Instant::now();
    // Without a sample there is no mean: 0 / 0 would be black with NaN, and the share of the budget never reach 1.
    let budget = if budget == Budget::Spp(0) { Budget::Spp(1) } else { budget };
    let pass = if matches!(budget, Budget::Spp(_)) { PASS } else { SHORT_PASS };
    let mut pixels = vec![Pixel::default(); view.width * view.height];
    let mut spp = 0;
    loop {
        let count = match budget {
            Budget::Spp(total) => pass.min(total - spp),
            Budget::Time(_) => pass,
        };
        add_pass(&view, estimator, seed, u64::from(spp / pass), count, &mut pixels);
        spp += count;
        let spent = match budget {
            Budget::Spp(total) => f64::from(spp) / f64::from(total),
            // Half a pass more is as near to the limit as half a pass less.
            Budget::Time(limit) => {
                let elapsed = start.elapsed().as_secs_f64();
                let half_pass = 0.5 * elapsed * f64::from(pass) / f64::from(spp);
                (elapsed + half_pass) / limit.as_secs_f64()
            }
        };
        progress(spent.min(1.0));
        if spent >= 1.0 || stop.load(Ordering::Relaxed) {
            break;
        }
    }
    develop(&view, &pixels, spp, start.elapsed().as_secs_f64())
}

/// Adds `count` samples to every pixel, tiles in parallel.
fn add_pass(view: &View<'_>, estimator: &dyn DirectEstimator, seed: u64, pass: u64, count: u32, pixels: &mut [Pixel]) {
    let across = view.width.div_ceil(TILE);
    let tiles = across * view.height.div_ceil(TILE);
    let places = |tile: usize| {
        let (left, top) = (tile % across * TILE, tile / across * TILE);
        let (right, bottom) = ((left + TILE).min(view.width), (top + TILE).min(view.height));
        let blocks = (top..bottom).step_by(BLOCK).flat_map(move |y| (left..right).step_by(BLOCK).map(move |x| (x, y)));
        blocks.flat_map(move |(left, top)| {
            let (right, bottom) = ((left + BLOCK).min(right), (top + BLOCK).min(bottom));
            (top..bottom).flat_map(move |y| (left..right).map(move |x| (x, y)))
        })
    };
    let done: Vec<Vec<Pixel>> = (0..tiles)
        .into_par_iter()
        .map(|tile| sample_tile(view, estimator, seed, pass, count, &places(tile).collect::<Vec<_>>()))
        .collect();
    for (tile, sums) in done.into_iter().enumerate() {
        for ((x, y), sum) in places(tile).zip(sums) {
            let pixel = &mut pixels[y * view.width + x];
            pixel.surfaces += sum.surfaces;
            pixel.background += sum.background;
            pixel.estimates += sum.estimates;
            pixel.rays += sum.rays;
            pixel.max_weight = pixel.max_weight.max(sum.max_weight);
        }
    }
}

/// `count` samples of each pixel of a tile, one sample of all pixels at a time: samplers get batches of shading points.
fn sample_tile(
    view: &View<'_>,
    estimator: &dyn DirectEstimator,
    seed: u64,
    pass: u64,
    count: u32,
    places: &[(usize, usize)],
) -> Vec<Pixel> {
    let stream = |&(x, y): &(usize, usize)| {
        Stream::new(seed, Purpose::Pixel, pass * (view.width * view.height) as u64 + (y * view.width + x) as u64)
    };
    let mut streams: Vec<Stream> = places.iter().map(stream).collect();
    let visibility: &dyn Visibility = if view.unshadowed { &Unshadowed } else { view.scene };
    let mut pixels = vec![Pixel::default(); places.len()];
    let (mut hits, mut of) = (Vec::with_capacity(places.len()), Vec::with_capacity(places.len()));
    for _ in 0..count {
        hits.clear();
        of.clear();
        timed(Stage::CameraRays, || look(view, places, &mut streams, &mut pixels, (&mut of, &mut hits)));
        let estimates = if view.depth > 1 {
            reflected(view, estimator, visibility, &hits, (&mut streams, &of))
        } else {
            estimator.estimate_batch(&hits, visibility, &mut Streams::new(&mut streams, &of))
        };
        for (&index, estimate) in of.iter().zip(estimates) {
            let pixel = &mut pixels[index];
            pixel.surfaces += estimate.radiance.as_dvec3();
            pixel.estimates += 1;
            pixel.rays += u64::from(estimate.rays);
            pixel.max_weight = pixel.max_weight.max(estimate.max_weight);
        }
    }
    flush();
    pixels
}

/// One camera ray through each pixel: the pixels (by their places in the list) that see a surface and the surfaces; the others get
/// the background.
fn look(
    view: &View<'_>,
    places: &[(usize, usize)],
    streams: &mut [Stream],
    pixels: &mut [Pixel],
    (of, hits): (&mut Vec<usize>, &mut Vec<ShadingPoint>),
) {
    let ray = |((x, y), random): (&(usize, usize), &mut Stream)| {
        let jitter = random.uniform2();
        view.camera.ray(*x as f32 + jitter.x, *y as f32 + jitter.y, view.width, view.height)
    };
    let rays: Vec<Ray> = places.iter().zip(streams).map(ray).collect();
    view.scene.intersect_batch(&rays, of, hits);
    let mut seen = of.iter().peekable();
    let (past, directions): (Vec<usize>, Vec<Vec3A>) = (rays.iter().enumerate())
        .filter(|(index, _)| seen.next_if_eq(&index).is_none())
        .map(|(index, ray)| (index, ray.direction))
        .unzip();
    let mut background = vec![Vec3A::ZERO; past.len()];
    view.environment.radiance_batch(&directions, &mut background);
    for (index, radiance) in past.into_iter().zip(background) {
        pixels[index].background += radiance.as_dvec3();
    }
}

fn develop(view: &View<'_>, pixels: &[Pixel], spp: u32, seconds: f64) -> Rendering {
    let image = |of: fn(&Pixel) -> DVec3| Image {
        width: view.width,
        height: view.height,
        pixels: pixels.iter().map(|pixel| Vec3A::from((of(pixel) / f64::from(spp)).as_vec3()).to_array()).collect(),
    };
    let (estimates, rays) = pixels.iter().fold((0, 0), |(e, r), pixel| (e + pixel.estimates, r + pixel.rays));
    Rendering {
        surfaces: image(|pixel| pixel.surfaces),
        background: image(|pixel| pixel.background),
        coverage: pixels.iter().map(|pixel| pixel.estimates as f32 / spp as f32).collect(),
        spp,
        seconds,
        rays_per_sample: rays as f64 / estimates.max(1) as f64,
        max_weight: pixels.iter().map(|pixel| pixel.max_weight).fold(0.0, f32::max),
    }
}
