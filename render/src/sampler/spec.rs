//! Sampler specifications: `cosine`, `mis`, `ris:4`, `head:FILE`, ... and the estimators they name.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use super::{
    BrdfSampler, CompensatedEmitterSampler, EmitterSampler, EnvironmentLight, OneSampleMis, Oracle, ProductSampler,
    Resampled,
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
    /// The exact product, tabulated at every shading point.
    Oracle,
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
                let candidates =
                    argument.and_then(|count| count.parse().ok()).filter(|count| (1..=4096).contains(count));
                Self::Ris(candidates.ok_or_else(|| {
                    Error::argument(format!("sampler '{text}'"), "name 1 to 4096 candidates, as in ris:4")
                })?)
            }
            "head" => Self::Head(file()?),
            "baked" => Self::Baked(file()?),
            "direct" => Self::Direct(file()?),
            "oracle" => Self::Oracle,
            _ => {
                let known =
                    "brdf (or cosine), emitter, mis, mis2, mis-comp, ris:4, head:FILE, baked:FILE, direct:FILE, oracle";
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
            Self::Oracle => f.write_str("oracle"),
        }
    }
}

impl SamplerSpec {
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
            Self::Head(file) => match self.read(file, environment)? {
                (Intermediate::Head(head), light) => Box::new(SingleSample::new(ProductSampler::new(light, head))),
                _ => return Err(wrong_kind(file, "a table; render it as baked:FILE or direct:FILE")),
            },
            Self::Baked(file) => match self.read(file, environment)? {
                (Intermediate::Bake(table), light) => Box::new(SingleSample::new(ProductSampler::new(light, table))),
                (Intermediate::Head(_), _) => {
                    return Err(wrong_kind(file, "a head; bake it first, or render it as head:FILE"));
                }
                _ => return Err(wrong_kind(file, "a direct bake; render it as direct:FILE")),
            },
            Self::Direct(file) => match self.read(file, environment)? {
                (Intermediate::DirectBake(table), light) => {
                    Box::new(SingleSample::new(ProductSampler::new(light, table)))
                }
                (Intermediate::Head(_), _) => return Err(wrong_kind(file, "a head; render it as head:FILE")),
                _ => return Err(wrong_kind(file, "the bake of a head; render it as baked:FILE")),
            },
        })
    }

    fn read(&self, file: &Path, environment: &Arc<Environment>) -> Result<(Intermediate, EnvironmentLight)> {
        let exported = ExportedSampler::read(file)?;
        exported.check_environment(environment).map_err(|error| match error {
            Error::Argument { what, reason } => Error::invalid(file, what, reason),
            other => other,
        })?;
        Ok((exported.intermediate, EnvironmentLight::with_tail(environment.clone(), exported.tail)))
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
        for text in
            ["cosine", "emitter", "mis", "mis2", "mis-comp", "ris:4", "head:a/b.safetensors", "baked:x:y", "oracle"]
        {
            assert_eq!(text.parse::<SamplerSpec>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn brdf_is_another_name_of_cosine() {
        assert_eq!("brdf".parse::<SamplerSpec>().unwrap(), SamplerSpec::Cosine);
    }

    #[test]
    fn mistakes_are_named() {
        for text in ["", "ris", "ris:0", "ris:x", "head", "head:", "mis:4", "brdf:1", "best"] {
            let error = text.parse::<SamplerSpec>().unwrap_err().to_string();
            assert!(error.contains(&format!("'{text}'")), "{error}");
        }
    }
}
