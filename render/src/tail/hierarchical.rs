//! The quad-tree tail: a warp that halves the map again and again (after Clarberg et al. 2005).

use glam::{Mat4, Vec2, Vec4};

use super::{BELOW_ONE, TailWarp, bilinear::Corners, density::BilinearDensity};
use crate::simd::{self, LANES, Lanes, Simd, Vectorized};

/// Where a node cuts its rectangle of Y: `[y of the horizontal cut, x of the vertical cut above it, x of the one below it, 0]`.
type Cuts = [f32; 4];

/// The hierarchical tail. From the root down, the rectangle of Y that belongs to a node is cut into an upper and a lower part, and
/// each of these into a left and a right one, in proportion to the light in the quarters of its part of X; within a cell the
/// bilinear density is inverted in closed form. It keeps neighbours together better than [`super::RowColumn`] on most maps.
///
/// A node holds where its cuts *are*, not how they divide: on the way down nothing has to be rescaled, and the four numbers that
/// bound a cell's rectangle are all that the way back needs.
#[derive(Clone, Debug)]
pub struct Hierarchical {
    grid: BilinearDensity,
    /// Root first.
    levels: Vec<Level>,
    /// How many of the last levels cut both ways; a map that is wider than high has levels above in which only columns are cut.
    square_levels: u32,
    /// All bits where those levels above have columns, none where they have rows.
    top_columns: u32,
}

#[derive(Clone, Debug)]
struct Level {
    /// 1 where nodes of this level have two columns (rows) of children, else 0.
    column_bits: u32,
    row_bits: u32,
    /// In the order in which the descent numbers nodes: the children of a node are neighbours.
    cuts: Vec<Cuts>,
}

impl Level {
    #[inline(always)]
    fn child(&self, index: u32, lower: u32, right: u32) -> u32 {
        (index << (self.column_bits + self.row_bits)) + (lower << self.column_bits) + right
    }
}

/// A rectangle of Y.
#[derive(Clone, Copy, Debug)]
struct Bounds<T> {
    left: T,
    right: T,
    top: T,
    bottom: T,
}

impl Bounds<f64> {
    const SQUARE: Self = Self { left: 0.0, right: 1.0, top: 0.0, bottom: 1.0 };
}

impl Hierarchical {
    /// Builds the tree over the cells of a density.
    pub fn new(grid: BilinearDensity) -> Self {
        let (columns, rows) = (grid.columns().next_power_of_two(), grid.rows().next_power_of_two());
        let square_levels = columns.min(rows).ilog2();
        let mut levels: Vec<Level> = (0..columns.max(rows).ilog2())
            .rev()
            .map(|height| {
                let bits = |count: usize| u32::from(count >> height > 1);
                Level { column_bits: bits(columns), row_bits: bits(rows), cuts: Vec::new() }
            })
            .collect();
        let mut masses = vec![vec![0.0_f64; columns * rows]];
        for row in 0..grid.rows() {
            for column in 0..grid.columns() {
                let index = cell_index(square_levels, column as u32, row as u32);
                masses[0][index as usize] = f64::from(grid.corners(column, row).mean());
            }
        }
        for level in levels.iter().rev() {
            let children = 1 << (level.column_bits + level.row_bits);
            let finer: &Vec<f64> = &masses[masses.len() - 1];
            // Halves first, as the cuts are made.
            let sum = |node: &[f64]| node.chunks(2).map(|half| half.iter().sum::<f64>()).sum();
            masses.push(finer.chunks_exact(children).map(sum).collect());
        }
        masses.reverse();
        let mut bounds = vec![Bounds::SQUARE];
        for (level, masses) in levels.iter_mut().zip(&masses[1..]) {
            let children = 1 << (level.column_bits + level.row_bits);
            let mut inner = Vec::with_capacity(masses.len());
            for (bounds, masses) in bounds.iter().zip(masses.chunks_exact(children)) {
                level.cuts.push(cut(level, bounds, masses, &mut inner));
            }
            bounds = inner;
        }
        let top_columns = if columns > rows { u32::MAX } else { 0 };
        Self { grid, levels, square_levels, top_columns }
    }

    /// The density of the map.
    pub fn grid(&self) -> &BilinearDensity {
        &self.grid
    }

    /// Column and row of a number in the order of the descent: the inverse of [`cell_index`].
    #[inline(always)]
    fn cell(&self, index: u32) -> (u32, u32) {
        let bits = 2 * self.square_levels;
        let (top, low) = (index >> bits, index & ((1 << bits) - 1));
        let (column, row) = (gather(low), gather(low >> 1));
        (
            column + ((top & self.top_columns) << self.square_levels),
            row + ((top & !self.top_columns) << self.square_levels),
        )
    }

    /// The rectangle of a cell: each of its sides is a cut of the lowest node above the cell of which it is the border.
    #[inline]
    fn bounds(&self, column: u32, row: u32) -> Bounds<f32> {
        let mut bounds = Bounds { left: f32::NAN, right: f32::NAN, top: f32::NAN, bottom: f32::NAN };
        let (mut column, mut row, mut index) = (column, row, cell_index(self.square_levels, column, row));
        for level in self.levels.iter().rev() {
            let right = column & level.column_bits;
            let lower = row & level.row_bits;
            column >>= level.column_bits;
            row >>= level.row_bits;
            index >>= level.column_bits + level.row_bits;
            let [cut, above, below, _] = level.cuts[index as usize];
            let vertical = if lower == 0 { above } else { below };
            // A side that was found lower down stays.
            let side = if right == 0 { &mut bounds.right } else { &mut bounds.left };
            *side = if side.is_nan() { vertical } else { *side };
            let side = if lower == 0 { &mut bounds.bottom } else { &mut bounds.top };
            *side = if side.is_nan() { cut } else { *side };
            if (bounds.left + bounds.right) + (bounds.top + bounds.bottom) >= 0.0 {
                return bounds;
            }
        }
        // A cut outside of [0, 1] there is none: what was not found is a side of the square.
        Bounds {
            left: bounds.left.max(0.0),
            right: bounds.right.min(1.0),
            top: bounds.top.max(0.0),
            bottom: bounds.bottom.min(1.0),
        }
    }
}

/// The number of a cell in the order of the descent: the bits of row and column in turn, below what only one of them has.
#[inline(always)]
fn cell_index(square_levels: u32, column: u32, row: u32) -> u32 {
    let low = (1 << square_levels) - 1;
    // One of the two is 0.
    let top = (column >> square_levels) | (row >> square_levels);
    (top << (2 * square_levels)) | (spread(row & low) << 1) | spread(column & low)
}

/// The 16 low bits, a zero above each.
#[inline(always)]
fn spread(bits: u32) -> u32 {
    let bits = (bits | (bits << 8)) & 0x00ff_00ff;
    let bits = (bits | (bits << 4)) & 0x0f0f_0f0f;
    let bits = (bits | (bits << 2)) & 0x3333_3333;
    (bits | (bits << 1)) & 0x5555_5555
}

/// Every other bit, from the lowest on: the inverse of [`spread`].
#[inline(always)]
fn gather(bits: u32) -> u32 {
    let bits = bits & 0x5555_5555;
    let bits = (bits | (bits >> 1)) & 0x3333_3333;
    let bits = (bits | (bits >> 2)) & 0x0f0f_0f0f;
    let bits = (bits | (bits >> 4)) & 0x00ff_00ff;
    (bits | (bits >> 8)) & 0x0000_ffff
}

/// Cuts a node's rectangle in proportion to the masses of its children, and adds theirs.
fn cut(level: &Level, bounds: &Bounds<f64>, masses: &[f64], children: &mut Vec<Bounds<f64>>) -> Cuts {
    let per_row = 1 << level.column_bits;
    let (upper, lower) = masses.split_at(per_row);
    let whole = |row: &[f64]| row.iter().sum::<f64>();
    let horizontal = between(bounds.top, bounds.bottom, whole(upper), whole(lower));
    let mut cuts = [horizontal as f32, 0.0, 0.0, 0.0];
    for (row, masses) in [upper, lower].into_iter().enumerate() {
        let right = masses.get(1).copied().unwrap_or(0.0);
        let vertical = between(bounds.left, bounds.right, masses.first().copied().unwrap_or(0.0), right);
        cuts[1 + row] = vertical as f32;
        let [top, bottom] = [[bounds.top, horizontal], [horizontal, bounds.bottom]][row];
        let parts = [
            Bounds { left: bounds.left, right: vertical, top, bottom },
            Bounds { left: vertical, right: bounds.right, top, bottom },
        ];
        children.extend(&parts[..masses.len()]);
    }
    cuts
}

/// Where an interval is cut in proportion to two masses; at its end where there is nothing to divide.
fn between(start: f64, end: f64, first: f64, second: f64) -> f64 {
    if second > 0.0 { (start + (end - start) * (first / (first + second))).clamp(start, end) } else { end }
}

/// The way of a point from the lower to the upper bound.
#[inline(always)]
fn fraction(at: f32, from: f32, to: f32) -> f32 {
    let way = (at - from) / (to - from);
    // In this order what is not a number (an empty interval) becomes 0.
    let way = if way > 0.0 { way } else { 0.0 };
    if way < BELOW_ONE { way } else { BELOW_ONE }
}

/// Points of Y on their way down the tree, one in each lane.
#[derive(Clone, Copy)]
struct Descents {
    x: Lanes,
    y: Lanes,
    bounds: Bounds<Lanes>,
    index: [u32; LANES],
}

impl Descents {
    const AT_THE_ROOT: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        bounds: Bounds { left: [0.0; LANES], right: [1.0; LANES], top: [0.0; LANES], bottom: [1.0; LANES] },
        index: [0; LANES],
    };

    /// One level down.
    #[inline(always)]
    fn step(&mut self, level: &Level) {
        let mut cuts = [[0.0; LANES]; 3];
        for k in (0..LANES).step_by(4) {
            // Four nodes at a time: four loads and a transposition instead of twelve loads.
            let node = |lane: usize| Vec4::from_array(level.cuts[self.index[k + lane] as usize]);
            let nodes = Mat4::from_cols(node(0), node(1), node(2), node(3)).transpose();
            for (cuts, nodes) in cuts.iter_mut().zip([nodes.x_axis, nodes.y_axis, nodes.z_axis]) {
                cuts[k..k + 4].copy_from_slice(&nodes.to_array());
            }
        }
        let [horizontal, above, below] = &cuts;
        let Self { x, y, bounds, index } = self;
        for k in 0..LANES {
            let is_lower = y[k] >= horizontal[k];
            let vertical = if is_lower { below[k] } else { above[k] };
            let is_right = x[k] >= vertical;
            bounds.top[k] = if is_lower { horizontal[k] } else { bounds.top[k] };
            bounds.bottom[k] = if is_lower { bounds.bottom[k] } else { horizontal[k] };
            bounds.left[k] = if is_right { vertical } else { bounds.left[k] };
            bounds.right[k] = if is_right { bounds.right[k] } else { vertical };
            let (lower, right) = (u32::from(is_lower), u32::from(is_right));
            index[k] = level.child(index[k], lower, right);
        }
    }

    /// The points of X, and the Jacobians there.
    #[inline(always)]
    fn finish(&self, tail: &Hierarchical) -> ([Lanes; 2], Lanes) {
        let grid = &tail.grid;
        let (mut columns, mut rows) = ([0; LANES], [0; LANES]);
        for k in 0..LANES {
            (columns[k], rows[k]) = tail.cell(self.index[k]);
        }
        let mut corners = [[0.0; 4]; LANES];
        for k in 0..LANES {
            corners[k] = grid.corners(columns[k] as usize, rows[k] as usize).0;
        }
        let (mut x, mut jacobian) = ([[0.0; LANES]; 2], [0.0; LANES]);
        for k in 0..LANES {
            let corners = Corners(corners[k]);
            let across = fraction(self.x[k], self.bounds.left[k], self.bounds.right[k]);
            let down = fraction(self.y[k], self.bounds.top[k], self.bounds.bottom[k]);
            let inside = corners.sample(Vec2::new(across, down));
            let point = grid.point(columns[k], rows[k], inside);
            (x[0][k], x[1][k]) = (point.x, point.y);
            jacobian[k] = 1.0 / corners.evaluate(inside);
        }
        (x, jacobian)
    }
}

/// Chunks of [`LANES`] points that go down the tree side by side: each waits for memory while the others move.
const ABREAST: usize = 4;

/// [`TailWarp::forward`] of at most `ABREAST * LANES` points.
struct Forward<'a> {
    tail: &'a Hierarchical,
    y: &'a [Vec2],
    out: &'a mut [(Vec2, f32)],
}

impl Vectorized for Forward<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let mut descents = [Descents::AT_THE_ROOT; ABREAST];
        let chunks = self.y.len().div_ceil(LANES).min(ABREAST);
        let descents = &mut descents[..chunks];
        for (descents, y) in descents.iter_mut().zip(self.y.chunks(LANES)) {
            // Lanes without a point keep the point 0.
            for ((y, in_x), in_y) in y.iter().zip(&mut descents.x).zip(&mut descents.y) {
                (*in_x, *in_y) = (y.x.clamp(0.0, BELOW_ONE), y.y.clamp(0.0, BELOW_ONE));
            }
        }
        for level in &self.tail.levels {
            for descents in descents.iter_mut() {
                descents.step(level);
            }
        }
        for (descents, out) in descents.iter().zip(self.out.chunks_mut(LANES)) {
            let ([u, v], jacobian) = descents.finish(self.tail);
            for (k, out) in out.iter_mut().enumerate() {
                *out = (Vec2::new(u[k], v[k]), jacobian[k]);
            }
        }
    }
}

impl TailWarp for Hierarchical {
    fn forward(&self, y: Vec2) -> (Vec2, f32) {
        let y = y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE));
        let mut bounds = Bounds { left: 0.0, right: 1.0, top: 0.0, bottom: 1.0 };
        let mut index = 0;
        for level in &self.levels {
            let [horizontal, above, below, _] = level.cuts[index as usize];
            let is_lower = y.y >= horizontal;
            let vertical = if is_lower { below } else { above };
            let is_right = y.x >= vertical;
            // Selections, not branches: which part a sample falls into cannot be predicted.
            bounds.top = if is_lower { horizontal } else { bounds.top };
            bounds.bottom = if is_lower { bounds.bottom } else { horizontal };
            bounds.left = if is_right { vertical } else { bounds.left };
            bounds.right = if is_right { bounds.right } else { vertical };
            let (lower, right) = (u32::from(is_lower), u32::from(is_right));
            index = level.child(index, lower, right);
        }
        let (column, row) = self.cell(index);
        let corners = self.grid.corners(column as usize, row as usize);
        let across = fraction(y.x, bounds.left, bounds.right);
        let down = fraction(y.y, bounds.top, bounds.bottom);
        let inside = corners.sample(Vec2::new(across, down));
        (self.grid.point(column, row, inside), 1.0 / corners.evaluate(inside))
    }

    fn forward_batch(&self, y: &[Vec2], out: &mut [(Vec2, f32)]) {
        for (y, out) in y.chunks(ABREAST * LANES).zip(out.chunks_mut(ABREAST * LANES)) {
            simd::dispatch(Forward { tail: self, y, out });
        }
    }

    fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        let (column, row, inside) = self.grid.cell(x);
        let corners = self.grid.corners(column, row);
        let Bounds { left, right, top, bottom } = self.bounds(column as u32, row as u32);
        let share = corners.invert(inside);
        let y = Vec2::new(left + share.x * (right - left), top + share.y * (bottom - top));
        (y.min(Vec2::splat(BELOW_ONE)), corners.evaluate(inside))
    }

    fn density(&self, x: Vec2) -> f32 {
        self.grid.density(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(columns: usize, rows: usize) -> Hierarchical {
        let luminance: Vec<f32> = (0..columns * (rows + 1)).map(|k| ((k * 7919) % 13) as f32).collect();
        Hierarchical::new(BilinearDensity::new(columns, rows + 1, &luminance).unwrap())
    }

    #[test]
    fn cells_are_numbered_one_to_one_for_every_shape() {
        for (columns, rows) in [(1, 1), (8, 8), (16, 4), (4, 32), (7, 3), (1, 9), (1024, 511)] {
            let tree = tree(columns, rows);
            let mut seen = vec![false; columns.next_power_of_two() * rows.next_power_of_two()];
            for row in 0..rows as u32 {
                for column in 0..columns as u32 {
                    let index = cell_index(tree.square_levels, column, row);
                    assert_eq!(tree.cell(index), (column, row), "{columns} x {rows}");
                    assert!(!std::mem::replace(&mut seen[index as usize], true));
                }
            }
        }
    }

    #[test]
    fn rectangles_tile_the_square_in_proportion_to_the_light() {
        for (columns, rows) in [(1, 1), (16, 4), (4, 32), (7, 3), (64, 31)] {
            let tree = tree(columns, rows);
            let cells = (columns * rows) as f32;
            let mut sum = 0.0;
            for row in 0..rows {
                for column in 0..columns {
                    let Bounds { left, right, top, bottom } = tree.bounds(column as u32, row as u32);
                    let (area, mass) = ((right - left) * (bottom - top), tree.grid.corners(column, row).mean() / cells);
                    assert!((0.0..=1.0).contains(&left) && right <= 1.0 && top >= 0.0 && bottom <= 1.0);
                    // Four bounds, each rounded to 6e-8, times sides of at most 1.
                    assert!((area - mass).abs() < 3e-7, "{columns} x {rows}: {column} {row}: {area} {mass}");
                    sum += area;
                }
            }
            assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        }
    }

    #[test]
    fn batches_are_warped_like_single_points() {
        let tree = tree(64, 31);
        let y: Vec<Vec2> = (0..1000).map(|k| Vec2::new(k as f32 * 0.618_034 % 1.0, k as f32 / 999.0)).collect();
        for length in [1, 15, 16, 17, 63, 64, 65, 1000] {
            let mut out = vec![(Vec2::ZERO, 0.0); length];
            tree.forward_batch(&y[..length], &mut out);
            for (&y, &out) in y.iter().zip(&out) {
                assert_eq!(tree.forward(y), out);
            }
        }
    }
}
