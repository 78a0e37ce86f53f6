//! Moments of a map's light over rectangles of its cells.

use std::ops::{Add, Range};

use crate::parallel::*;
use glam::{DMat3, DVec3, Vec2, Vec3};

use crate::{columns::vectorized, environment::BilinearDensity, simd, tail::Node};

/// Light of a rectangle: its energy, and the energy times the first and second moments of its directions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    /// Fraction of the map's light.
    pub energy: f64,
    first: DVec3,
    /// xx, yy, zz, xy, xz, yz.
    second: [f64; 6],
    /// Energy times the density over solid angle.
    squared: f64,
}

impl Add for Moments {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let second = std::array::from_fn(|k| self.second[k] + other.second[k]);
        let (energy, squared) = (self.energy + other.energy, self.squared + other.squared);
        Self { energy, first: self.first + other.first, second, squared }
    }
}

impl Moments {
    /// The mean direction, of length below 1.
    pub fn centroid(&self) -> DVec3 {
        self.first / self.energy
    }

    /// The mean density of its light over solid angle for directions drawn in proportion to the light, in
    /// 1/sr.
    pub fn brightness(&self) -> f64 {
        self.squared / self.energy
    }

    /// The mean variance of the directions along an axis.
    pub fn variance(&self) -> f64 {
        let covariance = self.covariance();
        (3.0 * covariance.x_axis.x + 3.0 * covariance.y_axis.y + 3.0 * covariance.z_axis.z) / 3.0
    }

    /// The covariance of the directions.
    pub fn covariance(&self) -> DMat3 {
        let [xx, yy, zz, xy, xz, yz] = self.second.map(|moment| moment / self.energy);
        let (s, mixed) = (self.centroid(), [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]);
        DMat3::from_cols_array_2d(&mixed) - DMat3::from_cols(s * s.x, s * s.y, s * s.z)
    }
}

/// Levels with more than 2^17 nodes are not stored; their moments are summed on request.
const KEPT_BITS: u32 = 17;
/// Cells of maps with fewer rows than this are evaluated at more than one point.
const LEAST_ROWS: usize = 128;

/// The moments of all nodes of a map.
#[derive(Debug)]
pub struct MomentMap<'a> {
    density: &'a BilinearDensity,
    root: Node,
    /// Points along a side of a cell.
    points: usize,
    /// Cosines and sines of the azimuth of each column of points, and of the polar angle of each row.
    angles: [[Vec<f32>; 2]; 2],
    /// Whether there is light at the points, row by row.
    lit: Vec<bool>,
    /// Solid angle of the sphere over area of X, for each row of points.
    solid_angles: Vec<f64>,
    /// Root first; each row by row.
    levels: Vec<Vec<Moments>>,
}

impl<'a> MomentMap<'a> {
    /// The moments of the light of a map.
    pub fn new(density: &'a BilinearDensity) -> Self {
        let root = Node::root(density.columns(), density.rows());
        let points = LEAST_ROWS.div_ceil(density.rows().min(density.columns().div_ceil(2)).max(1)).max(1);
        let angles = angles(density, points);
        let solid_angles = angles[1][0].iter().map(|&cosine| solid_angle(f64::from(cosine))).collect();
        let lit = lit(density, points);
        let mut map = Self { density, root, points, angles, lit, solid_angles, levels: Vec::new() };
        let mut shape = root;
        while !shape.is_cell() && map.bits_above(shape) < KEPT_BITS {
            shape = shape.children()[0];
        }
        let mut finest = vec![Moments::default(); 1 << map.bits_above(shape)];
        let rows = finest.par_chunks_mut(1 << (root.width_bits - shape.width_bits)).enumerate();
        rows.for_each(|(row, out)| sum_row(&map, Node { row: (row as u32) << shape.height_bits, ..shape }, out));
        let mut levels = vec![finest];
        while shape != root {
            shape = map.parent_shape(shape);
            let finer = &levels[levels.len() - 1];
            levels.push(map.coarser(shape, finer));
        }
        levels.reverse();
        map.levels = levels;
        map
    }

    /// The whole map.
    pub fn root(&self) -> Node {
        self.root
    }

    /// Largest distance between neighbouring evaluation points of the map, in radians.
    pub fn step(&self) -> f64 {
        let (columns, rows) = (self.density.columns() as f64, self.density.rows() as f64);
        (std::f64::consts::PI / rows).max(std::f64::consts::TAU / columns) / self.points as f64
    }

    /// The moments of a node.
    pub fn moments(&self, node: Node) -> Moments {
        let Some(level) = self.levels.get(self.bits_above(node) as usize) else { return self.sum_cells(node) };
        let width = 1_usize << (self.root.width_bits - node.width_bits);
        level[(node.row >> node.height_bits) as usize * width + (node.column >> node.width_bits) as usize]
    }

    /// Returns each direction of a node at which there is light.
    #[cfg(test)]
    pub fn lit_directions(&self, node: Node) -> Vec<DVec3> {
        let (side, width) = (self.points, self.angles[0][0].len());
        let [[cos_phi, sin_phi], [cos_theta, sin_theta]] = &self.angles;
        let [columns, rows] = self.cells(node);
        let cells = rows.flat_map(|row| columns.clone().map(move |column| [column * side, row * side]));
        let lit = cells.filter(|[column, row]| self.lit[row * width + column]);
        let points = lit.flat_map(|[column, row]| (0..side * side).map(move |k| [column + k % side, row + k / side]));
        let direction =
            |[i, j]: [usize; 2]| Vec3::new(sin_phi[i] * sin_theta[j], cos_theta[j], -cos_phi[i] * sin_theta[j]);
        points.map(|point| direction(point).as_dvec3()).collect()
    }

    /// Returns the largest squared distance from `s` of the directions of a node at which there is light, and the
    /// largest in the metric of a symmetric matrix.
    pub fn farthest(&self, node: Node, s: DVec3, metric: DMat3) -> [f64; 2] {
        let side = self.points;
        let [columns, rows] = self.cells(node).map(|cells| cells.start * side..cells.end * side);
        let [[cos_phi, sin_phi], [cos_theta, sin_theta]] = &self.angles;
        let (width, azimuths) = (cos_phi.len(), [&cos_phi[columns.clone()], &sin_phi[columns.clone()]]);
        let lit = &self.lit[rows.start * width + columns.start..];
        let mut farthest = [0.0; 2];
        let polar_angles = [&cos_theta[rows.clone()], &sin_theta[rows]];
        farthest_points(azimuths, polar_angles, lit, width, s, metric, &mut farthest);
        farthest
    }

    /// Returns the columns and rows of a node that the map has.
    fn cells(&self, node: Node) -> [Range<usize>; 2] {
        let of_node =
            |start: u32, bits: u32, end: usize| (start as usize).min(end)..(start as usize + (1 << bits)).min(end);
        [
            of_node(node.column, node.width_bits, self.density.columns()),
            of_node(node.row, node.height_bits, self.density.rows()),
        ]
    }

    /// Levels between the root and a node.
    fn bits_above(&self, node: Node) -> u32 {
        self.root.width_bits + self.root.height_bits - node.width_bits - node.height_bits
    }

    fn sum_cells(&self, node: Node) -> Moments {
        let [moments] = self.sums(node);
        moments
    }

    /// Returns the moments of `N` nodes side by side, of which `first` is the first; those beyond the map are dark.
    ///
    /// The light of a cell is spread around its points along either tangent, with the variance of a uniform density
    /// between neighbouring ones.
    #[inline(always)]
    fn sums<const N: usize>(&self, first: Node) -> [Moments; N] {
        let (side, grid, points, columns) =
            (self.points, self.density.grid(), self.lit.len() as f64, self.density.columns());
        let [[cos_phi, sin_phi], [cos_theta, sin_theta]] = &self.angles;
        let variance = self.step() * self.step() / 12.0;
        let keep = 1.0 - variance;
        let mut sums = [[0.0; N]; 11];
        let [_, rows] = self.cells(first);
        let cells = rows.flat_map(|row| (0..1_usize << first.width_bits).map(move |across| (row, across)));
        for (row, across) in cells {
            for (k, inside) in insides(side).enumerate() {
                let j = row * side + k / side;
                let (mut energies, mut w) = ([0.0; N], [[0.0; N]; 3]);
                for lane in 0..N {
                    let column = first.column as usize + (lane << first.width_bits) + across;
                    let is_inside = column < columns;
                    let column = if is_inside { column } else { 0 };
                    let i = column * side + k % side;
                    let is_lit = is_inside & self.lit[row * side * cos_phi.len() + column * side];
                    let light = grid.corners(column, row).evaluate(inside);
                    energies[lane] = if is_lit { f64::from(light) / points } else { 0.0 };
                    w[0][lane] = f64::from(sin_phi[i] * sin_theta[j]);
                    w[1][lane] = f64::from(cos_theta[j]);
                    w[2][lane] = f64::from(-cos_phi[i] * sin_theta[j]);
                }
                for lane in 0..N {
                    let (energy, [x, y, z]) = (energies[lane], w.map(|w| w[lane]));
                    let second = [
                        keep * x * x + variance,
                        keep * y * y + variance,
                        keep * z * z + variance,
                        keep * x * y,
                        keep * x * z,
                        keep * y * z,
                    ];
                    let squared = energy * (energy * points / self.solid_angles[j]);
                    let [xx, yy, zz, xy, xz, yz] = second.map(|moment| energy * moment);
                    let added = [energy, energy * x, energy * y, energy * z, xx, yy, zz, xy, xz, yz, squared];
                    for (sum, added) in sums.iter_mut().zip(added) {
                        sum[lane] += added;
                    }
                }
            }
        }
        std::array::from_fn(|lane| {
            let [energy, x, y, z, second @ .., squared] = sums.map(|sum| sum[lane]);
            Moments { energy, first: DVec3::new(x, y, z), second, squared }
        })
    }

    /// The shape of the parents of nodes of a shape.
    fn parent_shape(&self, shape: Node) -> Node {
        let mut parent = self.root;
        while self.bits_above(parent) + 1 < self.bits_above(shape) {
            parent = parent.children()[0];
        }
        parent
    }

    /// Sums the level below to a level of nodes of `shape`.
    fn coarser(&self, shape: Node, finer: &[Moments]) -> Vec<Moments> {
        let width = 1_usize << (self.root.width_bits - shape.width_bits);
        let height = 1_usize << (self.root.height_bits - shape.height_bits);
        let pair = |row: usize, column: usize| {
            if shape.halves_columns() {
                let first = row * 2 * width + 2 * column;
                [first, first + 1]
            } else {
                [2 * row * width + column, (2 * row + 1) * width + column]
            }
        };
        let sum = |k: usize| {
            let [first, second] = pair(k / width, k % width);
            finer[first] + finer[second]
        };
        (0..height * width).into_par_iter().map(sum).collect()
    }
}

/// The points of a cell, from 0 to 1.
fn insides(side: usize) -> impl Iterator<Item = Vec2> {
    (0..side * side).map(move |k| (Vec2::new((k % side) as f32, (k / side) as f32) + 0.5) / side as f32)
}

/// Cosines and sines of azimuths and polar angles, of which [`crate::latlong::direction`] takes products.
fn angles(density: &BilinearDensity, side: usize) -> [[Vec<f32>; 2]; 2] {
    let inside = |i: usize| ((i % side) as f32 + 0.5) / side as f32;
    let across = |i: usize| {
        let x = density.point((i / side) as u32, 0, Vec2::new(inside(i), 0.0));
        simd::cos_sin_turns(x.x)
    };
    let down = |i: usize| {
        let x = density.point(0, (i / side) as u32, Vec2::new(0.0, inside(i)));
        simd::cos_sin_turns(0.5 * x.y)
    };
    let unzip = |angles: (Vec<f32>, Vec<f32>)| [angles.0, angles.1];
    [unzip((0..density.columns() * side).map(across).unzip()), unzip((0..density.rows() * side).map(down).unzip())]
}

/// Whether there is light in the cells of points, row by row of points.
fn lit(density: &BilinearDensity, side: usize) -> Vec<bool> {
    let (grid, width) = (density.grid(), density.columns() * side);
    let mut lit = vec![false; width * density.rows() * side];
    lit.par_chunks_mut(width).enumerate().for_each(|(row, lit)| {
        for (column, lit) in lit.chunks_exact_mut(side).enumerate() {
            lit.fill(grid.corners(column, row / side).mean() > 0.0);
        }
    });
    lit
}

/// The solid angle of the sphere over the area of X, at a cosine of the polar angle.
fn solid_angle(cosine: f64) -> f64 {
    2.0 * std::f64::consts::PI.powi(2) * (1.0 - cosine * cosine).max(1e-14).sqrt()
}

/// Columns of points side by side.
const COLUMNS: usize = 8;

/// The directions of a row of points.
#[derive(Clone, Copy)]
struct PointRow<'a> {
    cos_phi: &'a [f32],
    sin_phi: &'a [f32],
    cos_theta: f32,
    sin_theta: f32,
    lit: &'a [bool],
}

vectorized! {
/// Computes the moments of a row of nodes of one shape, of which `first` is the first.
fn sum_row['a](_simd, map: &'a MomentMap<'a>, first: Node, out: &'a mut [Moments]) {
    for (strip, out) in out.chunks_mut(COLUMNS).enumerate() {
        let column = ((strip * COLUMNS) << first.width_bits) as u32;
        let moments = map.sums::<COLUMNS>(Node { column, ..first });
        out.copy_from_slice(&moments[..out.len()]);
    }
}
}

vectorized! {
/// [`MomentMap::farthest`] over rows of points, `width` apart in `lit`.
fn farthest_points['a](
    _simd, azimuths: [&'a [f32]; 2], polar_angles: [&'a [f32]; 2], lit: &'a [bool], width: usize,
    s: DVec3, metric: DMat3, out: &'a mut [f64; 2],
) {
    let ([cos_phi, sin_phi], columns) = (azimuths, azimuths[0].len());
    let whole = columns / COLUMNS * COLUMNS;
    let (mut wide, mut narrow) = ([[0.0; COLUMNS]; 2], [[0.0; 1]; 2]);
    for (row, (&cos_theta, &sin_theta)) in polar_angles[0].iter().zip(polar_angles[1]).enumerate() {
        let lit = &lit[row * width..][..columns];
        let row = PointRow { cos_phi, sin_phi, cos_theta, sin_theta, lit };
        for start in (0..whole).step_by(COLUMNS) {
            farthest_of(row, start, s, &metric, &mut wide);
        }
        for start in whole..columns {
            farthest_of(row, start, s, &metric, &mut narrow);
        }
    }
    for (out, (wide, narrow)) in out.iter_mut().zip(wide.iter().zip(&narrow)) {
        *out = wide.iter().chain(narrow).fold(0.0, |most: f64, &square| most.max(square));
    }
}
}

/// Updates the largest squared distances of `N` points of a row from `start` on.
#[inline(always)]
fn farthest_of<const N: usize>(row: PointRow<'_>, start: usize, s: DVec3, metric: &DMat3, most: &mut [[f64; N]; 2]) {
    let (cos_phi, sin_phi, lit) = (&row.cos_phi[start..][..N], &row.sin_phi[start..][..N], &row.lit[start..][..N]);
    for k in 0..N {
        let w = Vec3::new(sin_phi[k] * row.sin_theta, row.cos_theta, -cos_phi[k] * row.sin_theta);
        let d = w.as_dvec3() - s;
        let squares = [d.length_squared(), d.dot(*metric * d)];
        for (most, square) in most.iter_mut().zip(squares) {
            most[k] = if lit[k] & (square > most[k]) { square } else { most[k] };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latlong;

    fn density(columns: usize, rows: usize) -> BilinearDensity {
        let luminance: Vec<f32> = (0..columns * (rows + 1)).map(|k| ((k * 7919) % 13) as f32).collect();
        BilinearDensity::new(columns, rows + 1, &luminance).unwrap()
    }

    #[test]
    fn every_node_is_the_sum_of_its_halves_and_the_whole_is_1() {
        for (columns, rows) in [(1, 1), (16, 4), (4, 32), (7, 3), (1024, 511)] {
            let density = density(columns, rows);
            let map = MomentMap::new(&density);
            assert!((map.moments(map.root()).energy - 1.0).abs() < 1e-6, "{columns} x {rows}");
            let mut node = map.root();
            while !node.is_cell() {
                let [a, b] = node.children().map(|child| map.moments(child));
                let (whole, sum) = (map.moments(node), a + b);
                assert!((whole.energy - sum.energy).abs() < 1e-12 && (whole.first - sum.first).length() < 1e-12);
                node = node.children()[(columns + node.row as usize) % 2];
            }
        }
    }

    #[test]
    fn directions_match_the_map() {
        for (columns, rows) in [(7, 3), (300, 150)] {
            let density = density(columns, rows);
            let map = MomentMap::new(&density);
            let mut expected = Vec::new();
            for row in 0..rows as u32 {
                for column in 0..columns as u32 {
                    let lit = density.corners(column as usize, row as usize).mean() > 0.0;
                    let points = insides(map.points).filter(|_| lit);
                    expected
                        .extend(points.map(|inside| latlong::direction(density.point(column, row, inside)).as_dvec3()));
                }
            }
            assert_eq!(map.lit_directions(map.root()), expected);
        }
    }

    #[test]
    fn moments_match_the_density() {
        let density = density(5, 3);
        let map = MomentMap::new(&density);
        // 10,000 points per cell: the midpoint rule's error is the square of a step of 0.004 by 0.01.
        let (mut energy, mut first, mut square) = (0.0, DVec3::ZERO, 0.0);
        for k in 0..5 * 3 * 10_000 {
            let (cell, point) = (k / 10_000, k % 10_000);
            let inside = (Vec2::new((point % 100) as f32, (point / 100) as f32) + 0.5) / 100.0;
            let x = density.point(cell as u32 % 5, cell as u32 / 5, inside);
            let (e, w) = (f64::from(density.density(x)) / 150_000.0, latlong::direction(x).as_dvec3());
            (energy, first, square) = (energy + e, first + e * w, square + e * w.x * w.x);
        }
        let whole = map.moments(map.root());
        assert!((whole.energy - energy).abs() < 1e-4 && (whole.first - first).length() < 1e-3);
        assert!((whole.second[0] - square).abs() < 1e-3, "{} {square}", whole.second[0]);
    }
}
