//! The quad-tree tail as flat lists, for implementations on other devices.

use super::Hierarchical;
use crate::flat::FlatArray;

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
        let (width, height) = (self.grid().columns(), self.grid().rows() + 1);
        vec![
            FlatArray::floats("tail.nodes", vec![height, width], self.grid().nodes().collect()),
            FlatArray::floats("tail.cuts", vec![cuts.len() / 4, 4], cuts),
            FlatArray::integers("tail.levels", vec![levels.len() / 3, 3], levels),
        ]
    }
}
