//! Sources of directions: their names, and the samplers that they build.
//!
//! A new sampler needs its own file and, here, a variant of [`Source`], a row of [`NAMED`] and an arm of [`Source::build`].

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use super::context::BuildContext;
use crate::{
    environment::Environment,
    error::{Error, Result},
    export::{ExportedSampler, Intermediate},
    patches::{Detail, PatchSampler},
    portals::{self, Portal, PortalSampler},
    rival::{RivalKind, RivalSampler},
    sampler::{BrdfSampler, EmitterSampler, EnvironmentLight, OneSampleMis, Oracle, ProductSampler, Sampler},
    tail::TailKind,
};

/// The source of directions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Chosen for the view: see [`SamplerSpec::resolved`](super::SamplerSpec::resolved).
    Auto,
    /// BRDF sampling.
    Brdf,
    /// BRDF sampling, by its name on Lambert surfaces.
    Cosine,
    /// Emitter sampling.
    Emitter,
    /// Emitter sampling with MIS compensation (Karlik et al. 2019), which leaves out dim light and needs a companion.
    Compensated,
    /// Patches of the map, beside BRDF sampling on glossy surfaces.
    Patches(Detail),
    /// The product, tabulated at every shading point.
    Oracle,
    /// Portal-masked sampling beside emitter sampling, through the portals of a file or those found in the scene.
    Portals(Option<PathBuf>),
    /// A sampler in a file.
    File(FileKind, PathBuf),
    /// Another method's sampler, trained for a material.
    Rival(RivalFamily, PathBuf),
}

/// The sampler beside a source in one-sample MIS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Companion {
    /// None: the source alone.
    None,
    /// BRDF sampling, with the mixture weight that the source has learned, otherwise 0.5.
    Brdf,
    /// Emitter sampling, for rivals.
    Emitter,
}

/// The purpose of a form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// For rendering.
    Use,
    /// The method of Litalien et al. 2024.
    Paper,
    /// A common method of other renderers.
    Baseline,
    /// For studies.
    Study,
}

/// A source without a file, possibly beside a companion, and its name.
pub(super) struct Named {
    pub name: &'static str,
    pub source: Source,
    pub companion: Companion,
    /// Description in a clause, and purpose.
    pub what: (&'static str, Purpose),
}

const fn named(name: &'static str, source: Source, companion: Companion, what: (&'static str, Purpose)) -> Named {
    Named { name, source, companion, what }
}

/// Every source without a file. Combinations with a companion that are not listed do not exist.
pub(super) static NAMED: [Named; 10] = [
    named("auto", Source::Auto, Companion::None, ("chosen for the view by a short pilot rendering", Purpose::Use)),
    named(
        "patches",
        Source::Patches(Detail::Leaves),
        Companion::None,
        ("the product of light, BRDF and cosine in closed form", Purpose::Use),
    ),
    named(
        "patches:fine",
        Source::Patches(Detail::Twigs),
        Companion::None,
        ("patches on a finer division of the map", Purpose::Use),
    ),
    named("mis", Source::Emitter, Companion::Brdf, ("emitter and BRDF sampling in one-sample MIS", Purpose::Baseline)),
    named("mis-comp", Source::Compensated, Companion::Brdf, ("mis with MIS compensation", Purpose::Baseline)),
    named("brdf", Source::Brdf, Companion::None, ("BRDF sampling", Purpose::Baseline)),
    named("cosine", Source::Cosine, Companion::None, ("another name of brdf, for diffuse surfaces", Purpose::Baseline)),
    named("emitter", Source::Emitter, Companion::None, ("emitter sampling", Purpose::Baseline)),
    named(
        "oracle",
        Source::Oracle,
        Companion::None,
        ("a fine table of light x BRDF x cosine at every point; slow, and no bound", Purpose::Study),
    ),
    named("oracle+mis", Source::Oracle, Companion::Brdf, ("the same beside BRDF sampling", Purpose::Study)),
];

/// Names of two-sample MIS with sources of emitter sampling.
pub(super) static PAIRS: [(&str, Source); 2] = [("mis2", Source::Emitter), ("mis2-comp", Source::Compensated)];

/// The name of [`Source::Portals`].
pub(super) const PORTALS: &str = "portals";

/// The content of a sampler's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A trained head.
    Head,
    /// A trained head over patches, in a mixture with BRDF sampling on glossy surfaces.
    HeadOverPatches,
    /// A table baked from a head.
    Baked,
    /// A table baked from the target itself.
    Direct,
}

impl FileKind {
    pub(super) const ALL: [Self; 4] = [Self::Head, Self::HeadOverPatches, Self::Baked, Self::Direct];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::HeadOverPatches => "head+patches",
            Self::Baked => "baked",
            Self::Direct => "direct",
        }
    }

    /// Returns the kind of an exported sampler.
    pub fn of(exported: &ExportedSampler) -> Self {
        match exported.intermediate {
            Intermediate::Head(_) if exported.patches.is_some() => Self::HeadOverPatches,
            Intermediate::Head(_) => Self::Head,
            Intermediate::Bake(_) => Self::Baked,
            Intermediate::DirectBake(_) => Self::Direct,
        }
    }

    /// Reads a file, which must be of this kind.
    ///
    /// # Errors
    /// If it cannot be read, or is of another kind.
    pub fn read(self, file: &Path) -> Result<ExportedSampler> {
        let exported = ExportedSampler::read(file)?;
        let held = Self::of(&exported);
        if held == self {
            return Ok(exported);
        }
        let holds = match held {
            Self::Head if self == Self::Baked => "a head; bake it first, or render it as head:FILE",
            Self::Head => "a head; render it as head:FILE",
            Self::HeadOverPatches => "a head over patches; render it as head+patches:FILE",
            Self::Baked => "the bake of a head; render it as baked:FILE",
            Self::Direct => "a direct bake; render it as direct:FILE",
        };
        Err(Error::invalid(file, "intermediate.kind", format!("the file holds {holds}")))
    }
}

/// The method of a rival.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RivalFamily {
    /// NeuSample's lobes or flow, depending on the file.
    NeuSample,
    /// The reparameterised sampler.
    Reparam,
}

impl RivalFamily {
    pub(super) const ALL: [Self; 2] = [Self::NeuSample, Self::Reparam];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::NeuSample => "neusample",
            Self::Reparam => "reparam",
        }
    }

    fn kinds(self) -> &'static [RivalKind] {
        match self {
            Self::NeuSample => &[RivalKind::Lobes, RivalKind::Flow],
            Self::Reparam => &[RivalKind::Reparam],
        }
    }
}

impl Source {
    pub(super) fn file(&self) -> Option<&Path> {
        match self {
            Self::File(_, file) | Self::Rival(_, file) => Some(file),
            Self::Portals(file) => file.as_deref(),
            _ => None,
        }
    }

    /// Returns why a source cannot be combined with a companion, or `None` if it can.
    pub(super) fn fault_beside(&self, companion: Companion) -> Option<&'static str> {
        match (self, companion) {
            (Self::File(FileKind::HeadOverPatches, _), Companion::Brdf) => {
                Some("'head+patches' is beside BRDF sampling already")
            }
            (Self::File(..) | Self::Portals(_), Companion::None | Companion::Brdf) => None,
            (Self::Rival(..), Companion::None | Companion::Emitter) => None,
            (Self::Rival(..), Companion::Brdf) => Some("has no form beside BRDF sampling"),
            (_, Companion::Emitter) => Some("only neusample and reparam are placed beside emitter sampling"),
            (source, companion) => {
                let exists = NAMED.iter().any(|named| named.source == *source && named.companion == companion);
                (!exists).then_some("has no form with this companion")
            }
        }
    }

    /// Whether it takes visibility.
    pub(super) fn takes_visibility(&self) -> bool {
        matches!(self, Self::Patches(_) | Self::File(FileKind::HeadOverPatches, _))
    }

    /// Returns the portals of a scene that moved, for [`Source::Portals`]; at least one.
    pub(super) fn portals(&self, context: BuildContext<'_>) -> Result<Vec<Portal>> {
        let portals = match self {
            Self::Portals(Some(file)) => {
                portals::read(file)?.iter().map(|portal| portal.moved(&context.motion)).collect()
            }
            _ => context.portals.to_vec(),
        };
        if portals.is_empty() {
            return Err(Error::argument("portals", "no scene to find them in; name a file, as in mis2:portals:FILE"));
        }
        Ok(portals)
    }

    /// Builds the sampler for a map, beside its companion.
    pub(super) fn build(
        &self,
        companion: Companion,
        environment: &Arc<Environment>,
        context: BuildContext<'_>,
    ) -> Result<Arc<dyn Sampler>> {
        let light = || EnvironmentLight::new(environment.clone(), TailKind::Hierarchical);
        let is_mixed = companion == Companion::Brdf;
        let source: Arc<dyn Sampler> = match self {
            Self::Brdf | Self::Cosine => Arc::new(BrdfSampler),
            Self::Emitter => Arc::new(EmitterSampler::new(light()?)),
            Self::Compensated => Arc::new(EmitterSampler::compensated(environment, TailKind::Hierarchical)?),
            Self::Oracle => {
                let light = light()?;
                Arc::new(ProductSampler::new(light.clone(), Oracle::new(light.tail())))
            }
            Self::Auto => return Self::Patches(Detail::Leaves).build(companion, environment, context),
            Self::Patches(detail) => Arc::new(OneSampleMis::new(PatchSampler::new(light()?, *detail)?, BrdfSampler)),
            Self::Portals(_) => {
                Arc::new(PortalSampler::new(&self.portals(context)?, environment).beside_emitter(light()?))
            }
            Self::File(kind, file) => {
                let is_mixed = is_mixed || *kind == FileKind::HeadOverPatches;
                let built = kind.read(file)?.sampler(environment, is_mixed);
                return built.map_err(|error| error.in_file(file));
            }
            Self::Rival(family, file) => {
                let rival = RivalSampler::open(file, family.kinds())?;
                let checked = context.scene.map_or(Ok(()), |scene| rival.check(scene.brdfs()));
                checked.map_err(|error| error.in_file(file))?;
                return Ok(match companion {
                    Companion::Emitter => Arc::new(OneSampleMis::new(EmitterSampler::new(light()?), rival)),
                    _ => Arc::new(rival),
                });
            }
        };
        Ok(if is_mixed { Arc::new(OneSampleMis::new(source, BrdfSampler)) } else { source })
    }
}
