//! Importance sampling of environment light: samplers, estimators and their files, for a renderer to embed.
//!
//! Uniform points become directions in proportion to light x BRDF x cosine, as columns of SIMD lanes. This crate knows neither scenes nor rays: the
//! renderer that embeds it finds out which directions are visible.

pub mod bake;
pub mod batch;
pub mod brdf;
pub mod color;
pub mod columns;
pub mod discrete;
pub mod environment;
pub mod error;
pub mod estimator;
pub mod export;
pub mod file;
pub mod flat;
pub mod frame;
pub mod head;
pub mod image;
pub mod large;
pub mod latlong;
pub(crate) mod linear;
pub mod memory;
#[doc(hidden)]
pub mod morton;
pub mod one_point;
mod parallel;
pub mod patches;
pub mod path_text;
pub mod points;
pub mod random;
pub mod remark;
pub mod rival;
pub mod sampler;
pub mod simd;
pub mod spec;
pub mod spline;
pub mod tail;
#[doc(hidden)]
pub mod tensor_file;
pub mod tile;
pub mod timings;
pub mod visibility;

pub use error::{Error, Result};
