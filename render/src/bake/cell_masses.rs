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

/// A row in which a target was found.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FoundRow {
    pub node: usize,
    pub index: usize,
    /// Position inside, in `[0, 1)`.
    pub below: f32,
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
    /// The tables of `masses` `[tables, rows, columns]`, all positive. A row is rounded to 1/65535 of the largest row of its
    /// table, a cell to 1/65535 of its row, and neither to nothing.
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
            numbers[0] = (whole / largest * f64::from(WHOLE)).round().max(1.0) as u16;
            let (mut exact, mut before) = (0.0, 0);
            for (column, mass) in masses[..columns - 1].iter().enumerate() {
                exact += mass / whole * f64::from(WHOLE);
                // Each of the cells to come needs a step too.
                let sum = (exact.round() as u16).clamp(before + 1, WHOLE - (columns - 1 - column) as u16);
                numbers[column + 1] = sum;
                before = sum;
            }
            // At most 64 x 65535, which is less than 2^24.
            factors += u32::from(numbers[0]);
            self.row_sums.push(factors as f32);
        }
        self.row_sums.extend(std::iter::repeat_n(f32::INFINITY, self.padded_rows - rows));
        let scale = largest / (f64::from(WHOLE) * f64::from(WHOLE));
        self.nodes.push(Node { scale: scale as f32, rows: factors as f32 });
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

    /// The row in which the running sum of a table's factors passes `target`.
    ///
    /// All sums are compared rather than bisected: no branch to predict, no load that waits for another, and whole SIMD lanes.
    #[inline(always)]
    pub fn search_row(&self, node: usize, target: f32) -> FoundRow {
        let sums = &self.row_sums[node * self.padded_rows..][..self.padded_rows];
        let mut passed = [0_u32; LANES];
        let (chunks, _) = sums.as_chunks::<LANES>();
        for chunk in chunks {
            for (passed, &sum) in passed.iter_mut().zip(chunk) {
                *passed += u32::from(sum <= target);
            }
        }
        // The total is not passed but by rounding.
        let mut index = 0;
        for passed in passed {
            index += passed as usize;
        }
        let index = index.min(self.cells.shape().0 - 1);
        let before = if index == 0 { 0.0 } else { sums[index - 1] };
        FoundRow { node, index, below: remap(target, before, sums[index]) }
    }

    /// The column of a row at which the share `z` of the row's mass is reached, and the position inside in `[0, 1)`.
    #[inline(always)]
    pub fn search_column(&self, FoundRow { node, index, .. }: FoundRow, z: f32) -> (usize, f32) {
        let target = z * f32::from(WHOLE);
        let below = (target as u16).min(WHOLE - 1);
        let numbers = &self.numbers[self.row_start(node, index)..][..=self.stride];
        let passed = if self.stride >= 2 * LANES {
            count_passed::<{ 2 * LANES }>(numbers, below)
        } else if self.stride == LANES {
            count_passed::<LANES>(numbers, below)
        } else {
            count_passed::<1>(numbers, below)
        };
        // The first number of the row is no sum.
        let column = usize::from(passed - u16::from(numbers[0] <= below));
        let Ends { without_before, last } = self.ends(column);
        let (before, sum) = (f32::from(numbers[column] & without_before), f32::from(numbers[column + 1] | last));
        (column, remap(target, before, sum))
    }

    /// What makes the running sum before the first cell of a row 0, and that after the last 65535.
    #[inline(always)]
    fn ends(&self, column: usize) -> Ends {
        let mask = |set: bool| u16::from(set).wrapping_neg();
        Ends { without_before: mask(column != 0), last: mask(column + 1 == self.cells.shape().1) }
    }

    /// The masses of one cell in several tables, in units of the tables' scales.
    #[inline(always)]
    pub fn masses<const N: usize>(&self, nodes: [usize; N], row: usize, column: usize) -> [f32; N] {
        let Ends { without_before, last } = self.ends(column);
        let mut masses = [0.0; N];
        for (mass, node) in masses.iter_mut().zip(nodes) {
            let numbers = &self.numbers[self.row_start(node, row)..][..=self.stride];
            let (before, sum) = (numbers[column] & without_before, numbers[column + 1] | last);
            // The product of two 16-bit integers, which needs 32 bits.
            *mass = (i64::from(numbers[0]) * (i64::from(sum) - i64::from(before))) as f32;
        }
        masses
    }
}

/// Masks over the running sums before and after a cell.
struct Ends {
    without_before: u16,
    last: u16,
}

/// How many of the numbers but the very last are at most `below`; they are a multiple of `N`.
#[inline(always)]
fn count_passed<const N: usize>(numbers: &[u16], below: u16) -> u16 {
    let (chunks, _) = numbers[..numbers.len() - 1].as_chunks::<N>();
    // Loops, not iterator adapters: those are not inlined into functions compiled for other processor features.
    let mut lanes = [0; N];
    for chunk in chunks {
        for k in 0..N {
            lanes[k] += u16::from(chunk[k] <= below);
        }
    }
    let mut passed = 0;
    for lane in lanes {
        passed += lane;
    }
    passed
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRIDS: [(usize, usize); 8] = [(1, 1), (3, 5), (8, 8), (16, 12), (32, 32), (7, 33), (5, 1), (64, 64)];

    /// Three tables: irregular masses, the same with one cell that outweighs all others together, one bright row.
    fn tables(cells: CellGrid) -> (CellMasses, [Vec<f64>; 3]) {
        let (count, columns) = (cells.cells(), cells.shape().1);
        let irregular: Vec<f64> = (0..count).map(|cell| ((cell * 7919) % 101) as f64 + 0.01).collect();
        let mut peaked = irregular.clone();
        peaked[count / 2] = 1e7;
        let row: Vec<f64> = (0..count).map(|cell| if cell / columns == 0 { 1.0 } else { 1e-9 }).collect();
        let tables = [irregular, peaked, row];
        (CellMasses::new(cells, &tables.concat()), tables)
    }

    #[test]
    fn masses_are_rounded_to_a_step_and_never_to_nothing() {
        for (rows, columns) in GRIDS {
            let (masses, tables) = tables(CellGrid::new(rows, columns).unwrap());
            for (node, table) in tables.iter().enumerate() {
                let Node { scale, rows: factors } = masses.node(node);
                let by_row = || table.chunks_exact(columns).map(|row| row.iter().sum::<f64>());
                let largest = by_row().fold(0.0, f64::max);
                let mut sum = 0.0;
                for ((row, whole), values) in by_row().enumerate().zip(table.chunks_exact(columns)) {
                    for (column, &value) in values.iter().enumerate() {
                        let [mass] = masses.masses([node], row, column);
                        assert!(mass >= 1.0);
                        sum += f64::from(mass);
                        // Half a step of the row's factor and a step at either end of the cell; a row or cell that is less than
                        // a step takes one from the others of its row or table.
                        let row_step = largest / 65535.0;
                        let cell_steps = 2.0 + columns as f64;
                        let bound = row_step * (value / whole + cell_steps / 65535.0) + whole * cell_steps / 65535.0;
                        let error = (f64::from(mass) * f64::from(scale) - value).abs();
                        assert!(error <= 1.0001 * bound, "{rows}x{columns} {node}: {error} {bound}");
                    }
                }
                // Products of 16-bit integers are rounded to 24 bits.
                let expected = f64::from(factors) * f64::from(CellMasses::ROW);
                assert!((sum / expected - 1.0).abs() < 1e-7, "{sum} {expected}");
            }
        }
    }

    #[test]
    fn cells_are_found_where_their_running_sums_say() {
        for (rows, columns) in GRIDS {
            let (masses, tables) = tables(CellGrid::new(rows, columns).unwrap());
            for node in 0..tables.len() {
                let mut above = 0.0;
                for row in 0..rows {
                    let factor = f32::from(masses.numbers[masses.row_start(node, row)]);
                    let found = masses.search_row(node, above + 0.25 * factor);
                    assert!(found.index == row && (found.below - 0.25).abs() < 1e-2 / factor.min(1e3), "{found:?}");
                    assert_eq!(masses.search_row(node, above).index, row);
                    above += factor;
                    let mut before = 0.0;
                    for column in 0..columns {
                        let sum = before + masses.masses([node], row, column)[0] / factor;
                        let (at, inside) = masses.search_column(found, (0.5 * (before + sum)) / 65535.0);
                        before = sum;
                        assert!(at == column && (inside - 0.5).abs() < 1e-2, "{rows}x{columns} {column} {at} {inside}");
                    }
                }
                // What rounding puts at the end is in the last cell.
                let last = masses.search_row(node, above);
                assert_eq!((last.index, masses.search_column(last, 1.0).0), (rows - 1, columns - 1));
            }
        }
    }
}
