//! The pixels of a picture in square tiles, with sums, visited in parallel.

use std::ops::Range;

use rayon::prelude::*;

use super::view::Part;
use crate::morton::morton;

/// Edge of a tile in pixels.
const TILE: usize = 16;

/// Edge of the squares that order the pixels of a tile, so that batches are spatially coherent.
const BLOCK: usize = 4;

/// Pixels tile by tile, with a sum of type `S` for each. Sums of a pixel are added in sample order and so do not depend
/// on threads.
pub(crate) struct Tiles<S> {
    part: Part,
    /// Column and row of each pixel.
    places: Vec<(u16, u16)>,
    sums: Vec<S>,
    /// Number of pixels of each tile.
    counts: Vec<usize>,
}

/// The pixels of one tile.
pub(crate) struct TilePixels<'a, S> {
    /// Column and row of each.
    pub places: &'a [(u16, u16)],
    pub sums: &'a mut [S],
}

impl<S: Copy + Default + Send> Tiles<S> {
    /// Divides the pixels of a part whose keys `has` accepts.
    pub fn new(part: Part, has: impl Fn(u32) -> bool) -> Self {
        let mut places = Vec::with_capacity(part.width * part.height);
        let mut counts = Vec::new();
        let (bottom, right) = (part.top + part.height, part.left + part.width);
        for top in (part.top..bottom).step_by(TILE) {
            for left in (part.left..right).step_by(TILE) {
                let before = places.len();
                for_squares(top..(top + TILE).min(bottom), left..(left + TILE).min(right), |x, y| {
                    let place = (x as u16, y as u16);
                    if has(morton(place.0, place.1)) {
                        places.push(place);
                    }
                });
                counts.push(places.len() - before);
            }
        }
        Self { part, sums: vec![S::default(); places.len()], places, counts }
    }

    /// Visits all tiles in parallel.
    pub fn par_for_each(&mut self, visit: impl Fn(TilePixels<'_, S>) + Sync + Send) {
        let (mut places, mut sums) = (&self.places[..], &mut self.sums[..]);
        let mut tiles = Vec::with_capacity(self.counts.len());
        for &count in &self.counts {
            let (own, rest) = places.split_at(count);
            let (own_sums, rest_sums) = std::mem::take(&mut sums).split_at_mut(count);
            tiles.push(TilePixels { places: own, sums: own_sums });
            (places, sums) = (rest, rest_sums);
        }
        tiles.into_par_iter().for_each(visit);
    }

    /// Returns `[height * width]` sums of the part; those of pixels without a tile are zero.
    pub fn row_major(&self) -> Vec<S> {
        let Part { left, top, width, height } = self.part;
        let mut pixels = vec![S::default(); width * height];
        for (&(x, y), sum) in self.places.iter().zip(&self.sums) {
            pixels[(usize::from(y) - top) * width + usize::from(x) - left] = *sum;
        }
        pixels
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
