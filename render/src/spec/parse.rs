//! How SPECs are read.

use std::{path::PathBuf, str::FromStr};

use super::{Drawn, FileKind, ONLY_THESE_LEARN, RivalFamily, SamplerSpec, Source, forms};
use crate::{
    bake::WeightedTable,
    error::{Error, Result},
    estimator::{LearnedVisibility, Split},
    patches::Detail,
    path_text::path_of,
    points::MAX_CANDIDATES,
    sampler::BrdfSampler,
};

impl FromStr for SamplerSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        if text == "mis2" {
            return Ok(Self::Two(Source::Emitter));
        }
        if let Some(source) = text.strip_prefix("mis2:") {
            return Ok(Self::Two(source_of(source, text)?));
        }
        if let Some(rest) = text.strip_prefix("split:") {
            let (count, source) = rest.split_once(':').ok_or_else(|| {
                Error::argument(format!("sampler '{text}'"), "name directions and a source, as in split:2:patches")
            })?;
            let directions = count_of(count, Split::<BrdfSampler>::MOST, text, "directions, as in split:2:patches")?;
            return match Learning::of(source) {
                Some(learning) => learning.spec(directions, text),
                None => Ok(Self::Split(directions, source_of(source, text)?)),
            };
        }
        if let Some(learning) = Learning::of(text) {
            return learning.spec(1, text);
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
    count_of(count, MAX_CANDIDATES, whole, "candidates, as in ris:4")
}

/// A number from 1 to `most` in a SPEC, which `whole` is.
fn count_of(count: &str, most: u32, whole: &str, what: &str) -> Result<u32> {
    let count = count.parse().ok().filter(|count| (1..=most).contains(count));
    count.ok_or_else(|| Error::argument(format!("sampler '{whole}'"), format!("name 1 to {most} {what}")))
}

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

    /// The SPEC with so many directions.
    fn spec(self, directions: u32, whole: &str) -> Result<SamplerSpec> {
        let wrong = |reason: &str| Error::argument(format!("sampler '{whole}'"), reason);
        let Self { sampler, grid, known, rest } = self;
        if known == Some("") || rest == Some("") {
            return Err(wrong("name a file, as in patches+vis:FILE, direct+vis:FILE or direct+vis@LEARNED:FILE"));
        }
        let learning = |source, drawn, grid, known: Option<&str>| {
            let known = known.map(path_of);
            Ok(SamplerSpec::Learning { source, drawn, grid, known })
        };
        let drawn = Drawn::Directions(directions);
        if let Some(count) = sampler.strip_prefix("ris:").filter(|_| grid.is_empty()) {
            if directions > 1 {
                return Err(wrong("resampling draws one direction"));
            }
            let source = rest.map_or(Ok(Source::Emitter), |source| source_of(source, whole))?;
            let drawn = Drawn::Candidates(candidates_of(count, whole)?);
            return learning(source, drawn, LearnedVisibility::GRID, known);
        }
        if matches!(sampler, "patches" | "patches:fine") && grid.is_empty() && known.is_none() {
            return learning(source_of(sampler, whole)?, drawn, LearnedVisibility::GRID, rest);
        }
        let of_file = source_of(&format!("{sampler}:{}", rest.unwrap_or("FILE")), whole);
        let source = of_file.ok().filter(Source::learns).ok_or_else(|| wrong(ONLY_THESE_LEARN))?;
        if rest.is_none() {
            return Err(wrong(&format!("name a file, as in {sampler}+vis:FILE")));
        }
        let of_table = matches!(source.path(), Some((FileKind::Direct | FileKind::Baked, _)));
        let side =
            match grid {
                "" => LearnedVisibility::GRID,
                _ => WeightedTable::SIDES.into_iter().find(|side| of_table && side.to_string() == grid).ok_or_else(
                    || wrong("the cells along a side of a table's weights are 8, 16 or 32, as in direct+vis8:FILE"),
                )?,
            };
        learning(source, drawn, side, known)
    }
}

/// The rival of a name, and whether it is beside emitter sampling.
fn rival_of(name: &str) -> Option<(RivalFamily, bool)> {
    let (base, with_emitter) = name.strip_suffix("+emitter").map_or((name, false), |base| (base, true));
    RivalFamily::ALL.into_iter().find(|family| family.name() == base).map(|family| (family, with_emitter))
}

/// The source of a part of a SPEC, which `whole` is.
fn source_of(text: &str, whole: &str) -> Result<Source> {
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
                Ok(path_of(file.ok_or_else(|| wrong(format!("name a file, as in {name}:FILE")))?))
            };
            return match (rival, kind) {
                (Some((family, with_emitter)), _) => Ok(Source::Rival { family, file: file()?, with_emitter }),
                (None, None) => Err(wrong(forms::is_none())),
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
        _ => Err(wrong(forms::is_none())),
    }
}
