//! Makes a tabulated warp one-to-one.

use glam::{DVec2, Vec2};

use super::warp_map::{LEAST_CORNER, WarpMap, cell_of, close};
use crate::error::Result;

/// Rounds of untangling before the surroundings of the remaining cells are smoothed.
const ROUNDS: usize = 60;
/// Smallest Jacobian of a cell's corners that smoothing requires, as a fraction of their mean: barely convex
/// cells come from non-convex ones.
const ROOM: f64 = 0.2;
/// Rounds of smoothing before the whole map is blended with the identity.
const SMOOTHINGS: usize = 120;
/// Number of rounds of smoothing after which their reach grows by half: from 1 node around a cell to 100.
const SMOOTHINGS_OF_A_REACH: usize = 10;

/// The statistics of [`WarpMap::repaired`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Repair {
    /// Largest number of cells in a round whose images are not convex.
    pub cells: usize,
    /// Rounds of moving their corners.
    pub rounds: usize,
    /// Rounds of smoothing around the remaining cells.
    pub smoothings: usize,
    /// Weight of the identity in the result; 0 if untangling or smoothing suffices.
    pub blended: f32,
}

impl WarpMap {
    /// Returns the map with the values `nodes` (see [`WarpMap::new`]), in which the corners of cells whose
    /// images are not convex are moved iteratively. Where some remain, the map is smoothed around them, with
    /// a reach that grows with the number of rounds. If that fails, too, the whole map is blended with the
    /// identity, which is convex.
    ///
    /// # Errors
    /// As [`WarpMap::new`], except for convexity.
    pub fn repaired(cells: usize, mut nodes: Vec<Vec2>) -> Result<(Self, Repair)> {
        let mut repair = Repair::default();
        let original = nodes.clone();
        let usable = nodes.len() == cells * (cells + 1) && nodes.iter().all(|node| node.is_finite());
        while usable && repair.rounds < ROUNDS {
            let broken = broken_cells(cells, &nodes, LEAST_CORNER);
            if broken.is_empty() {
                break;
            }
            repair.cells = repair.cells.max(broken.len());
            repair.rounds += 1;
            untangle(cells, &mut nodes, &broken);
        }
        while usable && repair.rounds == ROUNDS && repair.smoothings < SMOOTHINGS {
            if repair.smoothings == 0 {
                if broken_cells(cells, &nodes, LEAST_CORNER).is_empty() {
                    break;
                }
                nodes.clone_from(&original);
            }
            let broken = broken_cells(cells, &nodes, ROOM);
            if broken.is_empty() {
                break;
            }
            let reach = 1.5_f64.powi((repair.smoothings / SMOOTHINGS_OF_A_REACH) as i32);
            repair.smoothings += 1;
            smooth(cells, &mut nodes, &broken, reach as usize);
        }
        let mut fraction = 1e-3_f32;
        while usable && repair.smoothings == SMOOTHINGS && !broken_cells(cells, &nodes, LEAST_CORNER).is_empty() {
            repair.blended = fraction.min(1.0);
            nodes = blend(cells, &original, repair.blended);
            fraction *= 1.5;
        }
        Ok((Self::new(cells, &nodes)?, repair))
    }
}

fn broken_cells(cells: usize, nodes: &[Vec2], least: f64) -> Vec<usize> {
    let closed = close(cells, nodes);
    (0..cells * cells).filter(|&index| !cell_of(cells, &closed, index).has_room(least)).collect()
}

/// Moves each corner of `broken` cells to maximize the smallest triangle at its four cells, relative to the
/// size of its cell (after Freitag and Plassmann 2000, "Local optimization-based simplicial mesh untangling
/// and improvement"), by a pattern search.
fn untangle(cells: usize, nodes: &mut [Vec2], broken: &[usize]) {
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
    for at in corners {
        nodes[at] = best_place(cells, nodes, at);
    }
}

/// Moves the nodes within `reach` of `broken` cells half of the way to the mean of their four neighbours;
/// nodes of the first and the last row move along it. Larger steps would leave a kink at the border of the
/// moved region, where sheared cells fold again.
fn smooth(cells: usize, nodes: &mut [Vec2], broken: &[usize], reach: usize) {
    let mut within = vec![false; nodes.len()];
    for &index in broken {
        let (column, row) = (index % cells, index / cells);
        for row in row.saturating_sub(reach)..=(row + 1 + reach).min(cells) {
            for across in 0..=(2 * reach + 1).min(cells - 1) {
                within[row * cells + (column + cells - reach % cells + across) % cells] = true;
            }
        }
    }
    let moving: Vec<usize> = (0..nodes.len()).filter(|&at| within[at]).collect();
    let middle = |&at: &usize| {
        let [[_, above, _], [left, _, right], [_, below, _]] = around(cells, nodes, at);
        let sides = [left, right].into_iter().flatten().sum::<DVec2>();
        let middle = match (above, below) {
            (Some(above), Some(below)) => 0.25 * (sides + above + below),
            _ => DVec2::new(0.5 * sides.x, f64::from(nodes[at].y)),
        };
        nodes[at].as_dvec2().lerp(middle, 0.5).as_vec2()
    };
    let moved: Vec<Vec2> = moving.iter().map(middle).collect();
    for (at, place) in moving.into_iter().zip(moved) {
        nodes[at] = place;
    }
}

/// Returns the eight nodes around a node, row by row, lifted to the line around it; `None` beyond a border.
fn around(cells: usize, nodes: &[Vec2], at: usize) -> [[Option<DVec2>; 3]; 3] {
    let (column, row) = ((at % cells) as isize, (at / cells) as isize);
    let side = cells as isize;
    std::array::from_fn(|down| {
        std::array::from_fn(|across| {
            let (row, column) = (row + down as isize - 1, column + across as isize - 1);
            (0..=side).contains(&row).then(|| {
                let turn = column.div_euclid(side) as f64;
                nodes[(row * side + column.rem_euclid(side)) as usize].as_dvec2() + DVec2::new(turn, 0.0)
            })
        })
    })
}

/// Returns the smallest triangle, relative to its cell, of those with the node as a corner, if it were at
/// `place`.
fn smallest_triangle(around: &[[Option<DVec2>; 3]; 3], place: DVec2) -> f64 {
    let mut least = f64::INFINITY;
    for (down, across) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        // In the order of a cell's border.
        let corners = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(i, j)| (down + i, across + j));
        let own = corners.iter().position(|&corner| corner == (1, 1)).expect("the node is a corner of all four cells");
        let points = corners.map(|(i, j)| if (i, j) == (1, 1) { Some(place) } else { around[i][j] });
        let [Some(_), Some(_), Some(_), Some(_)] = points else { continue };
        let triangle = |apex: usize| {
            let [p, q, r] = [apex % 4, (apex + 1) % 4, (apex + 3) % 4].map(|k| points[k].unwrap_or_default());
            (q - p).perp_dot(r - p)
        };
        // Cells differ in size by orders of magnitude, so each is relative to itself.
        let size: f64 = (0..4).map(|apex| triangle(apex).abs()).sum();
        for apex in [own + 3, own, own + 1] {
            least = least.min(triangle(apex) / size.max(f64::MIN_POSITIVE));
        }
    }
    least
}

fn best_place(cells: usize, nodes: &[Vec2], at: usize) -> Vec2 {
    let around = around(cells, nodes, at);
    let row = at / cells;
    let is_border = row == 0 || row == cells;
    let mut place = nodes[at].as_dvec2();
    let mut best = smallest_triangle(&around, place);
    let span = around.iter().flatten().flatten().map(|p| (*p - place).abs().max_element()).fold(0.0, f64::max);
    let mut step = 0.5 * span;
    while step > 1e-4 * span {
        let moves = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)];
        let tried = moves.map(|(x, y)| {
            let moved = place + step * DVec2::new(f64::from(x), if is_border { 0.0 } else { f64::from(y) });
            let moved = if is_border { moved } else { DVec2::new(moved.x, moved.y.clamp(0.0, 1.0)) };
            (moved, smallest_triangle(&around, moved))
        });
        let (found, least) = tried.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("there are eight moves");
        if least > best {
            (place, best) = (found, least);
        } else {
            step *= 0.5;
        }
    }
    place.as_vec2()
}

/// Blends with the identity, shifted along the circle by the mean shift of the map.
fn blend(cells: usize, nodes: &[Vec2], fraction: f32) -> Vec<Vec2> {
    let own = |at: usize| Vec2::new((at % cells) as f32, (at / cells) as f32) / cells as f32;
    let shift = (0..nodes.len()).map(|at| f64::from(nodes[at].x - own(at).x)).sum::<f64>() / nodes.len() as f64;
    let shift = Vec2::new(shift as f32, 0.0);
    (0..nodes.len()).map(|at| nodes[at].lerp(own(at) + shift, fraction)).collect()
}
