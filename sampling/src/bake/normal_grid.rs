//! The grid of normals over which a table is interpolated.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Vec2, Vec3A};

use crate::{
    error::{Error, Result},
    latlong,
};

/// A lat-long grid of normals: `polar` rows from +Y to -Y, both included, times `azimuth` columns around.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NormalGrid {
    polar: usize,
    azimuth: usize,
}

impl NormalGrid {
    /// Makes a grid of `polar x azimuth` normals.
    ///
    /// # Errors
    /// `polar` must be 2 to 256 and `azimuth` 3 to 512.
    pub fn new(polar: usize, azimuth: usize) -> Result<Self> {
        if !(2..=256).contains(&polar) || !(3..=512).contains(&azimuth) {
            return Err(Error::argument("normals", format!("{polar}x{azimuth}: choose from 2x3 up to 256x512")));
        }
        Ok(Self { polar, azimuth })
    }

    /// Rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        (self.polar, self.azimuth)
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.polar * self.azimuth
    }

    /// The unit normal of a node.
    pub fn normal(&self, node: usize) -> Vec3A {
        let (row, column) = (node / self.azimuth, node % self.azimuth);
        latlong::direction(Vec2::new(column as f32 / self.azimuth as f32, row as f32 / (self.polar - 1) as f32))
    }

    /// The position of a unit normal on the grid: column and row, as real numbers.
    ///
    /// The angles come from a polynomial of error 1e-5. Weights may be off by 1e-4, without bias, since
    /// draws and pdfs use the same weights.
    #[inline(always)]
    pub(super) fn position(&self, [x, y, z]: [f32; 3]) -> Vec2 {
        let azimuth = fast_atan2(x, -z) * (self.azimuth as f32 / TAU);
        let azimuth = if azimuth < 0.0 { azimuth + self.azimuth as f32 } else { azimuth };
        let horizontal = (x * x + z * z).sqrt();
        let polar = fast_atan2(horizontal, y).max(0.0) * ((self.polar - 1) as f32 / PI);
        Vec2::new(azimuth, polar)
    }

    /// The cell of the grid around a position.
    #[inline(always)]
    pub(super) fn cell(&self, Vec2 { x: azimuth, y: polar }: Vec2) -> GridCell {
        let columns = self.azimuth as i32;
        // Signed, as there is no SIMD conversion to unsigned integers; positions are far below 2^31.
        let column = (azimuth as i32).min(columns - 1).max(0);
        let row = (polar as i32).min(self.polar as i32 - 2).max(0);
        let across = (azimuth - column as f32).clamp(0.0, 1.0);
        let down = (polar - row as f32).clamp(0.0, 1.0);
        GridCell { number: (row * columns + column) as u32, across, down }
    }

    /// Number of cells between nodes. A cell has the index of its upper left node.
    pub(super) fn cells(&self) -> usize {
        (self.polar - 1) * self.azimuth
    }

    /// The nodes at the upper left, upper right, lower left and lower right of a cell.
    pub(super) fn corners(&self, cell: usize) -> [usize; 4] {
        let next = if (cell + 1).is_multiple_of(self.azimuth) { cell + 1 - self.azimuth } else { cell + 1 };
        [cell, next, cell + self.azimuth, next + self.azimuth]
    }

    /// A cell that has a node as a corner, and the corner's index.
    pub(super) fn cell_of(&self, node: usize) -> (usize, usize) {
        if node < self.cells() { (node, 0) } else { (node - self.azimuth, 2) }
    }
}

/// A normal with its interpolation stencil.
#[derive(Clone, Copy, Debug)]
pub(super) struct Served {
    pub normal: Vec3A,
    nodes: [usize; 4],
    weights: [f32; 4],
    /// Length of the weighted sum of the nodes' normals.
    pub length: f32,
}

impl Served {
    /// Nodes and their weights.
    pub fn stencil(&self) -> impl Iterator<Item = (usize, f32)> {
        self.nodes.into_iter().zip(self.weights)
    }
}

impl NormalGrid {
    /// Normals in all cells of the grid, `side x side` per cell from its first corner on, which include
    /// all nodes.
    pub(super) fn between(&self, side: usize) -> Vec<Served> {
        let (down, around) = ((self.polar - 1) * side, self.azimuth * side);
        let served = |row: usize, column: usize| self.served(Vec2::new(column as f32, row as f32) / side as f32);
        (0..=down).flat_map(|row| (0..around).map(move |column| served(row, column))).collect()
    }

    /// The normal at a position on the grid.
    fn served(&self, position: Vec2) -> Served {
        let normal = latlong::direction(position / Vec2::new(self.azimuth as f32, (self.polar - 1) as f32));
        let cell = self.cell(position);
        let (nodes, weights) = (self.corners(cell.number as usize), cell.weights());
        let sum: Vec3A = nodes.iter().zip(weights).map(|(&node, weight)| weight * self.normal(node)).sum();
        Served { normal, nodes, weights, length: sum.length() }
    }

    /// For each row of nodes, the largest angle in radians between a normal in the adjacent cells and
    /// the weighted sum of its nodes' normals.
    pub(super) fn reaches(&self) -> Vec<f32> {
        /// Less than pi, so that a cap widened by it does not wrap around.
        const FARTHEST: f32 = 3.0;
        /// Normals along a side of a cell: the angle is smooth, and 0 at the corners.
        const SIDE: usize = 16;
        let angle = |row: usize, k: usize| {
            let inside = Vec2::new((k % (SIDE + 1)) as f32, (k / (SIDE + 1)) as f32) / SIDE as f32;
            let Served { normal, nodes, weights, .. } =
                self.served(Vec2::new(0.0, row as f32) + inside.min(Vec2::splat(0.999_999)));
            let sum: Vec3A = nodes.iter().zip(weights).map(|(&node, weight)| weight * self.normal(node)).sum();
            // The sum of opposite normals may vanish and then has no direction.
            let angle = normal.angle_between(sum);
            if angle < FARTHEST { angle } else { FARTHEST }
        };
        let of_cells: Vec<f32> =
            (0..self.polar - 1).map(|row| (0..(SIDE + 1).pow(2)).map(|k| angle(row, k)).fold(0.0, f32::max)).collect();
        (0..self.polar).map(|row| of_cells[row.saturating_sub(1)].max(of_cells[row.min(self.polar - 2)])).collect()
    }
}

/// A cell of the grid and a position in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridCell {
    /// The index of the upper left node.
    pub number: u32,
    /// Position inside, in `[0, 1]`.
    across: f32,
    down: f32,
}

impl GridCell {
    /// The bilinear weights of the upper left, upper right, lower left and lower right nodes.
    #[inline(always)]
    pub fn weights(&self) -> [f32; 4] {
        let (s, t) = (self.across, self.down);
        [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t]
    }
}

/// `atan2` with an absolute error of about 1e-5 (Abramowitz and Stegun 1964, 4.4.49); 0 at the origin.
#[inline(always)]
fn fast_atan2(y: f32, x: f32) -> f32 {
    let (small, large) = (y.abs().min(x.abs()), y.abs().max(x.abs()));
    let a = small / large.max(f32::MIN_POSITIVE);
    let s = a * a;
    let angle = a * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let angle = if y.abs() > x.abs() { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    /// Nodes and weights around a normal.
    struct Stencil {
        nodes: [usize; 4],
        weights: [f32; 4],
    }

    fn stencil(grid: &NormalGrid, normal: Vec3A) -> Stencil {
        let cell = grid.cell(grid.position(normal.to_array()));
        Stencil { nodes: grid.corners(cell.number as usize), weights: cell.weights() }
    }

    #[test]
    fn stencils_are_partitions_of_unity_near_their_normal() {
        let grid = NormalGrid::new(16, 32).unwrap();
        let mut random = Stream::new(1, Purpose::Test, 0);
        for _ in 0..20_000 {
            let normal = random.direction();
            let stencil = stencil(&grid, normal);
            assert!((stencil.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            assert!(stencil.weights.iter().all(|weight| *weight >= 0.0));
            let mean: Vec3A = (0..4).map(|k| grid.normal(stencil.nodes[k]) * stencil.weights[k]).sum();
            // The chord of a 12 degree cell lies at most 1 - cos(8.2 degrees) below the sphere.
            assert!(mean.normalize().dot(normal) > 0.999, "{normal}");
        }
    }

    #[test]
    fn nodes_interpolate_to_themselves() {
        let grid = NormalGrid::new(16, 32).unwrap();
        for node in 32..grid.nodes() - 32 {
            let stencil = stencil(&grid, grid.normal(node));
            let own: f32 = (0..4).filter(|&k| stencil.nodes[k] == node).map(|k| stencil.weights[k]).sum();
            assert!(own > 0.999, "node {node}: {own}");
        }
    }

    #[test]
    fn poles_and_seam_are_covered() {
        let grid = NormalGrid::new(2, 3).unwrap();
        for normal in
            [Vec3A::Y, -Vec3A::Y, Vec3A::Z, -Vec3A::Z, Vec3A::new(-1e-20, 0.0, -1.0), Vec3A::new(-0.0, 1.0, 0.0)]
        {
            let stencil = stencil(&grid, normal);
            assert!(stencil.nodes.iter().all(|&node| node < grid.nodes()));
            assert!((stencil.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
    }
}
