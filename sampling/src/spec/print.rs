//! How SPECs are written, so that they parse to the same again.

use std::{fmt, path::Path};

use super::{Combiner, Companion, SamplerSpec, Source, Visibility};
use crate::{patches::Detail, path_text::text_of};

impl fmt::Display for SamplerSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, companion, combiner, visibility } = self;
        let is_emitter = (source, *companion) == (&Source::Emitter, Companion::None);
        match combiner {
            Combiner::One => {}
            Combiner::Split(directions) => write!(f, "split:{directions}:")?,
            Combiner::TwoSampleMis if is_emitter => return f.write_str("mis2"),
            Combiner::TwoSampleMis => f.write_str("mis2:")?,
            Combiner::Ris(candidates) if is_emitter => return write!(f, "ris:{candidates}"),
            Combiner::Ris(candidates) => write!(f, "ris:{candidates}:")?,
        }
        match (source, companion) {
            (Source::Emitter, Companion::Brdf) => f.write_str("mis")?,
            (_, Companion::None) => f.write_str(source.name())?,
            // Compensation has no name without its companion.
            (Source::Compensated, Companion::Brdf) => f.write_str(source.name())?,
            (_, Companion::Brdf) => write!(f, "{}+mis", source.name())?,
            (_, Companion::Emitter) => write!(f, "{}+emitter", source.name())?,
        }
        let (precomputed, file) = match (visibility, source.file()) {
            // The visibility of patches stands where other sources have their file.
            (Visibility::File(precomputed), None) => (None, Some(&**precomputed)),
            (Visibility::File(precomputed), file) => (Some(precomputed), file),
            (_, file) => (None, file),
        };
        if *visibility != Visibility::None {
            f.write_str("+vis")?;
        }
        if let Some(precomputed) = precomputed {
            write!(f, "@{}", text_of(precomputed))?;
        }
        file.map_or(Ok(()), |file| write!(f, ":{}", text_of(file)))
    }
}

impl Source {
    /// Its name, without its file.
    fn name(&self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Brdf => "brdf",
            Self::Cosine => "cosine",
            Self::Emitter => "emitter",
            Self::Compensated => "mis-comp",
            Self::Oracle => "oracle",
            Self::Patches(Detail::Leaves) => "patches",
            Self::Patches(Detail::Twigs) => "patches:fine",
            Self::File(kind, _) => kind.name(),
            Self::Rival(family, _) => family.name(),
        }
    }

    fn file(&self) -> Option<&Path> {
        match self {
            Self::File(_, file) | Self::Rival(_, file) => Some(file),
            _ => None,
        }
    }
}
