//! Sampler specifications: `cosine`, `mis`, `ris:4`, `head:FILE`, ... and the estimators they name.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use super::{
    BrdfSampler, CompactEmitters, CompensatedEmitterSampler, EmitterSampler, EnvironmentLight, IntermediateDensity,
    OneSampleMis, Oracle, ProductSampler, Resampled, WithCompactEmitters,
};
use crate::{
    environment::Environment,
    error::{Error, Result},
    export::{ExportedSampler, Intermediate},
    integrator::{DirectEstimator, ResampledEstimator, SingleSample, TwoSampleMis},
    tail::TailKind,
};

/// A sampler by name, with the file it is read from where it has one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SamplerSpec {
    /// BRDF sampling, `brdf`; on Lambert surfaces it is cosine sampling, hence its other name, under which it is printed.
    Cosine,
    /// Emitter sampling.
    Emitter,
    /// One-sample MIS of both, balance heuristic.
    Mis,
    /// Two-sample MIS of both, power heuristic; two shadow rays.
    Mis2,
    /// One-sample MIS with a compensated emitter sampler.
    MisCompensated,
    /// Resampled importance sampling with this many candidates, half of them from each.
    Ris(u32),
    /// A trained head.
    Head(PathBuf),
    /// A table baked from a head.
    Baked(PathBuf),
    /// A table baked from the target itself.
    Direct(PathBuf),
    /// One-sample mixture of a file's sampler with BRDF sampling, with the share that the head has learned, else 1/2.
    WithMis(FileKind, PathBuf),
    /// Resampled importance sampling with this many candidates, half of them from a file's sampler, half from the BRDF.
    RisOf(u32, FileKind, PathBuf),
    /// The exact product, tabulated at every shading point.
    Oracle,
}

/// What a file's sampler is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A trained head.
    Head,
    /// A table baked from a head.
    Baked,
    /// A table baked from the target itself.
    Direct,
}

impl FileKind {
    const ALL: [Self; 3] = [Self::Head, Self::Baked, Self::Direct];

    fn name(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::Baked => "baked",
            Self::Direct => "direct",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl FromStr for SamplerSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, argument) = text.split_once(':').map_or((text, None), |(name, argument)| (name, Some(argument)));
        let file = || match argument {
            Some(file) if !file.is_empty() => Ok(PathBuf::from(file)),
            _ => Err(Error::argument(format!("sampler '{text}'"), format!("name a file, as in {name}:FILE"))),
        };
        if argument.is_some() && matches!(name, "brdf" | "cosine" | "emitter" | "mis" | "mis2" | "mis-comp" | "oracle")
        {
            return Err(Error::argument(format!("sampler '{text}'"), format!("'{name}' takes nothing after a colon")));
        }
        Ok(match name {
            "brdf" | "cosine" => Self::Cosine,
            "emitter" => Self::Emitter,
            "mis" => Self::Mis,
            "mis2" => Self::Mis2,
            "mis-comp" => Self::MisCompensated,
            "ris" => {
                let (count, of) = argument
                    .unwrap_or_default()
                    .split_once(':')
                    .map_or((argument.unwrap_or_default(), None), |(count, of)| (count, Some(of)));
                let candidates = count.parse().ok().filter(|count| (1..=4096).contains(count)).ok_or_else(|| {
                    Error::argument(format!("sampler '{text}'"), "name 1 to 4096 candidates, as in ris:4")
                })?;
                let Some(of) = of else { return Ok(Self::Ris(candidates)) };
                let named = of.split_once(':').filter(|(_, file)| !file.is_empty());
                match named.and_then(|(kind, file)| Some((FileKind::from_name(kind)?, file))) {
                    Some((kind, file)) => Self::RisOf(candidates, kind, file.into()),
                    None => {
                        let reason = "name the other candidates as head:FILE, baked:FILE or direct:FILE";
                        return Err(Error::argument(format!("sampler '{text}'"), reason));
                    }
                }
            }
            "head" => Self::Head(file()?),
            "baked" => Self::Baked(file()?),
            "direct" => Self::Direct(file()?),
            "oracle" => Self::Oracle,
            _ => {
                if let Some(kind) = name.strip_suffix("+mis").and_then(FileKind::from_name) {
                    return Ok(Self::WithMis(kind, file()?));
                }
                let known = "brdf (or cosine), emitter, mis, mis2, mis-comp, ris:4, head:FILE, baked:FILE, direct:FILE, \
                             head+mis:FILE, direct+mis:FILE, ris:4:head:FILE, ris:4:direct:FILE, oracle";
                return Err(Error::argument(format!("sampler '{text}'"), format!("is not one of {known}")));
            }
        })
    }
}

impl fmt::Display for SamplerSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cosine => f.write_str("cosine"),
            Self::Emitter => f.write_str("emitter"),
            Self::Mis => f.write_str("mis"),
            Self::Mis2 => f.write_str("mis2"),
            Self::MisCompensated => f.write_str("mis-comp"),
            Self::Ris(candidates) => write!(f, "ris:{candidates}"),
            Self::Head(file) => write!(f, "head:{}", file.display()),
            Self::Baked(file) => write!(f, "baked:{}", file.display()),
            Self::Direct(file) => write!(f, "direct:{}", file.display()),
            Self::WithMis(kind, file) => write!(f, "{}+mis:{}", kind.name(), file.display()),
            Self::RisOf(candidates, kind, file) => write!(f, "ris:{candidates}:{}:{}", kind.name(), file.display()),
            Self::Oracle => f.write_str("oracle"),
        }
    }
}

impl SamplerSpec {
    /// What a file's sampler was made to be: a head that has learned its share beside BRDF sampling is one in that mixture, all others are
    /// alone.
    pub fn of_exported(exported: &ExportedSampler, file: PathBuf) -> Self {
        match &exported.intermediate {
            Intermediate::Head(head) if head.has_selection() => Self::WithMis(FileKind::Head, file),
            Intermediate::Head(_) => Self::Head(file),
            Intermediate::Bake(_) => Self::Baked(file),
            Intermediate::DirectBake(_) => Self::Direct(file),
        }
    }

    /// Builds the estimator for a map.
    ///
    /// # Errors
    /// A file cannot be read, is of another kind, or was made for another map.
    pub fn build(&self, environment: &Arc<Environment>) -> Result<Box<dyn DirectEstimator>> {
        let light = || EnvironmentLight::new(environment.clone(), TailKind::Hierarchical);
        let emitter = || light().map(EmitterSampler::new);
        let brdf = || BrdfSampler::new(environment.clone());
        Ok(match self {
            Self::Cosine => Box::new(SingleSample::new(brdf())),
            Self::Emitter => Box::new(SingleSample::new(emitter()?)),
            Self::Mis => Box::new(SingleSample::new(OneSampleMis::new(emitter()?, brdf()))),
            Self::Mis2 => Box::new(TwoSampleMis::new(emitter()?, brdf())),
            Self::MisCompensated => {
                let compensated = CompensatedEmitterSampler::new(&light()?)?;
                Box::new(SingleSample::new(OneSampleMis::new(compensated, brdf())))
            }
            Self::Ris(candidates) => {
                Box::new(ResampledEstimator::new(Resampled::new(emitter()?, brdf(), *candidates)?))
            }
            Self::Oracle => {
                let light = light()?;
                let oracle = Oracle::new(light.tail());
                Box::new(SingleSample::new(ProductSampler::new(light, oracle)))
            }
            Self::Head(file) => Self::open(FileKind::Head, file, environment, Use::Alone)?,
            Self::Baked(file) => Self::open(FileKind::Baked, file, environment, Use::Alone)?,
            Self::Direct(file) => Self::open(FileKind::Direct, file, environment, Use::Alone)?,
            Self::WithMis(kind, file) => Self::open(*kind, file, environment, Use::Mis)?,
            Self::RisOf(candidates, kind, file) => Self::open(*kind, file, environment, Use::Ris(*candidates))?,
        })
    }

    /// The estimator of a file's sampler.
    fn open(
        kind: FileKind,
        file: &Path,
        environment: &Arc<Environment>,
        r#use: Use,
    ) -> Result<Box<dyn DirectEstimator>> {
        let blame = |error: Error| match error {
            Error::Argument { what, reason } => Error::invalid(file, what, reason),
            other => other,
        };
        let exported = ExportedSampler::read(file)?;
        exported.check_environment(environment).map_err(blame)?;
        let compact = exported.compact(environment).map_err(blame)?;
        let light = EnvironmentLight::with_tail(environment.clone(), exported.tail);
        match (kind, exported.intermediate) {
            (FileKind::Head, Intermediate::Head(head)) => r#use.of(ProductSampler::new(light, head), compact),
            (FileKind::Baked, Intermediate::Bake(table)) | (FileKind::Direct, Intermediate::DirectBake(table)) => {
                r#use.of(ProductSampler::new(light, table), compact)
            }
            (FileKind::Baked, Intermediate::Head(_)) => {
                Err(wrong_kind(file, "a head; bake it first, or render it as head:FILE"))
            }
            (_, Intermediate::Head(_)) => Err(wrong_kind(file, "a head; render it as head:FILE")),
            (FileKind::Head, _) => Err(wrong_kind(file, "a table; render it as baked:FILE or direct:FILE")),
            (_, Intermediate::Bake(_)) => Err(wrong_kind(file, "the bake of a head; render it as baked:FILE")),
            (_, Intermediate::DirectBake(_)) => Err(wrong_kind(file, "a direct bake; render it as direct:FILE")),
        }
    }
}

/// What a file's sampler is used for.
#[derive(Clone, Copy)]
enum Use {
    Alone,
    Mis,
    Ris(u32),
}

impl Use {
    /// The estimator of a product, in a mixture with the compact emitters that its tail leaves out.
    fn of<I: IntermediateDensity + 'static>(
        self,
        product: ProductSampler<I>,
        compact: Option<Arc<CompactEmitters>>,
    ) -> Result<Box<dyn DirectEstimator>> {
        let brdf = BrdfSampler::new(product.environment().clone());
        Ok(match (self, compact) {
            (Self::Alone, None) => Box::new(SingleSample::new(product)),
            (Self::Alone, Some(compact)) => Box::new(SingleSample::new(WithCompactEmitters::new(compact, product))),
            (Self::Mis, None) => Box::new(SingleSample::new(OneSampleMis::new(product, brdf))),
            (Self::Mis, Some(compact)) => {
                let rest = OneSampleMis::new(product, brdf);
                Box::new(SingleSample::new(WithCompactEmitters::new(compact, rest)))
            }
            (Self::Ris(candidates), None) => {
                Box::new(ResampledEstimator::new(Resampled::new(product, brdf, candidates)?))
            }
            (Self::Ris(candidates), Some(compact)) => {
                let first = WithCompactEmitters::new(compact, product);
                Box::new(ResampledEstimator::new(Resampled::new(first, brdf, candidates)?))
            }
        })
    }
}

fn wrong_kind(file: &Path, holds: &str) -> Error {
    Error::invalid(file, "intermediate.kind", format!("the file holds {holds}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specifications_print_as_they_parse() {
        for text in [
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
        ] {
            assert_eq!(text.parse::<SamplerSpec>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn brdf_is_another_name_of_cosine() {
        assert_eq!("brdf".parse::<SamplerSpec>().unwrap(), SamplerSpec::Cosine);
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
            "head+mis",
            "ris:4:head",
            "ris:4:mis:x",
        ] {
            let error = text.parse::<SamplerSpec>().unwrap_err().to_string();
            assert!(error.contains(&format!("'{text}'")), "{error}");
        }
    }
}
