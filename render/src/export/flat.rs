//! Whole samplers as flat arrays, for implementations on other devices.

use super::{ExportedSampler, Intermediate};
use crate::{
    error::{Error, Result},
    flat::FlatArray,
    patches::{Detail, Patches},
    tail::Tail,
};

/// The arrays of `patches` over a tail.
///
/// # Errors
/// The tail is not the hierarchical one.
pub fn flat_patches(tail: &Tail, detail: Detail) -> Result<Vec<FlatArray>> {
    let Tail::Hierarchical(tail) = tail else {
        return Err(Error::argument("tail", format!("is {}; patches are over the hierarchical one", tail.kind().name())));
    };
    let patches = Patches::new(tail, detail);
    Ok([tail.flat(), patches.flat(tail.grid().columns(), tail.grid().rows())].concat())
}

/// The arrays of a file's table or head over its tail.
///
/// # Errors
/// The file leaves out compact emitters.
pub fn flat_exported(exported: &ExportedSampler) -> Result<Vec<FlatArray>> {
    if exported.compact_emitters {
        return Err(Error::argument("compact_emitters", "there is no form for other devices of them"));
    }
    let intermediate = match &exported.intermediate {
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => table.flat(),
        Intermediate::Head(head) => head.flat(),
    };
    Ok([exported.tail.flat(), intermediate].concat())
}
