//! The normalised density of an environment map's light over the sample square.

use std::{f64::consts::PI, sync::Arc};

use glam::Vec2;

use super::bilinear::Corners;
use crate::{
    columns::vectorized,
    discrete::BELOW_ONE,
    error::{Error, Result},
    large::Large,
    latlong,
    simd::{LANES, Lanes},
};

/// `luminance x sin theta`, normalised to integrate to 1 over X, bilinear between the texels of the map.
///
/// Luminance is a linear function of radiance, so this equals the luminance of the bilinear radiance
/// lookup, except for the sine, which is linear within a cell here. It is positive wherever the
/// bilinear luminance is, pole rows included: their weight is the mean of the sine over their half
/// cell.
///
/// Cells lie *between* texel centres: cell `i` of a row spans texels `i` and `i + 1` (periodic), so a
/// cell's left edge is at `u = (i + 0.5) / width`.
///
/// The density of a map's own light is stored beside its texels, so that sampling brings the radiance
/// into the cache; the density of other luminance takes 4 bytes per texel.
#[derive(Clone, Debug)]
pub struct BilinearDensity {
    width: usize,
    height: usize,
    nodes: Nodes,
}

/// The densities at the texels, row-major.
#[derive(Clone, Debug)]
enum Nodes {
    Own(Arc<[f32]>),
    /// The fourth number of each texel.
    OfTexels(Arc<Large<[f32; 4]>>),
}

/// The densities at the texels as one list: node `k` is `nodes[k * stride + offset]`.
#[derive(Clone, Copy)]
pub(crate) struct Grid<'a> {
    width: usize,
    nodes: &'a [f32],
    stride: usize,
    offset: usize,
}

impl Grid<'_> {
    /// The densities at the corners of a cell.
    #[inline(always)]
    pub fn corners(&self, column: usize, row: usize) -> Corners {
        let next = if column + 1 == self.width { 0 } else { column + 1 };
        let (upper, lower) = (row * self.width, (row + 1) * self.width);
        Corners([
            self.node(upper + column),
            self.node(upper + next),
            self.node(lower + column),
            self.node(lower + next),
        ])
    }

    /// [`Self::corners`] of one cell per lane. All addresses are computed first, so that the loads overlap.
    #[inline(always)]
    pub fn corners_of(&self, columns: &[u32; LANES], rows: &[u32; LANES]) -> [Corners; LANES] {
        let (width, stride, offset) = (self.width as u32, self.stride as u32, self.offset as u32);
        let (mut left, mut right) = ([0; LANES], [0; LANES]);
        for k in 0..LANES {
            let next = if columns[k] + 1 == width { 0 } else { columns[k] + 1 };
            left[k] = (rows[k] * width + columns[k]) * stride + offset;
            right[k] = (rows[k] * width + next) * stride + offset;
        }
        let (upper, lower) = (self.nodes, &self.nodes[self.width * self.stride..]);
        let mut corners = [Corners([0.0; 4]); LANES];
        for k in 0..LANES {
            let (left, right) = (left[k] as usize, right[k] as usize);
            corners[k] = Corners([upper[left], upper[right], lower[left], lower[right]]);
        }
        corners
    }

    #[inline(always)]
    fn node(&self, index: usize) -> f32 {
        self.nodes[index * self.stride + self.offset]
    }
}

impl BilinearDensity {
    /// Builds the density of the luminance `[height * width]`.
    ///
    /// # Errors
    /// The size does not match, a value is negative or not finite, or all are zero.
    pub fn new(width: usize, height: usize, luminance: &[f32]) -> Result<Self> {
        if width == 0 || height < 2 || luminance.len() != width * height {
            let reason = format!("{width} x {height} does not fit {} values (height at least 2)", luminance.len());
            return Err(Error::argument("tail luminance", reason));
        }
        // Addresses in lanes have 32 bits.
        if u32::try_from(4 * luminance.len()).is_err() {
            return Err(Error::argument("tail luminance", format!("{width} x {height} is too large")));
        }
        if luminance.iter().any(|value| !(value.is_finite() && *value >= 0.0)) {
            return Err(Error::argument("tail luminance", "holds a value that is negative or not finite"));
        }
        let rows =
            || luminance.chunks_exact(width).enumerate().map(|(row, values)| (row, values, row_weight(row, height)));
        let cells = (width * (height - 1)) as f64;
        // The integral is a sum over cells of the mean of four corners: inner rows count twice, end
        // rows once.
        let mut sum = 0.0;
        for (row, values, weight) in rows() {
            let part = if row == 0 || row == height - 1 { 0.5 } else { 1.0 };
            values.iter().for_each(|&value| sum += f64::from(value) * weight * part);
        }
        if sum <= 0.0 {
            return Err(Error::argument("tail luminance", "is zero everywhere: there is no light to sample"));
        }
        let mut nodes = Vec::with_capacity(luminance.len());
        for (_, values, weight) in rows() {
            nodes.extend(values.iter().map(|&value| (f64::from(value) * weight * cells / sum) as f32));
        }
        Ok(Self { width, height, nodes: Nodes::Own(nodes.into()) })
    }

    /// The same density, stored in the fourth numbers of a map's texels.
    pub(super) fn in_texels(&self, texels: &Arc<Large<[f32; 4]>>) -> Self {
        Self { nodes: Nodes::OfTexels(texels.clone()), ..*self }
    }

    /// The densities at the texels.
    #[inline(always)]
    pub(crate) fn grid(&self) -> Grid<'_> {
        let (nodes, stride, offset) = match &self.nodes {
            Nodes::Own(nodes) => (&**nodes, 1, 0),
            Nodes::OfTexels(texels) => (texels.as_flattened(), 4, 3),
        };
        Grid { width: self.width, nodes, stride, offset }
    }

    /// The densities at all texels, row by row.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = f32> + Clone + '_ {
        let grid = self.grid();
        (0..self.width * self.height).map(move |k| grid.node(k))
    }

    /// Whether two densities are equal at all texels.
    pub fn is_same(&self, other: &Self) -> bool {
        (self.width, self.height) == (other.width, other.height) && self.nodes().eq(other.nodes())
    }

    /// Cells in a row (periodic).
    pub fn columns(&self) -> usize {
        self.width
    }

    /// Rows of cells.
    pub fn rows(&self) -> usize {
        self.height - 1
    }

    /// The densities at the corners of a cell.
    #[inline(always)]
    pub fn corners(&self, column: usize, row: usize) -> Corners {
        self.grid().corners(column, row)
    }

    /// The cell of a point of X, `(column, row, position inside)`.
    #[inline(always)]
    pub fn cell(&self, x: Vec2) -> (usize, usize, Vec2) {
        let shifted = x.x * self.width as f32 - 0.5;
        let across = if shifted < 0.0 { shifted + self.width as f32 } else { shifted };
        // Signed, as SIMD has no conversion to unsigned integers; NaN becomes 0.
        let column = (across as i32).clamp(0, self.width as i32 - 1);
        let down = x.y * self.rows() as f32;
        let row = (down as i32).clamp(0, self.rows() as i32 - 1);
        let inside = Vec2::new(across - column as f32, down - row as f32).clamp(Vec2::ZERO, Vec2::ONE);
        (column as usize, row as usize, inside)
    }

    /// The point of X at a position inside a cell: the inverse of [`Self::cell`].
    #[inline(always)]
    pub fn point(&self, column: u32, row: u32, inside: Vec2) -> Vec2 {
        let u = (column as f32 + inside.x + 0.5) / self.width as f32;
        let v = (row as f32 + inside.y) / self.rows() as f32;
        Vec2::new(if u >= 1.0 { (u - 1.0).clamp(0.0, BELOW_ONE) } else { u }, v.min(1.0))
    }

    /// The factor of the luminance in each row of texels.
    pub(crate) fn row_weights(&self) -> Vec<f32> {
        (0..self.height).map(|row| row_weight(row, self.height) as f32).collect()
    }

    /// Light over density at points of X, with [`Self::row_weights`]; 1 where there is no light. The
    /// density interpolates the sine linearly within a cell, so next to a pole the light is up to 3
    /// times the density.
    pub(crate) fn light_over_density(&self, weights: &[f32], points: &[Vec2]) -> Vec<f32> {
        let ratio = |&x: &Vec2| {
            let (column, row, inside) = self.cell(x);
            let Corners([a, b, c, d]) = self.corners(column, row);
            let density = Corners([a, b, c, d]).evaluate(inside);
            let (upper, lower) = (weights[row], weights[row + 1]);
            let light =
                Corners([a / upper, b / upper, c / lower, d / lower]).evaluate(inside) * latlong::sin_theta(x.y);
            if density > 0.0 { light / density } else { 1.0 }
        };
        points.iter().map(ratio).collect()
    }

    /// [`Self::density`] over columns.
    pub fn densities(&self, x: [&[Lanes]; 2], out: &mut [Lanes]) {
        densities(self, x, out);
    }

    /// The density at a point of X.
    pub fn density(&self, x: Vec2) -> f32 {
        let (column, row, inside) = self.cell(x);
        self.corners(column, row).evaluate(inside)
    }
}

vectorized! {
    fn densities['a](_simd, grid: &'a BilinearDensity, x: [&'a [Lanes]; 2], out: &'a mut [Lanes]) {
        let nodes = grid.grid();
        for strip in 0..out.len() {
            let (u, v) = (x[0][strip], x[1][strip]);
            let (mut columns, mut rows, mut inside) = ([0; LANES], [0; LANES], [Vec2::ZERO; LANES]);
            for k in 0..LANES {
                let (column, row, place) = grid.cell(Vec2::new(u[k], v[k]));
                (columns[k], rows[k], inside[k]) = (column as u32, row as u32, place);
            }
            // All loads come before the arithmetic, so that they overlap.
            let corners = nodes.corners_of(&columns, &rows);
            for k in 0..LANES {
                out[strip][k] = corners[k].evaluate(inside[k]);
            }
        }
    }
}

/// The mean of `sin theta` over the hat function of a row of nodes, in f64.
fn row_weight(row: usize, height: usize) -> f64 {
    let step = PI / (height - 1) as f64;
    // The integral of hat x sine is h sin(theta) (2 - 2 cos h) / h^2 over a whole hat, and 1 - sin(h)/h
    // over a pole's half.
    if row == 0 || row == height - 1 {
        2.0 * (1.0 - step.sin() / step) / step
    } else {
        (row as f64 * step).sin() * (2.0 - 2.0 * step.cos()) / (step * step)
    }
}
