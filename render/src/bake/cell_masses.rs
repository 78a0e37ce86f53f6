//! The cell masses of many tables as 16-bit integers: half the memory of floats, and sums without rounding.
//!
//! What a sample reads decides its time, as a table of the usual size does not fit into the second-level cache: one or two
//! lines of row sums, and one line of each of the four tables around a normal.

use super::cell_grid::CellGrid;
use crate::discrete::remap;

/// Numbers in one cache line.
const LINE: usize = 32;

/// Bytes of a cache line.
const LINE_BYTES: usize = 64;

/// The running sum at the end of a row, and the factor of the row of largest mass.
const WHOLE: u16 = u16::MAX;

/// Row sums that are compared at once, in SIMD lanes.
const LANES: usize = 8;

/// One table among many.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// What a mass of 1 stands for.
    pub scale: f32,
    /// The sum of the factors of all rows.
    pub rows: f32,
}

/// Four tables and what a unit of each one's mass counts for: its weight times its scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blend {
    pub nodes: [usize; 4],
    pub weights: [f32; 4],
}

/// The sum of four tables' numbers, each times its weight. In this order everywhere, so that equal numbers have equal sums.
#[inline(always)]
fn weighted_sum(weights: [f32; 4], numbers: [f32; 4]) -> f32 {
    let near = weights[0] * numbers[0] + weights[1] * numbers[1];
    let far = weights[2] * numbers[2] + weights[3] * numbers[3];
    near + far
}

/// Masses of the cells of many tables over the same grid of cells.
///
/// The mass of a cell is `scale of the table x factor of the row x difference of running sums along the row`. Factors and
/// running sums are integers up to 65535 and no difference is 0, so every cell has a mass and all sums are exact in f32.
#[derive(Clone, Debug)]
pub(super) struct CellMasses {
    cells: CellGrid,
    /// Numbers from one row to the next: a power of two, so that no row of up to 32 columns lies in two lines.
    stride: usize,
    /// Row sums from one table to the next: whole SIMD lanes, padded with sums that no target passes.
    padded_rows: usize,
    nodes: Vec<Node>,
    /// For each table the inclusive running sums of its rows' factors.
    row_sums: Vec<f32>,
    /// For each table and row: the row's factor, then the running sums before each cell but the first, where it is 0, then
    /// padding of 65535.
    numbers: Vec<u16>,
    /// Where the numbers begin: at a cache line.
    start: usize,
}

impl CellMasses {
    /// The tables of `masses` `[tables, rows, columns]`, all positive. A row is rounded up to 1/65535 of the largest row of its
    /// table, a cell to 1/65535 of its row.
    pub fn new(cells: CellGrid, masses: &[f64]) -> Self {
        let (rows, columns) = cells.shape();
        let tables = masses.len() / cells.cells();
        let stride = columns.next_power_of_two();
        let padded_rows = rows.next_multiple_of(LANES);
        // One number more, as the running sum after a cell is read as the one before the next.
        let numbers = vec![WHOLE; tables * rows * stride + 1 + LINE];
        let start = numbers.as_ptr().align_offset(LINE_BYTES).min(LINE);
        let mut new = Self {
            cells,
            stride,
            padded_rows,
            nodes: Vec::with_capacity(tables),
            row_sums: Vec::with_capacity(tables * padded_rows),
            numbers,
            start,
        };
        for masses in masses.chunks_exact(cells.cells()) {
            new.push(masses);
        }
        new
    }

    fn push(&mut self, masses: &[f64]) {
        let (rows, columns) = self.cells.shape();
        let row_mass = |row: &[f64]| row.iter().sum::<f64>();
        let largest = masses.chunks_exact(columns).map(row_mass).fold(0.0, f64::max);
        let mut factors = 0_u32;
        for (row, masses) in masses.chunks_exact(columns).enumerate() {
            let at = self.row_start(self.nodes.len(), row);
            let numbers = &mut self.numbers[at..][..self.stride];
            let whole = row_mass(masses);
            // Up, so that no row counts for less.
            numbers[0] = (whole / largest * f64::from(WHOLE)).ceil().max(1.0) as u16;
            let mut sum = 0;
            for (number, steps) in numbers[1..].iter_mut().zip(steps_of(masses)) {
                sum += steps;
                *number = sum;
            }
            // At most 64 x 65535, which is less than 2^24.
            factors += u32::from(numbers[0]);
            self.row_sums.push(factors as f32);
        }
        self.row_sums.extend(std::iter::repeat_n(f32::INFINITY, self.padded_rows - rows));
        let scale = largest / (f64::from(WHOLE) * f64::from(WHOLE));
        self.nodes.push(Node { scale: scale as f32, rows: factors as f32 });
    }

    /// For each table, row and cell the running mass of the row up to the cell's end and the cell's own mass, and for each table and row the running mass
    /// of the rows. A cell's mass is no difference of its neighbours' running masses here, as those are rounded.
    pub fn running_masses(&self) -> [Vec<f32>; 3] {
        let (rows, columns) = self.cells.shape();
        let [mut along, mut own, mut down] = [const { Vec::new() }; 3];
        for (table, node) in self.nodes.iter().enumerate() {
            for row in 0..rows {
                let numbers = &self.numbers[self.row_start(table, row)..];
                let (factor, mut before) = (node.scale * f32::from(numbers[0]), 0);
                for k in 1..=columns {
                    let sum = if k == columns { WHOLE } else { numbers[k] };
                    along.push(factor * f32::from(sum));
                    own.push(factor * f32::from(sum - before));
                    before = sum;
                }
                down.push(node.scale * Self::ROW * self.row_sums[table * self.padded_rows + row]);
            }
        }
        [along, own, down]
    }

    /// Scale and sum of a table.
    #[inline(always)]
    pub fn node(&self, node: usize) -> Node {
        self.nodes[node]
    }

    /// The mass of all cells of a table in which the rows' factors sum to 1, in units of its scale.
    pub const ROW: f32 = WHOLE as f32;

    #[inline(always)]
    fn row_start(&self, node: usize, row: usize) -> usize {
        self.start + (node * self.cells.shape().0 + row) * self.stride
    }

    /// The row in which the weighted sum of the tables' running sums of factors passes `target`, and the position inside in
    /// `[0, 1)`.
    ///
    /// All sums are compared rather than bisected: no branch to predict, no load that waits for another, and whole SIMD lanes.
    /// Products and sums of rounded numbers never decrease where the numbers do not, so the weighted sums grow along the rows.
    #[inline(always)]
    pub fn search_row(&self, Blend { nodes, weights }: &Blend, target: f32) -> (usize, f32) {
        let [a, b, c, d] = nodes;
        let padded = self.padded_rows;
        let (a, b) = (&self.row_sums[a * padded..][..padded], &self.row_sums[b * padded..][..padded]);
        let (c, d) = (&self.row_sums[c * padded..][..padded], &self.row_sums[d * padded..][..padded]);
        let mut passed = [0_i32; LANES];
        for (((a, b), c), d) in chunks(a).iter().zip(chunks(b)).zip(chunks(c)).zip(chunks(d)) {
            for k in 0..LANES {
                // Padding, infinite or, with a weight of 0, not a number, is not passed.
                passed[k] += i32::from(weighted_sum(*weights, [a[k], b[k], c[k], d[k]]) <= target);
            }
        }
        let mut index = 0;
        for passed in passed {
            index += passed as usize;
        }
        // The total is not passed but by rounding.
        let index = index.min(self.cells.shape().0 - 1);
        let before = index.max(1) - 1;
        let before_sum = weighted_sum(*weights, [a[before], b[before], c[before], d[before]]);
        let sum = weighted_sum(*weights, [a[index], b[index], c[index], d[index]]);
        (index, remap(target, if index == 0 { 0.0 } else { before_sum }, sum))
    }

    /// The column of a row at which the share `z` of the row's mass in all tables is reached, the position inside in `[0, 1)`, and the
    /// mass of the cell as [`Self::mass`] gives it.
    #[inline(always)]
    pub fn search_column(&self, blend: &Blend, row: usize, z: f32) -> (usize, f32, f32) {
        let numbers = self.row(&blend.nodes, row);
        let weights = row_weights(blend, &numbers);
        let whole = weighted_sum(weights, [f32::from(WHOLE); 4]);
        let target = z * whole;
        let passed = if self.stride >= 2 * LANES {
            count_passed::<{ 2 * LANES }>(numbers, weights, target)
        } else if self.stride == LANES {
            count_passed::<LANES>(numbers, weights, target)
        } else {
            count_passed::<1>(numbers, weights, target)
        };
        // The first number of a row is no sum; the padding is the whole, which is not passed but by rounding.
        let first = weighted_sum(weights, numbers_at(&numbers, 0));
        let column = (passed - usize::from(first <= target)).min(self.cells.shape().1 - 1);
        let ends = self.ends(column);
        let (before, after) = ends.of(&numbers);
        let (low, high) = (weighted_sum(weights, before), weighted_sum(weights, after));
        (column, remap(target, low, high), mass_between(weights, before, after))
    }

    /// The mass of a cell in all tables, each times its weight.
    #[inline(always)]
    pub fn mass(&self, blend: &Blend, row: usize, column: usize) -> f32 {
        let numbers = self.row(&blend.nodes, row);
        let (before, after) = self.ends(column).of(&numbers);
        mass_between(row_weights(blend, &numbers), before, after)
    }

    /// The numbers of a row of four tables, and one more.
    #[inline(always)]
    fn row(&self, [a, b, c, d]: &[usize; 4], row: usize) -> [&[u16]; 4] {
        let length = self.stride + 1;
        [
            &self.numbers[self.row_start(*a, row)..][..length],
            &self.numbers[self.row_start(*b, row)..][..length],
            &self.numbers[self.row_start(*c, row)..][..length],
            &self.numbers[self.row_start(*d, row)..][..length],
        ]
    }

    /// What makes the running sum before the first cell of a row 0, and that after the last 65535.
    #[inline(always)]
    fn ends(&self, column: usize) -> Ends {
        let mask = |set: bool| u16::from(set).wrapping_neg();
        Ends { column, without_before: mask(column != 0), last: mask(column + 1 == self.cells.shape().1) }
    }
}

/// The masses of a row in steps of 1/65535 of it.
///
/// All are rounded up, a small one too: where its directions are worth much, a step less would make their weights large. What that is too much is taken
/// from the largest cells, of which one at least has 1024 steps.
fn steps_of(masses: &[f64]) -> Vec<u16> {
    /// Cells of less steps are left alone.
    const LARGE: u16 = 512;
    let unit = f64::from(WHOLE) / masses.iter().sum::<f64>();
    let mut steps: Vec<u16> =
        masses.iter().map(|mass| (mass * unit).ceil().clamp(1.0, f64::from(WHOLE)) as u16).collect();
    let mut largest: Vec<usize> = (0..masses.len()).filter(|&cell| steps[cell] >= LARGE).collect();
    largest.sort_by(|&a, &b| masses[b].total_cmp(&masses[a]));
    // At most one step for each cell, and one for the rounding of the sum.
    let excess = steps.iter().map(|&steps| usize::from(steps)).sum::<usize>().saturating_sub(usize::from(WHOLE));
    for &cell in largest.iter().cycle().take(excess) {
        steps[cell] -= 1;
    }
    steps
}

/// Whole lanes.
#[inline(always)]
fn chunks(sums: &[f32]) -> &[[f32; LANES]] {
    sums.as_chunks().0
}

/// The numbers of four rows at one place. They go through signed integers: there is no SIMD conversion of others.
#[inline(always)]
fn numbers_at([a, b, c, d]: &[&[u16]; 4], at: usize) -> [f32; 4] {
    [i32::from(a[at]) as f32, i32::from(b[at]) as f32, i32::from(c[at]) as f32, i32::from(d[at]) as f32]
}

/// What a unit of the running sums along a row counts for in each table: its weight times the row's factor.
#[inline(always)]
fn row_weights(Blend { weights, .. }: &Blend, numbers: &[&[u16]; 4]) -> [f32; 4] {
    let [a, b, c, d] = numbers_at(numbers, 0);
    [weights[0] * a, weights[1] * b, weights[2] * c, weights[3] * d]
}

/// The differences are those of integers, and exact: a small cell loses nothing beside large ones.
#[inline(always)]
fn mass_between(weights: [f32; 4], before: [f32; 4], after: [f32; 4]) -> f32 {
    let [a, b, c, d] = before;
    weighted_sum(weights, [after[0] - a, after[1] - b, after[2] - c, after[3] - d])
}

/// A column, and masks over the running sums before and after its cell.
struct Ends {
    column: usize,
    without_before: u16,
    last: u16,
}

impl Ends {
    /// The running sums of four rows before and after the cell.
    #[inline(always)]
    fn of(&self, [a, b, c, d]: &[&[u16]; 4]) -> ([f32; 4], [f32; 4]) {
        let (column, mask, last) = (self.column, self.without_before, self.last);
        let before = [a[column] & mask, b[column] & mask, c[column] & mask, d[column] & mask];
        let after = [a[column + 1] | last, b[column + 1] | last, c[column + 1] | last, d[column + 1] | last];
        let [e, f, g, h] = before;
        let [i, j, k, l] = after;
        (
            [f32::from(e), f32::from(f), f32::from(g), f32::from(h)],
            [f32::from(i), f32::from(j), f32::from(k), f32::from(l)],
        )
    }
}

/// How many of the weighted sums of four rows' numbers, but for the very last, are at most `target`; they are a multiple of `N`.
#[inline(always)]
fn count_passed<const N: usize>([a, b, c, d]: [&[u16]; 4], weights: [f32; 4], target: f32) -> usize {
    let length = a.len() - 1;
    let (a, b) = (a[..length].as_chunks::<N>().0, b[..length].as_chunks::<N>().0);
    let (c, d) = (c[..length].as_chunks::<N>().0, d[..length].as_chunks::<N>().0);
    let mut lanes = [0_i32; N];
    for (((a, b), c), d) in a.iter().zip(b).zip(c).zip(d) {
        for k in 0..N {
            let numbers =
                [i32::from(a[k]) as f32, i32::from(b[k]) as f32, i32::from(c[k]) as f32, i32::from(d[k]) as f32];
            lanes[k] += i32::from(weighted_sum(weights, numbers) <= target);
        }
    }
    let mut passed = 0;
    for lane in lanes {
        passed += lane as usize;
    }
    passed
}

#[cfg(test)]
mod tests;
