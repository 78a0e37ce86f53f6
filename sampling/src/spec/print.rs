//! Prints SPECs so that they parse to the same SPEC.

use std::fmt;

use super::{
    Combiner, Companion, SamplerSpec, Source, Visibility,
    source::{NAMED, Named, PORTALS},
};
use crate::path_text::text_of;

impl fmt::Display for SamplerSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, companion, combiner, visibility } = self;
        let is_emitter = (source, *companion) == (&Source::Emitter, Companion::None);
        match combiner {
            Combiner::One => {}
            Combiner::Split(directions) => write!(f, "split:{directions}:")?,
            Combiner::TwoSampleMis(pairs) => {
                if *pairs > 1 {
                    write!(f, "split:{pairs}:")?;
                }
                if let Some(name) = self.pair_name() {
                    return f.write_str(name);
                }
                f.write_str("mis2:")?;
            }
            Combiner::Ris(candidates) if is_emitter => return write!(f, "ris:{candidates}"),
            Combiner::Ris(candidates) => write!(f, "ris:{candidates}:")?,
        }
        match source {
            Source::File(kind, _) => f.write_str(kind.name())?,
            Source::Portals(_) => f.write_str(PORTALS)?,
            Source::Rival(family, _) => f.write_str(family.name())?,
            _ => {
                let is_own = |named: &&Named| named.source == *source && named.companion == *companion;
                f.write_str(NAMED.iter().find(is_own).map_or("?", |named| named.name))?;
            }
        }
        match companion {
            Companion::Brdf if source.file().is_some() || matches!(source, Source::Portals(_)) => {
                f.write_str("+mis")?;
            }
            Companion::Emitter => f.write_str("+emitter")?,
            _ => {}
        }
        let (precomputed, file) = match (visibility, source.file()) {
            // The visibility of patches takes the place of the file of other sources.
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
