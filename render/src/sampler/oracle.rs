//! The oracle: the exact product, tabulated anew at every shading point. Slow; the bound that other samplers are held against.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{ShadingPoint, product::IntermediateDensity};
use crate::{bake::search_prefix, color::luminance, tail::Tail};

/// Cells along each side of Y.
const CELLS: usize = 256;
/// Share of the light that is sampled whatever the table says: a cell can hold directions that its centre does not show.
const FLOOR: f32 = 1e-3;

/// Tabulates BRDF x cosine over 256 x 256 cells of Y, 65,536 evaluations for each shading point. Through the exact tail the
/// environment is no part of the table, so no highlight of the map is blurred by it.
#[derive(Clone, Debug)]
pub struct Oracle {
    /// Directions of the cells' centres, `[CELLS * CELLS]`, row-major.
    centres: Arc<[Vec3A]>,
}

/// The table of one shading point: running sums over the cells of each row, and over rows.
#[derive(Clone, Debug)]
pub struct OracleTable {
    prefix: Vec<f32>,
    rows: Vec<f32>,
}

impl Oracle {
    /// Computes the directions of the cells' centres.
    pub fn new(tail: &Tail) -> Self {
        let centre =
            |index: usize| Vec2::new((index % CELLS) as f32 + 0.5, (index / CELLS) as f32 + 0.5) / CELLS as f32;
        Self { centres: (0..CELLS * CELLS).map(|index| tail.forward_direction(centre(index)).1).collect() }
    }
}

impl IntermediateDensity for Oracle {
    type Prepared = OracleTable;

    fn prepare(&self, at: &ShadingPoint) -> OracleTable {
        let mut prefix: Vec<f32> = self.centres.iter().map(|&wi| luminance(at.brdf_cosine(wi))).collect();
        let floor = (FLOOR * prefix.iter().sum::<f32>() / prefix.len() as f32).max(f32::MIN_POSITIVE);
        let mut rows = Vec::with_capacity(CELLS);
        let mut above = 0.0;
        for row in prefix.chunks_exact_mut(CELLS) {
            let mut sum = 0.0;
            for value in row {
                sum += *value + floor;
                *value = sum;
            }
            above += sum;
            rows.push(above);
        }
        OracleTable { prefix, rows }
    }

    fn sample(&self, table: &OracleTable, z: Vec2) -> (Vec2, f32) {
        let (row, down) = search_prefix(&table.rows, z.y);
        let (column, across) = search_prefix(&table.prefix[row * CELLS..(row + 1) * CELLS], z.x);
        let y = Vec2::new(column as f32 + across, row as f32 + down) / CELLS as f32;
        (y, table.cell(column, row))
    }

    fn density(&self, table: &OracleTable, y: Vec2) -> f32 {
        let cell = |coordinate: f32| ((coordinate * CELLS as f32) as usize).min(CELLS - 1);
        table.cell(cell(y.x), cell(y.y))
    }
}

impl OracleTable {
    fn cell(&self, column: usize, row: usize) -> f32 {
        let index = row * CELLS + column;
        let before = if column == 0 { 0.0 } else { self.prefix[index - 1] };
        let total = self.rows[CELLS - 1];
        (self.prefix[index] - before) * (CELLS * CELLS) as f32 / total
    }
}
