//! Whole samplers as flat arrays, for implementations on other devices.

use super::{ExportedSampler, Intermediate};
use crate::{
    environment::Environment,
    error::{Error, Result},
    flat::FlatArray,
    patches::{Detail, Patches},
    portals::{Portal, PortalSampler},
    tail::{Hierarchical, Tail, TailKind},
};

/// Returns the arrays of `patches` over a tail.
///
/// # Errors
/// The tail is not hierarchical.
pub fn flat_patches(tail: &Tail, detail: Detail) -> Result<Vec<FlatArray>> {
    Ok([tail.flat(), patches_of(tail, |tail| Patches::alone(tail, detail))?].concat())
}

/// Returns the arrays of portals under a map, and of emitter sampling beside them.
///
/// # Errors
/// The map has no light.
pub fn flat_portals(portals: &[Portal], environment: &Environment) -> Result<Vec<FlatArray>> {
    let tail = Tail::of_environment(TailKind::Hierarchical, environment)?;
    Ok([tail.flat(), PortalSampler::new(portals, environment).flat()].concat())
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

/// Returns the arrays of a file's tail, and of its table or its head with the patches below it.
///
/// # Errors
/// There are patches, and the tail is not hierarchical.
pub fn flat_exported(exported: &ExportedSampler) -> Result<Vec<FlatArray>> {
    let intermediate = match &exported.intermediate {
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => table.flat(),
        Intermediate::Head(head) => head.flat(),
    };
    let mut arrays = [exported.tail.flat(), intermediate].concat();
    if let Some(detail) = exported.patches {
        arrays.extend(patches_of(&exported.tail, |tail| Patches::new(tail, detail))?);
    }
    Ok(arrays)
}
