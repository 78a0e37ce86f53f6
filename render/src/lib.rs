//! Importance samplers for environment light, native inference of exported heads, scenes and a direct-light integrator.
//!
//! This crate reads what headtail exports and knows nothing of the library that trained it.

pub mod bake;
pub mod batch;
pub mod brdf;
pub mod color;
pub mod columns;
pub mod composite;
pub mod discrete;
pub mod environment;
pub mod error;
pub mod estimator;
pub mod export;
pub mod fabric;
pub mod file;
pub mod flat;
pub mod frame;
pub mod head;
pub mod image;
pub mod integrator;
pub mod large;
pub mod latlong;
pub(crate) mod linear;
pub mod memory;
pub(crate) mod morton;
pub mod one_point;
pub mod patches;
pub mod path_text;
pub mod points;
pub mod random;
pub mod remark;
pub mod rival;
pub mod sampler;
pub mod scene;
pub mod simd;
pub mod spec;
pub mod spline;
pub mod statistics;
pub mod tail;
pub(crate) mod tensor_file;
pub mod tile;
pub mod timings;
pub mod visibility;

pub use error::{Error, Result};
