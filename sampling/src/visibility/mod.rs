//! What part of the sky is seen from where, learned from the shadow rays of a rendering.
//!
//! Shading points are gathered in cells of space ([`Cells`]), and for each cell the shadow rays are counted that were sent to each patch of
//! sky, and those that were not stopped. From these follow weights ([`Weights`]) that a sampler multiplies its product of light,
//! BRDF and cosine with: equal areas of Y carry equal light, so patches are small where light is.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the cache of one rendering |
//! | `cells.rs`, `places.rs` | cells of space, and their numbers |
//! | `counts.rs` | shadow rays counted by cell and patch |
//! | `estimate.rs` | visibility from counts, and weights from visibility |
//! | `division.rs`, `weights.rs` | the patches that weights are for; the weights |
//! | `worth.rs` | whether weights gain more than they cost |
//! | `known.rs`, `file.rs` | precomputed visibility, and its file |
//!
//! # Why estimates stay unbiased
//!
//! A pixel's points are one scrambled sequence: each point alone is uniform, but not after others of the sequence have been seen. So what is drawn with is
//! learned from other points, before the first one of a picture is drawn, and then stays.

mod cells;
mod counts;
mod division;
mod estimate;
mod file;
mod known;
mod places;
mod weights;
mod worth;

pub use cells::Cells;
pub use division::{CLUSTERS, Division, PATCHES};
pub use known::{Known, SceneVisibility};
pub use weights::{Unoccluded, Weighting, Weights};

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use crate::parallel::*;
use cells::CellKey;
use counts::Counts;
use estimate::{Rays, Visibility};
use worth::Worth;

use crate::{
    simd::{LANES, Lanes},
    tile::Rows,
};

/// The visibility of the sky in the cells of a scene, and what was seen of it since it was last updated.
#[derive(Debug)]
pub struct VisibilityCache {
    cells: Cells,
    counts: Counts,
    weights: Vec<Weights>,
    /// What weights would gain, by some of the cells until all are [finished](Self::finish).
    worth: Worth,
    /// The same when it was last asked whether to learn on.
    promised: Option<Worth>,
    /// What was learned before. Nothing is counted in its cells.
    known: Option<Arc<Known>>,
    /// Whether it is drawn with whatever that gains.
    always: bool,
    division: Arc<Division>,
    most_cells: usize,
    /// Shadow rays, those in cells that were known before, too.
    observed: AtomicU64,
    /// Points that were drawn for since the last update: all, and those without a cell.
    asked: [AtomicU64; 2],
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
    /// The variance of samples that are drawn without it over that of those drawn with it, as foreseen; usually less than is found.
    pub gain: f64,
    /// Whether it is drawn with: where little is in shadow, it would gain less than it takes.
    pub pays: bool,
}

/// The least share of rays in cells of which nothing was known before for more to be sent.
const LEAST_NEW: f64 = 0.25;
/// Cells, at least, that say what all are worth.
const ENOUGH_CELLS: usize = 1024;
/// Marks numbers of weights that were known before; the others count those of this rendering, after those of no cell.
const IS_KNOWN: u32 = 1 << 31;

impl VisibilityCache {
    /// Bytes of a cell: its counts, its weights, and its place in the lists of cells.
    pub const CELL_BYTES: usize = PATCHES * 8 + size_of::<Weights>() + 40;

    /// A cache that knows nothing yet, of at most `bytes` bytes.
    pub fn new(cells: Cells, division: Arc<Division>, bytes: usize) -> Self {
        let (counts, weights) = (Counts::default(), vec![Weights::unknown()]);
        let most_cells = bytes / Self::CELL_BYTES;
        Self {
            cells,
            counts,
            weights,
            worth: Worth::default(),
            promised: None,
            known: None,
            always: false,
            division,
            most_cells,
            observed: AtomicU64::new(0),
            asked: Default::default(),
        }
    }

    /// The same with what was learned before, in whose cells it learns on: what is known keeps, the rest is learned.
    #[must_use]
    pub fn knowing(self, known: Arc<Known>) -> Self {
        let most_cells = self.most_cells.saturating_sub(known.bytes() / Self::CELL_BYTES);
        Self { cells: known.cells(), known: Some(known), most_cells, ..self }
    }

    /// The same, to be drawn with even where that gains less than it takes.
    #[must_use]
    pub fn always(self) -> Self {
        Self { always: true, ..self }
    }

    /// The same that goes on learning everywhere where others have begun.
    #[must_use]
    pub fn resuming(mut self, visibility: SceneVisibility) -> Self {
        (self.cells, self.counts) = (visibility.cells, visibility.counts);
        self.learn();
        self.finish();
        self
    }

    /// What was learned, of a scene and under a map with these hashes.
    pub fn into_scene_visibility(
        self,
        scene_hash: String,
        environment: String,
        environment_hash: String,
    ) -> SceneVisibility {
        let (cells, counts) = (self.cells, self.counts);
        SceneVisibility { scene_hash, environment, environment_hash, seconds: None, cells, counts }
    }

    /// The finest cells of points.
    fn keys(&self, at: &Rows<'_>) -> Vec<CellKey> {
        let mut keys = Vec::with_capacity(at.len());
        for strip in 0..at.strips() {
            let mut own = [0; LANES];
            cells::keys(&self.cells, &at.positions(strip), &at.normals(strip), &mut own);
            keys.extend(own[..LANES.min(at.len() - strip * LANES)].iter().map(|&key| CellKey(key)));
        }
        keys
    }

    /// Counts shadow rays: the place among the rows that each left from, the patch that it was sent to, and whether it came through. Whatever the order
    /// of the rays, and on any number of threads, what is learned is the same.
    pub fn observe(&self, at: &Rows<'_>, rays: impl Iterator<Item = (u16, u16, bool)>) {
        let keys = self.keys(at);
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
        let mut observed = 0;
        self.counts.add(rays.inspect(|_| observed += 1).filter_map(of_ray));
        self.observed.fetch_add(observed, Relaxed);
    }

    /// Counts what was observed in cells.
    pub fn settle(&mut self) {
        self.counts.settle(self.most_cells);
    }

    /// Counts what was observed, and finds out what it is worth: of many cells, by some of them.
    pub fn learn(&mut self) {
        self.settle();
        let cells = self.counts.cells();
        // Cells stand by how many rays they had when they were made, so that these are of all kinds.
        let one_in = (cells / ENOUGH_CELLS).max(1);
        let asked = (0..cells).into_par_iter().step_by(one_in);
        let worths = self.estimate(asked, |rays, visibility| Worth::of(rays, &visibility, &self.division));
        self.worth = worths.into_iter().fold(Worth::default(), Worth::with).times(one_in);
    }

    /// Turns what was learned into weights, if they gain more than they take, and finds out what all of it is worth.
    pub fn finish(&mut self) {
        self.weights.truncate(1);
        if self.pays() {
            let of_cell = |rays: &_, visibility: Visibility| {
                (Worth::of(rays, &visibility, &self.division), visibility.weights(&self.division))
            };
            let (worths, weights): (Vec<_>, Vec<_>) =
                self.estimate(0..self.counts.cells(), of_cell).into_iter().unzip();
            self.worth = worths.into_iter().fold(Worth::default(), Worth::with);
            self.weights.extend(weights);
        }
        self.asked = Default::default();
    }

    fn estimate<T: Send>(
        &self,
        asked: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
        of: impl Fn(&Rays, Visibility) -> T + Sync,
    ) -> Vec<T> {
        let known = |key| self.known.as_ref().and_then(|known| known.visibility(key));
        estimate::estimate(&self.counts, known, asked, of)
    }

    /// The number of the weights at a key: those of the finest cell that is known.
    fn number(&self, key: CellKey) -> u32 {
        let own = self.counts.find(key);
        match self.known.as_ref().and_then(|known| known.find(key)) {
            Some((cell, level)) if own.is_none_or(|(_, own)| level < own) => IS_KNOWN | cell,
            _ => own.map_or(0, |(cell, _)| cell + 1),
        }
    }

    /// Whether what was learned gains more than it takes to draw with it.
    pub fn pays(&self) -> bool {
        self.always || self.worth_of_all().pays()
    }

    /// Whether it may come to gain so much if it learns so many times as much in all: if it knew something before, where that has no cells. What it says depends on what it
    /// had learned when it was last asked.
    pub fn promises(&mut self, times: f64) -> bool {
        let before = self.promised.replace(self.worth);
        let is_new = self.known.is_none() || self.worth.rays() >= LEAST_NEW * self.observed.load(Relaxed) as f64;
        is_new && (self.always || self.worth.promises(times, before.as_ref()))
    }

    /// What weights would gain, those that were known before and those that were learned.
    fn worth_of_all(&self) -> Worth {
        self.known.as_ref().map_or(self.worth, |known| known.worth().with(self.worth))
    }

    /// How large it is.
    pub fn size(&self) -> CacheSize {
        let (cells, bytes) = self.known.as_ref().map_or((0, 0), |known| (known.count(), known.bytes()));
        let (cells, bytes) = (cells + self.counts.cells(), bytes + self.counts.cells() * Self::CELL_BYTES);
        let [all, unknown] = self.asked.each_ref().map(|count| count.load(Relaxed) as f64);
        CacheSize { cells, bytes, unknown: unknown / all.max(1.0), gain: self.worth_of_all().gain(), pays: self.pays() }
    }
}

impl Weighting for VisibilityCache {
    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        let (mut last, mut unknown) = ((None, 0), 0);
        for (key, out) in self.keys(at).into_iter().zip(out.as_flattened_mut()) {
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
