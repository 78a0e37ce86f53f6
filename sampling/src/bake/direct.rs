//! The direct bake: the ideal intermediate density of a Lambert surface, tabulated without training.

use crate::parallel::*;

use super::{
    cell_directions::CellDirections, cell_grid::CellGrid, normal_grid::NormalGrid, progress::StageProgress,
    table::BakedTable,
};
use crate::{error::Result, tail::Tail};

/// The fraction of the time spent on root mean squares.
const SQUARES: f64 = 0.05;

/// Tabulates `max(0, n . t(y))` over the cells of Y for every normal of the grid.
///
/// The mass of a cell is the root mean square of the cosine over it, which gives the piecewise constant
/// density of least variance (it minimises the integral of g^2 / q subject to an integral of q = 1). It
/// is larger where a direction in the cell would have a large weight (see [`CellDirections::raise`]).
///
/// # Errors
/// See [`BakedTable::new`] and [`BakedTable::require_memory`].
pub fn direct_bake(tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    direct_bake_watched(tail, normals, cells, &|_| {})
}

/// [`direct_bake`] that reports the finished fraction to `watch`, from any thread.
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
    let progress = StageProgress::new(watch, (0.0, SQUARES), normals.nodes());
    nodes.for_each(|(node, masses)| {
        directions.root_mean_squares(normals.normal(node), masses);
        progress.step();
    });
    directions.raise(normals, &mut masses, (SQUARES, watch));
    BakedTable::new(normals, cells, masses)
}
