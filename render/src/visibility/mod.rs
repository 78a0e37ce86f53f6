//! What part of the sky is seen from where, learned from the shadow rays of a rendering.
//!
//! Shading points are gathered in cells of space ([`Cells`]), and for each cell the shadow rays are counted that were sent to each patch of
//! sky, and those that were not stopped. From these follow weights ([`Weights`]) that a sampler multiplies its product of light,
//! BRDF and cosine with: equal areas of Y carry equal light, so patches are small where light is.
//!
//! # Why estimates stay unbiased
//!
//! A pixel's points are one scrambled sequence: each point alone is uniform, but not after others of the sequence have been seen. So a pixel must not draw with
//! what its own points have taught, neither directly nor by way of others. Pixels are in four groups, two in each half. What is learned first
//! a group takes from the other group of its half, which has learned nothing before; what is learned then, from the other half, whose groups have learned
//! from each other alone. Given all points of the groups that a pixel has learned from, its own are still uniform. Independent points need no
//! groups.

mod cells;
mod counts;
mod estimate;
mod file;
mod known;
mod weights;

pub use cells::Cells;
pub use known::{Known, SceneVisibility};
pub use weights::{CLUSTERS, PATCHES, Unoccluded, Weighting, Weights};

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use cells::CellKey;
use counts::Counts;

use crate::{
    simd::{LANES, Lanes},
    tile::Rows,
};

/// The visibility of the sky in the cells of a scene, and what was seen of it since it was last updated.
#[derive(Debug)]
pub struct VisibilityCache {
    cells: Cells,
    grouping: Grouping,
    /// Whether groups learn from the other half.
    by_halves: bool,
    counts: Counts,
    weights: Vec<Weights>,
    /// What was learned before. Nothing is counted in its cells.
    known: Option<Arc<Known>>,
    /// The shares of light of the patches.
    energies: Vec<f32>,
    most_cells: usize,
    /// Points that were drawn for since the last update: all, and those without a cell.
    asked: [AtomicU64; 2],
}

/// Who learns from whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grouping {
    /// All from all: for points that are independent.
    One,
    /// Four groups of pixels, squares of four pixels along a side: for points that are a sequence in each pixel.
    Four,
}

/// What a cache has come to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CacheSize {
    /// Cells, of all levels.
    pub cells: usize,
    /// Bytes that they take.
    pub bytes: usize,
    /// The share of the points that were last drawn for of which nothing was known, as they lie in no cell.
    pub unknown: f64,
}

/// Marks numbers of weights that were known before; the others count those of this rendering, after those of no cell.
const IS_KNOWN: u32 = 1 << 31;

/// The lowest bits of keys that a group of pixels has all of: a strip of lanes is in one group.
const BLOCK_BITS: u32 = 4;

impl VisibilityCache {
    /// Bytes of a cell: its counts, its weights, and its place in the lists of cells.
    pub const CELL_BYTES: usize = PATCHES * 8 + size_of::<Weights>() + 40;

    /// A cache that knows nothing yet, of at most `bytes` bytes.
    ///
    /// `energies` are the shares of light of [`PATCHES`] patches, in their order; those that do not exist have 0.
    ///
    /// # Panics
    /// If there are not as many energies as patches.
    pub fn new(cells: Cells, grouping: Grouping, energies: Vec<f32>, bytes: usize) -> Self {
        assert_eq!(energies.len(), PATCHES, "a share of light for each patch");
        let (counts, weights, most_cells) = (Counts::default(), vec![Weights::UNKNOWN], bytes / Self::CELL_BYTES);
        let asked = Default::default();
        Self { cells, grouping, by_halves: false, counts, weights, known: None, energies, most_cells, asked }
    }

    /// The same with what was learned before, in whose cells it learns on: what is known keeps, the rest is learned.
    #[must_use]
    pub fn knowing(self, known: Arc<Known>) -> Self {
        let most_cells = self.most_cells.saturating_sub(known.bytes() / Self::CELL_BYTES);
        Self { cells: known.cells(), known: Some(known), most_cells, ..self }
    }

    /// The same that goes on learning everywhere where others have begun.
    #[must_use]
    pub fn resuming(mut self, visibility: SceneVisibility) -> Self {
        (self.cells, self.counts) = (visibility.cells, visibility.counts);
        self.estimate();
        self
    }

    /// What was learned by all groups together, of a scene and under a map with these hashes.
    pub fn into_scene_visibility(
        self,
        scene_hash: String,
        environment: String,
        environment_hash: String,
    ) -> SceneVisibility {
        let counts = self.counts.regrouped(|_| 0);
        SceneVisibility { scene_hash, environment, environment_hash, cells: self.cells, counts }
    }

    /// The group that a pixel's rays are counted in.
    fn group(&self, key: u32) -> u32 {
        match self.grouping {
            Grouping::One => 0,
            Grouping::Four => key >> BLOCK_BITS & 3,
        }
    }

    /// The group that a pixel learns from.
    fn read_group(&self, key: u32) -> u32 {
        match self.grouping {
            Grouping::One => 0,
            Grouping::Four if self.by_halves => (key >> (BLOCK_BITS + 1) & 1) ^ 1,
            Grouping::Four => (key >> BLOCK_BITS & 3) ^ 1,
        }
    }

    /// The finest cells of points, each for the group that `group` gives for the key of its pixel.
    fn keys(&self, at: &Rows<'_>, group: impl Fn(u32) -> u32) -> Vec<CellKey> {
        let mut keys = Vec::with_capacity(at.len());
        for strip in 0..at.strips() {
            let mut own = [0; LANES];
            cells::keys(&self.cells, &at.positions(strip), &at.normals(strip), &mut own);
            let places = strip * LANES..((strip + 1) * LANES).min(at.len());
            keys.extend(own.iter().zip(places).map(|(&key, place)| CellKey(key).of_group(group(at.key(place)))));
        }
        keys
    }

    /// Counts shadow rays: the place among the rows that each left from, the patch that it was sent to, and whether it came through. Whatever the order
    /// of the rays, and on any number of threads, what is learned is the same.
    pub fn observe(&self, at: &Rows<'_>, rays: impl Iterator<Item = (u16, u16, bool)>) {
        let keys = self.keys(at, |key| self.group(key));
        // A cell that was known before keeps what is known of it.
        let is_known = |key: &CellKey| self.known.as_ref().is_some_and(|known| known.visibility(*key).is_some());
        let mut last = (None, None);
        let learning = keys.into_iter().map(|key| {
            if last.0 != Some(key) {
                last = (Some(key), Some(key).filter(|key| !is_known(key)));
            }
            last.1
        });
        let keys: Vec<Option<CellKey>> = learning.collect();
        let of_ray =
            |(place, patch, is_visible): (u16, u16, bool)| Some((keys[usize::from(place)]?, patch, is_visible));
        self.counts.add(rays.filter_map(of_ray));
    }

    /// Turns what was observed into weights. After the last time nothing may be observed any more.
    pub fn learn(&mut self, is_last: bool) {
        let groups = if self.grouping == Grouping::Four { 4 } else { 1 };
        self.counts.settle(self.most_cells / groups);
        if is_last && self.grouping == Grouping::Four {
            self.counts = self.counts.regrouped(|group| group >> 1);
            self.by_halves = true;
        }
        self.estimate();
        self.asked = Default::default();
    }

    fn estimate(&mut self) {
        let known = |key| self.known.as_ref().and_then(|known| known.visibility(key));
        let weights = estimate::estimate(&self.counts, known, |visibility| visibility.weights(&self.energies));
        self.weights = std::iter::once(Weights::UNKNOWN).chain(weights).collect();
    }

    /// The number of the weights at a key: those of the finest cell that is known.
    fn number(&self, key: CellKey) -> u32 {
        let own = self.counts.find(key);
        match self.known.as_ref().and_then(|known| known.find(key)) {
            Some((cell, level)) if own.is_none_or(|(_, own)| level < own) => IS_KNOWN | cell,
            _ => own.map_or(0, |(cell, _)| cell + 1),
        }
    }

    /// How large it is.
    pub fn size(&self) -> CacheSize {
        let (cells, bytes) = self.known.as_ref().map_or((0, 0), |known| (known.len(), known.bytes()));
        let (cells, bytes) = (cells + self.counts.cells(), bytes + self.counts.cells() * Self::CELL_BYTES);
        let [all, unknown] = self.asked.each_ref().map(|count| count.load(Relaxed) as f64);
        CacheSize { cells, bytes, unknown: unknown / all.max(1.0) }
    }
}

impl Weighting for VisibilityCache {
    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        let (mut last, mut unknown) = ((None, 0), 0);
        for (key, out) in self.keys(at, |key| self.read_group(key)).into_iter().zip(out.as_flattened_mut()) {
            if last.0 != Some(key) {
                last = (Some(key), self.number(key));
            }
            unknown += u64::from(last.1 == 0);
            *out = f32::from_bits(last.1);
        }
        self.asked[0].fetch_add(at.len() as u64, Relaxed);
        self.asked[1].fetch_add(unknown, Relaxed);
    }

    #[inline(always)]
    fn at(&self, index: f32) -> Option<&Weights> {
        let number = index.to_bits();
        if number & IS_KNOWN != 0 {
            return self.known.as_ref().and_then(|known| known.weights(number & !IS_KNOWN));
        }
        self.weights.get(number as usize)
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec3, Vec3A};

    use super::*;
    use crate::{
        brdf::Lambert,
        tile::{ShadingPoint, Tile},
    };

    /// The weights that the pixels of each group draw with in the second and in the third stage. What a ray finds depends on what it was drawn with;
    /// those of group `other` find something else from the first sample on.
    fn weights_of_groups(grouping: Grouping, other: Option<u32>) -> [Vec<Vec<f32>>; 2] {
        let mut cache = VisibilityCache::new(Cells::new(Vec3A::ZERO, 0.01), grouping, vec![1.0; PATCHES], 1 << 30);
        // Four places near to each other; pixels of all groups see each.
        let mut tile = Tile::default();
        for row in 0..16 {
            let p = Vec3A::new(0.1 * (row % 4) as f32, 0.0, 10.0);
            let surface = Lambert { albedo: Vec3::ONE }.into();
            let point = ShadingPoint { p, ng: Vec3A::Y, ns: Vec3A::Y, wo: Vec3A::Y, surface };
            tile.push(&point, (row / 4) << BLOCK_BITS);
        }
        let at = tile.rows();
        let drawn = |cache: &VisibilityCache| -> Vec<Vec<f32>> {
            let mut indices = [[0.0; LANES]; 1];
            cache.indices(&at, &mut indices);
            let of_row = |&index: &f32| {
                (0..PATCHES).map(move |patch| cache.at(index).map_or(0.0, |weights| weights.of_patch(patch)))
            };
            indices[0].chunks_exact(4).map(|rows| rows.iter().flat_map(of_row).collect()).collect()
        };
        let mut out = [Vec::new(), Vec::new()];
        for stage in 0..2 {
            for (key, own) in drawn(&cache).iter().enumerate() {
                for (k, weights) in own.chunks_exact(PATCHES).enumerate() {
                    let bits = weights.iter().fold(7_u32, |sum, w| sum.wrapping_mul(31).wrapping_add(w.to_bits()));
                    let bits = bits ^ if other == Some(key as u32) { 0x5555 } else { 0 };
                    let rays = (0..2000_u32).map(|ray| {
                        let number = (ray ^ bits).wrapping_mul(0x9e37_79b9) >> 8;
                        ((4 * key + k) as u16, (number % 7) as u16, number % 11 == bits % 11)
                    });
                    cache.observe(&at, rays);
                }
            }
            cache.learn(stage == 1);
            out[stage] = drawn(&cache);
        }
        out
    }

    #[test]
    fn no_pixel_draws_with_what_its_own_points_have_taught_directly_or_by_way_of_others() {
        let same = weights_of_groups(Grouping::Four, None);
        for group in 0..4 {
            let changed = weights_of_groups(Grouping::Four, Some(group));
            for stage in 0..2 {
                let differ = |key: usize| same[stage][key] != changed[stage][key];
                assert!(!differ(group as usize), "group {group}, stage {}", stage + 1);
                assert!((0..4).any(differ), "others have learned from group {group}");
            }
            // In the last stage both groups of the other half have.
            assert_eq!((0..4).filter(|&key| same[1][key] != changed[1][key]).count(), 2);
            // Where all learn from all, a group learns from itself.
            let [of_all, with_change] = [None, Some(group)].map(|other| weights_of_groups(Grouping::One, other));
            assert_ne!(of_all[0][group as usize], with_change[0][group as usize]);
        }
    }
}
