//! The rectangles in which rays cross a plane.

use glam::{IVec2, Vec2};

use super::{
    plane::{Plane, Rectangle},
    projection::Projection,
};

/// Cells along the longer side of the scene.
const CELLS: f32 = 128.0;
/// Cells at this distance belong together, so that mullions and slats do not divide a window.
const REACH: i32 = 2;
/// Rays in a cell that count as light.
const LEAST_RAYS: u32 = 2;

/// Rays by the cell in which they cross a plane.
pub struct Grid {
    size: IVec2,
    origin: Vec2,
    cell: f32,
    open: Vec<u32>,
    blocked: Vec<u32>,
    weights: [f32; 2],
}

impl Grid {
    /// Counts the rays of a projection on one of its planes; `weights` are those of open and blocked rays.
    pub fn new(projection: &Projection, plane: Plane, weights: [f32; 2]) -> Self {
        let [low, high] = projection.extent();
        let cell = ((high - low).max_element() / CELLS).max(f32::MIN_POSITIVE);
        let size = ((high - low) / cell).ceil().as_ivec2().max(IVec2::ONE);
        let cells = (size.x * size.y) as usize;
        let mut grid = Self { size, origin: low, cell, open: vec![0; cells], blocked: vec![0; cells], weights };
        for at in projection.open(plane) {
            if let Some(cell) = grid.cell_at(at) {
                grid.open[cell] += 1;
            }
        }
        for at in projection.blocked(plane) {
            if let Some(cell) = grid.cell_at(at) {
                grid.blocked[cell] += 1;
            }
        }
        grid
    }

    fn cell_at(&self, at: Vec2) -> Option<usize> {
        let cell = ((at - self.origin) / self.cell).floor().as_ivec2();
        self.index(cell)
    }

    fn index(&self, cell: IVec2) -> Option<usize> {
        let inside = cell.cmpge(IVec2::ZERO).all() && cell.cmplt(self.size).all();
        inside.then(|| (cell.y * self.size.x + cell.x) as usize)
    }

    /// Returns the rectangle of the highest score around connected cells, and the score.
    pub fn best(&self) -> Option<(f32, Rectangle)> {
        let mut seen = vec![false; self.open.len()];
        let mut best: Option<(f32, Rectangle)> = None;
        for y in 0..self.size.y {
            for x in 0..self.size.x {
                let cell = IVec2::new(x, y);
                if self.is_lit(cell, &seen) {
                    let (low, high) = self.connected(cell, &mut seen);
                    let score = self.score(low, high);
                    if best.is_none_or(|(highest, _)| score > highest) {
                        let corner = |cell: IVec2| self.origin + self.cell * cell.as_vec2();
                        best = Some((score, Rectangle { low: corner(low), high: corner(high + IVec2::ONE) }));
                    }
                }
            }
        }
        best
    }

    fn is_lit(&self, cell: IVec2, seen: &[bool]) -> bool {
        self.index(cell).is_some_and(|index| !seen[index] && self.open[index] >= LEAST_RAYS)
    }

    /// Marks the cells connected to one; returns the lowest and the highest coordinates.
    fn connected(&self, first: IVec2, seen: &mut [bool]) -> (IVec2, IVec2) {
        let (mut low, mut high, mut open) = (first, first, vec![first]);
        while let Some(cell) = open.pop() {
            (low, high) = (low.min(cell), high.max(cell));
            for y in -REACH..=REACH {
                for x in -REACH..=REACH {
                    let other = cell + IVec2::new(x, y);
                    if self.is_lit(other, seen) {
                        seen[(other.y * self.size.x + other.x) as usize] = true;
                        open.push(other);
                    }
                }
            }
        }
        (low, high)
    }

    /// Returns `e^2 / a` of a rectangle: of `a` rays that cross it, `e` reach the environment.
    fn score(&self, low: IVec2, high: IVec2) -> f32 {
        let (mut open, mut blocked) = (0, 0);
        for y in low.y..=high.y {
            let row = (y * self.size.x) as usize;
            for index in row + low.x as usize..=row + high.x as usize {
                open += self.open[index];
                blocked += self.blocked[index];
            }
        }
        let (open, blocked) = (self.weights[0] * open as f32, self.weights[1] * blocked as f32);
        open * open / (open + blocked)
    }
}
