//! A table of intermediate densities over a grid of normals, interpolated between normals.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{
    normal_grid::{NormalGrid, Stencil},
    prefix::{padded_length, push_running_sums, search_padded},
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
    normals: NormalGrid,
    cells: CellGrid,
    /// Masses, floor not included: `[nodes, rows, columns]`; what a file holds.
    masses: Vec<f32>,
    /// Padded running sums, floor included: for each node those over its rows, then those along each row.
    sums: Vec<f32>,
}

/// The nodes around one normal and the shares of the interpolated table that come from them.
#[derive(Clone, Copy, Debug, Default)]
pub struct PreparedTable {
    /// Where each node's sums start, and its weight.
    offsets: [usize; 4],
    weights: [f32; 4],
    /// Running sums of weight times mass over the four nodes.
    shares: [f32; 4],
}

/// A row of one node's table.
#[derive(Clone, Copy, Debug, Default)]
struct SampledRow {
    /// Where the node's sums start.
    node: usize,
    index: usize,
    /// Position inside, in `[0, 1)`.
    below: f32,
}

/// Samples that go through the stages of a batch together.
const ABREAST: usize = 16;

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
        let mut sums = Vec::with_capacity(normals.nodes() * node_length(cells));
        for node in masses.chunks_exact(cells.cells()) {
            let total = scale * node.iter().map(|&mass| f64::from(mass)).sum::<f64>();
            // A node that sees no light at all still needs a distribution; a tiny one lets its neighbours decide.
            let floor = f64::from(FLOOR) * total.max(1e-6) / cells.cells() as f64;
            let rows = || {
                let row = |row: &'_ [f32]| row.iter().map(|&mass| scale * f64::from(mass) + floor).collect::<Vec<_>>();
                node.chunks_exact(cells.columns).map(row)
            };
            push_running_sums(rows().map(|row| row.iter().sum()), &mut sums);
            for row in rows() {
                push_running_sums(row.into_iter(), &mut sums);
            }
        }
        Ok(Self { normals, cells, masses, sums })
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
        let length = node_length(self.cells);
        let offsets = [nodes[0] * length, nodes[1] * length, nodes[2] * length, nodes[3] * length];
        let last = padded_length(self.cells.rows) - 1;
        let mut shares = [0.0; 4];
        let mut sum = 0.0;
        for k in 0..4 {
            sum += weights[k] * self.sums[offsets[k] + last];
            shares[k] = sum;
        }
        PreparedTable { offsets, weights, shares }
    }

    /// Draws `(y, density over Y)` from a uniform `z`, by inversion of one node's table.
    pub fn sample_at(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        let row = self.sample_row(prepared, z.y);
        let (column, right) = self.sample_column(&row, z.x);
        (self.point(&row, column, right), self.cell_density(prepared, row.index, column))
    }

    /// Picks a node and a row from one uniform number.
    #[inline(always)]
    fn sample_row(&self, prepared: &PreparedTable, z: f32) -> SampledRow {
        let [a, b, c, total] = prepared.shares;
        let target = z * total;
        let k = usize::from(target >= a) + usize::from(target >= b) + usize::from(target >= c);
        let before = [0.0, a, b, c][k];
        // A node of weight 0 has an empty share and is never picked but by rounding, and then its first cell will do.
        let target = (target - before) / prepared.weights[k].max(f32::MIN_POSITIVE);
        let sums = &self.sums[prepared.offsets[k]..][..padded_length(self.cells.rows)];
        let (index, below) = search_padded(sums, self.cells.rows, target);
        SampledRow { node: prepared.offsets[k], index, below }
    }

    /// Picks a column of the row, and the position inside.
    #[inline(always)]
    fn sample_column(&self, row: &SampledRow, z: f32) -> (usize, f32) {
        let length = padded_length(self.cells.columns);
        let sums = &self.sums[row.node + self.row_offset(row.index)..][..length];
        search_padded(sums, self.cells.columns, z * sums[length - 1])
    }

    /// [`Self::sample_stages`] compiled for AVX2: the same operations in the same order, so the same results.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn sample_batch_avx2(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        self.sample_stages(at, z, y, q);
    }

    /// A batch, stage by stage: the loads of a stage depend on the stage before, not on each other.
    #[inline(always)]
    fn sample_stages(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        let chunks = at.chunks(ABREAST).zip(z.chunks(ABREAST));
        for (((at, z), y), q) in chunks.zip(y.chunks_mut(ABREAST)).zip(q.chunks_mut(ABREAST)) {
            let mut positions = [Vec2::ZERO; ABREAST];
            let mut prepared = [PreparedTable::default(); ABREAST];
            let mut rows = [SampledRow::default(); ABREAST];
            let mut columns = [(0, 0.0); ABREAST];
            for (position, at) in positions.iter_mut().zip(at) {
                *position = self.normals.position(at.ns);
            }
            for (prepared, position) in prepared[..at.len()].iter_mut().zip(positions) {
                *prepared = self.prepare_stencil(self.normals.stencil_at(position));
            }
            for ((row, prepared), z) in rows.iter_mut().zip(&prepared).zip(z) {
                *row = self.sample_row(prepared, z.y);
            }
            for ((column, row), z) in columns.iter_mut().zip(&rows).zip(z) {
                *column = self.sample_column(row, z.x);
            }
            for (k, (y, q)) in y.iter_mut().zip(q).enumerate() {
                let (column, right) = columns[k];
                *y = self.point(&rows[k], column, right);
                *q = self.cell_density(&prepared[k], rows[k].index, column);
            }
        }
    }

    #[inline(always)]
    fn point(&self, row: &SampledRow, column: usize, right: f32) -> Vec2 {
        let CellGrid { rows, columns } = self.cells;
        Vec2::new((column as f32 + right) / columns as f32, (row.index as f32 + row.below) / rows as f32)
    }

    /// The density over Y at `y`.
    pub fn density_at(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        let (row, column) = self.cells.cell(y);
        self.cell_density(prepared, row, column)
    }

    /// The interpolated density in a cell. Differences come first, so that nothing of a small cell is lost beside a large sum.
    #[inline(always)]
    fn cell_density(&self, prepared: &PreparedTable, row: usize, column: usize) -> f32 {
        let offset = self.row_offset(row) + column;
        let mass = |k: usize| {
            let at = prepared.offsets[k] + offset;
            self.sums[at] - if column == 0 { 0.0 } else { self.sums[at - 1] }
        };
        let [a, b, c, d] = prepared.weights;
        let blended = (a * mass(0) + b * mass(1)) + (c * mass(2) + d * mass(3));
        blended * self.cells.cells() as f32 / prepared.shares[3]
    }

    /// Where the sums along a row start in a node.
    #[inline(always)]
    fn row_offset(&self, row: usize) -> usize {
        padded_length(self.cells.rows) + row * padded_length(self.cells.columns)
    }
}

/// Floats of one node.
fn node_length(cells: CellGrid) -> usize {
    padded_length(cells.rows) + cells.rows * padded_length(cells.columns)
}

impl IntermediateDensity for BakedTable {
    type Prepared = PreparedTable;

    fn prepare(&self, at: &ShadingPoint) -> PreparedTable {
        self.prepare_normal(at.ns)
    }

    fn sample(&self, prepared: &PreparedTable, z: Vec2) -> (Vec2, f32) {
        self.sample_at(prepared, z)
    }

    fn sample_batch(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the one feature that the function is compiled for, as was just found out.
            unsafe { self.sample_batch_avx2(at, z, y, q) };
            return;
        }
        self.sample_stages(at, z, y, q);
    }

    fn density(&self, prepared: &PreparedTable, y: Vec2) -> f32 {
        self.density_at(prepared, y)
    }
}
