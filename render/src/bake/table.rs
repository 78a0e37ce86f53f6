//! A table of intermediate densities over a grid of normals, interpolated between normals.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{
    cell_grid::CellGrid,
    cell_masses::{CellMasses, FoundRow, Node},
    normal_grid::NormalGrid,
};
use crate::{
    columns::{Arena, vectorized},
    error::{Error, Result},
    sampler::IntermediateDensity,
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Share of every node's mass that is spread evenly over Y. A cell whose sampled points see no light may still hold a
/// direction that does; without this floor its energy would be lost.
const FLOOR: f32 = 2e-3;

/// Piecewise constant masses over the cells of Y for every normal of a grid.
///
/// Between normals the *masses* are interpolated bilinearly. A sample picks one of the four nodes around its normal in
/// proportion to weight times mass and inverts that node's table, which draws from the interpolated table; the pdf is that of
/// the interpolated table, not of the one table drawn from. Because `max(0, n . w)` is convex in `n`, the interpolated table of a
/// cosine is nowhere much below the cosine, so weights stay bounded.
#[derive(Clone, Debug)]
pub struct BakedTable {
    normals: NormalGrid,
    cells: CellGrid,
    /// Masses, floor not included: `[nodes, rows, columns]`; what a file holds.
    masses: Vec<f32>,
    /// The same, floor included, as integers; what is drawn from and what the pdf is made of.
    quantized: CellMasses,
}

impl BakedTable {
    /// Makes a table of masses `[nodes, rows, columns]`, which are relative to each other across nodes too: a node's share in
    /// an interpolated table is its weight times its mass.
    ///
    /// # Errors
    /// The size does not fit, or a mass is negative or not finite. A node without any mass becomes uniform.
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
            // A node that sees no light at all still needs a distribution; a tiny one lets its neighbours decide.
            let floor = f64::from(FLOOR) * total.max(1e-6) / cells.cells() as f64;
            with_floor.extend(node.iter().map(|&mass| scale * f64::from(mass) + floor));
        }
        let quantized = CellMasses::new(cells, &with_floor);
        Ok(Self { normals, cells, masses, quantized })
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

    /// The masses `[nodes, rows, columns]` without the floor.
    pub fn masses(&self) -> &[f32] {
        &self.masses
    }

    /// Draws `(y, density over Y)` for each uniform `z`, at one unit normal.
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

    /// The densities over Y at points `y`, at one unit normal.
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

/// State of a shading point: the numbers of the four nodes around its normal (as bits), their weights times their scales, and the
/// running sums of weight times mass.
const COLUMNS: usize = 12;
const NODES: usize = 0;
const WEIGHTS: usize = 4;
const SUMS: usize = 8;

vectorized! {
    /// One strip of normals.
    fn prepare['a](_simd, table: &'a BakedTable, normals: &'a [Lanes; 3], state: &'a mut [Lanes]) {
        let grid = &table.normals;
        let (mut azimuths, mut polars) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let position = grid.position([normals[0][k], normals[1][k], normals[2][k]]);
            (azimuths[k], polars[k]) = (position.x, position.y);
        }
        let (mut corners, mut next, mut weights) = ([0_u32; LANES], [0_u32; LANES], [[0.0; LANES]; 4]);
        for k in 0..LANES {
            let cell = grid.cell(Vec2::new(azimuths[k], polars[k]));
            (corners[k], next[k]) = (cell.corner, cell.next);
            for (weights, weight) in weights.iter_mut().zip(cell.weights()) {
                weights[k] = weight;
            }
        }
        // Loads for all lanes and nodes before the arithmetic.
        let (mut scales, mut masses) = ([[0.0; LANES]; 4], [[0.0; LANES]; 4]);
        for k in 0..LANES {
            for (corner, node) in grid.nodes_of(corners[k], next[k]).into_iter().enumerate() {
                let Node { scale, rows } = table.quantized.node(node);
                (scales[corner][k], masses[corner][k]) = (scale, rows);
                state[NODES + corner][k] = f32::from_bits(node as u32);
            }
        }
        let mut sum = [0.0; LANES];
        for corner in 0..4 {
            for k in 0..LANES {
                let weight = weights[corner][k] * scales[corner][k];
                sum[k] += weight * masses[corner][k];
                state[WEIGHTS + corner][k] = weight;
            }
            state[SUMS + corner] = sum;
        }
    }
}

/// The nodes of one lane.
#[inline(always)]
fn nodes_of(state: &[Lanes], lane: usize) -> [usize; 4] {
    let mut nodes = [0; 4];
    for (corner, node) in nodes.iter_mut().enumerate() {
        *node = state[NODES + corner][lane].to_bits() as usize;
    }
    nodes
}

/// Which of the four nodes each lane draws from, and what is left of its uniform number for the node's rows.
#[inline(always)]
fn pick_nodes(z: &Lanes, state: &[Lanes]) -> ([u32; LANES], Lanes) {
    let (mut picked, mut targets) = ([0; LANES], [0.0; LANES]);
    for k in 0..LANES {
        let target = z[k] * state[SUMS + 3][k];
        let (mut before, mut weight, mut index) = (0.0, state[WEIGHTS][k], 0);
        for corner in 0..3 {
            let passed = target >= state[SUMS + corner][k];
            before = if passed { state[SUMS + corner][k] } else { before };
            weight = if passed { state[WEIGHTS + corner + 1][k] } else { weight };
            index = if passed { corner as u32 + 1 } else { index };
        }
        // A node of weight 0 has an empty share and is never picked but by rounding, and then its first cell will do.
        targets[k] = (target - before) / if weight > f32::MIN_POSITIVE { weight } else { f32::MIN_POSITIVE };
        picked[k] = index;
    }
    (picked, targets)
}

/// The interpolated densities from the masses of one cell in the four nodes.
#[inline(always)]
fn blend(table: &BakedTable, masses: &[Lanes; 4], state: &[Lanes]) -> Lanes {
    let unit = table.cells.cells() as f32 / CellMasses::ROW;
    let mut out = [0.0; LANES];
    for k in 0..LANES {
        let near = state[WEIGHTS][k] * masses[0][k] + state[WEIGHTS + 1][k] * masses[1][k];
        let far = state[WEIGHTS + 2][k] * masses[2][k] + state[WEIGHTS + 3][k] * masses[3][k];
        out[k] = (near + far) * unit / state[SUMS + 3][k];
    }
    out
}

vectorized! {
    /// Each stage is done for a strip before the next one: loads do not wait for each other. Lanes from `count` on are not drawn for: their state
    /// may be anything.
    fn sample['a](
        _simd, table: &'a BakedTable, count: usize, state: &'a [Lanes],
        z: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let (rows, columns) = (table.cells.shape().0 as f32, table.cells.shape().1 as f32);
        let [y_u, y_v] = y;
        for strip in 0..q.len() {
            let state = &state[strip * COLUMNS..][..COLUMNS];
            let lanes = LANES.min(count - strip * LANES);
            let (picked, targets) = pick_nodes(&z[1][strip], state);
            let (mut found, mut masses) = ([FoundRow::default(); LANES], [[0.0; LANES]; 4]);
            for k in 0..lanes {
                found[k] = table.quantized.search_row(nodes_of(state, k)[picked[k] as usize & 3], targets[k]);
            }
            for k in 0..lanes {
                let row = found[k];
                let (column, right) = table.quantized.search_column(row, z[0][strip][k]);
                y_u[strip][k] = (column as f32 + right) / columns;
                y_v[strip][k] = (row.index as f32 + row.below) / rows;
                let cell = table.quantized.masses(nodes_of(state, k), row.index, column);
                for (masses, mass) in masses.iter_mut().zip(cell) {
                    masses[k] = mass;
                }
            }
            q[strip] = blend(table, &masses, state);
        }
    }
}

vectorized! {
    fn density['a](
        _simd, table: &'a BakedTable, count: usize, state: &'a [Lanes], y: [&'a [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        for strip in 0..q.len() {
            let state = &state[strip * COLUMNS..][..COLUMNS];
            let mut masses = [[0.0; LANES]; 4];
            for k in 0..LANES.min(count - strip * LANES) {
                let (row, column) = table.cells.cell(Vec2::new(y[0][strip][k], y[1][strip][k]));
                let cell = table.quantized.masses(nodes_of(state, k), row, column);
                for (masses, mass) in masses.iter_mut().zip(cell) {
                    masses[k] = mass;
                }
            }
            q[strip] = blend(table, &masses, state);
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
