//! Whole samplers as flat arrays, for implementations on other devices.

use std::sync::Arc;

use super::{ExportedSampler, Intermediate};
use crate::{
    environment::Environment,
    error::{Error, Result},
    flat::FlatArray,
    patches::{Detail, Patches},
    sampler::CompactEmitters,
    tail::{Hierarchical, Tail},
};

/// The arrays of `patches` over a tail.
///
/// # Errors
/// The tail is not the hierarchical one.
pub fn flat_patches(tail: &Tail, detail: Detail) -> Result<Vec<FlatArray>> {
    Ok([tail.flat(), patches_of(tail, |tail| Patches::alone(tail, detail))?].concat())
}

/// The arrays of the patches of a tail.
fn patches_of(tail: &Tail, patches: impl Fn(&Hierarchical) -> Patches) -> Result<Vec<FlatArray>> {
    let Tail::Hierarchical(tail) = tail else {
        return Err(Error::argument(
            "tail",
            format!("is {}; patches are over the hierarchical one", tail.kind().name()),
        ));
    };
    Ok(patches(tail).flat(tail.grid().columns(), tail.grid().rows()))
}

/// The arrays of a file's table, or of its head and the patches below it, over its tail, and of its compact emitters, which take the map that the
/// file was made for.
///
/// # Errors
/// The map is another one, or there is none and the file has compact emitters.
pub fn flat_exported(exported: &ExportedSampler, map: Option<&Arc<Environment>>) -> Result<Vec<FlatArray>> {
    let intermediate = match &exported.intermediate {
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => table.flat(),
        Intermediate::Head(head) => head.flat(),
    };
    let mut arrays = [exported.tail.flat(), intermediate].concat();
    if let Some(detail) = exported.patches {
        arrays.extend(patches_of(&exported.tail, |tail| Patches::new(tail, detail))?);
    }
    if let Some(map) = map {
        exported.check_environment(map)?;
    }
    if exported.compact_emitters {
        let reason = "are the difference between the map and the file: give the map";
        let map = map.ok_or_else(|| Error::argument("compact_emitters", reason))?;
        arrays.extend(CompactEmitters::new(map, &exported.luminance.2)?.flat());
    }
    Ok(arrays)
}
