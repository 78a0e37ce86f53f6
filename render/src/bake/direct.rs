//! The direct bake: the ideal intermediate density of a Lambert surface, tabulated without any training.

use glam::{Vec2, Vec3A};

use super::{cell_grid::CellGrid, normal_grid::NormalGrid, table::BakedTable};
use crate::{error::Result, tail::Tail};

/// Points along each side of Y at which the tail is evaluated, at least.
const RESOLUTION: usize = 512;

/// Directions of evenly spaced points of Y, grouped by cell: what a bake averages over.
#[derive(Clone, Debug)]
pub struct CellPoints {
    per_cell: usize,
    positions: Vec<Vec2>,
    directions: Vec<Vec3A>,
}

impl CellPoints {
    /// Evaluates the tail at `per_side x per_side` points of every cell.
    pub fn new(tail: &Tail, cells: CellGrid, per_side: usize) -> Self {
        let (rows, columns) = cells.shape();
        let per_cell = per_side * per_side;
        let positions: Vec<Vec2> = (0..cells.cells() * per_cell)
            .map(|index| {
                let (cell, point) = (index / per_cell, index % per_cell);
                let inside =
                    Vec2::new((point % per_side) as f32 + 0.5, (point / per_side) as f32 + 0.5) / per_side as f32;
                Vec2::new(
                    ((cell % columns) as f32 + inside.x) / columns as f32,
                    ((cell / columns) as f32 + inside.y) / rows as f32,
                )
            })
            .collect();
        let directions = tail.forward_directions(&positions).map(|(_, wi, _)| wi).collect();
        Self { per_cell, positions, directions }
    }

    /// The points of Y of each cell.
    pub fn positions(&self) -> impl Iterator<Item = &[Vec2]> {
        self.positions.chunks_exact(self.per_cell)
    }

    /// The directions of each cell.
    pub fn directions(&self) -> impl Iterator<Item = &[Vec3A]> {
        self.directions.chunks_exact(self.per_cell)
    }
}

/// Tabulates `max(0, n . t(y))` over the cells of Y for every normal of the grid.
///
/// A cell holds the root mean square of the cosine over it, which is the piecewise constant density of least variance
/// (minimise the integral of g^2 / q under the integral of q = 1).
///
/// # Errors
/// See [`BakedTable::new`].
pub fn direct_bake(tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    let (rows, columns) = cells.shape();
    let points = CellPoints::new(tail, cells, (RESOLUTION / rows.min(columns)).clamp(8, 16));
    BakedTable::fill(normals, cells, |normal, masses| {
        for (mass, directions) in masses.iter_mut().zip(points.directions()) {
            let squares: f32 = directions.iter().map(|&wi| normal.dot(wi).max(0.0).powi(2)).sum();
            *mass = (squares / directions.len() as f32).sqrt();
        }
    })
}
