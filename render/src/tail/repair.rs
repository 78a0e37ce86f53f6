//! Making a tabulated warp one to one.

use glam::Vec2;

use super::warp_map::{WarpMap, cell_of, close};
use crate::error::Result;

/// Rounds of smoothing before the whole map is blended with the identity.
const ROUNDS: usize = 400;

/// What [`WarpMap::repaired`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Repair {
    /// Cells whose images were not convex.
    pub cells: usize,
    /// Rounds of smoothing around them.
    pub rounds: usize,
    /// Share of the identity in the result: 0 unless smoothing did not do.
    pub blended: f32,
}

impl WarpMap {
    /// The map with the values `nodes` (see [`WarpMap::new`]), in which cells whose images are not convex are smoothed: their nodes move
    /// halfway to the mean of their neighbours, again and again. What then is left is blended with the identity, which is convex.
    ///
    /// # Errors
    /// As [`WarpMap::new`], but for convexity.
    pub fn repaired(cells: usize, mut nodes: Vec<Vec2>) -> Result<(Self, Repair)> {
        let mut repair = Repair::default();
        let usable = nodes.len() == cells * (cells + 1) && nodes.iter().all(|node| node.is_finite());
        while usable && repair.rounds < ROUNDS {
            let broken = broken_cells(cells, &nodes);
            if broken.is_empty() {
                break;
            }
            repair.cells = repair.cells.max(broken.len());
            repair.rounds += 1;
            smooth(cells, &mut nodes, &broken);
        }
        let mut share = 1e-3_f32;
        let smoothed = nodes.clone();
        while usable && repair.rounds == ROUNDS && !broken_cells(cells, &nodes).is_empty() {
            repair.blended = share.min(1.0);
            nodes = blend(cells, &smoothed, repair.blended);
            share *= 1.5;
        }
        Ok((Self::new(cells, &nodes)?, repair))
    }
}

fn broken_cells(cells: usize, nodes: &[Vec2]) -> Vec<usize> {
    let closed = close(cells, nodes);
    (0..cells * cells).filter(|&index| !cell_of(cells, &closed, index).is_convex()).collect()
}

/// Moves the corners of some cells halfway to the mean of their four neighbours (along the border: two).
fn smooth(cells: usize, nodes: &mut [Vec2], broken: &[usize]) {
    let mut corners: Vec<usize> = broken
        .iter()
        .flat_map(|&index| {
            let (column, row) = (index % cells, index / cells);
            let next = (column + 1) % cells;
            [row * cells + column, row * cells + next, (row + 1) * cells + column, (row + 1) * cells + next]
        })
        .collect();
    corners.sort_unstable();
    corners.dedup();
    let before = nodes.to_vec();
    for at in corners {
        let (column, row) = (at % cells, at / cells);
        let left = if column == 0 { before[at + cells - 1] - Vec2::X } else { before[at - 1] };
        let right = if column + 1 == cells { before[at + 1 - cells] + Vec2::X } else { before[at + 1] };
        let mean = if row == 0 || row == cells {
            0.5 * (left + right)
        } else {
            0.25 * (left + right + before[at - cells] + before[at + cells])
        };
        let moved = 0.5 * (before[at] + mean);
        nodes[at] = Vec2::new(moved.x, before[at].y.clamp(0.0, 1.0));
        if row != 0 && row != cells {
            nodes[at].y = moved.y.clamp(0.0, 1.0);
        }
    }
}

/// Towards the identity, shifted along the circle as the map is on average.
fn blend(cells: usize, nodes: &[Vec2], share: f32) -> Vec<Vec2> {
    let own = |at: usize| Vec2::new((at % cells) as f32, (at / cells) as f32) / cells as f32;
    let shift = (0..nodes.len()).map(|at| f64::from(nodes[at].x - own(at).x)).sum::<f64>() / nodes.len() as f64;
    let shift = Vec2::new(shift as f32, 0.0);
    (0..nodes.len()).map(|at| nodes[at].lerp(own(at) + shift, share)).collect()
}
