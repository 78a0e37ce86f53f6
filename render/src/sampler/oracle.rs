//! The oracle: the exact product, tabulated anew at every shading point. Slow; the bound that other samplers are held against.

use std::sync::Arc;

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{ShadingPoint, product::IntermediateDensity};
use crate::{bake::search_prefix, color::luminance, tail::Tail};

/// Cells along each side of Y.
const CELLS: usize = 256;
/// Points along each side of a cell, by the angle (as a chord) that the cell's directions span: dark regions of a map are
/// squeezed into few cells of Y, and such a cell is not described by its centre.
const POINTS: [(f32, usize); 3] = [(0.02, 1), (0.2, 4), (f32::INFINITY, 8)];
/// Share of the mean over all cells that every cell is given, for each unit of the chord that it spans, and at least.
/// Whatever direction the points of a cell do not show is drawn with this density.
const FLOOR: f32 = 0.05;
const LEAST_FLOOR: f32 = 1e-3;

/// Tabulates BRDF x cosine over 256 x 256 cells of Y, some 1e5 evaluations for each shading point. Through the exact tail the
/// environment is no part of the table, so no highlight of the map is blurred by it.
#[derive(Clone, Debug)]
pub struct Oracle {
    cells: Arc<[Cell]>,
}

/// What is known of a cell of Y before any shading point.
#[derive(Clone, Debug)]
struct Cell {
    /// Directions of evenly spaced points.
    directions: Box<[Vec3A]>,
    /// Share of the mean that the cell is given in any case.
    floor: f32,
}

/// The table of one shading point: running sums over the cells of each row, and over rows.
#[derive(Clone, Debug)]
pub struct OracleTable {
    prefix: Vec<f32>,
    rows: Vec<f32>,
}

impl Oracle {
    /// Evaluates the tail at the points of all cells.
    pub fn new(tail: &Tail) -> Self {
        Self { cells: (0..CELLS * CELLS).into_par_iter().map(|index| Cell::new(tail, index)).collect() }
    }
}

impl Cell {
    fn new(tail: &Tail, index: usize) -> Self {
        let corner = Vec2::new((index % CELLS) as f32, (index / CELLS) as f32);
        let directions = |side: usize| -> Box<[Vec3A]> {
            let inside = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
            (0..side * side).map(|k| tail.forward_direction((corner + inside(k)) / CELLS as f32).1).collect()
        };
        let probe = directions(3);
        let chord = probe.iter().map(|w| (*w - probe[4]).length()).fold(0.0, f32::max);
        let (_, side) = POINTS[POINTS.iter().position(|(most, _)| chord <= *most).unwrap_or(2)];
        Self { directions: directions(side), floor: (FLOOR * chord).max(LEAST_FLOOR) }
    }

    /// Root mean square over the cell's points: the constant density of least variance.
    fn value(&self, at: &ShadingPoint) -> f32 {
        let target = |wi: &Vec3A| luminance(at.brdf_cosine(*wi));
        match &*self.directions {
            [only] => target(only),
            many => (many.iter().map(|wi| target(wi).powi(2)).sum::<f32>() / many.len() as f32).sqrt(),
        }
    }
}

impl IntermediateDensity for Oracle {
    type Prepared = OracleTable;

    fn prepare(&self, at: &ShadingPoint) -> OracleTable {
        let mut prefix: Vec<f32> = self.cells.iter().map(|cell| cell.value(at)).collect();
        let mean = (prefix.iter().sum::<f32>() / prefix.len() as f32).max(f32::MIN_POSITIVE / LEAST_FLOOR);
        let mut rows = Vec::with_capacity(CELLS);
        let mut above = 0.0;
        for (values, cells) in prefix.chunks_exact_mut(CELLS).zip(self.cells.chunks_exact(CELLS)) {
            let mut sum = 0.0;
            for (value, cell) in values.iter_mut().zip(cells) {
                sum += *value + mean * cell.floor;
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
