//! Patches of sky with the visibility that a rendering learns.

use std::sync::Arc;

use super::{Contributions, Estimator, Learner, Setting, single_sample::propose_one};
use crate::{
    columns::Arena,
    environment::Environment,
    error::Result,
    patches::PatchSampler,
    points::Points,
    sampler::{BrdfSampler, Covering, OneSampleMis},
    tile::Rows,
    visibility::{CacheSize, Cells, Grouping, Unoccluded, VisibilityCache, Weighting},
};

/// Pixels that a cell is wide, at least.
const CELL_PIXELS: f32 = 8.0;
/// Cells for a pixel if they are so wide, those of all levels.
const CELLS_PER_PIXEL: f32 = 0.045;
/// Groups of pixels of which a cell is seen at once, on average.
const GROUPS_AT_ONCE: f32 = 3.0;

/// One direction from patches of sky, beside BRDF sampling where surfaces are glossy, with masses that know what is seen of the sky.
#[derive(Clone, Debug)]
pub struct LearnedVisibility {
    sampler: Covering<PatchSampler>,
    environment: Arc<Environment>,
    memory: usize,
}

impl LearnedVisibility {
    /// An estimator that learns with at most `memory` bytes.
    ///
    /// # Errors
    /// The sampler leaves a part of the light out.
    pub fn new(sampler: PatchSampler, environment: Arc<Environment>, memory: usize) -> Result<Self> {
        Ok(Self { sampler: Covering::new(sampler)?, environment, memory })
    }

    fn propose_with<W: Weighting>(
        &self,
        weighting: &W,
        at: &Rows<'_>,
        points: &Points,
        out: &mut Contributions,
        arena: &Arena,
    ) {
        let sampler = OneSampleMis::new(self.sampler.get().weighted(weighting), BrdfSampler);
        propose_one(&sampler, &self.environment, at, points, out, arena);
    }
}

impl Estimator for LearnedVisibility {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        self.propose_with(&Unoccluded, at, points, out, arena);
    }

    fn learner<'a>(&'a self, setting: Setting) -> Option<Box<dyn Learner + 'a>> {
        let groups = if setting.grouping == Grouping::Four { GROUPS_AT_ONCE } else { 1.0 };
        let cells = CELLS_PER_PIXEL * groups * setting.pixels as f32;
        let shortage = (cells * VisibilityCache::CELL_BYTES as f32 / self.memory as f32).max(1.0).sqrt();
        let cells = Cells::new(setting.eye, CELL_PIXELS * shortage * setting.pixel);
        let cache = VisibilityCache::new(cells, setting.grouping, self.sampler.get().energies(), self.memory);
        Some(Box::new(Session { estimator: self, cache }))
    }
}

/// One rendering.
struct Session<'a> {
    estimator: &'a LearnedVisibility,
    cache: VisibilityCache,
}

impl Estimator for Session<'_> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        self.estimator.propose_with(&self.cache, at, points, out, arena);
    }
}

impl Learner for Session<'_> {
    fn observe(&self, at: &Rows<'_>, contributions: &Contributions, visible: &[bool]) {
        let patches = self.estimator.sampler.get().patches_of(contributions.wi());
        let rays = contributions.places().iter().zip(patches).zip(visible);
        self.cache.observe(at, rays.map(|((&place, patch), &visible)| (place, patch, visible)));
    }

    fn learn(&mut self, is_last: bool) {
        self.cache.learn(is_last);
    }

    fn size(&self) -> CacheSize {
        self.cache.size()
    }
}
