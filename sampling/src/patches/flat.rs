//! Patches as flat lists, for implementations on other devices.

use super::{
    hierarchy::{PARTS, Patches},
    mass::Block,
};
use crate::{flat::FlatArray, simd::LANES};

/// Numbers per patch in a list: the 14 that its mass is computed from, in the order of [`Block`], one extra
/// number, and 0.
const NUMBERS: usize = 16;

/// Lists the patches of blocks, each with an extra number `own`.
fn records(blocks: &[Block], own: impl Fn(usize) -> f32) -> Vec<f32> {
    let mut records = Vec::with_capacity(blocks.len() * LANES * NUMBERS);
    for (number, block) in blocks.iter().enumerate() {
        for lane in 0..LANES {
            records.extend(block.iter().map(|column| column[lane]));
            records.extend([own(number * LANES + lane), 0.0]);
        }
    }
    records
}

impl Patches {
    /// Returns all arrays that sampling and pdf read.
    ///
    /// - `patches.clusters` `[32, 16]`, `patches.leaves` `[32 * 16, 16]`, `patches.twigs` `[512 * 16, 16]`:
    ///   the energy, as a fraction of the map's light; centroid; three times the covariance xx, yy, zz, and
    ///   twice that xy, xz, yz; reach, mahalanobis, cell, variance; for leaves and twigs the reciprocal of
    ///   the energy, for clusters the mean density of their light over solid angle; 0. Missing patches are 0.
    /// - `patches.leaf_rectangles` `[512, 4]`, `patches.twig_rectangles` `[8192, 4]`: left, right, top, bottom in Y.
    /// - `patches.forest` `[splits]`: trees of splits; bits 0 to 6 are the place of the first patch of the
    ///   second half, bit 7 is set if columns are cut, bits 8 to 15 and 16 to 23 are the halves relative to
    ///   the root, bit 24 is set for a single patch.
    /// - `patches.roots` `[1 + 32 + 512]`: the roots of the trees over clusters, leaves and twigs.
    /// - `patches.twig_of_cell` `[rows, columns]`: the number of the twig of each cell of the map.
    /// - `patches.small` `[1]`: the number of clusters that are small lights, which come first.
    /// - `patches.narrow` `[1]`: the lobe width below which twigs are used.
    pub fn flat(&self, columns: usize, rows: usize) -> Vec<FlatArray> {
        let mut clusters = vec![Block::default(); 2];
        for (number, patch) in self.clusters.iter().enumerate() {
            patch.store(&mut clusters[number / LANES], number % LANES);
        }
        let list = |name, numbers: Vec<f32>, width: usize| {
            FlatArray::floats(name, vec![numbers.len() / width, width], numbers)
        };
        let rectangles = |level: &super::hierarchy::Level| {
            level.rectangles.iter().flat_map(|numbers| numbers[..4].to_vec()).collect()
        };
        let leaves = records(&self.leaves.blocks, |leaf| self.leaves.rectangles[leaf][4]);
        let twigs = records(&self.twigs.blocks, |twig| self.twigs.rectangles[twig][4]);
        let mut roots = vec![self.root];
        roots.extend(
            (0..crate::visibility::CLUSTERS)
                .map(|cluster| self.leaves.roots.get(cluster).copied().unwrap_or(self.rest)),
        );
        roots.extend(
            (0..crate::visibility::CLUSTERS * PARTS)
                .map(|leaf| self.twigs.roots.get(leaf).copied().unwrap_or(self.rest)),
        );
        let cells =
            (0..(rows * columns) as u32).map(|k| self.lookup.patch(k % columns as u32, k / columns as u32)).collect();
        let forest = self.forest.splits();
        vec![
            list(
                "patches.clusters",
                records(&clusters, |cluster| self.brightness.get(cluster).copied().unwrap_or(0.0)),
                NUMBERS,
            ),
            list("patches.leaves", leaves, NUMBERS),
            list("patches.twigs", twigs, NUMBERS),
            list("patches.leaf_rectangles", rectangles(&self.leaves), 4),
            list("patches.twig_rectangles", rectangles(&self.twigs), 4),
            FlatArray::integers("patches.forest", vec![forest.len()], forest),
            FlatArray::integers("patches.roots", vec![roots.len()], roots),
            FlatArray::integers("patches.twig_of_cell", vec![rows, columns], cells),
            FlatArray::integers("patches.small", vec![1], vec![self.small as u32]),
            FlatArray::floats(
                "patches.narrow",
                vec![1],
                vec![if self.narrow.is_finite() { self.narrow } else { f32::MAX }],
            ),
        ]
    }
}
