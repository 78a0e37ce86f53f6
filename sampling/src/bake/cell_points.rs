//! Evenly spaced points of the cells of Y.

use glam::{Vec2, Vec3A};

use super::cell_grid::CellGrid;
use crate::tail::Tail;

/// Evenly spaced points of Y and their directions, grouped by cell.
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
