//! A table of intermediate densities over a grid of normals, interpolated between normals.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{
    normal_grid::{NormalGrid, Stencil},
    prefix::BlendedSums,
};
use crate::{
    error::{Error, Result},
    sampler::{IntermediateDensity, ShadingPoint},
};

/// Most cells along one side of Y.
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
/// Between normals the *masses* are interpolated bilinearly, and both drawing and pdf use the interpolated table: the pdf is
/// that of the whole mixture, not of the one table drawn from. Because `max(0, n . w)` is convex in `n`, the interpolated
/// table of a cosine is nowhere much below the cosine, so weights stay bounded.
#[derive(Clone, Debug)]
pub struct BakedTable {
    normals: NormalGrid,
    cells: CellGrid,
    /// Masses, floor not included: `[nodes, rows, columns]`; what a file holds.
    masses: Vec<f32>,
    /// Inclusive running sums along each row, floor included, `[nodes, rows, columns]`.
    along: Vec<f32>,
    /// Inclusive running sums over the rows of a node, `[nodes, rows]`.
    down: Vec<f32>,
}

/// The nodes around one normal and the interpolated mass of the whole table there.
#[derive(Clone, Copy, Debug)]
pub struct PreparedTable {
    stencil: Stencil,
    total: f32,
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
        let (mut along, mut down) =
            (Vec::with_capacity(masses.len()), Vec::with_capacity(normals.nodes() * cells.rows));
        for node in masses.chunks_exact(cells.cells()) {
            let sum = scale * node.iter().map(|&mass| f64::from(mass)).sum::<f64>();
            // A node that sees no light at all still needs a distribution; a tiny one lets its neighbours decide.
            let floor = f64::from(FLOOR) * sum.max(1e-6) / cells.cells() as f64;
            let mut above = 0.0;
            for row in node.chunks_exact(cells.columns) {
                let mut before = 0.0;
                for &mass in row {
                    before += scale * f64::from(mass) + floor;
                    along.push(before as f32);
                }
                above += before;
                down.push(above as f32);
            }
        }
        Ok(Self { normals, cells, masses, along, down })
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
    pub fn prepare_normal(&self, normal: Vec3A) -> PreparedTable {
        let stencil = self.normals.stencil(normal);
        let lines = self.lines(&stencil, &self.down, self.cells.rows, 0, self.cells.rows);
        PreparedTable { stencil, total: lines.at(self.cells.rows - 1) }
    }

    /// Draws `(y, density over Y)` from a uniform `z`, by inversion of the interpolated table.
    pub fn sample_at(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        let CellGrid { rows, columns } = self.cells;
        let (row, below) = self.lines(&prepared.stencil, &self.down, rows, 0, rows).search(z.y);
        let (column, right) = self.row(prepared, row).search(z.x);
        let y = Vec2::new((column as f32 + right) / columns as f32, (row as f32 + below) / rows as f32);
        (y, self.cell_density(prepared, row, column))
    }

    /// The density over Y at `y`.
    pub fn density_at(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        let (row, column) = self.cells.cell(y);
        self.cell_density(prepared, row, column)
    }

    fn cell_density(&self, prepared: &PreparedTable, row: usize, column: usize) -> f32 {
        self.row(prepared, row).mass(column) * self.cells.cells() as f32 / prepared.total
    }

    /// The running sums along a row at the nodes around a normal.
    #[inline]
    fn row(&self, prepared: &PreparedTable, row: usize) -> BlendedSums<'_> {
        let columns = self.cells.columns;
        self.lines(&prepared.stencil, &self.along, self.cells.cells(), row * columns, columns)
    }

    /// `length` running sums at `offset` of every node's `stride`.
    #[inline]
    fn lines<'a>(
        &self,
        stencil: &Stencil,
        sums: &'a [f32],
        stride: usize,
        offset: usize,
        length: usize,
    ) -> BlendedSums<'a> {
        BlendedSums {
            lines: stencil.nodes.map(|node| &sums[node * stride + offset..][..length]),
            weights: stencil.weights,
        }
    }
}

impl IntermediateDensity for BakedTable {
    type Prepared = PreparedTable;

    fn prepare(&self, at: &ShadingPoint) -> PreparedTable {
        self.prepare_normal(at.ns)
    }

    fn sample(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        self.sample_at(prepared, z)
    }

    fn density(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        self.density_at(prepared, y)
    }
}
