//! The directions in each cell of Y: for integrals over a cell, and for bounds on all directions in it.

use std::f32::consts::{PI, TAU};

use crate::parallel::*;
use glam::{Vec2, Vec3A};

use super::{cell_grid::CellGrid, normal_grid::NormalGrid, progress::StageProgress};
use crate::{
    columns::{strips, vectorized},
    latlong,
    simd::{LANES, Lanes},
    tail::{Tail, TailWarp},
};

/// Points along a side of Y.
const Y_SIDE: usize = 512;
/// Approximate minimum of rows of points of X, with twice as many columns; larger maps get one point
/// per texel.
const X_ROWS: usize = 512;
/// Rows of the blocks of X by which directions are grouped, 1.4 degrees each, with twice as many columns.
const BLOCK_ROWS: usize = 128;
/// Bits of a block's index.
const BLOCK_BITS: u32 = (2 * BLOCK_ROWS * BLOCK_ROWS).ilog2();
/// Inset from the edges at which a part of a texel is looked up, relative to its size, so that rounding
/// does not lead to the neighbour.
const INSET: f32 = 4e-3;
/// Relative widening of the box of such points: the density at an edge of a texel is at most twice its
/// mean, so less than two insets of the texel's image lie beyond.
const WIDENING: f32 = 2.0 * 2.0 * INSET;
/// The bound on weight over mean weight that masses are raised for. The documented bound is 12; the
/// margin covers irradiance evaluated at some normals only, and light over density at some points of a
/// texel only.
const LARGEST_WEIGHT: f32 = 11.0;
/// The largest fraction of the highest cosine in a cell that a mass is raised to.
const LARGEST_FRACTION: f32 = 0.5;
/// Iterations of raising: the required fractions depend on the means of the raised masses.
const ROUNDS: usize = 4;
/// The fraction of the time of raising masses spent on the highest cosines.
const BOUNDS: f64 = 0.5;
/// Normals along a side of a cell of the grid of normals at which weights are bounded.
const BETWEEN: usize = 6;

/// The directions in the cells of Y, in groups of neighbours.
///
/// A texel's area in Y is proportional to its light: a dark part of the map is a thin strip of Y that
/// evenly spaced points miss, although it covers a large part of the sphere. So directions come from
/// points of Y *and* from points of X, combined by the balance heuristic, and the cells of a direction
/// are found from the corners of every texel.
#[derive(Clone, Debug)]
pub struct CellDirections {
    cells: CellGrid,
    /// Start of each cell's parts, and the end.
    starts: Vec<usize>,
    parts: Vec<Part>,
    /// Sums of directions times mass, one per block, in lanes.
    light: Vec<[Lanes; 3]>,
}

/// The part of a cell that lies in one block of X.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Mean direction of the points, not normalised, times the root of their fraction of the cell's mass.
    scaled: Vec3A,
    /// A cap around the block and the texels that it cuts, with the cosine and sine of its angle.
    centre: Vec3A,
    cos: f32,
    sin: f32,
    /// The largest light over density in it.
    excess: f32,
}

/// The points of one block in one cell.
#[derive(Clone, Copy, Debug)]
struct Group {
    /// The cell's index, then the block's.
    key: u32,
    /// Area in Y.
    mass: f32,
    /// Sum of directions times their masses.
    sum: Vec3A,
    /// The largest light over density.
    excess: f32,
}

impl CellDirections {
    /// Finds the directions of all cells.
    pub fn new(tail: &Tail, cells: CellGrid) -> Self {
        let split = Split::of(tail);
        let mut groups: Vec<Group> =
            (0..BLOCK_ROWS).into_par_iter().flat_map_iter(|band| split.groups_of_band(tail, cells, band)).collect();
        groups.extend(groups_of_y(tail, cells, &split));
        groups.par_sort_by_key(|group| group.key);
        merge(&mut groups);
        let caps: Vec<(Vec3A, f32, f32)> = (0..2 * BLOCK_ROWS * BLOCK_ROWS).map(|block| split.cap(block)).collect();
        let mut of_cells = vec![0.0; cells.cells()];
        let mut starts = vec![0; cells.cells() + 1];
        for group in &groups {
            of_cells[group.cell()] += group.mass;
            starts[group.cell() + 1] += 1;
        }
        for cell in 0..cells.cells() {
            starts[cell + 1] += starts[cell];
        }
        let part = |group: &Group| {
            let (centre, cos, sin) = caps[group.block()];
            let scale = if group.mass > 0.0 { 1.0 / (group.mass * of_cells[group.cell()]).sqrt() } else { 0.0 };
            Part { scaled: scale * group.sum, centre, cos, sin, excess: group.excess }
        };
        let parts = groups.iter().map(part).collect();
        Self { cells, starts, parts, light: light_of(&groups) }
    }

    /// The root mean square over each cell of the cosine to a normal: `[rows * columns]`.
    pub fn root_mean_squares(&self, normal: Vec3A, out: &mut [f32]) {
        for (out, ends) in out.iter_mut().zip(self.starts.windows(2)) {
            let squares = self.parts[ends[0]..ends[1]].iter().map(|part| normal.dot(part.scaled).max(0.0).powi(2));
            *out = squares.sum::<f32>().sqrt();
        }
    }

    /// An upper bound on the cosine between any direction in each cell and any normal within `reach`
    /// radians of `normal`, times light over density: `[rows * columns]`.
    fn highest_cosines(&self, normal: Vec3A, reach: f32, out: &mut [f32]) {
        let (sin_reach, cos_reach) = reach.sin_cos();
        for (out, ends) in out.iter_mut().zip(self.starts.windows(2)) {
            let mut highest = 0.0_f32;
            for part in &self.parts[ends[0]..ends[1]] {
                let (cos, sin) =
                    (part.cos * cos_reach - part.sin * sin_reach, part.sin * cos_reach + part.cos * sin_reach);
                let to_centre = normal.dot(part.centre);
                let to_edge = to_centre * cos + (1.0 - to_centre * to_centre).max(0.0).sqrt() * sin;
                highest = highest.max(part.excess * if to_centre >= cos { 1.0 } else { to_edge });
            }
            *out = highest;
        }
    }

    /// Raises masses `[nodes, rows, columns]` so that no direction has a weight (light x cosine over
    /// pdf) above 12 times the mean, for all normals of a Lambert surface.
    ///
    /// The mean of a node's masses must be at least the mean over Y of the cosine to its normal. At a
    /// normal n between nodes with weights w, M is the interpolated mass of a cell, S the mean of M
    /// over cells, and C the mean of the cosine: the weight of a direction over the mean weight is
    /// `cos S / C M`. Every mass is at least a fraction `a` of the highest cosine in its cell. As the
    /// cosine is convex in the normal, M is at least `a |N| cos` if n is along N, the sum of w times
    /// the nodes' normals. As n is only near N, the highest cosine is taken over all normals within
    /// that distance. Then no weight exceeds `S / (C |N| a)`, and the fraction of a node is the least
    /// that makes this 11 at the normals interpolated from it.
    ///
    /// Fractions are at most 1/2. Only normals with almost no light require more, where the highest
    /// cosines over all cells have a mean above 5 C: no table of so few cells could bound their weights
    /// much better.
    ///
    /// `watch` is called with the finished fraction of the whole work, of which `before` precedes this call.
    pub fn raise(&self, normals: NormalGrid, masses: &mut [f32], (before, watch): (f64, &(dyn Fn(f64) + Sync))) {
        let count = self.cells.cells();
        let mut highest = vec![0.0; masses.len()];
        let reaches = normals.reaches();
        let middle = before + BOUNDS * (1.0 - before);
        let bounds = StageProgress::new(watch, (before, middle), normals.nodes());
        highest.par_chunks_exact_mut(count).enumerate().for_each(|(node, out)| {
            self.highest_cosines(normals.normal(node), reaches[node / normals.shape().1], out);
            bounds.step();
        });
        let served = normals.between(BETWEEN);
        let light = StageProgress::new(watch, (middle, 1.0), served.len());
        let irradiance = |normal: Vec3A| {
            light.step();
            self.irradiance(normal)
        };
        let seen: Vec<f32> = served.par_iter().map(|served| irradiance(served.normal)).collect();
        let mut fractions = vec![0.0_f32; normals.nodes()];
        for _ in 0..ROUNDS {
            let raised = |node: usize| {
                let cells = node * count..(node + 1) * count;
                let sum: f32 =
                    masses[cells.clone()].iter().zip(&highest[cells]).map(|(m, h)| m.max(fractions[node] * h)).sum();
                sum / count as f32
            };
            let means: Vec<f32> = (0..normals.nodes()).into_par_iter().map(raised).collect();
            fractions.fill(0.0);
            for (served, &seen) in served.iter().zip(&seen) {
                let mean: f32 = served.stencil().map(|(node, weight)| weight * means[node]).sum();
                let fraction = (mean / (seen * served.length * LARGEST_WEIGHT)).min(LARGEST_FRACTION);
                for (node, _) in served.stencil().filter(|_| seen > 0.0) {
                    fractions[node] = fractions[node].max(fraction);
                }
            }
        }
        for (node, (masses, highest)) in masses.chunks_exact_mut(count).zip(highest.chunks_exact(count)).enumerate() {
            for (mass, highest) in masses.iter_mut().zip(highest) {
                *mass = mass.max(fractions[node] * highest);
            }
        }
    }

    /// The mean over Y of the cosine to a normal, clamped to positive values.
    pub fn irradiance(&self, normal: Vec3A) -> f32 {
        let mut sums = [0.0; LANES];
        irradiances(&self.light, normal.to_array(), &mut sums);
        sums.iter().sum()
    }
}

vectorized! {
    fn irradiances['a](_simd, light: &'a [[Lanes; 3]], normal: [f32; 3], sums: &'a mut Lanes) {
        // A local copy stays in registers; writes through the reference would go to memory.
        let mut own = *sums;
        for [x, y, z] in light {
            for k in 0..LANES {
                let cosine = normal[0] * x[k] + normal[1] * y[k] + normal[2] * z[k];
                own[k] += if cosine > 0.0 { cosine } else { 0.0 };
            }
        }
        *sums = own;
    }
}

impl Group {
    fn cell(&self) -> usize {
        (self.key >> BLOCK_BITS) as usize
    }

    fn block(&self) -> usize {
        self.key as usize & ((1 << BLOCK_BITS) - 1)
    }

    /// The group of a single point.
    fn of(cells: CellGrid, y: Vec2, x: Vec2, mass: f32) -> Self {
        let block = block_of(x);
        Self { key: key_of(cells, cells.cell(y), block), mass, sum: mass * latlong::direction(x), excess: 0.0 }
    }
}

/// The block of a point of X.
fn block_of(x: Vec2) -> usize {
    let row = ((x.y * BLOCK_ROWS as f32) as usize).min(BLOCK_ROWS - 1);
    let column = ((x.x * (2 * BLOCK_ROWS) as f32) as usize).min(2 * BLOCK_ROWS - 1);
    row * 2 * BLOCK_ROWS + column
}

fn key_of(cells: CellGrid, (row, column): (usize, usize), block: usize) -> u32 {
    // At most 12 and 15 bits.
    ((row * cells.shape().1 + column) << BLOCK_BITS | block) as u32
}

/// Merges neighbours of equal keys.
fn merge(groups: &mut Vec<Group>) {
    groups.dedup_by(|next, first| {
        let same = next.key == first.key;
        if same {
            first.mass += next.mass;
            first.sum += next.sum;
            first.excess = first.excess.max(next.excess);
        }
        same
    });
}

/// Sums the groups of each block over all cells.
fn light_of(groups: &[Group]) -> Vec<[Lanes; 3]> {
    let mut sums = vec![Vec3A::ZERO; 1 << BLOCK_BITS];
    for group in groups {
        sums[group.block()] += group.sum;
    }
    sums.retain(|sum| *sum != Vec3A::ZERO);
    let mut light = vec![[[0.0; LANES]; 3]; strips(sums.len())];
    for (k, sum) in sums.into_iter().enumerate() {
        for (lanes, component) in light[k / LANES].iter_mut().zip(sum.to_array()) {
            lanes[k % LANES] = component;
        }
    }
    light
}

/// The groups of evenly spaced points of Y.
fn groups_of_y(tail: &Tail, cells: CellGrid, split: &Split) -> Vec<Group> {
    let row = |row: usize| {
        let y = |k: usize| (Vec2::new(k as f32, row as f32) + 0.5) / Y_SIDE as f32;
        let y: Vec<Vec2> = (0..Y_SIDE).map(y).collect();
        let warped = tail.forward_points(&y);
        let group = |(&y, (x, jacobian)): (&Vec2, (Vec2, f32))| {
            let mass = split.mass(1.0 / jacobian);
            (mass > 0.0).then(|| Group::of(cells, y, x, mass))
        };
        let mut groups: Vec<Group> = y.iter().zip(warped).filter_map(group).collect();
        groups.sort_by_key(|group| group.key);
        merge(&mut groups);
        groups
    };
    (0..Y_SIDE).into_par_iter().flat_map_iter(row).collect()
}

/// The cells of a map's density, each split into rectangles.
struct Split {
    /// Cells of the density.
    columns: usize,
    rows: usize,
    /// Rectangles along the sides of a cell.
    across: usize,
    down: usize,
    /// Row weights of the density.
    row_weights: Vec<f32>,
}

impl Split {
    fn of(tail: &Tail) -> Self {
        let (columns, rows) = (tail.light().columns(), tail.light().rows());
        Self {
            columns,
            rows,
            across: (2 * X_ROWS / columns).max(1),
            down: (X_ROWS / rows).max(1),
            row_weights: tail.light().row_weights(),
        }
    }

    /// The weight of a point of X or Y in an integral over Y, by the balance heuristic over all points
    /// of both kinds; `density` is |dy/dx| there.
    fn mass(&self, density: f32) -> f32 {
        let of_x = (self.columns * self.across * self.rows * self.down) as f32;
        let of_y = (Y_SIDE * Y_SIDE) as f32;
        // Infinite where a sun is a single point.
        if density < f32::INFINITY { density / (of_x + of_y * density) } else { 1.0 / of_y }
    }

    /// The cap around a block and the texels at its edges: centre, and cosine and sine of its angle.
    fn cap(&self, block: usize) -> (Vec3A, f32, f32) {
        let at = |inside: Vec2| {
            let corner = Vec2::new((block % (2 * BLOCK_ROWS)) as f32, (block / (2 * BLOCK_ROWS)) as f32);
            latlong::direction((corner + inside) / Vec2::new((2 * BLOCK_ROWS) as f32, BLOCK_ROWS as f32))
        };
        let centre = at(Vec2::splat(0.5));
        let farthest = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE].map(|corner| at(corner).distance(centre));
        let block = 2.0 * (0.5 * farthest.into_iter().fold(0.0, f32::max)).asin();
        let texel = 0.5 * (TAU / (self.columns * self.across) as f32).hypot(PI / (self.rows * self.down) as f32);
        let (sin, cos) = (block + texel).sin_cos();
        (centre, cos, sin)
    }

    /// The groups of the rows of cells in one band. There is one band per row of blocks, so that groups
    /// merge well.
    fn groups_of_band(&self, tail: &Tail, cells: CellGrid, band: usize) -> Vec<Group> {
        let mut groups = Vec::new();
        for row in band * self.rows / BLOCK_ROWS..(band + 1) * self.rows / BLOCK_ROWS {
            self.push_row(tail, cells, row, &mut groups);
            groups.sort_by_key(|group| group.key);
            merge(&mut groups);
        }
        groups
    }

    /// Appends the groups of a row of cells of the density: their centres, and every cell of Y that
    /// they overlap.
    fn push_row(&self, tail: &Tail, cells: CellGrid, row: usize, groups: &mut Vec<Group>) {
        const PLACES: [Vec2; 5] = [
            Vec2::splat(0.5),
            Vec2::new(INSET, INSET),
            Vec2::new(1.0 - INSET, INSET),
            Vec2::new(INSET, 1.0 - INSET),
            Vec2::new(1.0 - INSET, 1.0 - INSET),
        ];
        let size = Vec2::new(self.across as f32, self.down as f32);
        for down in 0..self.down {
            let mut x = Vec::with_capacity(PLACES.len() * self.columns * self.across);
            for across in 0..self.columns * self.across {
                let corner = Vec2::new((across % self.across) as f32, down as f32);
                let at = |place: Vec2| {
                    tail.light().point((across / self.across) as u32, row as u32, (corner + place) / size)
                };
                x.extend(PLACES.map(at));
            }
            let y = tail.inverse_points(&x);
            let excess = tail.light().light_over_density(&self.row_weights, &x);
            let places =
                x.chunks_exact(PLACES.len()).zip(y.chunks_exact(PLACES.len())).zip(excess.chunks_exact(PLACES.len()));
            for ((x, y), excess) in places {
                self.push(cells, x[0], y, excess.iter().fold(1.0, |a, &b| a.max(b)), groups);
            }
        }
    }

    /// Appends the groups of a rectangle, given its centre and the points of Y of its centre and corners.
    fn push(&self, cells: CellGrid, centre: Vec2, y: &[(Vec2, f32)], excess: f32, groups: &mut Vec<Group>) {
        if y.iter().all(|&(_, density)| density <= 0.0) {
            return;
        }
        groups.push(Group::of(cells, y[0].0, centre, self.mass(y[0].1)));
        let (low, high) = y.iter().fold((y[0].0, y[0].0), |(low, high), &(y, _)| (low.min(y), high.max(y)));
        let margin = WIDENING * (high - low);
        let (first, last) = (cells.cell((low - margin).max(Vec2::ZERO)), cells.cell(high + margin));
        for row in first.0..=last.0 {
            for column in first.1..=last.1 {
                let key = key_of(cells, (row, column), block_of(centre));
                groups.push(Group { key, mass: 0.0, sum: Vec3A::ZERO, excess });
            }
        }
    }
}

#[cfg(test)]
mod tests;
