//! The direct bake: the ideal intermediate density of a Lambert surface, tabulated without any training.

use rayon::prelude::*;

use super::{cell_directions::CellDirections, cell_grid::CellGrid, normal_grid::NormalGrid, table::BakedTable};
use crate::{error::Result, tail::Tail};

/// Tabulates `max(0, n . t(y))` over the cells of Y for every normal of the grid.
///
/// A cell holds the root mean square of the cosine over it, which is the piecewise constant density of least variance
/// (minimise the integral of g^2 / q under the integral of q = 1), or more where a direction in it would have a large weight (see
/// [`CellDirections::raise`]).
///
/// # Errors
/// See [`BakedTable::new`].
pub fn direct_bake(tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    let directions = CellDirections::new(tail, cells);
    let mut masses = vec![0.0; normals.nodes() * cells.cells()];
    let nodes = masses.par_chunks_exact_mut(cells.cells()).enumerate();
    nodes.for_each(|(node, masses)| directions.root_mean_squares(normals.normal(node), masses));
    directions.raise(normals, &mut masses);
    BakedTable::new(normals, cells, masses)
}
