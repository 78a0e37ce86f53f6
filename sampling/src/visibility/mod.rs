//! Visibility of the map from points of a scene, learned from shadow rays; `docs/method/visibility.md`
//! describes the method.
//!
//! Shadow rays, unblocked and all, are counted by the cell of space that they start from ([`Cells`]) and the
//! patch of the map that they are sent to. The counts become weights ([`Weights`]), which multiply the masses
//! of patches.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the visibility cache of one rendering |
//! | `cells.rs`, `cell_index.rs` | cells of space, and their numbers |
//! | `counts.rs` | shadow rays counted by cell and patch |
//! | `estimate.rs` | visibility from counts, and weights from visibility |
//! | `division.rs`, `weights.rs` | the patches that weights refer to; the weights |
//! | `flat.rs` | weights as lists, for other devices |
//! | `predicted_gain.rs` | whether weights gain more than they cost |
//! | `precomputed.rs`, `file.rs` | precomputed visibility, and its file |
//!
//! # Why estimates stay unbiased
//!
//! The points of a pixel are one scrambled sequence: each is uniform, but not given the others. Weights are
//! therefore learned from independent points before the rendering, and then fixed.

mod cell_index;
mod cells;
mod counts;
mod division;
mod estimate;
mod file;
mod flat;
mod precomputed;
mod predicted_gain;
mod weights;

pub use cells::Cells;
pub use division::{CLUSTERS, Division, PATCHES};
pub use flat::FlatVisibility;
pub use precomputed::{PrecomputedVisibility, SceneVisibility};
pub use weights::{Unoccluded, Weighting, Weights};

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use crate::parallel::*;
use cells::CellKey;
use counts::Counts;
use estimate::{Rays, Visibility};
use predicted_gain::PredictedGain;

use crate::{simd::Lanes, tile::Rows};

/// The visibility of the map in the cells of a scene, for one rendering.
#[derive(Debug)]
pub struct VisibilityCache {
    cells: Cells,
    counts: Counts,
    weights: Vec<Weights>,
    /// Estimated from some of the cells until all are [finished](Self::finish).
    gain: PredictedGain,
    /// The gain at the last call of [`Self::could_pay`].
    previous_gain: Option<PredictedGain>,
    /// Precomputed visibility; no rays are counted in its cells.
    precomputed: Option<Arc<PrecomputedVisibility>>,
    /// Whether weights are used regardless of the predicted gain.
    always: bool,
    division: Arc<Division>,
    most_cells: usize,
    /// Shadow rays, including those in precomputed cells.
    observed: AtomicU64,
    /// Shading points since the last update: all, and those without a cell.
    looked_up: [AtomicU64; 2],
}

/// Size and predicted gain of a visibility cache.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CacheSize {
    /// Number of cells of all levels.
    pub cells: usize,
    /// Their size in bytes.
    pub bytes: usize,
    /// Fraction of shading points outside all cells.
    pub unknown: f64,
    /// Predicted variance without weights over that with them; measured gains are usually higher.
    pub gain: f64,
    /// Whether weights are used: their gain exceeds their cost.
    pub pays: bool,
}

/// Smallest fraction of rays outside precomputed cells for learning to go on.
const LEAST_NEW: f64 = 0.25;
/// Smallest number of cells from which the gain of all is estimated.
const SAMPLED_CELLS: usize = 1024;
/// Marks the numbers of precomputed cells. Other numbers are those of this rendering's cells plus 1; 0 means
/// no cell.
const IS_PRECOMPUTED: u32 = 1 << 31;

impl VisibilityCache {
    /// Bytes of a cell: counts, weights, and entries in the lists of cells.
    pub const CELL_BYTES: usize = PATCHES * 8 + size_of::<Weights>() + 40;

    /// An empty cache of at most `bytes` bytes.
    pub fn new(cells: Cells, division: Arc<Division>, bytes: usize) -> Self {
        let (counts, weights) = (Counts::default(), vec![Weights::unknown()]);
        let most_cells = bytes / Self::CELL_BYTES;
        Self {
            cells,
            counts,
            weights,
            gain: PredictedGain::default(),
            previous_gain: None,
            precomputed: None,
            always: false,
            division,
            most_cells,
            observed: AtomicU64::new(0),
            looked_up: Default::default(),
        }
    }

    /// Adds precomputed visibility. Its cells are not updated, and cells that it lacks are learned.
    #[must_use]
    pub fn with_precomputed(self, precomputed: Arc<PrecomputedVisibility>) -> Self {
        let most_cells = self.most_cells.saturating_sub(precomputed.bytes() / Self::CELL_BYTES);
        Self { cells: precomputed.cells(), precomputed: Some(precomputed), most_cells, ..self }
    }

    /// Uses weights regardless of the predicted gain.
    #[must_use]
    pub fn always(self) -> Self {
        Self { always: true, ..self }
    }

    /// Continues from the counts of an earlier rendering.
    #[must_use]
    pub fn resuming(mut self, visibility: SceneVisibility) -> Self {
        (self.cells, self.counts) = (visibility.cells, visibility.counts);
        self.learn();
        self.finish();
        self
    }

    /// Returns the counts, labelled with the hashes of scene and map.
    pub fn into_scene_visibility(
        self,
        scene_hash: String,
        environment: String,
        environment_hash: String,
    ) -> SceneVisibility {
        let (cells, counts) = (self.cells, self.counts);
        SceneVisibility { scene_hash, environment, environment_hash, seconds: None, cells, counts }
    }

    /// Counts shadow rays, given as the row that each starts from, its patch, and whether it is unblocked.
    /// The result does not depend on their order or on the number of threads.
    pub fn observe(&self, at: &Rows<'_>, rays: impl Iterator<Item = (u16, u16, bool)>) {
        let keys = self.cells.keys_of(at);
        let is_precomputed =
            |key: &CellKey| self.precomputed.as_ref().is_some_and(|cells| cells.visibility(*key).is_some());
        let mut last = (None, None);
        let learning = keys.into_iter().map(|key| {
            if last.0 != Some(key) {
                last = (Some(key), Some(key).filter(|key| !is_precomputed(key)));
            }
            last.1
        });
        let keys: Vec<Option<CellKey>> = learning.collect();
        let of_ray =
            |(place, patch, is_visible): (u16, u16, bool)| Some((keys[usize::from(place)]?, patch, is_visible));
        let mut observed = 0;
        self.counts.add(rays.inspect(|_| observed += 1).filter_map(of_ray));
        self.observed.fetch_add(observed, Relaxed);
    }

    /// Creates cells for the rays so far, which take less memory than a list of rays.
    pub fn settle(&mut self) {
        self.counts.settle(self.most_cells);
    }

    /// [Settles](Self::settle), and predicts the gain; from a subset if there are many cells.
    pub fn learn(&mut self) {
        self.settle();
        let cells = self.counts.cells();
        // Cells are ordered by their rays on creation, so every n-th is a representative subset.
        let one_in = (cells / SAMPLED_CELLS).max(1);
        let some = (0..cells).into_par_iter().step_by(one_in);
        let gains = self.estimate(some, |rays, visibility| PredictedGain::of(rays, &visibility, &self.division));
        self.gain = gains.into_iter().fold(PredictedGain::default(), PredictedGain::with).times(one_in);
    }

    /// Computes the weights, if they pay off, and the gain over all cells.
    pub fn finish(&mut self) {
        self.weights.truncate(1);
        if self.pays() {
            let of_cell = |rays: &_, visibility: Visibility| {
                (PredictedGain::of(rays, &visibility, &self.division), visibility.weights(&self.division))
            };
            let (gains, weights): (Vec<_>, Vec<_>) = self.estimate(0..self.counts.cells(), of_cell).into_iter().unzip();
            self.gain = gains.into_iter().fold(PredictedGain::default(), PredictedGain::with);
            self.weights.extend(weights);
        }
        self.looked_up = Default::default();
    }

    fn estimate<T: Send>(
        &self,
        chosen: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
        of: impl Fn(&Rays, Visibility) -> T + Sync,
    ) -> Vec<T> {
        let precomputed = |key| self.precomputed.as_ref().and_then(|cells| cells.visibility(key));
        estimate::estimate(&self.counts, precomputed, chosen, of)
    }

    /// Returns the weights of the cells of this rendering and of precomputed ones, if they are used.
    pub(crate) fn flat(&self, order: &[usize]) -> Option<FlatVisibility> {
        let own =
            (0..self.weights.len().saturating_sub(1)).map(|cell| (self.counts.key(cell), &self.weights[cell + 1]));
        // Of two cells with one key, `number` returns the one of this rendering.
        let precomputed = self.precomputed.iter().flat_map(|cells| cells.weighted_cells());
        let precomputed = precomputed.filter(|(key, _)| !matches!(self.counts.find(*key), Some((_, 0))));
        self.pays().then(|| FlatVisibility::new(&self.cells, own.chain(precomputed).collect(), order))
    }

    /// Returns the number of the weights at a key: those of the finest cell.
    fn number(&self, key: CellKey) -> u32 {
        let own = self.counts.find(key);
        match self.precomputed.as_ref().and_then(|cells| cells.find(key)) {
            Some((cell, level)) if own.is_none_or(|(_, own)| level < own) => IS_PRECOMPUTED | cell,
            _ => own.map_or(0, |(cell, _)| cell + 1),
        }
    }

    /// Whether weights are used: the predicted gain exceeds their cost.
    pub fn pays(&self) -> bool {
        self.always || self.total_gain().pays()
    }

    /// Whether `factor` times as many training rays could make weights worthwhile, judged by the gain and its
    /// growth since the last call; with precomputed visibility, also whether enough rays start outside its
    /// cells.
    pub fn could_pay(&mut self, factor: f64) -> bool {
        let before = self.previous_gain.replace(self.gain);
        let is_new = self.precomputed.is_none() || self.gain.rays() >= LEAST_NEW * self.observed.load(Relaxed) as f64;
        is_new && (self.always || self.gain.could_pay(factor, before.as_ref()))
    }

    /// Returns the predicted gain over precomputed and learned cells.
    fn total_gain(&self) -> PredictedGain {
        self.precomputed.as_ref().map_or(self.gain, |cells| cells.gain().with(self.gain))
    }

    /// Returns size and predicted gain.
    pub fn size(&self) -> CacheSize {
        let (cells, bytes) = self.precomputed.as_ref().map_or((0, 0), |cells| (cells.count(), cells.bytes()));
        let (cells, bytes) = (cells + self.counts.cells(), bytes + self.counts.cells() * Self::CELL_BYTES);
        let [all, unknown] = self.looked_up.each_ref().map(|count| count.load(Relaxed) as f64);
        CacheSize { cells, bytes, unknown: unknown / all.max(1.0), gain: self.total_gain().ratio(), pays: self.pays() }
    }
}

impl Weighting for VisibilityCache {
    const UNIT: f32 = Weights::UNIT;

    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        let (mut last, mut unknown) = ((None, 0), 0);
        for (key, out) in self.cells.keys_of(at).into_iter().zip(out.as_flattened_mut()) {
            if last.0 != Some(key) {
                last = (Some(key), self.number(key));
            }
            unknown += u64::from(last.1 == 0);
            *out = f32::from_bits(last.1);
        }
        self.looked_up[0].fetch_add(at.len() as u64, Relaxed);
        self.looked_up[1].fetch_add(unknown, Relaxed);
    }

    #[inline(always)]
    fn at(&self, index: f32) -> Option<&Weights> {
        let number = index.to_bits();
        if number & IS_PRECOMPUTED != 0 {
            return self.precomputed.as_ref().and_then(|cells| cells.weights(number & !IS_PRECOMPUTED));
        }
        self.weights.get(number as usize)
    }
}
