//! The compiled part of the Python package `headtail`: thin wrappers around the crates that release the
//! interpreter lock during work.
//!
//! `headtail/_arrays.py` normalises shapes and types to contiguous f32. The crates check values.

mod arrays;
mod compare;
mod environment;
mod error;
#[cfg(feature = "fit")]
mod fit;
mod portals;
mod render;
mod sampler;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[cfg(feature = "fit")]
    #[pymodule_export]
    use crate::fit::{bake_head, fit, settings};
    #[pymodule_export]
    use crate::{
        compare::compare,
        environment::Environment,
        error::HeadtailError,
        portals::{find_portals, portal_arrays, read_portals},
        render::{Scene, render},
        sampler::{Material, Prepared, Sampler, brdf_cosine},
    };
}
