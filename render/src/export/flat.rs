//! Whole samplers as flat arrays, for implementations on other devices.

use std::sync::Arc;

use super::{ExportedSampler, Intermediate};
use crate::{
    environment::Environment,
    error::{Error, Result},
    flat::FlatArray,
    patches::{Detail, Patches},
    sampler::CompactEmitters,
    tail::Tail,
};

/// The arrays of `patches` over a tail.
///
/// # Errors
/// The tail is not the hierarchical one.
pub fn flat_patches(tail: &Tail, detail: Detail) -> Result<Vec<FlatArray>> {
    let Tail::Hierarchical(tail) = tail else {
        return Err(Error::argument(
            "tail",
            format!("is {}; patches are over the hierarchical one", tail.kind().name()),
        ));
    };
    let patches = Patches::alone(tail, detail);
    Ok([tail.flat(), patches.flat(tail.grid().columns(), tail.grid().rows())].concat())
}

/// The arrays of a file's table or head over its tail, and of its compact emitters, which take the map that the file was made for.
///
/// # Errors
/// The map is another one, or there is none and the file has compact emitters; or the file holds a head over patches.
pub fn flat_exported(exported: &ExportedSampler, map: Option<&Arc<Environment>>) -> Result<Vec<FlatArray>> {
    if exported.patches.is_some() {
        let reason = "the file holds a head over patches of sky, of which there is no form for other devices; name a head over the tail";
        return Err(Error::argument("patches", reason));
    }
    let intermediate = match &exported.intermediate {
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => table.flat(),
        Intermediate::Head(head) => head.flat(),
    };
    let mut arrays = [exported.tail.flat(), intermediate].concat();
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
