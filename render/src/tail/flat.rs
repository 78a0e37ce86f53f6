//! Tails as flat lists, for implementations on other devices.

use super::{FlowTail, Hierarchical, RowColumn, Tail};
use crate::{environment::BilinearDensity, flat::FlatArray};

impl Tail {
    /// All that the warp reads; a tail is known by the names of its arrays.
    pub fn flat(&self) -> Vec<FlatArray> {
        match self {
            Self::Hierarchical(tail) => tail.flat(),
            Self::RowColumn(tail) => tail.flat(),
            Self::Flow(tail) => tail.flat(),
        }
    }
}

/// `tail.nodes` `[height, width]`: the density at the texels of the map.
fn nodes(grid: &BilinearDensity) -> FlatArray {
    FlatArray::floats("tail.nodes", vec![grid.rows() + 1, grid.columns()], grid.nodes().collect())
}

impl Hierarchical {
    /// All that the warp reads.
    ///
    /// - `tail.nodes` `[height, width]`: the density at the texels of the map.
    /// - `tail.cuts` `[nodes, 4]`, `tail.levels` `[levels, 3]`: see [`Self::levels`]; of a level the two logarithms and where its cuts begin.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut cuts, mut levels) = (Vec::new(), Vec::new());
        for ([column_bits, row_bits], own) in self.levels() {
            levels.extend([column_bits, row_bits, (cuts.len() / 4) as u32]);
            cuts.extend_from_slice(own.as_flattened());
        }
        vec![
            nodes(self.grid()),
            FlatArray::floats("tail.cuts", vec![cuts.len() / 4, 4], cuts),
            FlatArray::integers("tail.levels", vec![levels.len() / 3, 3], levels),
        ]
    }
}

impl RowColumn {
    /// All that the warp reads.
    ///
    /// - `tail.nodes` `[height, width]`: the density at the texels of the map.
    /// - `tail.marginal` `[height]`: the marginal density at the rows of texels; `tail.above` `[height]`: the share of the light above each.
    /// - `tail.before` `[height, width + 1]`: the integral of each row from its first texel's centre to each next one.
    pub fn flat(&self) -> Vec<FlatArray> {
        let [marginal, above, before] = self.tables();
        let rows = marginal.len();
        vec![
            nodes(self.grid()),
            FlatArray::floats("tail.marginal", vec![rows], marginal.to_vec()),
            FlatArray::floats("tail.above", vec![rows], above.to_vec()),
            FlatArray::floats("tail.before", vec![rows, before.len() / rows], before.to_vec()),
        ]
    }
}

impl FlowTail {
    /// All that the warp reads.
    ///
    /// - `tail.cells` `[cells * cells, 8]`: of each cell of Y, row by row, `p`, `e`, `f`, `g` of the image `p + s e + t f + s t g` in X; the circle's
    ///   coordinate is lifted to the line.
    /// - `tail.boxes` `[boxes, 4]`: a tree of bounding boxes of images (left, top, right, bottom): level `k` has `2^k x 2^k` of them, row by row, and the
    ///   last level one for each cell. Levels follow each other.
    pub fn flat(&self) -> Vec<FlatArray> {
        let map = self.map();
        let side = map.cells();
        let cells: Vec<f32> = (0..side * side).flat_map(|index| map.cell_numbers(index)).collect();
        let boxes: Vec<f32> = map.box_numbers().collect();
        vec![
            FlatArray::floats("tail.cells", vec![side * side, 8], cells),
            FlatArray::floats("tail.boxes", vec![boxes.len() / 4, 4], boxes),
        ]
    }
}
