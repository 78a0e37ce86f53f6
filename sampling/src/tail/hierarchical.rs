//! The quad-tree tail: a warp that halves the map recursively (after Clarberg et al. 2005).

use glam::Vec2;

use super::{Node, TailWarp};
use crate::{
    columns::vectorized,
    discrete::{BELOW_ONE, remap},
    environment::BilinearDensity,
    large::Large,
    morton::{gather, spread},
    parallel::*,
    simd::{LANES, Lanes, Quads},
};

/// The cuts of a node's rectangle of Y: y of the horizontal cut, x of the vertical cut above it, x of the one
/// below it, 0.
type Cuts = [f32; 4];

/// The hierarchical tail. From the root down, the rectangle of Y of a node is cut into an upper and a lower
/// part, and each of these into a left and a right one, in proportion to the light in the quarters of its
/// part of X; within a cell the bilinear density is inverted in closed form. It keeps neighbours together
/// better than [`super::RowColumn`] on most maps.
///
/// A node stores the positions of its cuts, not their ratios: the descent rescales nothing, and the inverse
/// needs only the four numbers that bound a cell's rectangle.
#[derive(Clone, Debug)]
pub struct Hierarchical {
    grid: BilinearDensity,
    /// Root first.
    levels: Vec<Level>,
    /// Number of the last levels that cut both ways; a map that is not square has levels above in which only
    /// columns or only rows are cut.
    square_levels: u32,
    /// All bits set if the levels above cut columns, 0 if they cut rows.
    top_columns: u32,
}

#[derive(Clone, Debug)]
struct Level {
    /// 1 if nodes of this level have two columns of children, else 0; `row_bits` likewise for rows.
    column_bits: u32,
    row_bits: u32,
    /// In the order of the descent: the children of a node are adjacent.
    cuts: Large<Cuts>,
}

impl Level {
    #[inline(always)]
    fn child(&self, index: u32, lower: u32, right: u32) -> u32 {
        (index << (self.column_bits + self.row_bits)) + (lower << self.column_bits) + right
    }

    /// Loads the cuts of nodes.
    #[inline(always)]
    fn load(&self, index: &[u32; LANES]) -> [Lanes; 3] {
        let [horizontal, above, below, _] = self.cuts.load(index);
        [horizontal, above, below]
    }
}

/// Least number of nodes for which a thread is used.
const PER_THREAD: usize = 4096;

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
                Level { column_bits: bits(columns), row_bits: bits(rows), cuts: Large::Ordinary(Vec::new()) }
            })
            .collect();
        let top_columns = if columns > rows { u32::MAX } else { 0 };
        let densities = grid.grid();
        let mass = |index: u32| {
            let (column, row) = cell(square_levels, top_columns, index);
            let is_padding = column as usize >= grid.columns() || row as usize >= grid.rows();
            if is_padding { 0.0 } else { f64::from(densities.corners(column as usize, row as usize).mean()) }
        };
        let cells = columns * rows;
        let mut masses: Vec<Vec<f64>> =
            vec![(0..cells as u32).into_par_iter().with_min_len(PER_THREAD).map(mass).collect()];
        for level in levels.iter().rev() {
            let finer = &masses[masses.len() - 1];
            // Sums halves first, as the cuts do.
            masses.push(match level.column_bits + level.row_bits {
                2 => finer.as_chunks().0.iter().map(|[a, b, c, d]| (a + b) + (c + d)).collect(),
                _ => finer.as_chunks().0.iter().map(|[a, b]| a + b).collect(),
            });
        }
        masses.reverse();
        let mut bounds = vec![Bounds::SQUARE];
        for (level, masses) in levels.iter_mut().zip(&masses[1..]) {
            let children = 1 << (level.column_bits + level.row_bits);
            let of_node = |node: usize| cut(level, &bounds[node], &masses[node * children..][..children]);
            let nodes = 0..bounds.len();
            // Cells have no cuts, so their rectangles are not needed.
            let (cuts, inner): (Vec<Cuts>, _) = if masses.len() == cells {
                (nodes.into_par_iter().with_min_len(PER_THREAD).map(|node| of_node(node).0).collect(), Vec::new())
            } else {
                let mut inner = Vec::with_capacity(masses.len());
                let cuts = nodes.map(|node| {
                    let (cuts, parts) = of_node(node);
                    inner.extend(&parts[..children]);
                    cuts
                });
                (cuts.collect(), inner)
            };
            level.cuts = cuts.into();
            bounds = inner;
        }
        Self { grid, levels, square_levels, top_columns }
    }

    /// Returns levels from the root down, for other devices: the logarithms of the numbers of columns and
    /// rows of children of a node, and the cuts of all nodes `[nodes, 4]`, the children of a node side by
    /// side: y of the horizontal cut, x of the vertical cut above and below it, 0.
    pub fn levels(&self) -> impl ExactSizeIterator<Item = ([u32; 2], &[[f32; 4]])> {
        self.levels.iter().map(|level| ([level.column_bits, level.row_bits], &*level.cuts))
    }

    /// Returns the density of the map.
    pub fn grid(&self) -> &BilinearDensity {
        &self.grid
    }

    pub(super) fn grid_mut(&mut self) -> &mut BilinearDensity {
        &mut self.grid
    }

    /// Returns the rectangle of Y that maps to a node: left, right, top, bottom.
    pub fn rectangle(&self, node: Node) -> [f32; 4] {
        let ([mut left, mut right, mut top, mut bottom], mut index) = ([0.0, 1.0, 0.0, 1.0], 0);
        for (level, bits) in self.levels.iter().zip((0..self.levels.len() as u32).rev()) {
            let [horizontal, above, below, _] = level.cuts[index as usize];
            let (is_lower, is_right) = (node.row >> bits & level.row_bits, node.column >> bits & level.column_bits);
            if level.row_bits == 1 && node.height_bits <= bits {
                if is_lower == 1 { top = horizontal } else { bottom = horizontal }
            }
            if level.column_bits == 1 && node.width_bits <= bits {
                let vertical = if is_lower == 1 { below } else { above };
                if is_right == 1 { left = vertical } else { right = vertical }
            }
            if node.width_bits.max(node.height_bits) > bits {
                break;
            }
            index = level.child(index, is_lower, is_right);
        }
        [left, right, top, bottom]
    }

    /// Returns the rectangles of cells: each side is a cut of the lowest ancestor whose cut borders the cell.
    /// A side that no ancestor sets is the square's own.
    #[inline(always)]
    fn bounds(&self, columns: &[u32; LANES], rows: &[u32; LANES]) -> Bounds<Lanes> {
        let mut bounds = Bounds { left: MISSING, right: MISSING, top: MISSING, bottom: MISSING };
        let (mut columns, mut rows, mut index) = (*columns, *rows, [0; LANES]);
        for k in 0..LANES {
            index[k] = cell_index(self.square_levels, columns[k], rows[k]);
        }
        for level in self.levels.iter().rev() {
            let (mut right, mut lower) = ([0; LANES], [0; LANES]);
            for k in 0..LANES {
                (right[k], lower[k]) = (columns[k] & level.column_bits, rows[k] & level.row_bits);
                columns[k] >>= level.column_bits;
                rows[k] >>= level.row_bits;
                index[k] >>= level.column_bits + level.row_bits;
            }
            let [horizontal, above, below] = level.load(&index);
            let mut missing = 0;
            for k in 0..LANES {
                let vertical = if lower[k] == 0 { above[k] } else { below[k] };
                // A side that was found at a lower level stays.
                let Bounds { left, right: right_side, top, bottom } = &mut bounds;
                right_side[k] = if (right[k] == 0) & (right_side[k] < 0.0) { vertical } else { right_side[k] };
                left[k] = if (right[k] != 0) & (left[k] < 0.0) { vertical } else { left[k] };
                bottom[k] = if (lower[k] == 0) & (bottom[k] < 0.0) { horizontal[k] } else { bottom[k] };
                top[k] = if (lower[k] != 0) & (top[k] < 0.0) { horizontal[k] } else { top[k] };
                missing |= u32::from((left[k] < 0.0) | (right_side[k] < 0.0) | (top[k] < 0.0) | (bottom[k] < 0.0));
            }
            if missing == 0 {
                return bounds;
            }
        }
        let Bounds { left, right, top, bottom } = &mut bounds;
        for k in 0..LANES {
            left[k] = if left[k] < 0.0 { 0.0 } else { left[k] };
            right[k] = if right[k] < 0.0 { 1.0 } else { right[k] };
            top[k] = if top[k] < 0.0 { 0.0 } else { top[k] };
            bottom[k] = if bottom[k] < 0.0 { 1.0 } else { bottom[k] };
        }
        bounds
    }
}

/// Marks sides that are not found yet; cuts are in `[0, 1]`.
const MISSING: Lanes = [-1.0; LANES];

/// Returns the number of a cell in the order of the descent: the interleaved bits of row and column, below
/// the bits that only one of them has.
#[inline(always)]
fn cell_index(square_levels: u32, column: u32, row: u32) -> u32 {
    let low = (1 << square_levels) - 1;
    // One of the two is 0.
    let top = (column >> square_levels) | (row >> square_levels);
    (top << (2 * square_levels)) | (spread(row & low) << 1) | spread(column & low)
}

/// Returns column and row of a number in the order of the descent: the inverse of [`cell_index`].
#[inline(always)]
fn cell(square_levels: u32, top_columns: u32, index: u32) -> (u32, u32) {
    let bits = 2 * square_levels;
    let (top, low) = (index >> bits, index & ((1 << bits) - 1));
    let (column, row) = (gather(low), gather(low >> 1));
    (column + ((top & top_columns) << square_levels), row + ((top & !top_columns) << square_levels))
}

/// Cuts a node's rectangle in proportion to the masses of its children; returns the cuts and the children's
/// rectangles.
fn cut(level: &Level, bounds: &Bounds<f64>, masses: &[f64]) -> (Cuts, [Bounds<f64>; 4]) {
    let per_row = 1 << level.column_bits;
    let (upper, lower) = masses.split_at(per_row);
    let whole = |row: &[f64]| row.iter().sum::<f64>();
    let horizontal = between(bounds.top, bounds.bottom, whole(upper), whole(lower));
    let (mut cuts, mut children) = ([horizontal as f32, 0.0, 0.0, 0.0], [*bounds; 4]);
    for (row, masses) in [upper, lower].into_iter().enumerate() {
        let right = masses.get(1).copied().unwrap_or(0.0);
        let vertical = between(bounds.left, bounds.right, masses.first().copied().unwrap_or(0.0), right);
        cuts[1 + row] = vertical as f32;
        let [top, bottom] = [[bounds.top, horizontal], [horizontal, bounds.bottom]][row];
        // In a row without a second column, only the first child exists.
        children[row * per_row] = Bounds { left: bounds.left, right: vertical, top, bottom };
        if per_row == 2 {
            children[2 * row + 1] = Bounds { left: vertical, right: bounds.right, top, bottom };
        }
    }
    (cuts, children)
}

/// Returns the position of the cut of an interval in proportion to two masses; its end where there is nothing
/// to divide.
fn between(start: f64, end: f64, first: f64, second: f64) -> f64 {
    if second > 0.0 { (start + (end - start) * (first / (first + second))).clamp(start, end) } else { end }
}

/// Points of Y that descend the tree, one per lane.
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

    /// Descends one level.
    #[inline(always)]
    fn step(&mut self, level: &Level) {
        let [horizontal, above, below] = &level.load(&self.index);
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

    /// Returns the points of X, and the Jacobians there.
    #[inline(always)]
    fn finish(&self, tail: &Hierarchical) -> ([Lanes; 2], Lanes) {
        let (grid, nodes) = (&tail.grid, tail.grid.grid());
        let (mut columns, mut rows) = ([0; LANES], [0; LANES]);
        for k in 0..LANES {
            (columns[k], rows[k]) = cell(tail.square_levels, tail.top_columns, self.index[k]);
        }
        let all_corners = nodes.corners_of(&columns, &rows);
        let (mut x, mut jacobian) = ([[0.0; LANES]; 2], [0.0; LANES]);
        for k in 0..LANES {
            let corners = &all_corners[k];
            let across = remap(self.x[k], self.bounds.left[k], self.bounds.right[k]);
            let down = remap(self.y[k], self.bounds.top[k], self.bounds.bottom[k]);
            let inside = corners.sample(Vec2::new(across, down));
            let point = grid.point(columns[k], rows[k], inside);
            (x[0][k], x[1][k]) = (point.x, point.y);
            jacobian[k] = 1.0 / corners.evaluate(inside);
        }
        (x, jacobian)
    }
}

/// Number of strips that descend together, to hide memory latency.
const STRIPS: usize = 4;

vectorized! {
    fn descend['a](
        _simd, tail: &'a Hierarchical, y: [&'a [Lanes]; 2], x: [&'a mut [Lanes]; 2], jacobian: &'a mut [Lanes],
    ) {
        let [x_u, x_v] = x;
        for first in (0..jacobian.len()).step_by(STRIPS) {
            let count = STRIPS.min(jacobian.len() - first);
            let mut descents = [Descents::AT_THE_ROOT; STRIPS];
            let descents = &mut descents[..count];
            for (k, descents) in descents.iter_mut().enumerate() {
                for lane in 0..LANES {
                    descents.x[lane] = remap(y[0][first + k][lane], 0.0, 1.0);
                    descents.y[lane] = remap(y[1][first + k][lane], 0.0, 1.0);
                }
            }
            for level in &tail.levels {
                for descents in descents.iter_mut() {
                    descents.step(level);
                }
            }
            for (k, descents) in descents.iter().enumerate() {
                ([x_u[first + k], x_v[first + k]], jacobian[first + k]) = descents.finish(tail);
            }
        }
    }
}

vectorized! {
    fn ascend['a](
        _simd, tail: &'a Hierarchical, x: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], density: &'a mut [Lanes],
    ) {
        let [y_u, y_v] = y;
        for strip in 0..density.len() {
            let (u, v) = (x[0][strip], x[1][strip]);
            let (mut columns, mut rows, mut inside) = ([0; LANES], [0; LANES], [Vec2::ZERO; LANES]);
            let nodes = tail.grid.grid();
            for k in 0..LANES {
                let (column, row, place) = tail.grid.cell(Vec2::new(u[k], v[k]));
                (columns[k], rows[k], inside[k]) = (column as u32, row as u32, place);
            }
            let corners = nodes.corners_of(&columns, &rows);
            let Bounds { left, right, top, bottom } = tail.bounds(&columns, &rows);
            for k in 0..LANES {
                let fraction = corners[k].invert(inside[k]);
                let u = left[k] + fraction.x * (right[k] - left[k]);
                let v = top[k] + fraction.y * (bottom[k] - top[k]);
                y_u[strip][k] = if u < BELOW_ONE { u } else { BELOW_ONE };
                y_v[strip][k] = if v < BELOW_ONE { v } else { BELOW_ONE };
                density[strip][k] = corners[k].evaluate(inside[k]);
            }
        }
    }
}

impl TailWarp for Hierarchical {
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]) {
        descend(self, y, x, jacobian);
    }

    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]) {
        ascend(self, x, y, density);
    }

    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]) {
        self.grid.densities(x, density);
    }
}

#[cfg(test)]
mod tests;
