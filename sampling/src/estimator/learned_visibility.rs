//! Patches with visibility that is learned before each rendering.

use std::sync::Arc;

use super::{
    Contributions, Estimator, ViewGeometry,
    exploration::explore,
    split::{check_directions, propose_mean},
};
use crate::{
    columns::Arena,
    environment::Environment,
    error::Result,
    patches::{Detail, PatchSampler, SkyRays},
    points::Points,
    sampler::{BrdfSampler, Covering, EnvironmentLight, OneSampleMis, Sampler},
    tail::TailKind,
    tile::Rows,
    visibility::{
        CacheSize, Cells, Division, FlatVisibility, PrecomputedVisibility, SceneVisibility, Unoccluded,
        VisibilityCache, Weighting,
    },
};

/// Smallest width of a cell, in pixels.
const CELL_PIXELS: f32 = 8.0;
/// Number of cells of all levels per pixel at that width.
const CELLS_PER_PIXEL: f32 = 0.045;

/// Number of shadow rays from each point.
const RAYS: u32 = 8;

/// Samples patches, or a head over patches, combined with BRDF sampling on glossy surfaces. The masses of
/// patches are multiplied by weights from learned visibility ([`crate::visibility`]).
#[derive(Clone)]
pub struct LearnedVisibility {
    sampler: Arc<Covering<PatchSampler>>,
    /// Number of directions from each shading point.
    directions: u32,
    /// The patches for which rays are counted.
    sky: Arc<SkyRays>,
    division: Arc<Division>,
    environment: Arc<Environment>,
    memory: usize,
    precomputed: Option<Arc<PrecomputedVisibility>>,
    always: bool,
}

impl LearnedVisibility {
    /// Default size of the cache in bytes.
    pub const MEMORY: usize = 64 << 20;

    /// An estimator over the patches of a map, with a cache of at most `memory` bytes.
    ///
    /// # Errors
    /// The map has no light, or is too large.
    pub fn new(environment: Arc<Environment>, detail: Detail, memory: usize) -> Result<Self> {
        let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
        Self::of_sampler(PatchSampler::new(light, detail)?, environment, memory)
    }

    /// An estimator over given patches, which may have a head over them.
    ///
    /// # Errors
    /// The sampler does not cover the whole light.
    pub fn of_sampler(sampler: PatchSampler, environment: Arc<Environment>, memory: usize) -> Result<Self> {
        let (sky, division) = (Arc::new(SkyRays::new(sampler.clone())), Arc::new(sampler.division()));
        let sampler = Arc::new(Covering::new(sampler)?);
        Ok(Self { sampler, directions: 1, sky, division, environment, memory, precomputed: None, always: false })
    }

    /// Averages `directions` directions from each shading point.
    ///
    /// # Errors
    /// `directions` is not in 1 to [`Split::MOST`](super::Split::MOST).
    pub fn with_directions(self, directions: u32) -> Result<Self> {
        Ok(Self { directions: check_directions(directions)?, ..self })
    }

    /// Uses weights regardless of the predicted gain, for scenes in which rays are expensive, or to measure
    /// weights.
    #[must_use]
    pub fn always(self) -> Self {
        Self { always: true, ..self }
    }

    /// Adds precomputed visibility; cells that it lacks are learned. The points of a rendering must be
    /// independent of those that it was learned from, as with
    /// `headtail_render::integrator::learn_visibility`.
    ///
    /// # Errors
    /// It takes more memory than the estimator has.
    pub fn with_precomputed(self, visibility: &SceneVisibility) -> Result<Self> {
        let precomputed = PrecomputedVisibility::new(visibility, &self.division, self.memory)?;
        Ok(Self { precomputed: Some(Arc::new(precomputed)), ..self })
    }

    /// Returns the sampler of one direction with precomputed visibility, used regardless of the predicted gain.
    ///
    /// # Errors
    /// As [`Self::with_precomputed`].
    pub fn sampler_with(&self, visibility: &SceneVisibility) -> Result<Arc<dyn Sampler>> {
        let visibility = PrecomputedVisibility::new(visibility, &self.division, self.memory)?;
        Ok(Arc::new(OneSampleMis::new(self.sampler.get().weighted(Arc::new(visibility)), BrdfSampler)))
    }

    /// Returns the precomputed weights as lists for other devices; `None` if there are none. Clusters are in the order of
    /// [`flat_patches`](crate::export::flat_patches).
    pub fn flat_precomputed(&self) -> Option<FlatVisibility> {
        self.precomputed.as_ref().map(|precomputed| precomputed.flat(self.sampler.get().cluster_numbers()))
    }

    /// Returns an estimator for one rendering, which learns visibility before it.
    pub fn session(&self, view: ViewGeometry) -> LearningSession<'_> {
        let cells = CELLS_PER_PIXEL * view.pixels as f32;
        let needed = cells * VisibilityCache::CELL_BYTES as f32;
        let shortage = (needed / self.memory as f32).max(1.0).sqrt();
        let cells = Cells::new(view.eye, CELL_PIXELS * shortage * view.pixel);
        let cache = VisibilityCache::new(cells, self.division.clone(), self.memory);
        let cache = match &self.precomputed {
            Some(precomputed) => cache.with_precomputed(precomputed.clone()),
            None => cache,
        };
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

    fn learning_session(&self, view: ViewGeometry) -> Option<LearningSession<'_>> {
        Some(self.session(view))
    }
}

/// A [`LearnedVisibility`] for one rendering.
pub struct LearningSession<'a> {
    estimator: &'a LearnedVisibility,
    cache: VisibilityCache,
    explores: bool,
}

impl LearningSession<'_> {
    /// Continues from the counts of an earlier session.
    #[must_use]
    pub fn resuming(self, visibility: SceneVisibility) -> Self {
        Self { cache: self.cache.resuming(visibility), ..self }
    }

    /// Starts or ends exploration, in which proposals are shadow rays for learning and their contributions are 0.
    pub fn explore(&mut self, explores: bool) {
        self.explores = explores;
    }

    /// Counts the shadow rays of contributions that were proposed for these rows while [exploring](Self::explore).
    pub fn observe(&self, at: &Rows<'_>, contributions: &Contributions, visible: &[bool]) {
        let rays = contributions.places().iter().zip(&contributions.patches).zip(visible);
        self.cache.observe(at, rays.map(|((&place, &patch), &visible)| (place, patch, visible)));
    }

    /// Builds cells for the rays so far, which take less memory than a list of rays.
    pub fn settle(&mut self) {
        self.cache.settle();
    }

    /// [Settles](Self::settle), and predicts the gain of weights.
    pub fn learn(&mut self) {
        self.cache.learn();
    }

    /// Whether `factor` times as many training rays could make weights worthwhile; also depends on the growth of the gain since the
    /// last call.
    pub fn could_pay(&mut self, factor: f64) -> bool {
        self.cache.could_pay(factor)
    }

    /// Ends learning and computes the weights, if they pay off.
    pub fn finish(&mut self) {
        self.cache.finish();
    }

    /// Returns size and predicted gain of its cache.
    pub fn size(&self) -> CacheSize {
        self.cache.size()
    }

    /// Returns the weights that it has learned and precomputed ones, as lists for other devices; `None` if they are not
    /// used. Clusters are in the order of [`flat_patches`](crate::export::flat_patches).
    pub fn flat(&self) -> Option<FlatVisibility> {
        self.cache.flat(self.estimator.sampler.get().cluster_numbers())
    }

    /// Returns the counts. `scene_hash` is
    /// [`SceneContext::geometry_hash`](crate::spec::SceneContext::geometry_hash).
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
