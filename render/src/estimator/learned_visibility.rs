//! Samplers with the visibility that a rendering learns.

use std::sync::Arc;

use super::{
    Contributions, Estimator, Learner, Ris, Setting,
    exploration::explore,
    split::{check_directions, propose_mean},
};
use crate::{
    bake::{BakedTable, WeightedTable},
    columns::Arena,
    environment::Environment,
    error::Result,
    patches::{Detail, PatchSampler, SkyRays},
    points::Points,
    sampler::{BrdfSampler, Covering, EnvironmentLight, OneSampleMis, ProductSampler, Sampler},
    simd::Lanes,
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

/// An estimator that knows what is seen of the sky, and learns it from shadow rays: patches of sky, a table, or resampling, with masses or targets that
/// are multiplied by weights of where a point is.
#[derive(Clone)]
pub struct LearnedVisibility {
    technique: Arc<Technique>,
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

/// How directions are drawn.
enum Technique {
    /// By patches of sky, beside BRDF sampling where surfaces are glossy.
    Patches(Covering<PatchSampler>),
    /// By a table, perhaps in a mixture with BRDF sampling.
    Table { light: EnvironmentLight, table: Box<WeightedTable>, mixed: bool },
    /// By patches of sky, beside a head in the place of BRDF sampling.
    Beside { patches: PatchSampler, head: Arc<dyn Sampler> },
    /// Resampled from those of a sampler and BRDF sampling.
    Resampled(Box<Ris<Arc<dyn Sampler>, BrdfSampler>>),
}

impl LearnedVisibility {
    /// The bytes that it learns with where nobody says otherwise.
    pub const MEMORY: usize = 64 << 20;
    /// The cells along a side of Y that a table's weights have where nobody says otherwise.
    pub const GRID: usize = 16;

    /// An estimator over the patches of a map's sky, in this detail, that learns with at most `memory` bytes.
    ///
    /// # Errors
    /// The map has no light, or is too large.
    pub fn new(environment: Arc<Environment>, detail: Detail, memory: usize) -> Result<Self> {
        Self::of_sampler(patches_of(&environment, detail)?, environment, memory)
    }

    /// The same over patches that are there already, perhaps below a head.
    ///
    /// # Errors
    /// The sampler leaves a part of the light out.
    pub fn of_sampler(sampler: PatchSampler, environment: Arc<Environment>, memory: usize) -> Result<Self> {
        let (sky, division) = (sampler.clone(), sampler.division());
        Ok(Self::with(Technique::Patches(Covering::new(sampler)?), sky, division, environment, memory))
    }

    /// A table over the square that a light's tail carries, perhaps in a mixture with BRDF sampling, with weights on a grid of `side x side` cells of Y.
    ///
    /// # Errors
    /// The tail leaves a part of the light out, or `side` is none of [`WeightedTable::SIDES`].
    pub fn of_table(
        table: BakedTable,
        light: EnvironmentLight,
        (side, mixed): (usize, bool),
        memory: usize,
    ) -> Result<Self> {
        let environment = light.environment().clone();
        let (sky, table) = (patches_of(&environment, Detail::Leaves)?, WeightedTable::new(table, side)?);
        Covering::new(ProductSampler::new(light.clone(), table.weighted(&Unoccluded)))?;
        let division = sky.division().with_grid(table.patch_grid(light.tail(), |x| sky.patch_at(x)));
        Ok(Self::with(Technique::Table { light, table: Box::new(table), mixed }, sky, division, environment, memory))
    }

    /// Patches of a map's sky beside a head that covers the integrand, with the share that BRDF sampling has otherwise: more where lobes are narrow against
    /// patches, and none on diffuse surfaces, where patches alone do better.
    ///
    /// # Errors
    /// The map has no light, or is too large.
    pub fn beside_head(head: Covering<Arc<dyn Sampler>>, environment: Arc<Environment>, memory: usize) -> Result<Self> {
        let sky = patches_of(&environment, Detail::Leaves)?;
        let (patches, division) = (sky.clone(), sky.division());
        Ok(Self::with(Technique::Beside { patches, head: head.into_inner() }, sky, division, environment, memory))
    }

    /// Resampling whose target knows what is seen.
    ///
    /// # Errors
    /// The map has no light, or is too large.
    pub fn of_ris(
        ris: Ris<Arc<dyn Sampler>, BrdfSampler>,
        environment: Arc<Environment>,
        memory: usize,
    ) -> Result<Self> {
        let sky = patches_of(&environment, Detail::Leaves)?;
        let division = sky.division();
        Ok(Self::with(Technique::Resampled(Box::new(ris)), sky, division, environment, memory))
    }

    fn with(
        technique: Technique,
        sky: PatchSampler,
        division: Division,
        environment: Arc<Environment>,
        memory: usize,
    ) -> Self {
        let (technique, sky, division) = (Arc::new(technique), Arc::new(SkyRays::new(sky)), Arc::new(division));
        Self { technique, directions: 1, sky, division, environment, memory, known: None, always: false }
    }

    /// The same with the mean of so many directions from each surface point. Resampling draws one all the same.
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
    /// rendering must be independent of those that it was learned with, as those of [`learn_visibility`](crate::integrator::learn_visibility) are.
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
        let needed = cells * VisibilityCache::cell_bytes(&self.division) as f32;
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
        let environment = &self.environment;
        match &*self.technique {
            Technique::Patches(sampler) => {
                let sampler = OneSampleMis::new(sampler.get().weighted(weighting), BrdfSampler);
                propose_mean(self.directions, &sampler, environment, at, points, out, arena);
            }
            Technique::Table { light, table, mixed } => {
                let sampler = ProductSampler::new(light.clone(), table.weighted(weighting));
                if *mixed {
                    let sampler = OneSampleMis::new(sampler, BrdfSampler);
                    propose_mean(self.directions, &sampler, environment, at, points, out, arena);
                } else {
                    propose_mean(self.directions, &sampler, environment, at, points, out, arena);
                }
            }
            Technique::Beside { patches, head } => {
                let sampler = OneSampleMis::new(patches.weighted(weighting), head.clone());
                propose_mean(self.directions, &sampler, environment, at, points, out, arena);
            }
            Technique::Resampled(ris) => {
                let mut indices = arena.columns::<1>(at.strips());
                weighting.indices(at, indices.get_mut()[0]);
                let weigh = |wi: [&[Lanes]; 3], target: &mut [Lanes]| {
                    self.sky.sampler().weigh(weighting, (at.len(), indices.get()[0]), wi, target);
                };
                ris.propose_weighted(at, points, &weigh, out, arena);
            }
        }
    }
}

fn patches_of(environment: &Arc<Environment>, detail: Detail) -> Result<PatchSampler> {
    PatchSampler::new(EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?, detail)
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

    /// What it has learned. `scene_hash` is [`Scene::geometry_hash`](crate::scene::Scene::geometry_hash).
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
