//! A table of intermediate densities, interpolated over a grid of normals.

use crate::parallel::*;
use glam::{Vec2, Vec3A};

use super::{
    cell_grid::CellGrid,
    cell_masses::{Blends, CellMasses},
    normal_grid::NormalGrid,
};
use crate::{
    columns::{Arena, vectorized},
    discrete::BELOW_ONE,
    error::{Error, Result},
    flat::FlatArray,
    memory,
    sampler::IntermediateDensity,
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Fraction of every node's mass that is spread evenly over Y. A cell whose sampled points see no light
/// may still contain a direction that does; without this floor its energy would be lost.
const FLOOR: f32 = 2e-3;

/// Maximum bytes per mass while a table is made: the mass itself, a double with the floor, an integer,
/// and copies for each of the four cells around the node, twice while they are moved into place.
const BYTES_PER_MASS: u64 = 32;

/// Piecewise constant masses over the cells of Y for every normal of a grid.
///
/// Between normals the *masses* are interpolated bilinearly. A sample inverts the interpolated table,
/// whose running sums are the weighted sums of those of the four nodes around the normal: first the
/// rows by `z.y`, then the columns of the row by `z.x`. Each coordinate of y is monotonic in the same
/// coordinate of z, so stratification is preserved. Because `max(0, n . w)` is convex in `n`, the
/// interpolated table of a cosine is nowhere much below the cosine, so weights are bounded.
#[derive(Clone, Debug)]
pub struct BakedTable {
    normals: NormalGrid,
    pub(super) cells: CellGrid,
    /// Masses without the floor, as stored in files: `[nodes, rows, columns]`.
    masses: Vec<f32>,
    /// Masses with the floor, as integers, for draws and pdfs.
    pub(super) quantized: CellMasses,
}

impl BakedTable {
    /// Makes a table of masses `[nodes, rows, columns]`, whose scale is common to all nodes: a node
    /// contributes its weight times its mass to an interpolated table. A node without mass becomes
    /// uniform.
    ///
    /// # Errors
    /// The size does not match, or a mass is negative, above 1e30 or not a number.
    pub fn new(normals: NormalGrid, cells: CellGrid, masses: Vec<f32>) -> Result<Self> {
        if masses.len() != normals.nodes() * cells.cells() {
            let reason = format!("{} values do not fill {normals:?} of {cells:?}", masses.len());
            return Err(Error::argument("table", reason));
        }
        if masses.iter().any(|mass| !(*mass >= 0.0 && *mass <= 1e30)) {
            return Err(Error::argument("table", "holds a mass that is negative, above 1e30 or not a number"));
        }
        let largest = masses
            .chunks_exact(cells.cells())
            .map(|node| node.iter().map(|&mass| f64::from(mass)).sum::<f64>())
            .fold(0.0, f64::max);
        let scale = if largest > 0.0 { 1.0 / largest } else { 1.0 };
        let mut with_floor = Vec::with_capacity(masses.len());
        for node in masses.chunks_exact(cells.cells()) {
            let total = scale * node.iter().map(|&mass| f64::from(mass)).sum::<f64>();
            // A node without light still needs a distribution; its tiny mass lets its neighbours dominate.
            let floor = f64::from(FLOOR) * total.max(1e-6) / cells.cells() as f64;
            with_floor.extend(node.iter().map(|&mass| scale * f64::from(mass) + floor));
        }
        let quantized = CellMasses::new(normals, cells, &with_floor);
        Ok(Self { normals, cells, masses, quantized })
    }

    /// Rejects a table whose construction needs more memory than is available.
    ///
    /// # Errors
    /// As [`memory::require`].
    pub fn require_memory(normals: NormalGrid, cells: CellGrid) -> Result<()> {
        let bytes = BYTES_PER_MASS * (normals.nodes() * cells.cells()) as u64;
        memory::require(bytes, || format!("a table of {} normals, {} cells for each", normals.nodes(), cells.cells()))
    }

    /// Fills a table with `fill(normal, masses of the cells [rows * columns])`, normals in parallel.
    ///
    /// # Errors
    /// See [`Self::new`].
    pub fn fill(normals: NormalGrid, cells: CellGrid, fill: impl Fn(Vec3A, &mut [f32]) + Sync) -> Result<Self> {
        let mut masses = vec![0.0; normals.nodes() * cells.cells()];
        masses.par_chunks_exact_mut(cells.cells()).enumerate().for_each(|(node, out)| fill(normals.normal(node), out));
        Self::new(normals, cells, masses)
    }

    /// The grid of normals.
    pub fn normals(&self) -> NormalGrid {
        self.normals
    }

    /// The grid of cells.
    pub fn cells(&self) -> CellGrid {
        self.cells
    }

    /// The arrays that draws and pdfs read, floor included, for implementations on other devices:
    /// `table.along` `[nodes, rows, columns]`, the running masses of each row up to the ends of its
    /// cells; `table.masses`, of the same shape, the masses of the cells; `table.down` `[nodes, rows]`,
    /// the running masses of the rows; and `table.shape` `[4]`: polar, azimuth, rows, columns.
    pub fn flat(&self) -> Vec<FlatArray> {
        let ((polar, azimuth), (rows, columns)) = (self.normals.shape(), self.cells.shape());
        let [along, own, down] = self.quantized.running_masses();
        let nodes = polar * azimuth;
        vec![
            FlatArray::floats("table.along", vec![nodes, rows, columns], along),
            FlatArray::floats("table.masses", vec![nodes, rows, columns], own),
            FlatArray::floats("table.down", vec![nodes, rows], down),
            FlatArray::integers(
                "table.shape",
                vec![4],
                [polar, azimuth, rows, columns].map(|count| count as u32).to_vec(),
            ),
        ]
    }

    /// The masses `[nodes, rows, columns]` without the floor.
    pub fn masses(&self) -> &[f32] {
        &self.masses
    }

    /// Draws `(y, density over Y)` for each uniform `z`, for one unit normal.
    pub fn sample_at(&self, normal: Vec3A, z: &[Vec2]) -> Vec<(Vec2, f32)> {
        let state = self.state_of(normal);
        let draw = |z: &Vec2| {
            let (mut y, mut q) = ([[[0.0; LANES]]; 2], [[0.0; LANES]]);
            let [u, v] = &mut y;
            sample(self, 1, &state, [&[[z.x; LANES]], &[[z.y; LANES]]], [u, v], &mut q);
            (Vec2::new(y[0][0][0], y[1][0][0]), q[0][0])
        };
        z.iter().map(draw).collect()
    }

    /// Evaluates the densities over Y at points `y`, for one unit normal.
    pub fn density_at(&self, normal: Vec3A, y: &[Vec2]) -> Vec<f32> {
        let state = self.state_of(normal);
        let density = |y: &Vec2| {
            let mut q = [[0.0; LANES]];
            density(self, 1, &state, [&[[y.x; LANES]], &[[y.y; LANES]]], &mut q);
            q[0][0]
        };
        y.iter().map(density).collect()
    }

    fn state_of(&self, normal: Vec3A) -> [Lanes; COLUMNS] {
        let mut state = [[0.0; LANES]; COLUMNS];
        prepare(self, &normal.to_array().map(|number| [number; LANES]), &mut state);
        state
    }
}

/// Columns of a shading point's state: the index (as bits) of its cell of the grid of normals, the
/// weights of the four nodes times their scales, and the sum of weight times mass.
pub(super) const COLUMNS: usize = 6;
pub(super) const CELL: usize = 0;
pub(super) const WEIGHTS: usize = 1;
const TOTAL: usize = 5;

vectorized! {
    /// Fills the state for one strip of normals.
    pub(super) fn prepare['a](_simd, table: &'a BakedTable, normals: &'a [Lanes; 3], state: &'a mut [Lanes]) {
        let grid = &table.normals;
        let (mut azimuths, mut polars) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let position = grid.position([normals[0][k], normals[1][k], normals[2][k]]);
            (azimuths[k], polars[k]) = (position.x, position.y);
        }
        let (mut cells, mut weights) = ([0_u32; LANES], [[0.0; LANES]; 4]);
        for k in 0..LANES {
            let cell = grid.cell(Vec2::new(azimuths[k], polars[k]));
            cells[k] = cell.number;
            for (weights, weight) in weights.iter_mut().zip(cell.weights()) {
                weights[k] = weight;
            }
        }
        let (blends, total) = table.quantized.blends(&cells, &weights);
        for k in 0..LANES {
            state[CELL][k] = f32::from_bits(cells[k]);
        }
        state[WEIGHTS..TOTAL].copy_from_slice(&blends.weights);
        state[TOTAL] = total;
    }
}

/// The blends of `N` samples; those from `count` on are arbitrary.
#[inline(always)]
fn blends_of<const N: usize>(state: &[Lanes], count: usize) -> Blends<N> {
    let (mut cells, mut weights) = ([0; N], [[0.0; N]; 4]);
    for (strip, state) in state.chunks_exact(COLUMNS).enumerate() {
        for k in 0..LANES {
            let at = strip * LANES + k;
            cells[at] = if at < count { state[CELL][k].to_bits() } else { 0 };
            for corner in 0..4 {
                weights[corner][at] = state[WEIGHTS + corner][k];
            }
        }
    }
    Blends { cells, weights }
}

/// `index + position`, kept below `index + 1` even after rounding.
#[inline(always)]
pub(super) fn inside(index: usize, position: f32) -> f32 {
    let (index, end) = (index as i32 as f32, (index + 1) as i32 as f32 * BELOW_ONE);
    if index + position < end { index + position } else { end }
}

/// Converts interpolated masses of cells to densities.
#[inline(always)]
fn densities(table: &BakedTable, masses: &[f32], state: &[Lanes], out: &mut [Lanes]) {
    let unit = table.cells.cells() as f32 / CellMasses::ROW;
    for ((masses, state), out) in masses.as_chunks().0.iter().zip(state.chunks_exact(COLUMNS)).zip(out) {
        let masses: &Lanes = masses;
        for k in 0..LANES {
            out[k] = masses[k] * unit / state[TOTAL][k];
        }
    }
}

/// Draws `N` samples, in whole strips.
#[inline(always)]
fn sample_strips<const N: usize>(
    table: &BakedTable,
    count: usize,
    state: &[Lanes],
    [z_u, z_v]: [&[Lanes]; 2],
    [y_u, y_v]: [&mut [Lanes]; 2],
    q: &mut [Lanes],
) {
    let (rows, columns) = (table.cells.shape().0 as f32, table.cells.shape().1 as f32);
    let (mut across, mut down) = ([0.0; N], [0.0; N]);
    for (strip, state) in state.chunks_exact(COLUMNS).enumerate() {
        for k in 0..LANES {
            across[strip * LANES + k] = z_u[strip][k];
            down[strip * LANES + k] = z_v[strip][k] * state[TOTAL][k];
        }
    }
    let blends = blends_of::<N>(state, count);
    let (row, below) = table.quantized.search_rows(&blends, &down);
    let (column, right, masses) = table.quantized.search_columns(&blends, &row, &across);
    for strip in 0..q.len() {
        for k in 0..LANES {
            let at = strip * LANES + k;
            y_v[strip][k] = inside(row[at] as usize, below[at]) / rows;
            y_u[strip][k] = inside(column[at] as usize, right[at]) / columns;
        }
    }
    densities(table, &masses, state, q);
}

vectorized! {
    /// Draws samples. Lanes from `count` on are not drawn: their state may be arbitrary.
    fn sample['a](
        _simd, table: &'a BakedTable, count: usize, state: &'a [Lanes],
        z: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let [y_u, y_v] = y;
        let pairs = q.chunks_mut(2).zip(y_u.chunks_mut(2)).zip(y_v.chunks_mut(2));
        for (pair, ((q, y_u), y_v)) in pairs.enumerate() {
            let (first, strips) = (2 * pair, q.len());
            let (state, left) = (&state[first * COLUMNS..][..strips * COLUMNS], count - first * LANES);
            let z = [&z[0][first..][..strips], &z[1][first..][..strips]];
            if strips == 2 {
                sample_strips::<{ 2 * LANES }>(table, left, state, z, [y_u, y_v], q);
            } else {
                sample_strips::<LANES>(table, left, state, z, [y_u, y_v], q);
            }
        }
    }
}

vectorized! {
    fn density['a](
        _simd, table: &'a BakedTable, count: usize, state: &'a [Lanes], y: [&'a [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        for strip in 0..q.len() {
            let state = &state[strip * COLUMNS..][..COLUMNS];
            let (mut rows, mut columns) = ([0; LANES], [0; LANES]);
            for k in 0..LANES {
                let (row, column) = table.cells.cell(Vec2::new(y[0][strip][k], y[1][strip][k]));
                (rows[k], columns[k]) = (row as u32, column as u32);
            }
            let masses = table.quantized.masses(&blends_of::<LANES>(state, count - strip * LANES), &rows, &columns);
            densities(table, &masses, state, &mut q[strip..=strip]);
        }
    }
}

impl IntermediateDensity for BakedTable {
    fn columns(&self) -> usize {
        COLUMNS
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], _arena: &Arena) {
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            prepare(self, &at.normals(strip), state);
        }
    }

    fn sample(
        &self,
        at: &Rows<'_>,
        state: &[Lanes],
        z: [&[Lanes]; 2],
        y: [&mut [Lanes]; 2],
        q: &mut [Lanes],
        _arena: &Arena,
    ) {
        sample(self, at.len(), state, z, y, q);
    }

    fn density(&self, at: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], q: &mut [Lanes], _arena: &Arena) {
        density(self, at.len(), state, y, q);
    }
}

#[cfg(test)]
mod tests;
