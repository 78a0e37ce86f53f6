//! Sampler specifications (SPECs): `brdf`, `mis`, `ris:4`, `split:4:patches+vis`, `head+mis:FILE`, ...
//!
//! A SPEC is a choice on independent axes: the [`Source`] of directions, the [`Companion`] beside it in
//! one-sample MIS, the [`Combiner`] of several directions, and [`Visibility`]. Combinations that do not exist
//! are rejected on construction.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the axes, and their valid combinations |
//! | `parse.rs`, `print.rs` | parsing and printing |
//! | `forms.rs` | all forms, for help |
//! | `source.rs` | sources of directions: names and samplers |
//! | `context.rs`, `build.rs` | the scene that samplers are built for; building estimators |

mod build;
mod context;
pub mod forms;
mod parse;
mod print;
mod source;
#[cfg(test)]
mod tests;

pub use context::{BuildContext, SceneContext};
pub use source::{Companion, FileKind, RivalFamily, Source};

use std::path::{Path, PathBuf};

use crate::{
    error::{Error, Result},
    export::ExportedSampler,
    patches::Detail,
};

/// A sampler or an estimator by name.
///
/// ```
/// use headtail_sampling::spec::{Combiner, SamplerSpec, Visibility};
///
/// let spec: SamplerSpec = "split:4:patches+vis".parse()?;
/// assert_eq!(spec.combiner(), Combiner::Split(4));
/// assert_eq!(spec.visibility(), &Visibility::Learned);
/// assert_eq!(spec.to_string(), "split:4:patches+vis");
/// # Ok::<(), headtail_sampling::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SamplerSpec {
    source: Source,
    companion: Companion,
    combiner: Combiner,
    visibility: Visibility,
}

/// How directions from one shading point are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Combiner {
    /// One direction.
    One,
    /// The mean of this many directions.
    Split(u32),
    /// The mean of this many pairs of two-sample MIS with BRDF sampling, power heuristic; two shadow rays each.
    TwoSampleMis(u32),
    /// Resampled importance sampling with this many candidates, half of them from the source, half from BRDF sampling.
    Ris(u32),
}

/// Whether masses are multiplied by the probability that light is visible.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// All light counts as visible.
    None,
    /// Learned before each rendering.
    Learned,
    /// Precomputed, from a file of `bake --visibility`.
    File(PathBuf),
}

impl SamplerSpec {
    /// One direction from a source and its companion, without visibility.
    ///
    /// # Errors
    /// [`Error::Argument`] if the two cannot be combined.
    pub fn new(source: Source, companion: Companion) -> Result<Self> {
        Self { source, companion, combiner: Combiner::One, visibility: Visibility::None }.checked()
    }

    /// Returns the same SPEC with another combiner.
    ///
    /// # Errors
    /// [`Error::Argument`] if that combination does not exist.
    pub fn combined(self, combiner: Combiner) -> Result<Self> {
        Self { combiner, ..self }.checked()
    }

    /// Returns the same SPEC with this visibility.
    ///
    /// # Errors
    /// [`Error::Argument`] if the source takes no visibility.
    pub fn with_visibility(self, visibility: Visibility) -> Result<Self> {
        Self { visibility, ..self }.checked()
    }

    fn checked(self) -> Result<Self> {
        match self.fault() {
            None => Ok(self),
            Some(reason) => Err(Error::argument(format!("sampler '{self}'"), reason)),
        }
    }

    /// Returns why the combination does not exist, or `None` if it does.
    fn fault(&self) -> Option<&'static str> {
        let Self { source, companion, combiner, visibility } = self;
        let is_plain = *combiner == Combiner::One && *visibility == Visibility::None;
        if *source == Source::Auto && !is_plain {
            return Some("'auto' chooses all of a SPEC; name it alone");
        }
        let is_pair = self.pair_name().is_some();
        if let Some(reason) = source.fault_beside(*companion).filter(|_| !is_pair) {
            return Some(reason);
        }
        if *visibility == Visibility::None {
            return None;
        }
        if !source.takes_visibility() {
            return Some("takes no visibility; only patches and heads over patches do");
        }
        let draws = matches!(combiner, Combiner::One | Combiner::Split(_));
        (!draws).then_some("resampling and two-sample MIS take no visibility; use split:N")
    }

    /// Returns the name of two-sample MIS with its source, if it has one of [`PAIRS`](source::PAIRS).
    fn pair_name(&self) -> Option<&'static str> {
        let is_pair = matches!(self.combiner, Combiner::TwoSampleMis(_)) && self.companion == Companion::None;
        source::PAIRS.iter().find(|(_, source)| is_pair && *source == self.source).map(|(name, _)| *name)
    }

    fn plain(source: Source) -> Self {
        Self { source, companion: Companion::None, combiner: Combiner::One, visibility: Visibility::None }
    }

    /// `auto`.
    pub fn auto() -> Self {
        Self::plain(Source::Auto)
    }

    /// `brdf`.
    pub fn brdf() -> Self {
        Self::plain(Source::Brdf)
    }

    /// `emitter`.
    pub fn emitter() -> Self {
        Self::plain(Source::Emitter)
    }

    /// `mis`.
    pub fn mis() -> Self {
        Self { companion: Companion::Brdf, ..Self::emitter() }
    }

    /// `oracle`.
    pub fn oracle() -> Self {
        Self::plain(Source::Oracle)
    }

    /// `patches`.
    pub fn patches() -> Self {
        Self::plain(Source::Patches(Detail::Leaves))
    }

    /// `ris:M`.
    pub fn ris(candidates: u32) -> Self {
        Self { combiner: Combiner::Ris(candidates), ..Self::emitter() }
    }

    /// `KIND:FILE`.
    pub fn file(kind: FileKind, file: PathBuf) -> Self {
        Self::plain(Source::File(kind, file))
    }

    /// `KIND+mis:FILE`; `head+patches:FILE` of a head over patches, which has a companion already.
    pub fn file_with_mis(kind: FileKind, file: PathBuf) -> Self {
        let companion = if kind == FileKind::HeadOverPatches { Companion::None } else { Companion::Brdf };
        Self { companion, ..Self::file(kind, file) }
    }

    /// Returns the SPEC that an exported sampler was made for: a head with a learned mixture weight is beside
    /// BRDF sampling, all others are alone.
    pub fn of_exported(exported: &ExportedSampler, file: PathBuf) -> Self {
        let kind = FileKind::of(exported);
        if exported.has_mixture_weight() { Self::file_with_mis(kind, file) } else { Self::file(kind, file) }
    }

    /// `split:N:patches+vis`, or `patches+vis` for one direction.
    pub fn split_patches_with_visibility(directions: u32) -> Self {
        Self { visibility: Visibility::Learned, ..Self::patches() }.split(directions)
    }

    /// `split:N:mis2-comp`, or `mis2-comp` for one pair.
    pub fn compensated_pairs(pairs: u32) -> Self {
        Self { combiner: Combiner::TwoSampleMis(pairs), ..Self::plain(Source::Compensated) }
    }

    /// `split:N:portals+mis`, or `portals+mis` for one direction: through the portals found in the scene.
    pub fn split_portals(directions: u32) -> Self {
        Self { companion: Companion::Brdf, ..Self::plain(Source::Portals(None)) }.split(directions)
    }

    fn split(self, directions: u32) -> Self {
        let combiner = if directions == 1 { Combiner::One } else { Combiner::Split(directions) };
        Self { combiner, ..self }
    }

    /// Returns the source of directions.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// Returns the sampler beside the source.
    pub fn companion(&self) -> Companion {
        self.companion
    }

    /// Returns how directions are combined.
    pub fn combiner(&self) -> Combiner {
        self.combiner
    }

    /// Returns the visibility by which masses are multiplied.
    pub fn visibility(&self) -> &Visibility {
        &self.visibility
    }

    /// Returns the number of directions of one sample, each with a shadow ray.
    pub fn directions(&self) -> u32 {
        match self.combiner {
            Combiner::One | Combiner::Ris(_) => 1,
            Combiner::TwoSampleMis(pairs) => 2 * pairs,
            Combiner::Split(directions) => directions,
        }
    }

    /// Whether it names one sampler with a pdf, and not an estimator. Visibility that is learned before each rendering
    /// makes it one.
    pub fn has_pdf(&self) -> bool {
        self.combiner == Combiner::One && self.visibility != Visibility::Learned
    }

    /// Whether its samplers depend on the positions of points.
    pub fn needs_positions(&self) -> bool {
        self.visibility != Visibility::None || matches!(self.source, Source::Portals(_))
    }

    /// Returns what `auto` stands for by rule alone: `split:4:patches+vis` in a scene, and `patches` without
    /// one, because there the caller chooses the number of directions of a point. Other SPECs stand for
    /// themselves.
    #[must_use]
    pub fn resolved(&self, in_scene: bool) -> Self {
        match (&self.source, in_scene) {
            (Source::Auto, true) => Self::split_patches_with_visibility(4),
            (Source::Auto, false) => Self::patches(),
            _ => self.clone(),
        }
    }

    /// Returns the sampler's file and its required kind, if there is one.
    pub fn path(&self) -> Option<(FileKind, &Path)> {
        match &self.source {
            Source::File(kind, file) => Some((*kind, file)),
            _ => None,
        }
    }
}
