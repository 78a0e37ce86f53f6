//! Patches with the visibility that a rendering learns.

use std::sync::Arc;

use super::{
    Contributions, Estimator, Learner, Setting,
    exploration::explore,
    split::{check_directions, propose_mean},
};
use crate::{
    columns::Arena,
    environment::Environment,
    error::Result,
    patches::{Detail, PatchSampler, SkyRays},
    points::Points,
    sampler::{BrdfSampler, Covering, EnvironmentLight, OneSampleMis},
    tail::TailKind,
    tile::Rows,
    visibility::{CacheSize, Cells, Division, Known, SceneVisibility, Unoccluded, VisibilityCache, Weighting},
};

/// Pixels that a cell is wide, at least.
const CELL_PIXELS: f32 = 8.0;
/// Cells for a pixel if they are so wide, those of all levels.
const CELLS_PER_PIXEL: f32 = 0.045;

/// Shadow rays from each point that is learned from.
const RAYS: u32 = 8;

/// An estimator that draws from patches, or from a head over patches, beside BRDF sampling on glossy surfaces. The masses of patches are multiplied
/// by weights that follow from the visibility of the light in cells of the scene, learned from shadow rays.
#[derive(Clone)]
pub struct LearnedVisibility {
    sampler: Arc<Covering<PatchSampler>>,
    /// From each surface point.
    directions: u32,
    /// The patches of sky that rays are counted by.
    sky: Arc<SkyRays>,
    division: Arc<Division>,
    environment: Arc<Environment>,
    memory: usize,
    known: Option<Arc<Known>>,
    always: bool,
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
        let (sky, division) = (Arc::new(SkyRays::new(sampler.clone())), Arc::new(sampler.division()));
        let sampler = Arc::new(Covering::new(sampler)?);
        Ok(Self { sampler, directions: 1, sky, division, environment, memory, known: None, always: false })
    }

    /// The same with the mean of so many directions from each surface point.
    ///
    /// # Errors
    /// There must be 1 to [`Split::MOST`](super::Split::MOST).
    pub fn drawing(self, directions: u32) -> Result<Self> {
        Ok(Self { directions: check_directions(directions)?, ..self })
    }

    /// The same that draws with what it knows even where that is foreseen to gain less than it takes: where a ray is dear, or to measure it.
    #[must_use]
    pub fn always(self) -> Self {
        Self { always: true, ..self }
    }

    /// The same with what was learned beforehand: if that gains more than it takes it draws with it from the first sample on, and it learns where nothing is known. The points of a
    /// rendering must be independent of those that it was learned with, as those of `headtail_render::integrator::learn_visibility` are.
    ///
    /// # Errors
    /// It takes more memory than the estimator has.
    pub fn knowing(self, visibility: &SceneVisibility) -> Result<Self> {
        let known = Known::new(visibility, &self.division, self.memory)?;
        Ok(Self { known: Some(Arc::new(known)), ..self })
    }

    /// What learns in one rendering; the concrete type of [`Estimator::learner`].
    pub fn session(&self, setting: Setting) -> LearningSession<'_> {
        let cells = CELLS_PER_PIXEL * setting.pixels as f32;
        let needed = cells * VisibilityCache::CELL_BYTES as f32;
        let shortage = (needed / self.memory as f32).max(1.0).sqrt();
        let cells = Cells::new(setting.eye, CELL_PIXELS * shortage * setting.pixel);
        let cache = VisibilityCache::new(cells, self.division.clone(), self.memory);
        let cache = if let Some(known) = &self.known { cache.knowing(known.clone()) } else { cache };
        let cache = if self.always { cache.always() } else { cache };
        LearningSession { estimator: self, cache, explores: false }
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
        propose_mean(self.directions, &sampler, &self.environment, at, points, out, arena);
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
pub struct LearningSession<'a> {
    estimator: &'a LearnedVisibility,
    cache: VisibilityCache,
    explores: bool,
}

impl LearningSession<'_> {
    /// The same that goes on where others have ended.
    #[must_use]
    pub fn resuming(self, visibility: SceneVisibility) -> Self {
        Self { cache: self.cache.resuming(visibility), ..self }
    }

    /// What it has learned. `scene_hash` is [`SceneContext::geometry_hash`](crate::spec::SceneContext::geometry_hash).
    pub fn into_visibility(self, scene_hash: String) -> SceneVisibility {
        let map = &self.estimator.environment;
        self.cache.into_scene_visibility(scene_hash, map.name().to_owned(), map.hash().to_owned())
    }
}

impl Estimator for LearningSession<'_> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        if self.explores {
            explore(&self.estimator.sky, at, points, RAYS, out, arena);
        } else if self.cache.pays() {
            self.estimator.propose_with(&self.cache, at, points, out, arena);
        } else {
            self.estimator.propose_with(&Unoccluded, at, points, out, arena);
        }
    }
}

impl Learner for LearningSession<'_> {
    fn observe(&self, at: &Rows<'_>, contributions: &Contributions, visible: &[bool]) {
        let rays = contributions.places().iter().zip(&contributions.patches).zip(visible);
        self.cache.observe(at, rays.map(|((&place, &patch), &visible)| (place, patch, visible)));
    }

    fn settle(&mut self) {
        self.cache.settle();
    }

    fn learn(&mut self) {
        self.cache.learn();
    }

    fn finish(&mut self) {
        self.cache.finish();
    }

    fn promises(&mut self, times: f64) -> bool {
        self.cache.promises(times)
    }

    fn explore(&mut self, explores: bool) {
        self.explores = explores;
    }

    fn size(&self) -> CacheSize {
        self.cache.size()
    }
}
