//! Whole samplers as flat arrays, for implementations on other devices.

use super::{ExportedSampler, Intermediate};
use crate::{
    error::{Error, Result},
    flat::FlatArray,
    patches::{Detail, Patches},
    tail::{Hierarchical, Tail},
};

/// The quad-tree tail of a sampler.
fn hierarchical(tail: &Tail) -> Result<&Hierarchical> {
    match tail {
        Tail::Hierarchical(tail) => Ok(tail),
        Tail::RowColumn(_) | Tail::Flow(_) => {
            let reason =
                format!("is {}; there is a form for other devices of the hierarchical one alone", tail.kind().name());
            Err(Error::argument("tail", reason))
        }
    }
}

/// The arrays of `patches` over a tail.
///
/// # Errors
/// The tail is not the hierarchical one.
pub fn flat_patches(tail: &Tail, detail: Detail) -> Result<Vec<FlatArray>> {
    let tail = hierarchical(tail)?;
    let patches = Patches::new(tail, detail);
    Ok([tail.flat(), patches.flat(tail.grid().columns(), tail.grid().rows())].concat())
}

/// The arrays of a file's table or head over its tail.
///
/// # Errors
/// The file holds another tail, or leaves out compact emitters.
pub fn flat_exported(exported: &ExportedSampler) -> Result<Vec<FlatArray>> {
    if exported.compact_emitters {
        return Err(Error::argument("compact_emitters", "there is no form for other devices of them"));
    }
    let intermediate = match &exported.intermediate {
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => table.flat(),
        Intermediate::Head(head) => head.flat(),
    };
    Ok([hierarchical(&exported.tail)?.flat(), intermediate].concat())
}
