//! The cell masses of the tables at the nodes of a grid of normals, as 16-bit integers with exact sums.
//!
//! A draw reads the tables of the four nodes around its normal at the same positions. So the numbers of
//! four nodes are stored side by side, for each cell of the grid of normals: a step of a search is one
//! load per sample, and the same few instructions for all samples of a strip. Each step depends on the
//! previous one, so two strips are searched at once to hide latency: `N` is the number of samples.

use super::{cell_grid::CellGrid, normal_grid::NormalGrid};
use crate::{discrete::remap, large::Large, simd::Quads};

/// The running sum at the end of a row, and the factor of the row of largest mass.
const WHOLE: u16 = u16::MAX;

/// The four tables around the normals of `N` samples: the cell of the grid of normals, and for each of
/// its corners the weight times the table's scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blends<const N: usize> {
    pub cells: [u32; N],
    pub weights: [[f32; N]; 4],
}

/// The weighted sum of four tables' numbers. The order of summation is fixed, so that equal numbers
/// have equal sums.
#[inline(always)]
fn weighted_sum(weights: [f32; 4], numbers: [f32; 4]) -> f32 {
    let near = weights[0] * numbers[0] + weights[1] * numbers[1];
    let far = weights[2] * numbers[2] + weights[3] * numbers[3];
    near + far
}

/// [`weighted_sum`] for each sample.
#[inline(always)]
fn weighted_sums<const N: usize>(weights: &[[f32; N]; 4], numbers: &[[f32; N]; 4]) -> [f32; N] {
    let mut sums = [0.0; N];
    for k in 0..N {
        sums[k] = weighted_sum(lane(weights, k), lane(numbers, k));
    }
    sums
}

/// The four numbers of a sample.
#[inline(always)]
fn lane<const N: usize>(columns: &[[f32; N]; 4], k: usize) -> [f32; 4] {
    [columns[0][k], columns[1][k], columns[2][k], columns[3][k]]
}

/// Masses of the cells of many tables over the same grid of cells.
///
/// The mass of a cell is
/// `scale of the table x factor of the row x difference of running sums along the row`. Factors and
/// running sums are integers up to 65535 and no difference is 0, so every cell has a mass and all sums
/// are exact in f32.
#[derive(Clone, Debug)]
pub(super) struct CellMasses {
    normals: NormalGrid,
    cells: CellGrid,
    /// The value of one unit of mass: `[cells of normals, corners]`.
    scales: Vec<[f32; 4]>,
    /// The inclusive running sums of the rows' factors: `[cells of normals, rows, corners]`.
    row_sums: Large<[f32; 4]>,
    /// For each row its factor, then the running sums up to the end of each cell, of which the last is 65535:
    /// `[cells of normals, rows, columns + 1, corners]`.
    numbers: Large<[u16; 4]>,
}

/// One table.
struct Quantized {
    scale: f32,
    row_sums: Vec<f32>,
    /// `[rows, columns + 1]`.
    numbers: Vec<u16>,
}

impl Quantized {
    /// Rounds rows up to 1/65535 of the largest row, and cells to 1/65535 of their row.
    fn new(columns: usize, masses: &[f64]) -> Self {
        let row_mass = |row: &[f64]| row.iter().sum::<f64>();
        let largest = masses.chunks_exact(columns).map(row_mass).fold(0.0, f64::max);
        let (mut factors, mut row_sums, mut numbers) = (0_u32, Vec::new(), Vec::new());
        for masses in masses.chunks_exact(columns) {
            // Rounded up, so that no row loses mass.
            let factor = (row_mass(masses) / largest * f64::from(WHOLE)).ceil().max(1.0) as u16;
            numbers.push(factor);
            let mut sum = 0;
            for steps in &steps_of(masses)[..columns - 1] {
                sum += steps;
                numbers.push(sum);
            }
            numbers.push(WHOLE);
            // At most 64 x 65535, which is less than 2^24.
            factors += u32::from(factor);
            row_sums.push(factors as f32);
        }
        Self { scale: (largest / (f64::from(WHOLE) * f64::from(WHOLE))) as f32, row_sums, numbers }
    }
}

impl CellMasses {
    /// Makes tables from `masses` `[nodes of normals, rows, columns]`, all positive.
    pub fn new(normals: NormalGrid, cells: CellGrid, masses: &[f64]) -> Self {
        let nodes = masses.chunks_exact(cells.cells()).map(|masses| Quantized::new(cells.shape().1, masses));
        let nodes: Vec<Quantized> = nodes.collect();
        let (mut scales, mut row_sums, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        for cell in 0..normals.cells() {
            let corners = normals.corners(cell).map(|node| &nodes[node]);
            scales.push(corners.map(|node| node.scale));
            row_sums.extend((0..corners[0].row_sums.len()).map(|row| corners.map(|node| node.row_sums[row])));
            numbers.extend((0..corners[0].numbers.len()).map(|k| corners.map(|node| node.numbers[k])));
        }
        Self { normals, cells, scales, row_sums: row_sums.into(), numbers: numbers.into() }
    }

    /// For each table, row and cell the running mass of the row up to the cell's end, and the cell's
    /// own mass; for each table and row the running mass of the rows. Cell masses are not differences
    /// of running masses, as those are rounded.
    pub fn running_masses(&self) -> [Vec<f32>; 3] {
        let (rows, columns) = self.cells.shape();
        let [mut along, mut own, mut down] = [const { Vec::new() }; 3];
        for node in 0..self.normals.nodes() {
            let (cell, corner) = self.normals.cell_of(node);
            let scale = self.scales[cell][corner];
            for row in 0..rows {
                let numbers = &self.numbers[self.row_start(cell, row)..][..=columns];
                let (factor, mut before) = (scale * f32::from(numbers[0][corner]), 0);
                for sum in &numbers[1..] {
                    along.push(factor * f32::from(sum[corner]));
                    own.push(factor * f32::from(sum[corner] - before));
                    before = sum[corner];
                }
                down.push(scale * Self::ROW * self.row_sums[cell * rows + row][corner]);
            }
        }
        [along, own, down]
    }

    /// Returns the weights times scales of the four tables around each normal, and the weighted sum of
    /// their total row factors.
    #[inline(always)]
    pub fn blends<const N: usize>(&self, cells: &[u32; N], weights: &[[f32; N]; 4]) -> (Blends<N>, [f32; N]) {
        let (rows, scales) = (self.cells.shape().0 as u32, self.scales.load(cells));
        let (mut last, mut scaled, mut total) = ([0; N], [[0.0; N]; 4], [0.0; N]);
        for k in 0..N {
            last[k] = cells[k] * rows + rows - 1;
        }
        let factors = self.row_sums.load(&last);
        for corner in 0..4 {
            for k in 0..N {
                let weight = weights[corner][k] * scales[corner][k];
                total[k] += weight * factors[corner][k];
                scaled[corner][k] = weight;
            }
        }
        (Blends { cells: *cells, weights: scaled }, total)
    }

    /// The mass of a row of factor 1, in units of the table's scale.
    pub const ROW: f32 = WHOLE as f32;

    #[inline(always)]
    fn row_start(&self, cell: usize, row: usize) -> usize {
        let (rows, columns) = self.cells.shape();
        (cell * rows + row) * (columns + 1)
    }

    /// Finds for each sample the row in which the weighted running sum of factors passes `target`, and
    /// the position inside in `[0, 1)`.
    #[inline(always)]
    pub fn search_rows<const N: usize>(&self, at: &Blends<N>, target: &[f32; N]) -> ([u32; N], [f32; N]) {
        let rows = self.cells.shape().0 as u32;
        let mut first = [0; N];
        for k in 0..N {
            first[k] = at.cells[k] * rows;
        }
        let found = Found::new(&*self.row_sums, first, rows, &at.weights, target);
        (found.index, found.inside(target))
    }

    /// Finds for each sample the column at which the weighted running mass of a row passes `z` times
    /// the row's mass, the position inside in `[0, 1)`, and the weighted mass of the cell.
    #[inline(always)]
    pub fn search_columns<const N: usize>(
        &self,
        at: &Blends<N>,
        rows: &[u32; N],
        z: &[f32; N],
    ) -> ([u32; N], [f32; N], [f32; N]) {
        let (starts, weights) = self.rows(at, rows);
        let (mut first, mut target) = ([0; N], [0.0; N]);
        for k in 0..N {
            first[k] = starts[k] + 1;
            target[k] = z[k] * weighted_sum(lane(&weights, k), [Self::ROW; 4]);
        }
        let found = Found::new(&*self.numbers, first, self.cells.shape().1 as u32, &weights, &target);
        let masses = self.between(&starts, &found.index, &weights, &found.numbers);
        (found.index, found.inside(&target), masses)
    }

    /// The weighted mass of a cell for each sample.
    #[inline(always)]
    pub fn masses<const N: usize>(&self, at: &Blends<N>, rows: &[u32; N], columns: &[u32; N]) -> [f32; N] {
        let (starts, weights) = self.rows(at, rows);
        let mut ends = [0; N];
        for k in 0..N {
            ends[k] = starts[k] + columns[k] + 1;
        }
        self.between(&starts, columns, &weights, &self.numbers.load(&ends))
    }

    /// The start of each row, and for each table the weight times the row's factor.
    #[inline(always)]
    fn rows<const N: usize>(&self, at: &Blends<N>, rows: &[u32; N]) -> ([u32; N], [[f32; N]; 4]) {
        let (count, stride) = (self.cells.shape().0 as u32, self.cells.shape().1 as u32 + 1);
        let mut starts = [0; N];
        for k in 0..N {
            starts[k] = (at.cells[k] * count + rows[k]) * stride;
        }
        let mut weights = self.numbers.load(&starts);
        for (own, all) in weights.iter_mut().zip(&at.weights) {
            for k in 0..N {
                own[k] *= all[k];
            }
        }
        (starts, weights)
    }

    /// The masses of the cells whose running sums end at `after`.
    #[inline(always)]
    fn between<const N: usize>(
        &self,
        starts: &[u32; N],
        columns: &[u32; N],
        weights: &[[f32; N]; 4],
        after: &[[f32; N]; 4],
    ) -> [f32; N] {
        let (mut place, mut masses) = ([0; N], [0.0; N]);
        for k in 0..N {
            place[k] = starts[k] + columns[k];
        }
        let mut before = self.numbers.load(&place);
        for before in &mut before {
            for k in 0..N {
                // The first number of a row is its factor, not a sum.
                before[k] = if columns[k] == 0 { 0.0 } else { before[k] };
            }
        }
        for k in 0..N {
            masses[k] = mass_between(lane(weights, k), lane(&before, k), lane(after, k));
        }
        masses
    }
}

/// The result of a bisection of running sums, for each sample.
struct Found<const N: usize> {
    /// Index of the first sum above the target, or of the last sum if there is none.
    index: [u32; N],
    /// The previous sum, and the sum itself.
    before: [f32; N],
    sum: [f32; N],
    /// The terms of the weighted sum.
    numbers: [[f32; N]; 4],
}

impl<const N: usize> Found<N> {
    /// Searches the `count` weighted sums from `first` on. Rounded products and sums are monotonic, so
    /// the weighted sums do not decrease.
    #[inline(always)]
    fn new<Q: Quads + ?Sized>(
        quads: &Q,
        first: [u32; N],
        count: u32,
        weights: &[[f32; N]; 4],
        target: &[f32; N],
    ) -> Self {
        let (mut place, mut before, mut size) = (first, [0.0; N], count);
        while size > 1 {
            let half = size / 2;
            let mut middle = place;
            for middle in &mut middle {
                *middle += half - 1;
            }
            let sums = weighted_sums(weights, &quads.load(&middle));
            for k in 0..N {
                let passed = sums[k] <= target[k];
                place[k] += if passed { half } else { 0 };
                before[k] = if passed { sums[k] } else { before[k] };
            }
            size -= half;
        }
        let numbers = quads.load(&place);
        let sum = weighted_sums(weights, &numbers);
        for k in 0..N {
            place[k] -= first[k];
        }
        Self { index: place, before, sum, numbers }
    }

    /// The position of the target between both sums, in `[0, 1)`.
    #[inline(always)]
    fn inside(&self, target: &[f32; N]) -> [f32; N] {
        let mut inside = [0.0; N];
        for k in 0..N {
            inside[k] = remap(target[k], self.before[k], self.sum[k]);
        }
        inside
    }
}

/// The masses of a row in steps of 1/65535 of it.
///
/// All are rounded up, also small ones: if directions in a small cell have large values, losing a step
/// would make their weights large. The excess is subtracted from the largest cells, of which at least
/// one has 1024 steps.
fn steps_of(masses: &[f64]) -> Vec<u16> {
    /// Cells of fewer steps keep all of them.
    const LARGE: u16 = 512;
    let unit = f64::from(WHOLE) / masses.iter().sum::<f64>();
    let mut steps: Vec<u16> =
        masses.iter().map(|mass| (mass * unit).ceil().clamp(1.0, f64::from(WHOLE)) as u16).collect();
    let mut largest: Vec<usize> = (0..masses.len()).filter(|&cell| steps[cell] >= LARGE).collect();
    largest.sort_by(|&a, &b| masses[b].total_cmp(&masses[a]));
    // At most one step per cell, and one for the rounding of the sum.
    let excess = steps.iter().map(|&steps| usize::from(steps)).sum::<usize>().saturating_sub(usize::from(WHOLE));
    for &cell in largest.iter().cycle().take(excess) {
        steps[cell] -= 1;
    }
    steps
}

/// The weighted mass of a cell. The differences are of integers and exact, so small cells next to large
/// ones lose no precision.
#[inline(always)]
fn mass_between(weights: [f32; 4], before: [f32; 4], after: [f32; 4]) -> f32 {
    let [a, b, c, d] = before;
    weighted_sum(weights, [after[0] - a, after[1] - b, after[2] - c, after[3] - d])
}

#[cfg(test)]
mod tests;
