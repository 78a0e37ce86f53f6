//! Sampler specifications: `brdf`, `mis`, `ris:4`, `head+mis:FILE`, ... and the estimators that they name.
//!
//! A SPEC is a *source* of directions (`brdf`, `emitter`, `patches`, `oracle`, `KIND:FILE`, or a source in a mixture with BRDF sampling), used alone,
//! several times (`split:N`, also of what learns), in two-sample MIS (`mis2`) or in resampling (`ris:M`).
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | what SPECs say |
//! | `parse.rs`, `print.rs` | their grammar, both ways |
//! | `forms.rs` | all forms, for help |
//! | `build.rs` | the samplers and estimators that they name |

mod build;
pub mod forms;
mod parse;
mod print;
#[cfg(test)]
mod tests;

pub use build::Place;

use std::path::{Path, PathBuf};

use crate::{
    estimator::LearnedVisibility,
    export::{ExportedSampler, Intermediate},
    patches::Detail,
    rival::RivalKind,
};

/// An estimator by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SamplerSpec {
    /// What suits the place: see [`Self::resolved`].
    Auto,
    /// One direction.
    One(Source),
    /// Two-sample MIS with BRDF sampling, power heuristic; two shadow rays.
    Two(Source),
    /// What learns what is visible while an image is rendered.
    Learning {
        /// Patches, a head over them, a table, or a head.
        source: Source,
        /// What is drawn from it.
        drawn: Drawn,
        /// The cells along a side of Y that a table's weights have.
        grid: usize,
        /// What was learned beforehand.
        known: Option<PathBuf>,
    },
    /// The mean of this many directions.
    Split(u32, Source),
    /// Resampled importance sampling with this many candidates, half of them from the source, half from BRDF sampling.
    Ris(u32, Source),
}

/// What an estimator that learns draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drawn {
    /// This many directions from the source, of which it takes the mean.
    Directions(u32),
    /// One of so many candidates, half of them from the source, by resampling with a target that knows what is visible.
    Candidates(u32),
}

/// What directions are drawn from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// BRDF sampling.
    Brdf,
    /// Its other name, which says what it is on Lambert surfaces.
    Cosine,
    /// Emitter sampling.
    Emitter,
    /// Emitter sampling with MIS compensation, which covers a part only.
    Compensated,
    /// Patches of sky, beside BRDF sampling where surfaces are glossy.
    Patches(Detail),
    /// The product, tabulated at every shading point.
    Oracle,
    /// A file's sampler.
    File(FileKind, PathBuf),
    /// A sampler that others trained for a material, alone or in one-sample MIS with emitter sampling.
    Rival {
        /// Which.
        family: RivalFamily,
        /// Its file.
        file: PathBuf,
        /// Whether it is beside emitter sampling.
        with_emitter: bool,
    },
    /// One-sample MIS with BRDF sampling, with the share that the source has learned, else 1/2.
    Mixture(Box<Source>),
}

/// Whose sampler a rival is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RivalFamily {
    /// NeuSample's lobes or flow, as the file has them.
    NeuSample,
    /// The reparameterised sampler.
    Reparam,
}

impl RivalFamily {
    const ALL: [Self; 2] = [Self::NeuSample, Self::Reparam];

    fn name(self) -> &'static str {
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

/// What a file's sampler is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A trained head.
    Head,
    /// A trained head over patches of sky, in a mixture with BRDF sampling where surfaces are glossy.
    HeadOverPatches,
    /// A table baked from a head.
    Baked,
    /// A table baked from the target itself.
    Direct,
}

impl FileKind {
    const ALL: [Self; 4] = [Self::Head, Self::HeadOverPatches, Self::Baked, Self::Direct];

    fn name(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::HeadOverPatches => "head+patches",
            Self::Baked => "baked",
            Self::Direct => "direct",
        }
    }

    /// The kind of what a file holds.
    pub fn of(exported: &ExportedSampler) -> Self {
        match exported.intermediate {
            Intermediate::Head(_) if exported.patches.is_some() => Self::HeadOverPatches,
            Intermediate::Head(_) => Self::Head,
            Intermediate::Bake(_) => Self::Baked,
            Intermediate::DirectBake(_) => Self::Direct,
        }
    }
}

impl SamplerSpec {
    /// `brdf`.
    pub fn brdf() -> Self {
        Self::One(Source::Brdf)
    }

    /// `emitter`.
    pub fn emitter() -> Self {
        Self::One(Source::Emitter)
    }

    /// `mis`.
    pub fn mis() -> Self {
        Self::One(Source::Emitter.mixed())
    }

    /// `oracle`.
    pub fn oracle() -> Self {
        Self::One(Source::Oracle)
    }

    /// `patches`.
    pub fn patches() -> Self {
        Self::One(Source::Patches(Detail::Leaves))
    }

    /// `ris:M`.
    pub fn ris(candidates: u32) -> Self {
        Self::Ris(candidates, Source::Emitter)
    }

    /// `KIND:FILE`.
    pub fn file(kind: FileKind, file: PathBuf) -> Self {
        Self::One(Source::File(kind, file))
    }

    /// `KIND+mis:FILE`.
    pub fn file_with_mis(kind: FileKind, file: PathBuf) -> Self {
        Self::One(Source::File(kind, file).mixed())
    }

    /// What a file's sampler was made to be: a head that has learned its share beside BRDF sampling is one in that mixture, all others are
    /// alone.
    pub fn of_exported(exported: &ExportedSampler, file: PathBuf) -> Self {
        let kind = FileKind::of(exported);
        let source = Source::File(kind, file);
        Self::One(if exported.has_share() && kind != FileKind::HeadOverPatches { source.mixed() } else { source })
    }

    /// Where the directions come from; of `auto`, what it is where there is no scene.
    pub fn source(&self) -> &Source {
        match self {
            Self::Auto => &Source::Patches(Detail::Leaves),
            Self::One(source)
            | Self::Two(source)
            | Self::Split(_, source)
            | Self::Learning { source, .. }
            | Self::Ris(_, source) => source,
        }
    }

    /// `split:N:patches+vis`.
    pub fn split_patches_with_visibility(directions: u32) -> Self {
        Self::Learning {
            source: Source::Patches(Detail::Leaves),
            drawn: Drawn::Directions(directions),
            grid: LearnedVisibility::GRID,
            known: None,
        }
    }

    /// `split:N:mis-comp`, or `mis-comp` for one direction.
    pub fn split_compensated(directions: u32) -> Self {
        let source = Source::Compensated.mixed();
        if directions == 1 { Self::One(source) } else { Self::Split(directions, source) }
    }

    /// What `auto` stands for by rule alone: `split:4:patches+vis` in a scene, and `patches` where there is none, because whoever calls decides
    /// how many directions a point has. Others stand for themselves.
    #[must_use]
    pub fn resolved(&self, in_scene: bool) -> Self {
        match (self, in_scene) {
            (Self::Auto, true) => Self::split_patches_with_visibility(4),
            (Self::Auto, false) => Self::patches(),
            (other, _) => other.clone(),
        }
    }

    /// The file that it is read from, if there is one, and what it must hold.
    pub fn path(&self) -> Option<(FileKind, &Path)> {
        self.source().path()
    }
}

impl Source {
    /// In a mixture with BRDF sampling.
    #[must_use]
    pub fn mixed(self) -> Self {
        Self::Mixture(Box::new(self))
    }

    fn path(&self) -> Option<(FileKind, &Path)> {
        match self {
            Self::File(kind, file) => Some((*kind, file)),
            Self::Mixture(source) => source.path(),
            _ => None,
        }
    }

    /// Whether it has a form that learns what is visible: patches, tables and heads.
    fn learns(&self) -> bool {
        matches!(self, Self::Patches(_)) || self.path().is_some()
    }
}

/// What is said of SPECs that ask others to learn.
const ONLY_THESE_LEARN: &str =
    "learns no visibility: only patches, tables (direct, baked), heads over patches and resampling (ris:4+vis) do";
