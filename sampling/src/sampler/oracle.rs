//! The oracle: the product of light, BRDF and cosine, tabulated at every shading point. Slow; shows product
//! sampling without model error. It ignores visibility, so a sampler that distributes its noise better can
//! have lower error.

use std::sync::Arc;

use crate::parallel::*;
use glam::{Vec2, Vec3A};

use super::product::IntermediateDensity;
use crate::{
    color::luminance,
    columns::Arena,
    discrete::invert_running_sums,
    latlong,
    one_point::OnePoint,
    simd::Lanes,
    tail::{Tail, TailWarp},
    tile::Rows,
};

/// Cells along each side of Y.
const CELLS: usize = 256;
/// Points along each side of a cell, by the angle (as a chord) that the cell's directions span: dark regions
/// of a map are compressed into few cells of Y, whose centres do not represent them.
const POINTS: [(f32, usize); 3] = [(0.02, 1), (0.2, 4), (f32::INFINITY, 8)];
/// Floor of each cell as a fraction of the mean over all cells, per unit of the chord that it spans; and its
/// minimum. Directions that the points of a cell miss are drawn with this density.
const FLOOR: f32 = 0.05;
const LEAST_FLOOR: f32 = 1e-3;
/// Where points of a cell are farther apart than this many widths of the BRDF's narrowest lobe, BRDF samples
/// are added.
const RESOLVED: f32 = 0.5;
/// BRDF samples along a side of the unit square.
const LOBE_POINTS: usize = 32;

/// Tabulates BRDF x cosine over 256 x 256 cells of Y, with about 1e5 evaluations per shading point. The exact
/// tail handles the environment, so the table does not blur highlights of the map.
///
/// A glossy lobe can fall between the points of a cell that spans much of the sky. BRDF samples that are
/// pulled back through the tail are added to such cells (balance heuristic).
#[derive(Clone, Debug)]
pub struct Oracle {
    tail: Arc<Tail>,
    cells: Arc<[Cell]>,
    /// Directions of the points of all cells.
    directions: Arc<[Vec3A]>,
    /// The largest [`Cell::spacing`].
    coarsest: f32,
}

/// The precomputed part of a cell of Y.
#[derive(Clone, Debug)]
struct Cell {
    /// Directions of evenly spaced points, and the tail's pdf over solid angle there.
    points: Box<[(Vec3A, f32)]>,
    /// Largest distance between neighbouring points on the unit sphere.
    spacing: f32,
    /// Floor of the cell as a fraction of the mean.
    floor: f32,
}

impl Oracle {
    /// Evaluates the tail at the points of all cells.
    pub fn new(tail: &Arc<Tail>) -> Self {
        let cells: Arc<[Cell]> = (0..CELLS * CELLS).into_par_iter().map(|index| Cell::new(tail, index)).collect();
        let coarsest = cells.iter().map(|cell| cell.spacing).fold(0.0, f32::max);
        let directions = cells.iter().flat_map(|cell| &cell.points).map(|point| point.0).collect();
        Self { tail: tail.clone(), cells, directions, coarsest }
    }

    /// Returns the root mean square of the target in each cell: the constant density with the lowest
    /// variance.
    fn values(&self, point: &OnePoint) -> Vec<f32> {
        let targets: Vec<f32> = point.brdf_cosines(&self.directions).into_iter().map(luminance).collect();
        let resolved = RESOLVED * point.lobe_width();
        let brdf_pdfs = if self.coarsest > resolved { point.brdf_pdfs(&self.directions) } else { Vec::new() };
        let mut first = 0;
        let value = |cell: &Cell| {
            let own = first..first + cell.points.len();
            first = own.end;
            if cell.spacing <= resolved {
                cell.value(&targets[own])
            } else {
                cell.value_beside_lobes(&targets[own.clone()], &brdf_pdfs[own])
            }
        };
        let mut values: Vec<f32> = self.cells.iter().map(value).collect();
        if self.coarsest > resolved {
            self.add_lobe_parts(point, resolved, &mut values);
        }
        values
    }

    /// Adds the contributions of BRDF samples to cells coarser than `resolved`.
    fn add_lobe_parts(&self, point: &OnePoint, resolved: f32, values: &mut [f32]) {
        let u =
            |k: usize| Vec2::new((k % LOBE_POINTS) as f32 + 0.5, (k / LOBE_POINTS) as f32 + 0.5) / LOBE_POINTS as f32;
        let u: Vec<Vec2> = (0..LOBE_POINTS * LOBE_POINTS).map(u).collect();
        let (wi, pdfs): (Vec<_>, Vec<_>) = point.sample_brdf(&u).into_iter().flatten().unzip();
        let x: Vec<Vec2> = wi.iter().map(|&wi| latlong::square(wi)).collect();
        let targets = point.brdf_cosines(&wi);
        for (((x, (y, density)), target), pdf) in x.iter().zip(self.tail.inverse_points(&x)).zip(targets).zip(pdfs) {
            let emitter = density * latlong::solid_angle_factor(x.y);
            let index = cell_of(y.y) * CELLS + cell_of(y.x);
            let cell = &self.cells[index];
            // Where the map is black, no y maps to wi.
            if emitter > 0.0 && cell.spacing > resolved {
                values[index] = values[index].hypot(cell.weigh(luminance(target), pdf / emitter).sqrt());
            }
        }
    }

    /// Fills the table of a shading point: running sums along each row of cells, then those of the rows.
    fn fill(&self, point: &OnePoint, table: &mut [f32]) {
        let values = self.values(point);
        let mean = (values.iter().sum::<f32>() / values.len() as f32).max(f32::MIN_POSITIVE / LEAST_FLOOR);
        let (prefix, rows) = table.split_at_mut(CELLS * CELLS);
        let mut above = 0.0;
        let all = prefix.chunks_exact_mut(CELLS).zip(values.chunks_exact(CELLS)).zip(self.cells.chunks_exact(CELLS));
        for (((sums, values), cells), row) in all.zip(rows) {
            let mut sum = 0.0;
            for ((out, value), cell) in sums.iter_mut().zip(values).zip(cells) {
                sum += value + mean * cell.floor;
                *out = sum;
            }
            above += sum;
            *row = above;
        }
    }
}

/// Returns the column or row of a coordinate of Y.
fn cell_of(coordinate: f32) -> usize {
    ((coordinate * CELLS as f32) as usize).min(CELLS - 1)
}

impl Cell {
    fn new(tail: &Tail, index: usize) -> Self {
        let corner = Vec2::new((index % CELLS) as f32, (index / CELLS) as f32);
        let points = |side: usize| -> Box<[(Vec3A, f32)]> {
            let inside = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
            let y: Vec<Vec2> = (0..side * side).map(|k| (corner + inside(k)) / CELLS as f32).collect();
            tail.forward_directions(&y).map(|(_, wi, pdf)| (wi, pdf)).collect()
        };
        let probe = points(3);
        let chord = probe.iter().map(|(w, _)| (*w - probe[4].0).length()).fold(0.0, f32::max);
        let (_, side) = POINTS[POINTS.iter().position(|(most, _)| chord <= *most).unwrap_or(2)];
        let floor = (FLOOR * chord).max(LEAST_FLOOR);
        Self { points: points(side), spacing: 2.0 * chord / side as f32, floor }
    }

    /// Returns the root mean square over the cell's points.
    fn value(&self, targets: &[f32]) -> f32 {
        (targets.iter().map(|target| target * target).sum::<f32>() / targets.len() as f32).sqrt()
    }

    /// The same where BRDF samples contribute.
    fn value_beside_lobes(&self, targets: &[f32], brdf_pdfs: &[f32]) -> f32 {
        let points = self.points.iter().zip(targets).zip(brdf_pdfs);
        let part = |((&(_, emitter), &target), &pdf): ((&(Vec3A, f32), &f32), &f32)| {
            self.weigh(target, pdf / emitter.max(f32::MIN_POSITIVE))
        };
        points.map(part).sum::<f32>().sqrt()
    }

    /// Returns the contribution of a point to the mean square over the cell, by the balance heuristic between
    /// the cell's own points and BRDF samples, whose density over Y there is `density`.
    fn weigh(&self, target: f32, density: f32) -> f32 {
        let samples = (LOBE_POINTS * LOBE_POINTS) as f32 / (CELLS * CELLS) as f32;
        target * target / (self.points.len() as f32 + samples * density)
    }
}

/// Number of values of a table.
const TABLE: usize = CELLS * CELLS + CELLS;

/// Returns the density over Y in a cell of a table.
fn density_of(table: &[f32], column: usize, row: usize) -> f32 {
    let index = row * CELLS + column;
    let before = if column == 0 { 0.0 } else { table[index - 1] };
    (table[index] - before) * (CELLS * CELLS) as f32 / table[TABLE - 1]
}

impl IntermediateDensity for Oracle {
    /// A strip holds the tables of its points one after the other.
    fn columns(&self) -> usize {
        TABLE
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], _arena: &Arena) {
        let tables = state.as_flattened_mut();
        for place in 0..at.len() {
            let (before, own) = tables.split_at_mut(place * TABLE);
            // Copies of a point have copies of its table.
            if place > 0 && at.point(place).is_same(&at.point(place - 1)) {
                own[..TABLE].copy_from_slice(&before[(place - 1) * TABLE..]);
            } else {
                self.fill(&at.point(place).one_of(at.brdfs()), &mut own[..TABLE]);
            }
        }
    }

    fn sample(
        &self,
        at: &Rows<'_>,
        state: &[Lanes],
        z: [&[Lanes]; 2],
        y: [&mut [Lanes]; 2],
        q: &mut [Lanes],
        _: &Arena,
    ) {
        let [z_u, z_v] = z.map(<[Lanes]>::as_flattened);
        let [y_u, y_v] = y.map(<[Lanes]>::as_flattened_mut);
        for place in 0..at.len() {
            let table = &state.as_flattened()[place * TABLE..][..TABLE];
            let (row, down) = invert_running_sums(&table[CELLS * CELLS..], z_v[place]);
            let (column, across) = invert_running_sums(&table[row * CELLS..(row + 1) * CELLS], z_u[place]);
            (y_u[place], y_v[place]) = ((column as f32 + across) / CELLS as f32, (row as f32 + down) / CELLS as f32);
            q.as_flattened_mut()[place] = density_of(table, column, row);
        }
    }

    fn density(&self, at: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], q: &mut [Lanes], _: &Arena) {
        let [y_u, y_v] = y.map(<[Lanes]>::as_flattened);
        for place in 0..at.len() {
            let table = &state.as_flattened()[place * TABLE..][..TABLE];
            q.as_flattened_mut()[place] = density_of(table, cell_of(y_u[place]), cell_of(y_v[place]));
        }
    }
}
