//! The sums of all pixels, and passes over them, tiles in parallel.

use std::{cell::RefCell, ops::Range};

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    rendering::Rendering,
    view::{Part, View},
    wavefront::{Estimate, Pixel, TilePixels, Workspace},
};
use crate::{
    estimator::{Estimator, VisibilityTrainer},
    image::Image,
    morton::morton,
    points::{PointSet, Points},
    timings::flush,
};

/// Edge of a tile in pixels.
const TILE: usize = 16;

/// Edge of the squares that order the pixels of a tile, so that batches are spatially coherent.
const BLOCK: usize = 4;

/// A range of samples of every pixel.
pub(super) struct Pass<'a> {
    pub estimator: &'a dyn Estimator,
    /// Receives the visibility of contributions.
    pub trainer: Option<&'a dyn VisibilityTrainer>,
    pub points: Points,
    /// First sample and end of the range.
    pub samples: (u32, u32),
}

/// The sums of all pixels, tile by tile. Each is accumulated in sample order and so does not depend on the
/// passes.
pub(super) struct Film {
    part: Part,
    places: Vec<(u16, u16)>,
    sums: Vec<Pixel>,
    /// Number of pixels of each tile.
    tiles: Vec<usize>,
}

impl Film {
    pub fn new(part: Part) -> Self {
        Self::of(part, |_| true)
    }

    /// Creates a film of the pixels whose keys `has` accepts.
    pub fn of(part: Part, has: impl Fn(u32) -> bool) -> Self {
        let places = Vec::with_capacity(part.width * part.height);
        let mut film = Self { part, places, sums: Vec::new(), tiles: Vec::new() };
        for top in (part.top..part.top + part.height).step_by(TILE) {
            for left in (part.left..part.left + part.width).step_by(TILE) {
                let before = film.places.len();
                let (right, bottom) =
                    ((left + TILE).min(part.left + part.width), (top + TILE).min(part.top + part.height));
                for_squares(top..bottom, left..right, |x, y| {
                    let place = (x as u16, y as u16);
                    if has(morton(place.0, place.1)) {
                        film.places.push(place);
                    }
                });
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
                let estimate = Estimate { estimator: pass.estimator, trainer: pass.trainer };
                for sample in pass.samples.0..pass.samples.1 {
                    workspace.sample(view, estimate, pass.points.at_sample(sample), &mut pixels);
                }
            });
            flush();
        });
    }

    /// Divides the sums by `spp`.
    pub fn resolve(&self, points: PointSet, spp: u32, seconds: f64) -> Rendering {
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

/// Visits the pixels of a tile, as column and row, square by square.
fn for_squares(rows: Range<usize>, columns: Range<usize>, mut visit: impl FnMut(usize, usize)) {
    for top in rows.clone().step_by(BLOCK) {
        for left in columns.clone().step_by(BLOCK) {
            for y in top..(top + BLOCK).min(rows.end) {
                for x in left..(left + BLOCK).min(columns.end) {
                    visit(x, y);
                }
            }
        }
    }
}
