//! The oracle: the exact product, tabulated anew at every shading point. Slow; the bound that other samplers are held against.

use std::sync::Arc;

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{ShadingPoint, product::IntermediateDensity};
use crate::{
    bake::search_prefix,
    color::luminance,
    latlong,
    tail::{Tail, TailWarp},
};

/// Cells along each side of Y.
const CELLS: usize = 256;
/// Points along each side of a cell, by the angle (as a chord) that the cell's directions span: dark regions of a map are
/// squeezed into few cells of Y, and such a cell is not described by its centre.
const POINTS: [(f32, usize); 3] = [(0.02, 1), (0.2, 4), (f32::INFINITY, 8)];
/// Share of the mean over all cells that every cell is given, for each unit of the chord that it spans, and at least.
/// Whatever direction the points of a cell do not show is drawn with this density.
const FLOOR: f32 = 0.05;
const LEAST_FLOOR: f32 = 1e-3;
/// Where points of a cell are farther apart than this many widths of the BRDF's narrowest lobe, BRDF samples look into it too.
const RESOLVED: f32 = 0.5;
/// BRDF samples along a side of their square.
const LOBE_POINTS: usize = 32;

/// Tabulates BRDF x cosine over 256 x 256 cells of Y, some 1e5 evaluations for each shading point. Through the exact tail the
/// environment is no part of the table, so no highlight of the map is blurred by it.
///
/// A glossy lobe can fall between the points of a cell that spans much of the sky. Such cells are also looked into by BRDF samples
/// that are pulled back through the tail (balance heuristic).
#[derive(Clone, Debug)]
pub struct Oracle {
    tail: Arc<Tail>,
    cells: Arc<[Cell]>,
    /// The largest [`Cell::spacing`].
    coarsest: f32,
}

/// What is known of a cell of Y before any shading point.
#[derive(Clone, Debug)]
struct Cell {
    /// Directions of evenly spaced points, and the tail's pdf over solid angle there.
    points: Box<[(Vec3A, f32)]>,
    /// Distance of neighbouring points on the unit sphere, at most.
    spacing: f32,
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
    pub fn new(tail: &Arc<Tail>) -> Self {
        let cells: Arc<[Cell]> = (0..CELLS * CELLS).into_par_iter().map(|index| Cell::new(tail, index)).collect();
        let coarsest = cells.iter().map(|cell| cell.spacing).fold(0.0, f32::max);
        Self { tail: tail.clone(), cells, coarsest }
    }

    /// The root mean square of the target in each cell: the constant density of least variance.
    fn values(&self, at: &ShadingPoint) -> Vec<f32> {
        let resolved = RESOLVED * at.brdf.narrowest_lobe();
        if self.coarsest <= resolved {
            return self.cells.iter().map(|cell| cell.value(at)).collect();
        }
        let value = |cell: &Cell| if cell.spacing <= resolved { cell.value(at) } else { cell.value_beside_lobes(at) };
        let mut values: Vec<f32> = self.cells.iter().map(value).collect();
        for (index, part) in self.lobe_parts(at, resolved) {
            values[index] = values[index].hypot(part);
        }
        values
    }

    /// What BRDF samples see in cells coarser than `resolved`: the cell of each, and the root of its part of the mean square.
    fn lobe_parts(&self, at: &ShadingPoint, resolved: f32) -> impl Iterator<Item = (usize, f32)> {
        (0..LOBE_POINTS * LOBE_POINTS).filter_map(move |k| {
            let u = Vec2::new((k % LOBE_POINTS) as f32 + 0.5, (k / LOBE_POINTS) as f32 + 0.5) / LOBE_POINTS as f32;
            let (wi, pdf) = at.brdf.sample(at.ns, at.wo, u)?;
            let x = latlong::square(wi);
            let (y, density) = self.tail.inverse(x);
            let emitter = density * latlong::solid_angle_factor(x.y);
            let index = cell_of(y.y) * CELLS + cell_of(y.x);
            let cell = &self.cells[index];
            // Where the map is black, no y is carried to wi.
            (emitter > 0.0 && cell.spacing > resolved)
                .then(|| (index, cell.weigh(target(at, wi), pdf / emitter).sqrt()))
        })
    }
}

/// The column or row of a coordinate of Y.
fn cell_of(coordinate: f32) -> usize {
    ((coordinate * CELLS as f32) as usize).min(CELLS - 1)
}

/// Luminance of BRDF x cosine.
fn target(at: &ShadingPoint, wi: Vec3A) -> f32 {
    luminance(at.brdf_cosine(wi))
}

impl Cell {
    fn new(tail: &Tail, index: usize) -> Self {
        let corner = Vec2::new((index % CELLS) as f32, (index / CELLS) as f32);
        let points = |side: usize| -> Box<[(Vec3A, f32)]> {
            let inside = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
            let point = |k: usize| {
                let (_, wi, pdf) = tail.forward_direction((corner + inside(k)) / CELLS as f32);
                (wi, pdf)
            };
            (0..side * side).map(point).collect()
        };
        let probe = points(3);
        let chord = probe.iter().map(|(w, _)| (*w - probe[4].0).length()).fold(0.0, f32::max);
        let (_, side) = POINTS[POINTS.iter().position(|(most, _)| chord <= *most).unwrap_or(2)];
        let floor = (FLOOR * chord).max(LEAST_FLOOR);
        Self { points: points(side), spacing: 2.0 * chord / side as f32, floor }
    }

    /// Root mean square over the cell's points.
    fn value(&self, at: &ShadingPoint) -> f32 {
        match &*self.points {
            [(only, _)] => target(at, *only),
            many => (many.iter().map(|(wi, _)| target(at, *wi).powi(2)).sum::<f32>() / many.len() as f32).sqrt(),
        }
    }

    /// The same where BRDF samples add their part.
    fn value_beside_lobes(&self, at: &ShadingPoint) -> f32 {
        let part = |&(wi, emitter): &(Vec3A, f32)| {
            let density = at.brdf.pdf(at.ns, at.wo, wi) / emitter.max(f32::MIN_POSITIVE);
            self.weigh(target(at, wi), density)
        };
        self.points.iter().map(part).sum::<f32>().sqrt()
    }

    /// The part of a point in the mean square over the cell, by the balance heuristic between the cell's own points and BRDF
    /// samples, whose density over Y there is `density`.
    fn weigh(&self, target: f32, density: f32) -> f32 {
        let samples = (LOBE_POINTS * LOBE_POINTS) as f32 / (CELLS * CELLS) as f32;
        target * target / (self.points.len() as f32 + samples * density)
    }
}

impl IntermediateDensity for Oracle {
    type Prepared = OracleTable;

    fn prepare(&self, at: &ShadingPoint) -> OracleTable {
        let mut prefix = self.values(at);
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
        table.cell(cell_of(y.x), cell_of(y.y))
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
