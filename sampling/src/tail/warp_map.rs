//! A warp of the square as a table of its values: bilinear in each cell, with that interpolant's own Jacobian
//! and inverse.

use crate::parallel::*;
use glam::{DVec2, Vec2};

use crate::{
    discrete::BELOW_ONE,
    error::{Error, Result},
};

/// Smallest and largest number of cells along a side.
const CELLS: std::ops::RangeInclusive<usize> = 4..=1024;
/// Smallest Jacobian at a corner of a cell, as a fraction of the cell's mean.
pub(super) const LEAST_CORNER: f64 = 1e-4;
/// Largest number of squares along a side of the grid over X in which walks start.
const STARTS: usize = 256;
/// Number of cells that a walk visits before the tree is used.
const WALK: usize = 16;
/// Largest number of columns and rows in the first step of a walk.
const STRIDE: f64 = 32.0;
/// Largest number of turns around the circle between a node and its cell: a flow may rotate rows near the
/// poles several times.
const MOST_TURNS: f32 = 16.0;
/// Margin of bounding boxes for single precision: half of the spacing of numbers above [`MOST_TURNS`].
const BOX_MARGIN: f32 = 1e-6;

/// A bijection of the unit square (coordinate 0 a circle, coordinate 1 an interval), tabulated at the corners of `n x n` cells.
///
/// Every cell is mapped to a convex quadrilateral by bilinear interpolation. Neighbours share edges, the
/// edges are straight, and the borders `v = 0` and `v = 1` are fixed, so that the images tile the square and
/// the map is one-to-one; its inverse is the root of a quadratic (Heckbert 1989, "Fundamentals of Texture
/// Mapping and Image Warping", section A.2). The density that it gives to uniform points is the reciprocal of
/// the interpolant's Jacobian, which integrates to 1 exactly.
///
/// The cell of a point is found by a short walk: from the cell at the middle of a square of X, each cell's
/// inverse estimates how many columns and rows away the point comes from. Under a sun, half of all cells are
/// in a few squares; walks that do not arrive fall back to a tree of bounding boxes over squares of cells.
#[derive(Clone, Debug)]
pub struct WarpMap {
    cells: usize,
    /// `[cells + 1, cells + 1]`, row-major; the last column is the first one, moved by 1.
    nodes: Vec<Vec2>,
    /// One level after the other, from the whole square down to single cells.
    boxes: Vec<Vec<Bounds>>,
    /// The cell at the middle of each square of a grid over X, `[side, side]`.
    starts: Vec<u32>,
}

/// `low.x, low.y, high.x, high.y`.
#[derive(Clone, Copy, Debug)]
struct Bounds([f32; 4]);

impl Bounds {
    fn of(points: &[Vec2]) -> Self {
        let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), &p| (low.min(p), high.max(p)));
        Self([low.x - BOX_MARGIN, low.y - BOX_MARGIN, high.x + BOX_MARGIN, high.y + BOX_MARGIN])
    }

    fn join(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a.min(e), b.min(f), c.max(g), d.max(h)])
    }

    fn contains(&self, p: Vec2) -> bool {
        let [a, b, c, d] = self.0;
        p.x >= a && p.x <= c && p.y >= b && p.y <= d
    }
}

/// One cell's interpolant `p + s e + t f + s t g` with `(s, t)` in the unit square.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    p: DVec2,
    e: DVec2,
    f: DVec2,
    g: DVec2,
}

impl Cell {
    /// Creates the interpolant of its corners at `(0, 0)`, `(1, 0)`, `(0, 1)`, `(1, 1)`.
    pub(super) fn new(corners: [Vec2; 4]) -> Self {
        let [a, b, c, d] = corners.map(Vec2::as_dvec2);
        Self { p: a, e: b - a, f: c - a, g: (d - c) - (b - a) }
    }

    fn evaluate(&self, s: f64, t: f64) -> DVec2 {
        self.p + s * self.e + t * self.f + s * t * self.g
    }

    /// Returns the Jacobian determinant by `(s, t)`, which is linear in both.
    pub(super) fn jacobian(&self, s: f64, t: f64) -> f64 {
        self.e.perp_dot(self.f) + s * self.e.perp_dot(self.g) + t * self.g.perp_dot(self.f)
    }

    /// Whether the image is convex with a margin: the Jacobian, linear, is positive in the cell if it is at
    /// the corners.
    pub(super) fn is_convex(&self) -> bool {
        self.has_room(LEAST_CORNER)
    }

    /// Whether the smallest Jacobian of its corners is at least `least` times their mean.
    pub(super) fn has_room(&self, least: f64) -> bool {
        let mean = self.jacobian(0.5, 0.5);
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
        mean > 0.0 && corners.iter().all(|&(s, t)| self.jacobian(s, t) >= least * mean)
    }

    /// Returns `(s, t)` of a point, and its distance outside the unit square (0 inside).
    fn invert(&self, x: DVec2) -> (DVec2, f64) {
        // (h - t f) x (e + t g) = 0.
        let h = x - self.p;
        let (a, b, c) = (self.g.perp_dot(self.f), h.perp_dot(self.g) + self.e.perp_dot(self.f), h.perp_dot(self.e));
        let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
        let q = -0.5 * (b + if b < 0.0 { -root } else { root });
        let candidate = |t: f64| {
            let along = self.e + t * self.g;
            let s = (h - t * self.f).dot(along) / along.length_squared();
            let st = DVec2::new(s, t);
            let outside = (-st).max(st - DVec2::ONE).max_element().max(0.0);
            // The apex of a trapezoid, where `along` vanishes, is a root too; `max` would miss that s is NaN.
            (st, if st.is_finite() { outside } else { f64::INFINITY })
        };
        let (first, second) = (candidate(c / q), candidate(q / a));
        if first.1 <= second.1 { first } else { second }
    }
}

impl WarpMap {
    /// Creates the map with the values `nodes`, `[cells + 1, cells]`, at the corners of cells. The circle's
    /// coordinate is lifted to the line: along a row it grows by 1 in total.
    ///
    /// # Errors
    /// The number of cells is not a power of two from 4 to 1024, a value is not finite or out of range, the
    /// borders move, or the image of a cell is not convex (see [`WarpMap::repaired`]).
    pub fn new(cells: usize, nodes: &[Vec2]) -> Result<Self> {
        let refuse = |reason: String| Err(Error::argument("tail.map", reason));
        if !(CELLS.contains(&cells) && cells.is_power_of_two()) || nodes.len() != cells * (cells + 1) {
            return refuse(format!(
                "{} nodes do not fit {cells} x {cells} cells (a power of two from {} to {})",
                nodes.len(),
                CELLS.start(),
                CELLS.end()
            ));
        }
        let in_range = |p: &Vec2| p.x.abs() <= MOST_TURNS && (0.0..=1.0).contains(&p.y);
        if let Some(at) = nodes.iter().position(|p| !in_range(p)) {
            return refuse(format!("the node {at} is at {}, outside the square", nodes[at]));
        }
        let (first, last) = (&nodes[..cells], &nodes[cells * cells..]);
        if first.iter().any(|p| p.y != 0.0) || last.iter().any(|p| p.y != 1.0) {
            return refuse("the first and last row of nodes must be the borders of the square".into());
        }
        let nodes = close(cells, nodes);
        let broken = (0..cells * cells).filter(|&k| !cell_of(cells, &nodes, k).is_convex()).count();
        if broken > 0 {
            return refuse(format!("the images of {broken} cells are not convex: the map is not one to one"));
        }
        let mut map = Self { cells, boxes: boxes(cells, &nodes), nodes, starts: Vec::new() };
        let side = cells.min(STARTS);
        let middle = |k: usize| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
        map.starts = (0..side * side).into_par_iter().map(|k| map.look_up(middle(k)).0 as u32).collect();
        Ok(map)
    }

    /// Returns the number of cells along a side.
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// Returns the values `[cells + 1, cells]` that [`WarpMap::new`] takes.
    pub fn nodes(&self) -> Vec<Vec2> {
        self.nodes.chunks_exact(self.cells + 1).flat_map(|row| &row[..self.cells]).copied().collect()
    }

    /// Returns `p`, `e`, `f` and `g` of a cell, for other devices: computed from nodes in single precision,
    /// differences would lose their digits.
    pub(super) fn cell_numbers(&self, index: usize) -> [f32; 8] {
        let Cell { p, e, f, g } = cell_of(self.cells, &self.nodes, index);
        [p.x, p.y, e.x, e.y, f.x, f.y, g.x, g.y].map(|number| number as f32)
    }

    /// Returns the bounding boxes of all levels, four numbers each.
    pub(super) fn box_numbers(&self) -> impl Iterator<Item = f32> {
        self.boxes.iter().flatten().flat_map(|bounds| bounds.0)
    }

    /// Maps `y` in `[0, 1)^2` to `(x, |dx/dy|)`.
    pub fn forward(&self, y: Vec2) -> (Vec2, f32) {
        let at = y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)) * self.cells as f32;
        let (column, row) = (at.x as usize, at.y as usize);
        let cell = cell_of(self.cells, &self.nodes, row * self.cells + column);
        let (s, t) = (f64::from(at.x) - column as f64, f64::from(at.y) - row as f64);
        let x = cell.evaluate(s, t);
        let u = (x.x - x.x.floor()) as f32;
        let x = Vec2::new(if u >= 1.0 { 0.0 } else { u }, (x.y as f32).clamp(0.0, 1.0));
        (x, (cell.jacobian(s, t) * self.scale()) as f32)
    }

    /// Maps `x` in `[0, 1]^2` to `(y, |dy/dx|)`.
    pub fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        let (index, st) = self.walk(x).unwrap_or_else(|| self.look_up(x));
        let cell = cell_of(self.cells, &self.nodes, index);
        let corner = DVec2::new((index % self.cells) as f64, (index / self.cells) as f64);
        let y = ((corner + st) / self.cells as f64).as_vec2();
        (y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)), (1.0 / (cell.jacobian(st.x, st.y) * self.scale())) as f32)
    }

    /// Returns the number of cells per unit area of Y.
    fn scale(&self) -> f64 {
        (self.cells * self.cells) as f64
    }

    /// Walks to the cell whose image contains `x`; returns it and the position in the cell, or `None` if the
    /// walk does not arrive.
    fn walk(&self, x: Vec2) -> Option<(usize, DVec2)> {
        let side = self.cells.min(STARTS);
        let at = |x: f32| ((x * side as f32) as usize).min(side - 1);
        let mut index = self.starts[at(x.y) * side + at(x.x)] as usize;
        let (mut stride, mut last) = (DVec2::splat(STRIDE), DVec2::ZERO);
        for _ in 0..WALK {
            let cell = cell_of(self.cells, &self.nodes, index);
            // Moves x to the cell's turn of the circle.
            let turn = (cell.evaluate(0.5, 0.5).x - f64::from(x.x)).round();
            let (st, outside) = cell.invert(x.as_dvec2() + DVec2::new(turn, 0.0));
            if outside == 0.0 {
                return Some((index, st));
            }
            if !st.is_finite() {
                return None;
            }
            let step = st.floor().clamp(-stride, stride);
            // On reversal, cells in between differ much in size; the steps become those of a bisection.
            let turns_back = (step * last).cmplt(DVec2::ZERO);
            stride = DVec2::select(turns_back, (0.5 * stride).ceil(), stride);
            last = DVec2::select(step.cmpeq(DVec2::ZERO), last, step);
            let step = step.clamp(-stride, stride);
            let side = self.cells as isize;
            let column = (index as isize % side + step.x as isize).rem_euclid(side);
            let row = (index as isize / side + step.y as isize).clamp(0, side - 1);
            index = (row * side + column) as usize;
        }
        None
    }

    /// Finds the cell whose image contains `x`, and the position in the cell, by the tree.
    fn look_up(&self, x: Vec2) -> (usize, DVec2) {
        let (mut best, mut least) = ((0, DVec2::splat(0.5)), f64::INFINITY);
        let root = self.boxes[0][0].0;
        let mut turn = (root[0] - x.x).ceil();
        while x.x + turn <= root[2] && least > 0.0 {
            self.search(Vec2::new(x.x + turn, x.y), &mut best, &mut least);
            turn += 1.0;
        }
        (best.0, best.1.clamp(DVec2::ZERO, DVec2::ONE))
    }

    /// Visits all cells whose box contains `x`, until one contains `x`; keeps the cell with the smallest
    /// distance.
    fn search(&self, x: Vec2, best: &mut (usize, DVec2), least: &mut f64) {
        // Three siblings wait at each of at most 10 levels.
        let mut waiting = [(0_u8, 0_u32, 0_u32); 48];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (level, column, row) = waiting[count];
            let side = 1_usize << level;
            if !self.boxes[level as usize][row as usize * side + column as usize].contains(x) {
                continue;
            }
            if side == self.cells {
                let index = row as usize * side + column as usize;
                let (st, outside) = cell_of(self.cells, &self.nodes, index).invert(x.as_dvec2());
                if outside < *least {
                    (*best, *least) = ((index, st), outside);
                }
                if outside == 0.0 {
                    return;
                }
                continue;
            }
            for child in 0..4 {
                waiting[count] = (level + 1, 2 * column + (child & 1), 2 * row + (child >> 1));
                count += 1;
            }
        }
    }
}

/// Returns nodes with the first column repeated at the end, moved by 1.
pub(super) fn close(cells: usize, nodes: &[Vec2]) -> Vec<Vec2> {
    nodes.chunks_exact(cells).flat_map(|row| row.iter().copied().chain([row[0] + Vec2::X])).collect()
}

/// Returns a cell of closed nodes.
pub(super) fn cell_of(cells: usize, nodes: &[Vec2], index: usize) -> Cell {
    let at = index / cells * (cells + 1) + index % cells;
    let below = at + cells + 1;
    Cell::new([nodes[at], nodes[at + 1], nodes[below], nodes[below + 1]])
}

/// Builds the tree of bounding boxes.
fn boxes(cells: usize, nodes: &[Vec2]) -> Vec<Vec<Bounds>> {
    let leaf = |index: usize| {
        let at = index / cells * (cells + 1) + index % cells;
        let below = at + cells + 1;
        Bounds::of(&[nodes[at], nodes[at + 1], nodes[below], nodes[below + 1]])
    };
    let mut levels = vec![(0..cells * cells).map(leaf).collect::<Vec<_>>()];
    let mut side = cells;
    while side > 1 {
        let children = &levels[levels.len() - 1];
        let half = side / 2;
        let parent = |index: usize| {
            let at = index / half * 2 * side + index % half * 2;
            children[at].join(children[at + 1]).join(children[at + side]).join(children[at + side + 1])
        };
        levels.push((0..half * half).map(parent).collect());
        side = half;
    }
    levels.reverse();
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    /// Returns a map whose rows are moved along the circle and whose columns gather around a point, as under
    /// a lamp.
    fn gathered(cells: usize) -> WarpMap {
        let node = |k: usize| {
            let (u, v) = ((k % cells) as f32 / cells as f32, (k / cells) as f32 / cells as f32);
            let squeezed = u + 0.14 * (std::f32::consts::TAU * u).sin();
            Vec2::new(squeezed + 0.9 * v, v + 0.12 * (std::f32::consts::TAU * v).sin())
        };
        let mut nodes: Vec<Vec2> = (0..cells * (cells + 1)).map(node).collect();
        nodes[cells * cells..].iter_mut().for_each(|node| node.y = 1.0);
        WarpMap::new(cells, &nodes).unwrap()
    }

    #[test]
    fn walks_and_tree_find_the_same_cell() {
        let map = gathered(64);
        let mut random = Stream::new(1, Purpose::Test, 0);
        let mut arrived = 0;
        for _ in 0..20_000 {
            let x = random.uniform2();
            let Some((walked, st)) = map.walk(x) else { continue };
            arrived += 1;
            let (found, at) = map.look_up(x);
            let y = |index: usize, st: DVec2| DVec2::new((index % 64) as f64, (index / 64) as f64) + st;
            let apart = (y(walked, st) - y(found, at)).abs();
            // On an edge either cell may be found, also across the seam. The tree rounds x to 1.2e-7 on
            // another turn of the circle, which is magnified by 64 cells and by the density, at most 10 in
            // either coordinate.
            assert!(apart.x.min(64.0 - apart.x) < 1e-4 && apart.y < 1e-4, "{x}: {walked} {st}, {found} {at}");
        }
        assert!(arrived > 19_900, "{arrived} walks arrived");
    }
}
