//! A table of densities over Y times weights that change from place to place: the product of what a surface reflects and what it sees.
//!
//! Weights are those of the cells of a coarser grid, in which a draw begins: row, then column, then the fine cell within. Each coordinate of y grows with
//! its own of z, so strata of z stay strata of y as in the table itself.

mod fine;
#[cfg(test)]
mod tests;

use std::ops::Range;

use fine::{Fine, search, share};
use glam::Vec2;

use super::table::{self, BakedTable, CELL, COLUMNS as OF_TABLE, WEIGHTS, blend_of, inside};
use crate::{
    columns::{Arena, vectorized},
    discrete::remap,
    error::{Error, Result},
    sampler::IntermediateDensity,
    simd::{LANES, Lanes},
    tail::{Tail, TailWarp},
    tile::Rows,
    visibility::{GridLayout, PatchGrid, Weighting},
};

/// Most coarse cells along one side of Y.
const MOST_COARSE: usize = 32;
/// Points along either side of a coarse cell that say what patches of sky it is of.
const POINTS: usize = 8;
/// The largest mass of a coarse cell.
const WHOLE: f64 = u16::MAX as f64;
/// The column of the number of weights.
const INDEX: usize = OF_TABLE;
/// The first column of the running sums of the coarse rows.
const SUMS: usize = INDEX + 1;

/// A table with the sums over the cells of a coarser grid.
#[derive(Clone, Debug)]
pub struct WeightedTable {
    table: BakedTable,
    layout: GridLayout,
    /// The coarse row of each row of the table, and the coarse column of each column.
    coarse: [Vec<u8>; 2],
    /// The rows of each coarse row, and the columns of each coarse column.
    fine: [Vec<Range<usize>>; 2],
    /// The nodes around each cell of the grid of normals.
    corners: Vec<[u32; 4]>,
    /// For each table the masses of the coarse cells, as the layout has them, in units of its own: only where a draw goes depends on them, and the
    /// density is that of where it goes, so they may be rounded.
    masses: Vec<u16>,
    units: Vec<f32>,
    /// The weights where nothing is known.
    even: Box<[u8]>,
}

impl WeightedTable {
    /// The cells along a side that the grid of weights may have.
    pub const SIDES: [usize; 3] = [8, 16, MOST_COARSE];

    /// A table with weights on a grid of `side x side` cells, or as many as it has itself if those are less.
    ///
    /// # Errors
    /// `side` is none of [`Self::SIDES`].
    pub fn new(table: BakedTable, side: usize) -> Result<Self> {
        if !Self::SIDES.contains(&side) {
            let [a, b, c] = Self::SIDES;
            let choose = format!("{side} cells along a side: choose {a}, {b} or {c}");
            return Err(Error::argument("visibility grid", choose));
        }
        let (rows, columns) = table.cells.shape();
        let layout = GridLayout { rows: side.min(rows), columns: side.min(columns) };
        let parts = |coarse: usize, fine: usize| -> Vec<Range<usize>> {
            (0..coarse).map(|k| k * fine / coarse..(k + 1) * fine / coarse).collect()
        };
        let fine = [parts(layout.rows, rows), parts(layout.columns, columns)];
        let of_fine = |parts: &[Range<usize>]| -> Vec<u8> {
            parts.iter().enumerate().flat_map(|(k, part)| std::iter::repeat_n(k as u8, part.len())).collect()
        };
        let coarse = fine.each_ref().map(|parts| of_fine(parts));
        let nodes = table.normals().nodes();
        let (mut masses, mut units) = (Vec::with_capacity(nodes * layout.bytes()), Vec::with_capacity(nodes));
        for node in 0..nodes {
            let alone = table.quantized.alone(node);
            let sum = |row: usize, column: usize| -> f64 {
                let cells =
                    fine[0][row].clone().flat_map(|row| fine[1][column].clone().map(move |column| (row, column)));
                cells.map(|(row, column)| f64::from(table.quantized.mass(&alone, row, column))).sum()
            };
            let sums: Vec<f64> =
                (0..layout.rows * layout.columns).map(|k| sum(k / layout.columns, k % layout.columns)).collect();
            let unit = sums.iter().copied().fold(0.0, f64::max) / WHOLE;
            // Up: a cell that counts for less than it holds would have large weights.
            let mass =
                |row: usize, column: usize| (sums[row * layout.columns + column] / unit).ceil().min(WHOLE) as u16;
            masses.extend_from_slice(&layout.lay_out(mass));
            units.push(unit as f32);
        }
        let normals = table.normals();
        let corners = (0..normals.cells()).map(|cell| normals.corners(cell).map(|node| node as u32)).collect();
        Ok(Self { table, layout, coarse, fine, corners, masses, units, even: layout.lay_out(|_, _| 255) })
    }

    /// How the weights of its coarse cells are laid out.
    pub fn layout(&self) -> GridLayout {
        self.layout
    }

    /// What patches of sky the coarse cells are of, where a tail carries them: `patch_at` gives the patch of a point of X.
    pub fn patch_grid(&self, tail: &Tail, patch_at: impl Fn(Vec2) -> u16) -> PatchGrid {
        let (rows, columns) = self.table.cells.shape();
        let spread = |part: &Range<usize>, all: usize, k: usize| {
            (part.start as f32 + part.len() as f32 * (k as f32 + 0.5) / POINTS as f32) / all as f32
        };
        let of_cell = |cell: usize| {
            let (row, column) = (&self.fine[0][cell / self.layout.columns], &self.fine[1][cell % self.layout.columns]);
            let point = |k: usize| Vec2::new(spread(column, columns, k % POINTS), spread(row, rows, k / POINTS));
            let y: Vec<Vec2> = (0..POINTS * POINTS).map(point).collect();
            tail.forward_points(&y).into_iter().map(|(x, _)| patch_at(x)).collect()
        };
        PatchGrid::new(self.layout, (0..self.layout.rows * self.layout.columns).map(of_cell))
    }

    /// The table times weights.
    pub fn weighted<'a, W: Weighting>(&'a self, weighting: &'a W) -> WeightedDensity<'a, W> {
        WeightedDensity { table: self, weighting }
    }

    /// The weights with a number.
    #[inline(always)]
    fn weights<'a, W: Weighting>(&'a self, weighting: &'a W, index: f32) -> &'a [u8] {
        weighting.at(index).and_then(|weights| weights.grid()).unwrap_or(&self.even)
    }

    /// The masses of the coarse cells of the four tables of a lane, and what a unit of each counts for.
    #[inline(always)]
    fn coarse_masses(&self, state: &[Lanes], lane: usize) -> ([&[u16]; 4], [f32; 4]) {
        let length = self.layout.bytes();
        let (mut masses, mut weights) = ([&self.masses[..0]; 4], [0.0; 4]);
        for (corner, &node) in self.corners[state[CELL][lane].to_bits() as usize].iter().enumerate() {
            let node = node as usize;
            masses[corner] = &self.masses[node * length..][..length];
            weights[corner] = state[WEIGHTS + corner][lane] * self.units[node];
        }
        (masses, weights)
    }

    /// The running sums of the weighted masses of the cells of a coarse row, for one lane.
    #[inline(always)]
    fn column_sums(&self, state: &[Lanes], lane: usize, weights: &[u8], row: usize) -> [f32; MOST_COARSE] {
        let (masses, units) = self.coarse_masses(state, lane);
        let (mut sums, start) = ([0.0; MOST_COARSE], self.layout.rows_start() + row * self.layout.row());
        for chunk in 0..self.layout.row() / LANES {
            let sums = &mut sums[chunk * LANES..][..LANES];
            sums.copy_from_slice(&weighted(masses, units, weights, start + chunk * LANES));
        }
        let mut sum = 0.0;
        for own in &mut sums[..self.layout.columns] {
            sum += *own;
            *own = sum;
        }
        sums
    }
}

/// The weighted sums of the rows of one table.
#[inline(always)]
fn row_sums(layout: GridLayout, masses: &[u16], weights: &[u8], out: &mut [f32; MOST_COARSE]) {
    for chunk in 0..layout.column() / LANES {
        let mut sums = [0.0; LANES];
        for column in 0..layout.columns {
            let at = column * layout.column() + chunk * LANES;
            let (masses, weights): (&[u16; LANES], &[u8; LANES]) = (lanes(masses, at), lanes(weights, at));
            for k in 0..LANES {
                sums[k] += i32::from(masses[k]) as f32 * i32::from(weights[k]) as f32;
            }
        }
        out[chunk * LANES..][..LANES].copy_from_slice(&sums);
    }
}

/// The masses of four tables from one place on, blended, each times its weight.
#[inline(always)]
fn weighted(masses: [&[u16]; 4], units: [f32; 4], weights: &[u8], at: usize) -> Lanes {
    let [a, b, c, d] = masses;
    let (a, b): (&[u16; LANES], &[u16; LANES]) = (lanes(a, at), lanes(b, at));
    let (c, d): (&[u16; LANES], &[u16; LANES]) = (lanes(c, at), lanes(d, at));
    let weights: &[u8; LANES] = lanes(weights, at);
    let mut out = [0.0; LANES];
    for k in 0..LANES {
        let near = units[0] * i32::from(a[k]) as f32 + units[1] * i32::from(b[k]) as f32;
        let far = units[2] * i32::from(c[k]) as f32 + units[3] * i32::from(d[k]) as f32;
        out[k] = (near + far) * i32::from(weights[k]) as f32;
    }
    out
}

/// Whole lanes of a list.
#[inline(always)]
fn lanes<T>(numbers: &[T], at: usize) -> &[T; LANES] {
    numbers[at..].first_chunk().expect("lists are padded to whole lanes")
}

vectorized! {
    /// The running sums of the coarse rows of a strip; the table's own state and the numbers of the weights are there.
    fn prepare['a, W: Weighting](_simd, table: &'a WeightedTable, weighting: &'a W, state: &'a mut [Lanes]) {
        let layout = table.layout;
        let (mut last, mut rows) = (None, [[0.0; MOST_COARSE]; 4]);
        for k in 0..LANES {
            let (masses, units) = table.coarse_masses(state, k);
            let key = Some((state[CELL][k].to_bits(), state[INDEX][k].to_bits()));
            // Neighbours mostly have the same tables and the same weights, and differ in what each table counts for.
            if key != last {
                let weights = table.weights(weighting, state[INDEX][k]);
                for (rows, masses) in rows.iter_mut().zip(masses) {
                    row_sums(layout, masses, weights, rows);
                }
                last = key;
            }
            for row in 0..layout.rows {
                let near = units[0] * rows[0][row] + units[1] * rows[1][row];
                let far = units[2] * rows[2][row] + units[3] * rows[3][row];
                state[SUMS + row][k] = near + far;
            }
        }
        let mut sum = [0.0; LANES];
        for row in &mut state[SUMS..][..layout.rows] {
            for k in 0..LANES {
                sum[k] += row[k];
            }
            *row = sum;
        }
    }
}

/// Where lanes of a strip are within the coarse grid, and with what probability.
struct Coarse {
    row: [i32; LANES],
    below: Lanes,
    probability: Lanes,
}

/// The coarse rows that uniform numbers fall into.
#[inline(always)]
fn search_rows(table: &WeightedTable, state: &[Lanes], z: &Lanes) -> Coarse {
    let sums = &state[SUMS..][..table.layout.rows];
    let whole = sums[sums.len() - 1];
    let (mut target, mut row) = ([0.0; LANES], [0_i32; LANES]);
    let (mut before, mut sum) = ([0.0; LANES], [0.0; LANES]);
    for k in 0..LANES {
        target[k] = z[k] * whole[k];
    }
    // The last row ends where all do: it is not passed but by rounding.
    for own in &sums[..sums.len() - 1] {
        for k in 0..LANES {
            let passed = own[k] <= target[k];
            row[k] += i32::from(passed);
            before[k] = if passed { own[k] } else { before[k] };
        }
    }
    for (index, own) in sums.iter().enumerate() {
        for k in 0..LANES {
            sum[k] = if row[k] == index as i32 { own[k] } else { sum[k] };
        }
    }
    let (mut below, mut probability) = ([0.0; LANES], [0.0; LANES]);
    for k in 0..LANES {
        below[k] = remap(target[k], before[k], sum[k]);
        probability[k] = share(before[k], sum[k], whole[k]);
    }
    Coarse { row, below, probability }
}

vectorized! {
    /// Lanes from `count` on are not drawn for.
    fn sample['a, W: Weighting](
        _simd, table: &'a WeightedTable, weighting: &'a W, count: usize, state: &'a [Lanes],
        z: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let (rows, columns) = table.table.cells.shape();
        let [y_u, y_v] = y;
        let stride = SUMS + table.layout.column();
        for strip in 0..q.len() {
            let state = &state[strip * stride..][..stride];
            let coarse = search_rows(table, state, &z[1][strip]);
            for k in 0..LANES.min(count - strip * LANES) {
                let row = coarse.row[k] as usize;
                let weights = table.weights(weighting, state[INDEX][k]);
                let sums = &table.column_sums(state, k, weights, row)[..table.layout.columns];
                let whole = sums[sums.len() - 1];
                let (column, before, sum) = search(sums, z[0][strip][k] * whole);
                let right = remap(z[0][strip][k] * whole, before, sum);
                let of_cell = [&table.fine[0][row], &table.fine[1][column]];
                let size = of_cell.map(ExactSizeIterator::len);
                let fine = Fine::new(&table.table.quantized, &blend_of(state, k), of_cell);
                let down = coarse.below[k] * fine.rows[size[0] - 1];
                let (fine_row, before_row, sum_row) = search(&fine.rows[..size[0]], down);
                let along = &fine.along[fine_row][..size[1]];
                let target = right * along[size[1] - 1];
                let (fine_column, before_column, sum_column) = search(along, target);
                y_v[strip][k] = inside(of_cell[0].start + fine_row, remap(down, before_row, sum_row)) / rows as f32;
                y_u[strip][k] =
                    inside(of_cell[1].start + fine_column, remap(target, before_column, sum_column)) / columns as f32;
                let probability = coarse.probability[k] * share(before, sum, whole);
                q[strip][k] =
                    probability * fine.probability([fine_row, fine_column], size) * (rows * columns) as f32;
            }
        }
    }
}

vectorized! {
    fn density['a, W: Weighting](
        _simd, table: &'a WeightedTable, weighting: &'a W, count: usize, state: &'a [Lanes], y: [&'a [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let (rows, columns) = table.table.cells.shape();
        let stride = SUMS + table.layout.column();
        for strip in 0..q.len() {
            let state = &state[strip * stride..][..stride];
            for k in 0..LANES.min(count - strip * LANES) {
                let (row, column) = table.table.cells.cell(Vec2::new(y[0][strip][k], y[1][strip][k]));
                let at = [usize::from(table.coarse[0][row]), usize::from(table.coarse[1][column])];
                let weights = table.weights(weighting, state[INDEX][k]);
                let sums = &table.column_sums(state, k, weights, at[0])[..table.layout.columns];
                let above = if at[0] == 0 { 0.0 } else { state[SUMS + at[0] - 1][k] };
                let left = if at[1] == 0 { 0.0 } else { sums[at[1] - 1] };
                let of_row = share(above, state[SUMS + at[0]][k], state[SUMS + table.layout.rows - 1][k]);
                let of_column = share(left, sums[at[1]], sums[sums.len() - 1]);
                let of_cell = [&table.fine[0][at[0]], &table.fine[1][at[1]]];
                let fine = Fine::new(&table.table.quantized, &blend_of(state, k), of_cell);
                let place = [row - of_cell[0].start, column - of_cell[1].start];
                let of_fine = fine.probability(place, of_cell.map(ExactSizeIterator::len));
                q[strip][k] = of_row * of_column * of_fine * (rows * columns) as f32;
            }
        }
    }
}

/// A [`WeightedTable`] with weights.
#[derive(Clone, Copy, Debug)]
pub struct WeightedDensity<'a, W> {
    table: &'a WeightedTable,
    weighting: &'a W,
}

impl<W: Weighting> IntermediateDensity for WeightedDensity<'_, W> {
    fn columns(&self) -> usize {
        SUMS + self.table.layout.column()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let mut indices = arena.columns::<1>(at.strips());
        self.weighting.indices(at, indices.get_mut()[0]);
        for (strip, state) in state.chunks_exact_mut(self.columns()).enumerate() {
            table::prepare(&self.table.table, &at.normals(strip), &mut state[..OF_TABLE]);
            state[INDEX] = indices.get()[0][strip];
            prepare(self.table, self.weighting, state);
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
        sample(self.table, self.weighting, at.len(), state, z, y, q);
    }

    fn density(&self, at: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], q: &mut [Lanes], _arena: &Arena) {
        density(self.table, self.weighting, at.len(), state, y, q);
    }
}
