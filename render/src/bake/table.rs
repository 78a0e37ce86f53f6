//! A table of intermediate densities over a grid of normals, interpolated between normals.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{
    cell_masses::{CellMasses, FoundRow, Node},
    normal_grid::{NormalGrid, Stencil},
};
use crate::{
    error::{Error, Result},
    sampler::{IntermediateDensity, ShadingPoint},
};

/// Most cells along one side of Y: the sums along a row are compared all at once.
const MOST_CELLS: usize = 64;

/// Share of every node's mass that is spread evenly over Y. A cell whose sampled points see no light may still hold a
/// direction that does; without this floor its energy would be lost.
const FLOOR: f32 = 2e-3;

/// The cells of the intermediate square: `rows` along elevation, `columns` around the circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellGrid {
    rows: usize,
    columns: usize,
}

impl CellGrid {
    /// A grid of `rows x columns` cells.
    ///
    /// # Errors
    /// Both must be 1 to 64.
    pub fn new(rows: usize, columns: usize) -> Result<Self> {
        if !(1..=MOST_CELLS).contains(&rows) || !(1..=MOST_CELLS).contains(&columns) {
            return Err(Error::argument("cells", format!("{rows}x{columns}: choose from 1x1 up to 64x64")));
        }
        Ok(Self { rows, columns })
    }

    /// Rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.rows * self.columns
    }

    /// Row and column of a point of Y.
    pub fn cell(&self, y: Vec2) -> (usize, usize) {
        let row = ((y.y * self.rows as f32) as usize).min(self.rows - 1);
        let column = ((y.x * self.columns as f32) as usize).min(self.columns - 1);
        (row, column)
    }
}

/// Piecewise constant masses over the cells of Y for every normal of a grid.
///
/// Between normals the *masses* are interpolated bilinearly. A sample picks one of the four nodes around its normal in
/// proportion to weight times mass and inverts that node's table, which draws from the interpolated table; the pdf is that of
/// the interpolated table, not of the one table drawn from. Because `max(0, n . w)` is convex in `n`, the interpolated table of a
/// cosine is nowhere much below the cosine, so weights stay bounded.
#[derive(Clone, Debug)]
pub struct BakedTable {
    pub(super) normals: NormalGrid,
    pub(super) cells: CellGrid,
    /// Masses, floor not included: `[nodes, rows, columns]`; what a file holds.
    masses: Vec<f32>,
    /// The same, floor included, as integers; what is drawn from and what the pdf is made of.
    pub(super) quantized: CellMasses,
}

/// The nodes around one normal and the shares of the interpolated table that come from them.
#[derive(Clone, Copy, Debug, Default)]
pub struct PreparedTable {
    nodes: [usize; 4],
    /// Each node's weight times the scale of its masses.
    weights: [f32; 4],
    /// Running sums of weight times mass over the four nodes, in units of [`CellMasses::ROW`].
    shares: [f32; 4],
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

    /// Finds the nodes around a unit normal.
    #[inline(always)]
    pub fn prepare_normal(&self, normal: Vec3A) -> PreparedTable {
        self.prepare_stencil(self.normals.stencil(normal))
    }

    #[inline(always)]
    fn prepare_stencil(&self, Stencil { nodes, weights }: Stencil) -> PreparedTable {
        let (mut scaled, mut shares) = ([0.0; 4], [0.0; 4]);
        let mut sum = 0.0;
        for k in 0..4 {
            let Node { scale, rows } = self.quantized.node(nodes[k]);
            scaled[k] = weights[k] * scale;
            sum += scaled[k] * rows;
            shares[k] = sum;
        }
        PreparedTable { nodes, weights: scaled, shares }
    }

    /// Draws `(y, density over Y)` from a uniform `z`, by inversion of one node's table.
    #[inline]
    pub fn sample_at(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        let row = self.sample_row(prepared, z.y);
        let (column, right) = self.quantized.search_column(row, z.x);
        (self.point(&row, column, right), self.cell_density(prepared, row.index, column))
    }

    /// Picks a node and a row from one uniform number.
    #[inline(always)]
    fn sample_row(&self, prepared: &PreparedTable, z: f32) -> FoundRow {
        let [a, b, c, total] = prepared.shares;
        let target = z * total;
        let k = usize::from(target >= a) + usize::from(target >= b) + usize::from(target >= c);
        let before = [0.0, a, b, c][k];
        // A node of weight 0 has an empty share and is never picked but by rounding, and then its first cell will do.
        let target = (target - before) / prepared.weights[k].max(f32::MIN_POSITIVE);
        self.quantized.search_row(prepared.nodes[k], target)
    }

    #[inline(always)]
    fn point(&self, row: &FoundRow, column: usize, right: f32) -> Vec2 {
        let CellGrid { rows, columns } = self.cells;
        Vec2::new((column as f32 + right) / columns as f32, (row.index as f32 + row.below) / rows as f32)
    }

    /// The density over Y at `y`.
    pub fn density_at(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        let (row, column) = self.cells.cell(y);
        self.cell_density(prepared, row, column)
    }

    /// The interpolated density in a cell.
    #[inline(always)]
    fn cell_density(&self, prepared: &PreparedTable, row: usize, column: usize) -> f32 {
        let mass = self.quantized.masses(prepared.nodes, row, column);
        let [a, b, c, d] = prepared.weights;
        let blended = (a * mass[0] + b * mass[1]) + (c * mass[2] + d * mass[3]);
        blended * (self.cells.cells() as f32 / CellMasses::ROW) / prepared.shares[3]
    }
}

impl IntermediateDensity for BakedTable {
    type Prepared = PreparedTable;

    #[inline]
    fn prepare(&self, at: &ShadingPoint) -> PreparedTable {
        self.prepare_normal(at.ns)
    }

    fn share_batch(&self, _at: &[ShadingPoint], shares: &mut [f32]) {
        shares.fill(0.5);
    }

    #[inline]
    fn sample(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        self.sample_at(prepared, z)
    }

    fn sample_batch(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        self.sample_abreast(at, z, y, q);
    }

    fn density(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        self.density_at(prepared, y)
    }
}
