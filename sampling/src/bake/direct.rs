//! The direct bake: the ideal intermediate density of a Lambert surface, tabulated without any training.

use crate::parallel::*;

use super::{
    cell_directions::CellDirections, cell_grid::CellGrid, normal_grid::NormalGrid, share::Share, table::BakedTable,
};
use crate::{error::Result, tail::Tail};

/// The share of its time in which the mean squares are found.
const SQUARES: f64 = 0.05;

/// Tabulates `max(0, n . t(y))` over the cells of Y for every normal of the grid.
///
/// A cell holds the root mean square of the cosine over it, which is the piecewise constant density of least variance
/// (minimise the integral of g^2 / q under the integral of q = 1), or more where a direction in it would have a large weight (see
/// [`CellDirections::raise`]).
///
/// # Errors
/// See [`BakedTable::new`] and [`BakedTable::require_memory`].
pub fn direct_bake(tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    direct_bake_watched(tail, normals, cells, &|_| {})
}

/// [`direct_bake`], of which `watch` is told now and then which share is done, from any thread.
///
/// # Errors
/// As [`direct_bake`].
pub fn direct_bake_watched(
    tail: &Tail,
    normals: NormalGrid,
    cells: CellGrid,
    watch: &(dyn Fn(f64) + Sync),
) -> Result<BakedTable> {
    BakedTable::require_memory(normals, cells)?;
    let directions = CellDirections::new(tail, cells);
    let mut masses = vec![0.0; normals.nodes() * cells.cells()];
    let nodes = masses.par_chunks_exact_mut(cells.cells()).enumerate();
    let share = Share::new(watch, (0.0, SQUARES), normals.nodes());
    nodes.for_each(|(node, masses)| {
        directions.root_mean_squares(normals.normal(node), masses);
        share.step();
    });
    directions.raise(normals, &mut masses, (SQUARES, watch));
    BakedTable::new(normals, cells, masses)
}
