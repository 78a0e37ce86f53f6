//! A table of densities over Y times weights that change from place to place: the product of what a surface reflects and what it sees.
//!
//! Weights are those of the cells of a coarser grid, in which a draw begins: row, then column, then the fine cell within. Each coordinate of y grows with
//! its own of z, so strata of z stay strata of y as in the table itself.

use std::ops::Range;

use glam::Vec2;

use super::{
    cell_masses::{Blend, CellMasses},
    table::{self, BakedTable, COLUMNS as OF_TABLE, NODES, WEIGHTS, blend_of, inside},
};
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
    /// For each table the masses of the coarse cells, as the layout has them, in units of its own: only where a draw goes depends on them, and the
    /// density is that of where it goes, so they may be rounded.
    masses: Vec<u16>,
    units: Vec<f32>,
    /// The weights where nothing is known.
    even: Box<[u8]>,
}

impl WeightedTable {
    /// The cells along a side that weights may have.
    pub const SIDES: [usize; 3] = [8, 16, MOST_COARSE];

    /// A table with weights on a grid of `side x side` cells, or as many as it has itself if those are less.
    ///
    /// # Errors
    /// `side` is not one of [`Self::SIDES`].
    pub fn new(table: BakedTable, side: usize) -> Result<Self> {
        if !Self::SIDES.contains(&side) {
            return Err(Error::argument("visibility grid", format!("{side} cells along a side: choose 8, 16 or 32")));
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
            let alone = Blend { nodes: [node; 4], weights: [1.0, 0.0, 0.0, 0.0] };
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
        Ok(Self { table, layout, coarse, fine, masses, units, even: layout.lay_out(|_, _| 255) })
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
        for corner in 0..4 {
            let node = state[NODES + corner][lane].to_bits() as usize;
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

/// How much of the whole a running sum adds.
#[inline(always)]
fn share(before: f32, sum: f32, whole: f32) -> f32 {
    (sum - before) / whole
}

vectorized! {
    /// The running sums of the coarse rows of a strip; the table's own state and the numbers of the weights are there.
    fn prepare['a, W: Weighting](_simd, table: &'a WeightedTable, weighting: &'a W, state: &'a mut [Lanes]) {
        let layout = table.layout;
        let (mut last, mut rows) = (None, [[0.0; MOST_COARSE]; 4]);
        for k in 0..LANES {
            let (masses, units) = table.coarse_masses(state, k);
            // The first of the four says which the others are.
            let key = Some((state[NODES][k].to_bits(), state[INDEX][k].to_bits()));
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

/// The last of running sums but the very last that a target passes, and the number of those that it passes.
#[inline(always)]
fn search(sums: &[f32], target: f32) -> (usize, f32, f32) {
    let mut passed = 0;
    for sum in &sums[..sums.len() - 1] {
        passed += i32::from(*sum <= target);
    }
    let place = passed as usize;
    (place, if place == 0 { 0.0 } else { sums[place - 1] }, sums[place])
}

/// The masses of the cells of the table in one coarse cell: running sums of its rows, and those along each of them.
struct Fine {
    rows: [f32; MOST_FINE],
    along: [[f32; MOST_FINE]; MOST_FINE],
}

/// Most cells of a table along one side of a coarse cell: 64 over 8.
const MOST_FINE: usize = 8;

impl Fine {
    #[inline(always)]
    fn new(masses: &CellMasses, blend: &Blend, [rows, columns]: [&Range<usize>; 2]) -> Self {
        let mut out = Self { rows: [0.0; MOST_FINE], along: [[0.0; MOST_FINE]; MOST_FINE] };
        let mut all = 0.0;
        for (row, (along, whole)) in rows.clone().zip(out.along.iter_mut().zip(&mut out.rows)) {
            let mut sum = 0.0;
            for (column, along) in columns.clone().zip(along.iter_mut()) {
                sum += masses.mass(blend, row, column);
                *along = sum;
            }
            all += sum;
            *whole = all;
        }
        out
    }

    /// The probability of a cell, by its row and column in the coarse cell of so many.
    #[inline(always)]
    fn probability(&self, [row, column]: [usize; 2], [rows, columns]: [usize; 2]) -> f32 {
        let own = |sums: &[f32], place: usize, count: usize| {
            share(if place == 0 { 0.0 } else { sums[place - 1] }, sums[place], sums[count - 1])
        };
        own(&self.rows, row, rows) * own(&self.along[row], column, columns)
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        bake::{CellGrid, NormalGrid},
        brdf::Lambert,
        random::{Purpose, Stream},
        tile::{ShadingPoint, Tile},
        visibility::{PATCHES, Weights},
    };
    use glam::{Vec3, Vec3A};

    struct One(Weights);

    impl Weighting for One {
        fn at(&self, _index: f32) -> Option<&Weights> {
            Some(&self.0)
        }
    }

    /// Sizes of tables with the sides of their coarse grids: multiples and not, a grid that is the table itself.
    const SIZES: [(usize, usize, usize); 6] =
        [(32, 32, 16), (32, 32, 8), (64, 64, 32), (7, 33, 16), (1, 1, 8), (64, 64, 8)];

    fn weight(cell: usize) -> f32 {
        ((cell * 37) % 10 + 1) as f32 / 10.0
    }

    fn tables() -> impl Iterator<Item = WeightedTable> {
        SIZES.into_iter().map(|(rows, columns, side)| {
            let (normals, cells) = (NormalGrid::new(5, 7).unwrap(), CellGrid::new(rows, columns).unwrap());
            let table = BakedTable::fill(normals, cells, |normal, masses| {
                for (k, mass) in masses.iter_mut().enumerate() {
                    *mass = ((0.7 * k as f32 + 3.0 * normal.x + normal.z).sin() + 0.9).max(0.0) * (1.1 + normal.y);
                }
            });
            WeightedTable::new(table.unwrap(), side).unwrap()
        })
    }

    /// Runs work over columns of points of the square at one normal: three numbers of each.
    fn at(
        density: &impl IntermediateDensity,
        normal: Vec3A,
        points: &[Vec2],
        work: impl Fn(&Rows<'_>, &[Lanes], [&[Lanes]; 2], [&mut [Lanes]; 3], &Arena),
    ) -> Vec<(Vec2, f32)> {
        let surface = Lambert { albedo: Vec3::ONE }.into();
        let point = ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, surface };
        let (arena, mut out) = (Arena::default(), Vec::new());
        for points in points.chunks(1024) {
            let tile = Tile::of(&vec![point; points.len()]);
            let rows = tile.rows();
            let mut state = vec![[0.0; LANES]; density.columns() * rows.strips()];
            density.prepare(&rows, &mut state, &arena);
            let mut columns = arena.columns::<5>(rows.strips());
            let [a, b, u, v, q] = columns.get_mut();
            for (k, point) in points.iter().enumerate() {
                (a[k / LANES][k % LANES], b[k / LANES][k % LANES]) = (point.x, point.y);
            }
            work(&rows, &state, [a, b], [&mut *u, &mut *v, &mut *q], &arena);
            let [_, _, u, v, q] = columns.get().map(<[Lanes]>::as_flattened);
            out.extend((0..points.len()).map(|k| (Vec2::new(u[k], v[k]), q[k])));
        }
        out
    }

    fn densities(density: &impl IntermediateDensity, normal: Vec3A, y: &[Vec2]) -> Vec<f64> {
        let work = |rows: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], [_, _, q]: [&mut [Lanes]; 3], arena: &Arena| {
            density.density(rows, state, y, q, arena);
        };
        at(density, normal, y, work).into_iter().map(|(_, q)| f64::from(q)).collect()
    }

    fn draws(density: &impl IntermediateDensity, normal: Vec3A, z: &[Vec2]) -> Vec<(Vec2, f32)> {
        let work = |rows: &Rows<'_>, state: &[Lanes], z: [&[Lanes]; 2], [u, v, q]: [&mut [Lanes]; 3], arena: &Arena| {
            density.sample(rows, state, z, [u, v], q, arena);
        };
        at(density, normal, z, work)
    }

    fn normals() -> impl Iterator<Item = Vec3A> {
        let mut random = Stream::new(4, Purpose::Test, 0);
        (0..8).map(move |_| random.direction()).chain([Vec3A::Y, -Vec3A::Y])
    }

    fn centres(table: &WeightedTable) -> Vec<Vec2> {
        let (rows, columns) = table.table.cells().shape();
        let centre = |k: usize| {
            Vec2::new(((k % columns) as f32 + 0.5) / columns as f32, ((k / columns) as f32 + 0.5) / rows as f32)
        };
        (0..rows * columns).map(centre).collect()
    }

    #[test]
    fn the_density_is_the_table_s_times_the_weights() {
        for table in tables() {
            let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
            let centres = centres(&table);
            for normal in normals() {
                let own = densities(&table.weighted(&weights), normal, &centres);
                let mean = own.iter().sum::<f64>() / own.len() as f64;
                assert!((mean - 1.0).abs() < 1e-5, "{mean}");
                let plain = table.table.density_at(normal, &centres);
                let (rows, columns) = table.table.cells().shape();
                let weighted: Vec<f64> = (0..rows * columns)
                    .map(|k| {
                        let (row, column) = (table.coarse[0][k / columns], table.coarse[1][k % columns]);
                        // In steps of 1/255, as weights are kept.
                        let weight = weight(usize::from(row) * table.layout.columns + usize::from(column));
                        f64::from(plain[k]) * f64::from((255.0 * weight).round())
                    })
                    .collect();
                let all = weighted.iter().sum::<f64>() / weighted.len() as f64;
                let largest = weighted.iter().copied().fold(0.0, f64::max) / all;
                for (own, weighted) in own.iter().zip(&weighted) {
                    // A coarse cell is rounded up by a step of 1/65535 of the largest of each of four tables, whose largest need not be that
                    // of the blend: a few steps. The whole is larger by as much.
                    let expected = weighted / all;
                    assert!((own - expected).abs() < 1e-4 * (expected + 10.0 * largest), "{own} {expected} {largest}");
                }
            }
        }
    }

    #[test]
    fn draws_grow_with_their_uniform_numbers_and_have_the_density_that_is_given() {
        const STEPS: usize = 2048;
        let share = |k: usize| k as f32 / STEPS as f32;
        for table in tables() {
            let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
            let density = table.weighted(&weights);
            for normal in normals() {
                let down: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(0.3, share(k))).collect();
                let along: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(share(k), 0.7)).collect();
                let (down, along) = (draws(&density, normal, &down), draws(&density, normal, &along));
                // Within a coarse row, what a column holds decides where it is divided: the order of rows is kept from one coarse row to the next.
                let row = |y: Vec2| table.coarse[0][table.table.cells().cell(y).0];
                assert!(down.windows(2).all(|pair| row(pair[0].0) <= row(pair[1].0)));
                let column = |y: Vec2| table.coarse[1][table.table.cells().cell(y).1];
                assert!(along.windows(2).all(|pair| column(pair[0].0) <= column(pair[1].0)));
                for drawn in [down, along] {
                    let y: Vec<Vec2> = drawn.iter().map(|&(y, _)| y).collect();
                    for ((y, q), found) in drawn.iter().zip(densities(&density, normal, &y)) {
                        assert!((f64::from(*q) / found - 1.0).abs() < 1e-5, "{y}: {q} {found}");
                    }
                }
            }
        }
    }

    /// Pearson's statistic over the table's cells, those that expect fewer than ten draws together as one, and as a normal deviate (Wilson and Hilferty
    /// 1931). Five of those are 3e-7 for each of some fifty tests.
    #[test]
    fn draws_are_as_many_as_the_density_says() {
        const DRAWS: usize = 1 << 17;
        for (number, table) in tables().enumerate() {
            let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
            let density = table.weighted(&weights);
            let (rows, columns) = table.table.cells().shape();
            for (k, normal) in normals().enumerate() {
                let mut random = Stream::new(9, Purpose::Test, (number * 100 + k) as u64);
                let z: Vec<Vec2> = (0..DRAWS).map(|_| random.uniform2()).collect();
                let mut counts = vec![0.0; rows * columns];
                for (y, _) in draws(&density, normal, &z) {
                    let (row, column) = table.table.cells().cell(y);
                    counts[row * columns + column] += 1.0;
                }
                let (mut statistic, mut cells, mut rest) = (0.0, 0, (0.0, 0.0));
                for (count, q) in counts.iter().zip(densities(&density, normal, &centres(&table))) {
                    let expected = q * DRAWS as f64 / (rows * columns) as f64;
                    if expected < 10.0 {
                        rest = (rest.0 + count, rest.1 + expected);
                    } else {
                        statistic += (count - expected).powi(2) / expected;
                        cells += 1;
                    }
                }
                if rest.1 >= 10.0 {
                    statistic += (rest.0 - rest.1).powi(2) / rest.1;
                    cells += 1;
                } else {
                    assert!(rest.0 < rest.1 + 40.0, "{} draws where {} are expected", rest.0, rest.1);
                }
                let freedom = f64::from(cells - 1);
                if freedom > 0.0 {
                    let spread = 2.0 / (9.0 * freedom);
                    let deviate = ((statistic / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
                    assert!(deviate < 5.0, "{rows} x {columns}, {normal}: {statistic} over {cells} cells");
                }
            }
        }
    }

    #[test]
    fn only_three_sizes_are_taken() {
        let table = || tables().next().unwrap().table;
        for side in [0, 7, 64, usize::MAX] {
            assert!(WeightedTable::new(table(), side).unwrap_err().to_string().contains("8, 16 or 32"));
        }
    }
}
