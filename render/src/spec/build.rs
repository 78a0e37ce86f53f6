//! What SPECs build: estimators and samplers for a map and a scene.

use std::{path::Path, sync::Arc};

use super::{Drawn, FileKind, ONLY_THESE_LEARN, SamplerSpec, Source};
use crate::{
    environment::Environment,
    error::{Error, Result},
    estimator::{Estimator, LearnedVisibility, Ris, SingleSample, Split, TwoSampleMis},
    export::ExportedSampler,
    patches::PatchSampler,
    rival::RivalSampler,
    sampler::{BrdfSampler, Covering, EmitterSampler, EnvironmentLight, OneSampleMis, Oracle, ProductSampler, Sampler},
    scene::Scene,
    tail::TailKind,
    visibility::SceneVisibility,
};

/// Where an estimator is used.
#[derive(Clone, Copy)]
pub struct Place<'a> {
    /// The scene, which what was learned beforehand must be of.
    pub scene: Option<&'a Scene>,
    /// Most bytes that are learned of the scene.
    pub memory: usize,
    /// Whether what is learned is drawn with even where that gains less than it takes.
    pub always: bool,
}

impl Default for Place<'_> {
    /// In no scene in particular; 64 MiB, drawn with where that pays.
    fn default() -> Self {
        Self { scene: None, memory: LearnedVisibility::MEMORY, always: false }
    }
}

impl SamplerSpec {
    /// Builds the estimator for a map, in no scene in particular: [`Self::build_in`].
    ///
    /// # Errors
    /// As there, and if what was learned of one scene belongs to it.
    pub fn build(&self, environment: &Arc<Environment>) -> Result<Box<dyn Estimator>> {
        self.build_in(environment, Place::default())
    }

    /// Builds the estimator for a map and a scene.
    ///
    /// # Errors
    /// A file cannot be read, is of another kind, or was made for another map or another scene.
    pub fn build_in(&self, environment: &Arc<Environment>, place: Place<'_>) -> Result<Box<dyn Estimator>> {
        let sampler = |source: &Source| source.build_in(environment, place);
        Ok(match self {
            Self::Auto => return self.resolved(place.scene.is_some()).build_in(environment, place),
            Self::One(source) => Box::new(SingleSample::new(Covering::new(sampler(source)?)?, environment.clone())),
            Self::Two(source) => Box::new(TwoSampleMis::new(sampler(source)?, BrdfSampler, environment.clone())?),
            Self::Split(directions, source) => {
                Box::new(Split::new(Covering::new(sampler(source)?)?, *directions, environment.clone())?)
            }
            Self::Ris(candidates, source) => Box::new(resampling(source, *candidates, environment, place)?),
            Self::Learning { source, drawn, grid, known } => {
                let estimator = learning(source, (*drawn, *grid), environment, place)?;
                let estimator = knowing(estimator, known.as_deref(), environment, place)?;
                Box::new(if place.always { estimator.always() } else { estimator })
            }
        })
    }
}

impl Source {
    /// Builds the sampler for a map.
    ///
    /// # Errors
    /// As [`SamplerSpec::build`].
    pub fn build(&self, environment: &Arc<Environment>) -> Result<Arc<dyn Sampler>> {
        self.build_in(environment, Place::default())
    }

    fn build_in(&self, environment: &Arc<Environment>, place: Place<'_>) -> Result<Arc<dyn Sampler>> {
        let light = || EnvironmentLight::new(environment.clone(), TailKind::Hierarchical);
        Ok(match self {
            Self::Brdf | Self::Cosine => Arc::new(BrdfSampler),
            Self::Emitter => Arc::new(EmitterSampler::new(light()?)),
            Self::Compensated => Arc::new(EmitterSampler::compensated(&light()?)?),
            Self::Oracle => {
                let light = light()?;
                Arc::new(ProductSampler::new(light.clone(), Oracle::new(light.tail())))
            }
            Self::Patches(detail) => Arc::new(OneSampleMis::new(PatchSampler::new(light()?, *detail)?, BrdfSampler)),
            Self::File(kind, file) => open(*kind, file, environment, *kind == FileKind::HeadOverPatches)?,
            Self::Rival { family, file, with_emitter } => {
                let rival = RivalSampler::open(file, family.kinds())?;
                let checked = place.scene.map_or(Ok(()), |scene| rival.check(scene.brdfs()));
                checked.map_err(|error| error.in_file(file))?;
                if *with_emitter {
                    Arc::new(OneSampleMis::new(EmitterSampler::new(light()?), rival))
                } else {
                    Arc::new(rival)
                }
            }
            Self::Mixture(source) => match &**source {
                // The compact emitters of a file are outside of the mixture.
                Self::File(kind, file) => open(*kind, file, environment, true)?,
                other => Arc::new(OneSampleMis::new(other.build_in(environment, place)?, BrdfSampler)),
            },
        })
    }
}

/// Resampling of candidates, half of them from a source and half from BRDF sampling.
fn resampling(
    source: &Source,
    candidates: u32,
    environment: &Arc<Environment>,
    place: Place<'_>,
) -> Result<Ris<Arc<dyn Sampler>, BrdfSampler>> {
    let source = Covering::new(source.build_in(environment, place)?)?;
    Ris::new(source, Covering::new(BrdfSampler)?, candidates, environment.clone())
}

/// An estimator that learns what is visible.
fn learning(
    source: &Source,
    (drawn, grid): (Drawn, usize),
    environment: &Arc<Environment>,
    place: Place<'_>,
) -> Result<LearnedVisibility> {
    let directions = match drawn {
        Drawn::Directions(directions) => directions,
        Drawn::Candidates(candidates) => {
            let ris = resampling(source, candidates, environment, place)?;
            return LearnedVisibility::of_ris(ris, environment.clone(), place.memory);
        }
    };
    let (kind, file, mixed) = match source {
        Source::Patches(detail) => {
            return LearnedVisibility::new(environment.clone(), *detail, place.memory)?.drawing(directions);
        }
        Source::File(kind, file) => (*kind, file, false),
        Source::Mixture(part) if let Source::File(kind, file) = &**part => (*kind, file, true),
        _ => return Err(Error::argument(format!("sampler '{source}'"), ONLY_THESE_LEARN)),
    };
    let exported = read(kind, file)?;
    let built = match kind {
        FileKind::HeadOverPatches => exported
            .patch_sampler(environment)
            .and_then(|sampler| LearnedVisibility::of_sampler(sampler, environment.clone(), place.memory)),
        FileKind::Baked | FileKind::Direct => exported
            .table_and_light(environment)
            .and_then(|(table, light)| LearnedVisibility::of_table(table, light, (grid, mixed), place.memory)),
        FileKind::Head => exported
            .sampler(environment, mixed)
            .and_then(Covering::new)
            .and_then(|head| LearnedVisibility::beside_head(head, environment.clone(), place.memory)),
    };
    built.and_then(|estimator| estimator.drawing(directions)).map_err(|error| error.in_file(file))
}

/// The same estimator with what a file knows of the scene.
fn knowing(
    estimator: LearnedVisibility,
    file: Option<&Path>,
    environment: &Arc<Environment>,
    place: Place<'_>,
) -> Result<LearnedVisibility> {
    let Some(file) = file else {
        return Ok(estimator);
    };
    let scene = place.scene.ok_or_else(|| Error::invalid(file, "visibility", "is of one scene, and none is named"))?;
    let visibility = SceneVisibility::open(file, scene, environment)?;
    estimator.knowing(&visibility).map_err(|error| error.in_file(file))
}

/// A file of a kind.
fn read(kind: FileKind, file: &Path) -> Result<ExportedSampler> {
    let exported = ExportedSampler::read(file)?;
    let held = FileKind::of(&exported);
    if held != kind {
        let holds = match held {
            FileKind::Head if kind == FileKind::Baked => "a head; bake it first, or render it as head:FILE",
            FileKind::Head => "a head; render it as head:FILE",
            FileKind::HeadOverPatches => "a head over patches of sky; render it as head+patches:FILE",
            FileKind::Baked => "the bake of a head; render it as baked:FILE",
            FileKind::Direct => "a direct bake; render it as direct:FILE",
        };
        return Err(Error::invalid(file, "intermediate.kind", format!("the file holds {holds}")));
    }
    Ok(exported)
}

/// The sampler of a file, alone or in a mixture with BRDF sampling.
fn open(kind: FileKind, file: &Path, environment: &Arc<Environment>, mixed: bool) -> Result<Arc<dyn Sampler>> {
    read(kind, file)?.sampler(environment, mixed).map_err(|error| error.in_file(file))
}
