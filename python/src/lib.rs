//! The compiled part of the Python package `headtail`: thin wrappers around the crates, with the interpreter lock released while they work.
//!
//! Shapes and types of arrays are brought into order by `headtail/_arrays.py`; what arrives here is contiguous f32. Values are checked by the crates.

mod compare;
mod environment;
mod error;
#[cfg(feature = "fit")]
mod fit;
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
        render::{Scene, render},
        sampler::Sampler,
    };
}
