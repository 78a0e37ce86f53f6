//! Parses SPECs.

use std::str::FromStr;

use super::{
    Combiner, Companion, FileKind, RivalFamily, SamplerSpec, Source, Visibility, forms,
    source::{NAMED, PAIRS, PORTALS},
};
use crate::{
    error::{Error, Result},
    estimator::Split,
    path_text::path_of,
    points::MAX_CANDIDATES,
    sampler::BrdfSampler,
};

impl FromStr for SamplerSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |reason: String| Error::argument(format!("sampler '{text}'"), reason);
        let (combiner, rest) = combiner_of(text).map_err(wrong)?;
        let spec = match (combiner, source_of_pair(rest)) {
            (Combiner::TwoSampleMis(_), Some(source)) => Self::plain(source),
            _ => Parts::of(rest).spec().map_err(wrong)?,
        };
        let spec = Self { combiner, ..spec };
        match spec.fault() {
            None => Ok(spec),
            Some(reason) => Err(wrong(reason.to_owned())),
        }
    }
}

/// Returns the source of a name of two-sample MIS.
fn source_of_pair(name: &str) -> Option<Source> {
    PAIRS.iter().find(|(own, _)| *own == name).map(|(_, source)| source.clone())
}

/// Splits a SPEC into its combiner and its source.
fn combiner_of(text: &str) -> std::result::Result<(Combiner, &str), String> {
    if source_of_pair(text).is_some() {
        return Ok((Combiner::TwoSampleMis(1), text));
    }
    let Some((name, rest)) = text.split_once(':') else {
        return if text == "ris" { Err(format!("name {CANDIDATES}")) } else { Ok((Combiner::One, text)) };
    };
    match name {
        "mis2" if source_of_pair(rest).is_none() => Ok((Combiner::TwoSampleMis(1), rest)),
        "split" => {
            let (count, source) =
                rest.split_once(':').ok_or("name directions and a source, as in split:2:patches".to_owned())?;
            let count = count_of(count, Split::<BrdfSampler>::MOST, "directions, as in split:2:patches")?;
            match combiner_of(source)? {
                (Combiner::TwoSampleMis(1), source) => Ok((Combiner::TwoSampleMis(count), source)),
                _ => Ok((Combiner::Split(count), source)),
            }
        }
        "ris" => {
            let (count, source) = rest.split_once(':').unwrap_or((rest, "emitter"));
            Ok((Combiner::Ris(count_of(count, MAX_CANDIDATES, CANDIDATES)?), source))
        }
        _ => Ok((Combiner::One, text)),
    }
}

const CANDIDATES: &str = "candidates, as in ris:4";

/// Parses a number from 1 to `most`.
fn count_of(count: &str, most: u32, what: &str) -> std::result::Result<u32, String> {
    let count = count.parse().ok().filter(|count| (1..=most).contains(count));
    count.ok_or_else(|| format!("name 1 to {most} {what}"))
}

/// `NAME[+vis[@PRECOMPUTED]][:FILE]`.
struct Parts<'a> {
    name: &'a str,
    /// The text after `+vis`.
    visibility: Option<&'a str>,
    file: Option<&'a str>,
}

impl<'a> Parts<'a> {
    fn of(text: &'a str) -> Self {
        const FINE: &str = "patches:fine";
        // The only name with a colon.
        let from = if text.starts_with(FINE) { FINE.len() } else { 0 };
        let (name, file) = match text[from..].find(':') {
            Some(colon) => (&text[..from + colon], Some(&text[from + colon + 1..])),
            None => (text, None),
        };
        match name.split_once("+vis") {
            Some((name, rest)) => Self { name, visibility: Some(rest), file },
            None => Self { name, visibility: None, file },
        }
    }

    fn spec(self) -> std::result::Result<SamplerSpec, String> {
        let Self { name, visibility, file } = self;
        let named = |file: Option<&str>, form: &str| {
            file.filter(|file| !file.is_empty()).map(path_of).ok_or_else(|| format!("name a file, as in {form}:FILE"))
        };
        let is_patches = matches!(name, "patches" | "patches:fine");
        let visibility_of = |rest: &str| match rest.strip_prefix('@') {
            None if !rest.is_empty() => Err(forms::is_none()),
            None if is_patches && file.is_some() => Ok(Visibility::File(named(file, "patches+vis")?)),
            None => Ok(Visibility::Learned),
            Some(_) if is_patches => Err("name the file after a colon, as in patches+vis:FILE".to_owned()),
            Some(known) => Ok(Visibility::File(named(Some(known), &format!("{name}+vis@PRECOMPUTED"))?)),
        };
        let visibility = visibility.map_or(Ok(Visibility::None), visibility_of)?;
        let is_of_visibility = is_patches && visibility != Visibility::None;
        let (source, companion) = match source_without_file(name) {
            Some(_) if file.is_some() && !is_of_visibility => {
                return Err(format!("'{name}' takes nothing after a colon"));
            }
            Some(own) => own,
            None => {
                let (base, companion) = companion_of(name);
                let source = match source_with_file(base).ok_or_else(forms::is_none)? {
                    WithFile::Portals if file.is_none() => Source::Portals(None),
                    with_file => with_file.source(named(file, name)?),
                };
                (source, companion)
            }
        };
        Ok(SamplerSpec { source, companion, combiner: Combiner::One, visibility })
    }
}

fn source_without_file(name: &str) -> Option<(Source, Companion)> {
    NAMED.iter().find(|named| named.name == name).map(|named| (named.source.clone(), named.companion))
}

/// A source with a file.
enum WithFile {
    Sampler(FileKind),
    Portals,
    Rival(RivalFamily),
}

impl WithFile {
    fn source(self, file: std::path::PathBuf) -> Source {
        match self {
            Self::Sampler(kind) => Source::File(kind, file),
            Self::Portals => Source::Portals(Some(file)),
            Self::Rival(family) => Source::Rival(family, file),
        }
    }
}

fn companion_of(name: &str) -> (&str, Companion) {
    match (name.strip_suffix("+mis"), name.strip_suffix("+emitter")) {
        (Some(base), _) => (base, Companion::Brdf),
        (_, Some(base)) => (base, Companion::Emitter),
        (None, None) => (name, Companion::None),
    }
}

fn source_with_file(base: &str) -> Option<WithFile> {
    if base == PORTALS {
        return Some(WithFile::Portals);
    }
    let sampler = FileKind::ALL.into_iter().find(|kind| kind.name() == base).map(WithFile::Sampler);
    sampler.or_else(|| RivalFamily::ALL.into_iter().find(|family| family.name() == base).map(WithFile::Rival))
}
