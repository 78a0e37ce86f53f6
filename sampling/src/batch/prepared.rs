//! Shading points that are prepared once.

use std::sync::Arc;

use super::{DrawList, Numbers, PointList, TILE, check_length, draw, each_tile, each_tile_of, evaluate};
use crate::{
    columns::Arena,
    error::Result,
    memory,
    parallel::*,
    sampler::Sampler,
    simd::{LANES, Lanes},
    tile::Tile,
};

/// Shading points with the state of a sampler, which draws from them and evaluates their pdfs any number of times:
/// a renderer with MIS does both at every point.
pub struct PreparedPoints {
    sampler: Arc<dyn Sampler>,
    count: usize,
    tiles: Vec<(Tile, Vec<Lanes>)>,
}

impl PreparedPoints {
    /// Bytes of a point besides the sampler's state.
    const POINT_BYTES: u64 = 160;

    /// Prepares `count` points: copies them, and computes what the sampler needs of each (for patches, 300 bytes).
    ///
    /// # Errors
    /// As [`sample`](super::sample).
    pub fn new(sampler: Arc<dyn Sampler>, at: &PointList<'_>, count: usize) -> Result<Self> {
        at.check_lengths(count)?;
        let bytes = 4 * sampler.columns() as u64 + Self::POINT_BYTES;
        // Asking the system takes longer than preparing a few points.
        if count > TILE {
            memory::require((count as u64).saturating_mul(bytes), || format!("{count} prepared points"))?;
        }
        let tile_at = |first: usize| {
            let (mut tile, arena) = (Tile::default(), Arena::default());
            at.fill(&mut tile, first, TILE.min(count - first))?;
            let mut state = vec![[0.0; LANES]; sampler.columns() * tile.rows().strips()];
            sampler.prepare(&tile.rows(), &mut state, &arena);
            Ok((tile, state))
        };
        let tiles: Vec<Result<_>> =
            (0..count.div_ceil(TILE)).into_par_iter().map(|index| tile_at(index * TILE)).collect();
        let tiles = tiles.into_iter().collect::<Result<_>>()?;
        Ok(Self { sampler, count, tiles })
    }

    /// Returns the number of points.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Draws one direction per point, the same as [`sample`](super::sample).
    ///
    /// # Errors
    /// As [`sample`](super::sample).
    pub fn sample(&self, numbers: Numbers<'_>, out: DrawList<'_>) -> Result<()> {
        check_length("pdf", out.pdf.len(), self.count)?;
        each_tile(numbers, out, |arena: &mut Arena, first, out| {
            let (tile, state) = &self.tiles[first / TILE];
            draw(&*self.sampler, &tile.rows(), state, (first, numbers), out, arena)
        })
    }

    /// Evaluates the solid-angle pdfs of unit directions, one per point, the same as [`pdf`](super::pdf).
    ///
    /// # Errors
    /// As [`sample`](super::sample).
    pub fn pdf(&self, wi: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        check_length("pdf", out.len(), self.count)?;
        check_length("wi", wi.len(), self.count)?;
        each_tile_of(wi, out, |arena: &mut Arena, first, wi, out| {
            let (tile, state) = &self.tiles[first / TILE];
            evaluate(&*self.sampler, &tile.rows(), state, (first, wi), out, arena)
        })
    }
}
