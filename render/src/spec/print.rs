//! How SPECs are written, so that they parse to the same again.

use std::fmt;

use super::{Drawn, SamplerSpec, Source};
use crate::{estimator::LearnedVisibility, patches::Detail, path_text::text_of};

impl fmt::Display for SamplerSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::One(source) => source.fmt(f),
            Self::Learning { source, drawn, grid, known } => {
                if let Drawn::Directions(directions) = drawn
                    && *directions > 1
                {
                    write!(f, "split:{directions}:")?;
                }
                let (name, known) = (source.to_string(), known.as_deref().map(|file| text_of(file).into_owned()));
                // What a source is read from stands last.
                let (name, known, rest) = match (drawn, source) {
                    (Drawn::Candidates(count), Source::Emitter) => (format!("ris:{count}"), known, None),
                    (Drawn::Candidates(count), _) => (format!("ris:{count}"), known, Some(name)),
                    (Drawn::Directions(_), Source::Patches(_)) => (name, None, known),
                    (Drawn::Directions(_), _) => match name.split_once(':') {
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
            Self::Split(directions, source) => write!(f, "split:{directions}:{source}"),
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
            Self::File(kind, file) => write!(f, "{}:{}", kind.name(), text_of(file)),
            Self::Rival { family, file, with_emitter } => {
                write!(f, "{}{}:{}", family.name(), if *with_emitter { "+emitter" } else { "" }, text_of(file))
            }
            Self::Mixture(source) => match &**source {
                Self::Emitter => f.write_str("mis"),
                Self::Compensated => f.write_str("mis-comp"),
                Self::File(kind, file) => write!(f, "{}+mis:{}", kind.name(), text_of(file)),
                other => write!(f, "{other}+mis"),
            },
        }
    }
}
