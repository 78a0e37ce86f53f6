//! Passes over an image, tiles in parallel, until a budget is spent.

use std::{
    cell::RefCell,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    learn::{learn_before, setting},
    view::{Part, View},
    wavefront::{Estimate, Pixel, TilePixels, Workspace},
};
use crate::{
    estimator::{Estimator, Learner},
    image::Image,
    morton::morton,
    points::{PointSet, Points},
    timings::flush,
    visibility::CacheSize,
};

/// Edge of a tile in pixels.
const TILE: usize = 16;

/// Edge of the squares in which the pixels of a tile are numbered: neighbours in a batch are neighbours in space.
const BLOCK: usize = 4;

/// Samples per pixel and pass where their number is the budget.
const PASS: u32 = 16;
/// The same where time is the budget: a pass should end close to the limit.
const SHORT_PASS: u32 = 1;

/// Largest width and height.
pub const MAX_SIDE: usize = u16::MAX as usize;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// After this many samples per pixel; 0 counts as 1.
    Spp(u32),
    /// After this much wall-clock time, at the end of the pass over all pixels that comes nearest to it.
    Time(Duration),
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
    /// The points that they were taken at.
    pub points: PointSet,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Shadow rays over light estimates.
    pub rays_per_sample: f64,
    /// The largest luminance of a single contribution before its shadow ray.
    pub max_weight: f32,
    /// What was learned of visibility, by an estimator that learns.
    pub learned: Option<CacheSize>,
}

impl Rendering {
    /// Surfaces before the environment.
    pub fn composite(&self) -> Image {
        let add = |(a, b): (&[f32; 3], &[f32; 3])| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        Image { pixels: self.surfaces.pixels.iter().zip(&self.background.pixels).map(add).collect(), ..self.surfaces }
    }

    /// The picture under a map that is so many times as bright, per channel: all light comes from the map.
    #[must_use]
    pub fn lit_by(mut self, factors: Vec3A) -> Self {
        for pixel in self.surfaces.pixels.iter_mut().chain(&mut self.background.pixels) {
            *pixel = (Vec3A::from_array(*pixel) * factors).to_array();
        }
        // A bound: the brightest contribution need not have been of the brightest channel.
        self.max_weight *= factors.max_element();
        self
    }
}

/// Renders until the budget is spent or `stop` is set; an interrupted image holds the passes that were finished (at least one).
///
/// `progress` is called after every pass with the share of the budget that is spent. Same `points` (their kind and seed) and same number of
/// samples: same bytes, on any number of threads and whatever the budget was given in. An estimator that learns does so first, from other points, in
/// a small part of the budget: its pictures depend on how much that was, too, which for a budget in time is not always the same.
///
/// # Panics
/// If a side is longer than [`MAX_SIDE`].
pub fn render(
    view: View<'_>,
    estimator: &dyn Estimator,
    budget: Budget,
    points: Points,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Rendering {
    render_part(view, view.whole(), estimator, budget, points, stop, progress)
}

/// [`render`] of a part of the image: at equal samples its pixels are those of the whole, bit for bit, but of an estimator that learns, to which
/// the others would have told something.
///
/// # Panics
/// As [`render`], and if the part is not inside of the image.
pub fn render_part(
    view: View<'_>,
    part: Part,
    estimator: &dyn Estimator,
    budget: Budget,
    points: Points,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Rendering {
    assert!(
        part.left + part.width <= view.width && part.top + part.height <= view.height,
        "{part:?} of {} x {}",
        view.width,
        view.height
    );
    assert!(view.width.max(view.height) <= MAX_SIDE, "an image of more than {MAX_SIDE} pixels along a side");
    view.scene.prepare_materials();
    let start = Instant::now();
    // Without a sample there is no mean: 0 / 0 would be black with NaN, and the share of the budget never reach 1.
    let budget = if budget == Budget::Spp(0) { Budget::Spp(1) } else { budget };
    let pass = if matches!(budget, Budget::Spp(_)) { PASS } else { SHORT_PASS };
    let mut film = Film::new(part);
    let mut learner = estimator.learner(setting(&view, part));
    if let Some(learner) = &mut learner {
        learn_before((&view, part), &mut **learner, budget, points.seed(), stop);
    }
    let estimator = learner.as_ref().map_or(estimator, |learner| &**learner as &dyn Estimator);
    let mut spp = 0;
    loop {
        let count = if let Budget::Spp(total) = budget { pass.min(total - spp) } else { pass };
        film.add(&view, &Pass { estimator, learner: None, points, samples: (spp, spp + count) });
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
    let learned = learner.map(|learner| learner.size());
    Rendering { learned, ..film.resolve(points.set(), spp, start.elapsed().as_secs_f64()) }
}

/// Some samples of every pixel.
pub(super) struct Pass<'a> {
    pub estimator: &'a dyn Estimator,
    /// Who is told what was visible.
    pub learner: Option<&'a dyn Learner>,
    pub points: Points,
    /// The first, and the first after them.
    pub samples: (u32, u32),
}

/// The sums of all pixels, tile after tile: each sum is made in the order of the samples, so that it does not depend on passes.
pub(super) struct Film {
    part: Part,
    places: Vec<(u16, u16)>,
    sums: Vec<Pixel>,
    /// How many pixels each tile has.
    tiles: Vec<usize>,
}

impl Film {
    pub fn new(part: Part) -> Self {
        Self::of(part, |_| true)
    }

    /// A film of some pixels alone, by their keys.
    pub fn of(part: Part, has: impl Fn(u32) -> bool) -> Self {
        let places = Vec::with_capacity(part.width * part.height);
        let mut film = Self { part, places, sums: Vec::new(), tiles: Vec::new() };
        for top in (part.top..part.top + part.height).step_by(TILE) {
            for left in (part.left..part.left + part.width).step_by(TILE) {
                let before = film.places.len();
                let (right, bottom) =
                    ((left + TILE).min(part.left + part.width), (top + TILE).min(part.top + part.height));
                for (y, x) in squares(top..bottom, left..right) {
                    let place = (x as u16, y as u16);
                    if has(morton(place.0, place.1)) {
                        film.places.push(place);
                    }
                }
                film.tiles.push(film.places.len() - before);
            }
        }
        film.sums = vec![Pixel::default(); film.places.len()];
        film
    }

    /// Adds samples to every pixel, tiles in parallel.
    pub fn add(&mut self, view: &View<'_>, pass: &Pass<'_>) {
        thread_local! {
            static WORKSPACE: RefCell<Workspace> = RefCell::default();
        }
        let (mut places, mut sums) = (&self.places[..], &mut self.sums[..]);
        let mut tiles = Vec::with_capacity(self.tiles.len());
        for &count in &self.tiles {
            let (own, rest) = places.split_at(count);
            let (own_sums, rest_sums) = std::mem::take(&mut sums).split_at_mut(count);
            tiles.push(TilePixels { places: own, sums: own_sums });
            (places, sums) = (rest, rest_sums);
        }
        tiles.into_par_iter().for_each(|mut pixels| {
            WORKSPACE.with_borrow_mut(|workspace| {
                let estimate = Estimate { estimator: pass.estimator, learner: pass.learner };
                for sample in pass.samples.0..pass.samples.1 {
                    workspace.sample(view, estimate, pass.points.at_sample(sample), &mut pixels);
                }
            });
            flush();
        });
    }

    fn resolve(&self, points: PointSet, spp: u32, seconds: f64) -> Rendering {
        let Part { left, top, width, height } = self.part;
        let mut pixels = vec![Pixel::default(); width * height];
        for (&(x, y), sum) in self.places.iter().zip(&self.sums) {
            pixels[(usize::from(y) - top) * width + usize::from(x) - left] = *sum;
        }
        let image = |of: fn(&Pixel) -> DVec3| Image {
            width,
            height,
            pixels: pixels.iter().map(|pixel| Vec3A::from((of(pixel) / f64::from(spp)).as_vec3()).to_array()).collect(),
        };
        let (estimates, rays) = pixels.iter().fold((0, 0), |(e, r), pixel| (e + pixel.estimates, r + pixel.rays));
        Rendering {
            surfaces: image(|pixel| pixel.surfaces),
            background: image(|pixel| pixel.background),
            coverage: pixels.iter().map(|pixel| pixel.estimates as f32 / spp as f32).collect(),
            spp,
            points,
            seconds,
            rays_per_sample: rays as f64 / estimates.max(1) as f64,
            max_weight: pixels.iter().map(|pixel| pixel.max_weight).fold(0.0, f32::max),
            learned: None,
        }
    }
}

/// Row and column of the pixels of a tile, square by square.
fn squares(rows: std::ops::Range<usize>, columns: std::ops::Range<usize>) -> impl Iterator<Item = (usize, usize)> {
    let tops = rows.clone().step_by(BLOCK);
    let corners = tops.flat_map(move |top| columns.clone().step_by(BLOCK).map(move |left| (top, left, columns.end)));
    corners.flat_map(move |(top, left, right)| {
        let (bottom, right) = ((top + BLOCK).min(rows.end), (left + BLOCK).min(right));
        (top..bottom).flat_map(move |y| (left..right).map(move |x| (y, x)))
    })
}
