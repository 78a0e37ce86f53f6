//! Patches of sky with the visibility that a rendering learns.

use std::sync::Arc;

use super::{Contributions, Estimator, Learner, Setting, single_sample::propose_one};
use crate::{
    columns::Arena,
    environment::Environment,
    error::Result,
    patches::{Detail, PatchSampler},
    points::Points,
    sampler::{BrdfSampler, Covering, EnvironmentLight, OneSampleMis},
    tail::TailKind,
    tile::Rows,
    visibility::{CacheSize, Cells, Known, SceneVisibility, Unoccluded, VisibilityCache, Weighting},
};

/// Pixels that a cell is wide, at least.
const CELL_PIXELS: f32 = 8.0;
/// Cells for a pixel if they are so wide, those of all levels.
const CELLS_PER_PIXEL: f32 = 0.045;

/// One direction from patches of sky, beside BRDF sampling where surfaces are glossy, with masses that know what is seen of the sky.
#[derive(Clone, Debug)]
pub struct LearnedVisibility {
    sampler: Covering<PatchSampler>,
    environment: Arc<Environment>,
    memory: usize,
    known: Option<Arc<Known>>,
}

impl LearnedVisibility {
    /// The bytes that it learns with where nobody says otherwise.
    pub const MEMORY: usize = 64 << 20;

    /// An estimator over the patches of a map's sky, in this detail, that learns with at most `memory` bytes.
    ///
    /// # Errors
    /// The map has no light, or is too large.
    pub fn new(environment: Arc<Environment>, detail: Detail, memory: usize) -> Result<Self> {
        let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
        Self::of_sampler(PatchSampler::new(light, detail)?, environment, memory)
    }

    /// The same over patches that are there already, perhaps below a head.
    ///
    /// # Errors
    /// The sampler leaves a part of the light out.
    pub fn of_sampler(sampler: PatchSampler, environment: Arc<Environment>, memory: usize) -> Result<Self> {
        Ok(Self { sampler: Covering::new(sampler)?, environment, memory, known: None })
    }

    /// The same with what was learned beforehand: it draws with that from the first sample on, and learns where nothing is known. The points of a
    /// rendering must be independent of those that it was learned with, as those of [`learn_visibility`](crate::integrator::learn_visibility) are.
    ///
    /// # Errors
    /// It takes more memory than the estimator has.
    pub fn knowing(self, visibility: &SceneVisibility) -> Result<Self> {
        let known = Known::new(visibility, &self.sampler.get().energies(), self.memory)?;
        Ok(Self { known: Some(Arc::new(known)), ..self })
    }

    /// What learns in one rendering; the concrete type of [`Estimator::learner`].
    pub fn session(&self, setting: Setting) -> LearningSession<'_> {
        let cells = CELLS_PER_PIXEL * setting.pixels as f32;
        let shortage = (cells * VisibilityCache::CELL_BYTES as f32 / self.memory as f32).max(1.0).sqrt();
        let cells = Cells::new(setting.eye, CELL_PIXELS * shortage * setting.pixel);
        let cache = VisibilityCache::new(cells, self.sampler.get().energies(), self.memory);
        let cache = if let Some(known) = &self.known { cache.knowing(known.clone()) } else { cache };
        LearningSession { estimator: self, cache }
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
        Some(Box::new(self.session(setting)))
    }
}

/// A [`LearnedVisibility`] in one rendering.
#[derive(Debug)]
pub struct LearningSession<'a> {
    estimator: &'a LearnedVisibility,
    cache: VisibilityCache,
}

impl LearningSession<'_> {
    /// The same that goes on where others have ended.
    #[must_use]
    pub fn resuming(self, visibility: SceneVisibility) -> Self {
        Self { cache: self.cache.resuming(visibility), ..self }
    }

    /// What it has learned. `scene_hash` is [`Scene::geometry_hash`](crate::scene::Scene::geometry_hash).
    pub fn into_visibility(self, scene_hash: String) -> SceneVisibility {
        let map = &self.estimator.environment;
        self.cache.into_scene_visibility(scene_hash, map.name().to_owned(), map.hash().to_owned())
    }
}

impl Estimator for LearningSession<'_> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        self.estimator.propose_with(&self.cache, at, points, out, arena);
    }
}

impl Learner for LearningSession<'_> {
    fn observe(&self, at: &Rows<'_>, contributions: &Contributions, visible: &[bool]) {
        let patches = self.estimator.sampler.get().patches_of(contributions.wi());
        let rays = contributions.places().iter().zip(patches).zip(visible);
        self.cache.observe(at, rays.map(|((&place, patch), &visible)| (place, patch, visible)));
    }

    fn learn(&mut self) {
        self.cache.learn();
    }

    fn size(&self) -> CacheSize {
        self.cache.size()
    }
}
