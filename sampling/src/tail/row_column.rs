//! The marginal/conditional tail: first a row in proportion to its light, then a column within the row.

use glam::Vec2;

use super::{TailWarp, each_lane};
use crate::{
    discrete::{BELOW_ONE, last_at_most, remap},
    environment::{BilinearDensity, invert_linear, sample_linear},
    simd::Lanes,
};

/// The row-column tail (the inversion method in two steps, as in pbrt and Mitsuba), exact for the bilinear
/// density: the marginal is piecewise linear over v, and so is the conditional over u, whose nodes
/// interpolate those of the two rows around v.
#[derive(Clone, Debug)]
pub struct RowColumn {
    grid: BilinearDensity,
    /// Marginal density at the rows of nodes, `[rows + 1]`.
    marginal: Vec<f32>,
    /// Fraction of the light above each row of nodes, `[rows + 1]`, from 0 to 1.
    above: Vec<f32>,
    /// Integral of each row of nodes from its first texel centre to each texel centre,
    /// `[rows + 1][columns + 1]`.
    before: Vec<f32>,
}

impl RowColumn {
    /// Builds the tables of a density.
    pub fn new(grid: BilinearDensity) -> Self {
        let (columns, rows) = (grid.columns(), grid.rows());
        let mut before = Vec::with_capacity((columns + 1) * (rows + 1));
        let mut sums = Vec::with_capacity(rows + 1);
        let all: Vec<f32> = grid.nodes().collect();
        for nodes in all.chunks_exact(columns) {
            let mut sum = 0.0_f64;
            before.push(0.0);
            for column in 0..columns {
                sum += 0.5 * f64::from(nodes[column] + nodes[(column + 1) % columns]) / columns as f64;
                before.push(sum as f32);
            }
            sums.push(sum);
        }
        let steps: Vec<f64> = sums.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        let total: f64 = steps.iter().sum();
        let mut above = vec![0.0_f32];
        let mut sum = 0.0;
        for step in steps {
            sum += step;
            above.push((sum / total) as f32);
        }
        Self { grid, marginal: sums.into_iter().map(|sum| sum as f32).collect(), above, before }
    }

    /// Returns the density of the map.
    pub fn grid(&self) -> &BilinearDensity {
        &self.grid
    }

    pub(super) fn grid_mut(&mut self) -> &mut BilinearDensity {
        &mut self.grid
    }

    /// Returns marginal densities, fractions above, and integrals of rows, for other devices.
    pub(super) fn tables(&self) -> [&[f32]; 3] {
        [&self.marginal, &self.above, &self.before]
    }

    /// Returns the integral of the interpolated row from its first texel centre to the left edge of a cell.
    fn before(&self, row: usize, t: f32, column: usize) -> f32 {
        let stride = self.grid.columns() + 1;
        let (upper, lower) = (self.before[row * stride + column], self.before[(row + 1) * stride + column]);
        (1.0 - t) * upper + t * lower
    }
}

impl RowColumn {
    fn warp(&self, y: Vec2) -> (Vec2, f32) {
        let y = y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE));
        let row = last_at_most(self.grid.rows(), y.y, |row| self.above[row]);
        let fraction = remap(y.y, self.above[row], self.above[row + 1]);
        let t = sample_linear(fraction, self.marginal[row], self.marginal[row + 1]);

        let columns = self.grid.columns();
        let target = y.x * self.before(row, t, columns);
        let column = last_at_most(columns, target, |column| self.before(row, t, column));
        let fraction = remap(target, self.before(row, t, column), self.before(row, t, column + 1));
        let corners = self.grid.corners(column, row);
        let [a, b, c, d] = corners.0;
        let s = sample_linear(fraction, (1.0 - t) * a + t * c, (1.0 - t) * b + t * d);
        let inside = Vec2::new(s, t);
        (self.grid.point(column as u32, row as u32, inside), 1.0 / corners.evaluate(inside))
    }

    fn unwarp(&self, x: Vec2) -> (Vec2, f32) {
        let (column, row, inside) = self.grid.cell(x);
        let corners = self.grid.corners(column, row);
        let [a, b, c, d] = corners.0;
        let t = inside.y;
        let down = invert_linear(t, self.marginal[row], self.marginal[row + 1]);
        let v = self.above[row] + down * (self.above[row + 1] - self.above[row]);
        let across = invert_linear(inside.x, (1.0 - t) * a + t * c, (1.0 - t) * b + t * d);
        let (start, end) = (self.before(row, t, column), self.before(row, t, column + 1));
        let total = self.before(row, t, self.grid.columns());
        let u = if total > 0.0 { (start + across * (end - start)) / total } else { inside.x };
        (Vec2::new(u, v).min(Vec2::splat(BELOW_ONE)), corners.evaluate(inside))
    }
}

impl TailWarp for RowColumn {
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]) {
        each_lane(y, x, jacobian, |y| self.warp(y));
    }

    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]) {
        each_lane(x, y, density, |x| self.unwarp(x));
    }

    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]) {
        self.grid.densities(x, density);
    }
}
