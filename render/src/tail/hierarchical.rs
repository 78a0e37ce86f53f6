//! The quad-tree tail: a warp that halves the map again and again (after Clarberg et al. 2005).

use glam::{UVec2, Vec2};

use super::{BELOW_ONE, TailWarp, density::BilinearDensity};

/// How a node divides its light: `[share of the upper half, share of the left in the upper half, ... in the lower half, 0]`.
type Split = [f32; 4];

/// The hierarchical tail. From the root down, a point of Y is put into the upper or lower half, then into the left or right
/// half, in proportion to the light in them, and stretched; within a cell the bilinear density is inverted in closed form.
/// It keeps neighbours together better than [`super::RowColumn`] on most maps.
#[derive(Clone, Debug)]
pub struct Hierarchical {
    grid: BilinearDensity,
    /// Root first. A level's splits are row-major; `size` counts its nodes.
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    columns: usize,
    /// Whether a node of this level divides horizontally or vertically at all: a map that is wider than high has levels in
    /// which only columns are divided.
    splits_columns: bool,
    splits_rows: bool,
    splits: Vec<Split>,
}

impl Hierarchical {
    /// Builds the tree over the cells of a density.
    pub fn new(grid: BilinearDensity) -> Self {
        let (mut columns, mut rows) = (grid.columns().next_power_of_two(), grid.rows().next_power_of_two());
        let mut masses = vec![0.0_f64; columns * rows];
        for row in 0..grid.rows() {
            for column in 0..grid.columns() {
                masses[row * columns + column] = f64::from(grid.corners(column, row).mean());
            }
        }
        let mut levels = Vec::new();
        while columns > 1 || rows > 1 {
            let (splits_columns, splits_rows) = (columns > 1, rows > 1);
            let (parent_columns, parent_rows) = ((columns / 2).max(1), (rows / 2).max(1));
            let mut parents = vec![0.0_f64; parent_columns * parent_rows];
            let mut splits = vec![[0.0; 4]; parents.len()];
            for (index, (parent, split)) in parents.iter_mut().zip(&mut splits).enumerate() {
                let (column, row) = (index % parent_columns, index / parent_columns);
                let child = |right: usize, lower: usize| {
                    let column = if splits_columns { 2 * column + right } else { column };
                    let row = if splits_rows { 2 * row + lower } else { row };
                    let exists = (splits_columns || right == 0) && (splits_rows || lower == 0);
                    if exists { masses[row * columns + column] } else { 0.0 }
                };
                let (upper, lower) = (child(0, 0) + child(1, 0), child(0, 1) + child(1, 1));
                *parent = upper + lower;
                *split = [share(upper, *parent), share(child(0, 0), upper), share(child(0, 1), lower), 0.0];
            }
            levels.push(Level { columns: parent_columns, splits_columns, splits_rows, splits });
            (columns, rows, masses) = (parent_columns, parent_rows, parents);
        }
        levels.reverse();
        Self { grid, levels }
    }

    /// The density of the map.
    pub fn grid(&self) -> &BilinearDensity {
        &self.grid
    }
}

/// `part / whole`, and 1 where there is nothing to divide.
fn share(part: f64, whole: f64) -> f32 {
    if whole > 0.0 { (part / whole) as f32 } else { 1.0 }
}

/// Puts a coordinate into one of two parts of sizes `share` and `1 - share`, and stretches it to `[0, 1)`.
fn descend(coordinate: &mut f32, share: f32) -> usize {
    let second = *coordinate >= share;
    // Both halves are computed and one is selected: which half a sample falls into cannot be predicted.
    let first_half = *coordinate / share;
    let second_half = (*coordinate - share) / (1.0 - share);
    *coordinate = if second { second_half } else { first_half }.clamp(0.0, BELOW_ONE);
    usize::from(second)
}

/// The inverse of [`descend`].
fn ascend(coordinate: &mut f32, second: bool, share: f32) {
    *coordinate = if second { share + *coordinate * (1.0 - share) } else { *coordinate * share };
}

/// A point of Y on its way down the tree.
#[derive(Clone, Copy, Debug)]
struct Descent {
    y: Vec2,
    column: usize,
    row: usize,
}

impl Descent {
    fn new(y: Vec2) -> Self {
        Self { y: y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)), column: 0, row: 0 }
    }

    #[inline(always)]
    fn step(&mut self, level: &Level) {
        let [upper, left_of_upper, left_of_lower, _] = level.splits[self.row * level.columns + self.column];
        let lower = descend(&mut self.y.y, upper);
        let right = descend(&mut self.y.x, if lower == 0 { left_of_upper } else { left_of_lower });
        self.column = (self.column << usize::from(level.splits_columns)) + right;
        self.row = (self.row << usize::from(level.splits_rows)) + lower;
    }

    fn finish(self, grid: &BilinearDensity) -> (Vec2, f32) {
        let corners = grid.corners(self.column, self.row);
        let inside = corners.sample(self.y);
        (grid.point(self.column, self.row, inside), 1.0 / corners.evaluate(inside))
    }
}

/// Points that go down the tree side by side: each waits for memory and divisions while the others move.
const ABREAST: usize = 16;

impl TailWarp for Hierarchical {
    fn forward(&self, y: Vec2) -> (Vec2, f32) {
        let mut descent = Descent::new(y);
        for level in &self.levels {
            descent.step(level);
        }
        descent.finish(&self.grid)
    }

    fn forward_batch(&self, y: &[Vec2], out: &mut [(Vec2, f32)]) {
        for (y, out) in y.chunks(ABREAST).zip(out.chunks_mut(ABREAST)) {
            let mut descents = [Descent::new(Vec2::ZERO); ABREAST];
            let descents = &mut descents[..y.len()];
            for (descent, &y) in descents.iter_mut().zip(y) {
                *descent = Descent::new(y);
            }
            for level in &self.levels {
                for descent in &mut *descents {
                    descent.step(level);
                }
            }
            for (descent, out) in descents.iter().zip(out) {
                *out = descent.finish(&self.grid);
            }
        }
    }

    fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        let (column, row, inside) = self.grid.cell(x);
        let corners = self.grid.corners(column, row);
        let mut y = corners.invert(inside);
        let mut node = UVec2::new(column as u32, row as u32);
        for level in self.levels.iter().rev() {
            let right = level.splits_columns && node.x & 1 == 1;
            let lower = level.splits_rows && node.y & 1 == 1;
            node = UVec2::new(node.x >> u32::from(level.splits_columns), node.y >> u32::from(level.splits_rows));
            let [upper, left_of_upper, left_of_lower, _] =
                level.splits[node.y as usize * level.columns + node.x as usize];
            ascend(&mut y.x, right, if lower { left_of_lower } else { left_of_upper });
            ascend(&mut y.y, lower, upper);
        }
        (y.min(Vec2::splat(BELOW_ONE)), corners.evaluate(inside))
    }

    fn density(&self, x: Vec2) -> f32 {
        self.grid.density(x)
    }
}
