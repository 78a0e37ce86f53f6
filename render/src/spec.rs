//! Sampler specifications: `brdf`, `mis`, `ris:4`, `head+mis:FILE`, ... and the estimators that they name.
//!
//! A SPEC is a *source* of directions (`brdf`, `emitter`, `patches`, `oracle`, `KIND:FILE`, or a source in a mixture with BRDF sampling), used alone,
//! in two-sample MIS (`mis2`) or in resampling (`ris:M`).

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use crate::{
    environment::Environment,
    error::{Error, Result},
    estimator::{Estimator, LearnedVisibility, Ris, SingleSample, TwoSampleMis},
    export::{ExportedSampler, Intermediate},
    patches::{Detail, PatchSampler},
    rival::{RivalKind, RivalSampler},
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
}

impl Default for Place<'_> {
    /// In no scene in particular; 64 MiB.
    fn default() -> Self {
        Self { scene: None, memory: LearnedVisibility::MEMORY }
    }
}

/// An estimator by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SamplerSpec {
    /// One direction.
    One(Source),
    /// Two-sample MIS with BRDF sampling, power heuristic; two shadow rays.
    Two(Source),
    /// What learns what is visible while an image is rendered.
    Learning {
        /// Patches, a head over them, a table, or a head.
        source: Source,
        /// The candidates of resampling with a target that knows what is visible, half of them from the source; otherwise one direction is drawn.
        candidates: Option<u32>,
        /// The cells along a side of Y that a table's weights have.
        grid: usize,
        /// What was learned beforehand.
        known: Option<PathBuf>,
    },
    /// Resampled importance sampling with this many candidates, half of them from the source, half from BRDF sampling.
    Ris(u32, Source),
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

    /// Where the directions come from.
    pub fn source(&self) -> &Source {
        match self {
            Self::One(source) | Self::Two(source) | Self::Learning { source, .. } | Self::Ris(_, source) => source,
        }
    }

    /// The file that it is read from, if there is one, and what it must hold.
    pub fn path(&self) -> Option<(FileKind, &Path)> {
        self.source().path()
    }

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
            Self::One(source) => Box::new(SingleSample::new(Covering::new(sampler(source)?)?, environment.clone())),
            Self::Two(source) => Box::new(TwoSampleMis::new(sampler(source)?, BrdfSampler, environment.clone())?),
            Self::Ris(candidates, source) => Box::new(resampling(source, *candidates, environment, place)?),
            Self::Learning { source, candidates, grid, known } => {
                let estimator = learning(source, (*candidates, *grid), environment, place)?;
                Box::new(knowing(estimator, known.as_deref(), environment, place)?)
            }
        })
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
    (candidates, grid): (Option<u32>, usize),
    environment: &Arc<Environment>,
    place: Place<'_>,
) -> Result<LearnedVisibility> {
    if let Some(candidates) = candidates {
        let ris = resampling(source, candidates, environment, place)?;
        return LearnedVisibility::of_ris(ris, environment.clone(), place.memory);
    }
    let (kind, file, mixed) = match source {
        Source::Patches(detail) => return LearnedVisibility::new(environment.clone(), *detail, place.memory),
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
    built.map_err(|error| error.in_file(file))
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

impl FromStr for SamplerSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text == "mis2" {
            return Ok(Self::Two(Source::Emitter));
        }
        if let Some(source) = text.strip_prefix("mis2:") {
            return Ok(Self::Two(source_of(source, text)?));
        }
        if let Some(learning) = Learning::of(text) {
            return learning.spec(text);
        }
        let Some(rest) = text.strip_prefix("ris").filter(|rest| rest.is_empty() || rest.starts_with(':')) else {
            return Ok(Self::One(source_of(text, text)?));
        };
        let rest = rest.trim_start_matches(':');
        let (count, source) = rest.split_once(':').map_or((rest, None), |(count, source)| (count, Some(source)));
        Ok(Self::Ris(
            candidates_of(count, text)?,
            source.map_or(Ok(Source::Emitter), |source| source_of(source, text))?,
        ))
    }
}

/// The candidates of resampling in a SPEC, which `whole` is.
fn candidates_of(count: &str, whole: &str) -> Result<u32> {
    let candidates = count.parse().ok().filter(|count| (1..=4096).contains(count));
    candidates.ok_or_else(|| Error::argument(format!("sampler '{whole}'"), "name 1 to 4096 candidates, as in ris:4"))
}

const ONLY_THESE_LEARN: &str =
    "learns no visibility: only patches, tables (direct, baked), heads over patches and resampling (ris:4+vis) do";

/// The parts of the SPEC of a sampler that learns: `SAMPLER+vis[GRID][@KNOWN][:REST]`.
struct Learning<'a> {
    sampler: &'a str,
    grid: &'a str,
    known: Option<&'a str>,
    rest: Option<&'a str>,
}

impl<'a> Learning<'a> {
    /// `None` where a `+vis` is a part of a file's name, or there is none.
    fn of(text: &'a str) -> Option<Self> {
        let (sampler, rest) = text.split_once("+vis")?;
        let is_name = !sampler.contains(':') || sampler == "patches:fine";
        let is_ris = sampler.strip_prefix("ris:").is_some_and(|count| !count.contains(':'));
        let (before, rest) = rest.split_once(':').map_or((rest, None), |(before, rest)| (before, Some(rest)));
        let (grid, known) = before.split_once('@').map_or((before, None), |(grid, known)| (grid, Some(known)));
        (is_name || is_ris).then_some(Self { sampler, grid, known, rest })
    }

    fn spec(self, whole: &str) -> Result<SamplerSpec> {
        let wrong = |reason: &str| Error::argument(format!("sampler '{whole}'"), reason);
        let Self { sampler, grid, known, rest } = self;
        if known == Some("") || rest == Some("") {
            return Err(wrong("name a file, as in patches+vis:FILE, direct+vis:FILE or direct+vis@LEARNED:FILE"));
        }
        let learning = |source, candidates, grid, known: Option<&str>| {
            let known = known.map(PathBuf::from);
            Ok(SamplerSpec::Learning { source, candidates, grid, known })
        };
        if let Some(count) = sampler.strip_prefix("ris:").filter(|_| grid.is_empty()) {
            let source = rest.map_or(Ok(Source::Emitter), |source| source_of(source, whole))?;
            return learning(source, Some(candidates_of(count, whole)?), LearnedVisibility::GRID, known);
        }
        let source = match (sampler, rest) {
            ("patches" | "patches:fine", known_here) if grid.is_empty() && known.is_none() => {
                return learning(source_of(sampler, whole)?, None, LearnedVisibility::GRID, known_here);
            }
            ("head+patches" | "direct" | "baked" | "direct+mis" | "baked+mis" | "head" | "head+mis", Some(file)) => {
                source_of(&format!("{sampler}:{file}"), whole)?
            }
            ("head+patches" | "direct" | "baked" | "direct+mis" | "baked+mis" | "head" | "head+mis", None) => {
                return Err(wrong(&format!("name a file, as in {sampler}+vis:FILE")));
            }
            _ => return Err(wrong(ONLY_THESE_LEARN)),
        };
        let of_table = matches!(source.path(), Some((FileKind::Direct | FileKind::Baked, _)));
        let side = match grid {
            "" => LearnedVisibility::GRID,
            "8" | "16" | "32" if of_table => grid.parse().unwrap_or(LearnedVisibility::GRID),
            _ => {
                return Err(wrong(
                    "the cells along a side of a table's weights are 8, 16 or 32, as in direct+vis8:FILE",
                ));
            }
        };
        learning(source, None, side, known)
    }
}

/// The rival of a name, and whether it is beside emitter sampling.
fn rival_of(name: &str) -> Option<(RivalFamily, bool)> {
    let (base, with_emitter) = name.strip_suffix("+emitter").map_or((name, false), |base| (base, true));
    let families = [RivalFamily::NeuSample, RivalFamily::Reparam];
    families.into_iter().find(|family| family.name() == base).map(|family| (family, with_emitter))
}

/// The source of a part of a SPEC, which `whole` is.
fn source_of(text: &str, whole: &str) -> Result<Source> {
    const KNOWN: &str = "is not one of brdf (or cosine), emitter, mis, mis2, mis-comp, ris:4, patches, patches:fine, patches+vis, patches:fine+vis, \
                         patches+vis:FILE, head:FILE, head+patches:FILE, head+patches+vis:FILE, baked:FILE, direct:FILE, \
                         direct+vis:FILE, direct+vis@LEARNED:FILE, ris:4+vis, ris:4+vis:direct:FILE, head+mis:FILE, direct+mis:FILE, ris:4:head:FILE, ris:4:direct:FILE, neusample:FILE, \
                         neusample+emitter:FILE, reparam:FILE, reparam+emitter:FILE, oracle";
    let wrong = |reason: String| Error::argument(format!("sampler '{whole}'"), reason);
    let (name, file) = text.split_once(':').map_or((text, None), |(name, file)| (name, Some(file)));
    let (base, mixed) = name.strip_suffix("+mis").map_or((name, false), |base| (base, true));
    let source = match base {
        "brdf" => Source::Brdf,
        "cosine" => Source::Cosine,
        "emitter" => Source::Emitter,
        "mis" => Source::Emitter.mixed(),
        "mis-comp" => Source::Compensated.mixed(),
        "oracle" => Source::Oracle,
        "patches" if file == Some("fine") && !mixed => return Ok(Source::Patches(Detail::Twigs)),
        "patches" => Source::Patches(Detail::Leaves),
        _ => {
            let rival = rival_of(base).filter(|_| !mixed);
            let kind = FileKind::ALL.into_iter().find(|kind| kind.name() == base);
            let file = || -> Result<PathBuf> {
                let file = file.filter(|file| !file.is_empty());
                Ok(file.ok_or_else(|| wrong(format!("name a file, as in {name}:FILE")))?.into())
            };
            return match (rival, kind) {
                (Some((family, with_emitter)), _) => Ok(Source::Rival { family, file: file()?, with_emitter }),
                (None, None) => Err(wrong(KNOWN.to_owned())),
                (None, Some(FileKind::HeadOverPatches)) if mixed => {
                    Err(wrong("'head+patches' is beside BRDF sampling already".to_owned()))
                }
                (None, Some(kind)) if mixed => Ok(Source::File(kind, file()?).mixed()),
                (None, Some(kind)) => Ok(Source::File(kind, file()?)),
            };
        }
    };
    if file.is_some() {
        return Err(wrong(format!("'{name}' takes nothing after a colon")));
    }
    match source {
        source if !mixed => Ok(source),
        Source::Emitter | Source::Oracle => Ok(source.mixed()),
        _ => Err(wrong(KNOWN.to_owned())),
    }
}

impl fmt::Display for SamplerSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(source) => source.fmt(f),
            Self::Learning { source, candidates, grid, known } => {
                let (name, known) = (source.to_string(), known.as_ref().map(|file| file.display().to_string()));
                // What a source is read from stands last.
                let (name, known, rest) = match (candidates, source) {
                    (Some(count), Source::Emitter) => (format!("ris:{count}"), known, None),
                    (Some(count), _) => (format!("ris:{count}"), known, Some(name)),
                    (None, Source::Patches(_)) => (name, None, known),
                    (None, _) => match name.split_once(':') {
                        Some((kind, file)) => (kind.to_owned(), known, Some(file.to_owned())),
                        None => (name, known, None),
                    },
                };
                let grid = if *grid == LearnedVisibility::GRID { String::new() } else { grid.to_string() };
                let known = known.map_or(String::new(), |file| format!("@{file}"));
                let rest = rest.map_or(String::new(), |file| format!(":{file}"));
                write!(f, "{name}+vis{grid}{known}{rest}")
            }
            Self::Two(Source::Emitter) => f.write_str("mis2"),
            Self::Two(source) => write!(f, "mis2:{source}"),
            Self::Ris(candidates, Source::Emitter) => write!(f, "ris:{candidates}"),
            Self::Ris(candidates, source) => write!(f, "ris:{candidates}:{source}"),
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Brdf => f.write_str("brdf"),
            Self::Cosine => f.write_str("cosine"),
            Self::Emitter => f.write_str("emitter"),
            // Not a SPEC: it leaves out what is dim.
            Self::Compensated => f.write_str("compensated emitter"),
            Self::Oracle => f.write_str("oracle"),
            Self::Patches(Detail::Leaves) => f.write_str("patches"),
            Self::Patches(Detail::Twigs) => f.write_str("patches:fine"),
            Self::File(kind, file) => write!(f, "{}:{}", kind.name(), file.display()),
            Self::Rival { family, file, with_emitter } => {
                write!(f, "{}{}:{}", family.name(), if *with_emitter { "+emitter" } else { "" }, file.display())
            }
            Self::Mixture(source) => match &**source {
                Self::Emitter => f.write_str("mis"),
                Self::Compensated => f.write_str("mis-comp"),
                Self::File(kind, file) => write!(f, "{}+mis:{}", kind.name(), file.display()),
                other => write!(f, "{other}+mis"),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specifications_print_as_they_parse() {
        for text in [
            "brdf",
            "cosine",
            "emitter",
            "mis",
            "mis2",
            "mis-comp",
            "ris:4",
            "head:a/b.safetensors",
            "baked:x:y",
            "head+mis:a",
            "direct+mis:b:c",
            "ris:4:head:a",
            "ris:16:direct:b:c",
            "oracle",
            "oracle+mis",
            "patches",
            "patches:fine",
            "patches+vis",
            "patches:fine+vis",
            "patches+vis:a/b:c",
            "patches:fine+vis:a",
            "head:a+vis:b",
            "head:a+vis",
            "head+patches:a/b:c",
            "head+patches:a+vis",
            "head+patches+vis:a/b:c",
            "head+patches+vis@a:b:c",
            "direct+vis:a:b",
            "direct+vis8:a",
            "direct+vis32@a/b:c:d",
            "baked+mis+vis:a",
            "direct:a+vis:b",
            "ris:4+vis",
            "ris:4+vis@a",
            "ris:4+vis:direct:a",
            "ris:4+vis@a:head:b",
            "ris:2+vis:patches",
            "ris:4:head+patches:a",
            "mis2:head+patches:a",
            "ris:4:patches",
            "mis2:direct:a",
            "ris:4:head+mis:a",
            "ris:4:mis",
        ] {
            assert_eq!(text.parse::<SamplerSpec>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn mistakes_are_named() {
        for text in [
            "",
            "ris",
            "ris:0",
            "ris:x",
            "head",
            "head:",
            "mis:4",
            "brdf:1",
            "best",
            "mis+mis:a",
            "patches:coarse",
            "patches+mis",
            "patches+mis:fine",
            "mis+vis",
            "direct+vis",
            "direct+vis:",
            "direct+vis@:a",
            "direct+vis9:a",
            "direct+vis@a",
            "direct+visual:a",
            "patches+vis8",
            "patches+vis@a",
            "patches+visual",
            "ris:0+vis",
            "ris:4+vis:",
            "ris:4+vis8:patches",
            "head+patches+vis8:a",
            "mis+vis:a",
            "patches+vis:",
            "head+patches",
            "head+patches+vis",
            "head+patches+vis:",
            "head+patches+mis:a",
            "ris:4:patches+vis",
            "head+mis",
            "ris:4:head",
            "ris:4:mis:x",
        ] {
            let error = text.parse::<SamplerSpec>().unwrap_err().to_string();
            assert!(error.contains(&format!("'{text}'")), "{error}");
        }
    }
}
