//! Importance sampling of environment light: samplers, estimators and their files, for embedding in a
//! renderer.
//!
//! Samplers map uniform points to directions with a density close to light x BRDF x cosine, as columns of
//! SIMD lanes. This crate has neither scenes nor rays: the renderer that embeds it traces visibility.
//!
//! | file | concept |
//! | --- | --- |
//! | `environment/`, `image/` | environment maps; reading their files |
//! | `tail/` | tail warps t: Y -> X |
//! | `spline/`, `head/`, `export/` | splines; inference of heads; the exported file |
//! | `bake/` | densities over Y tabulated over normals |
//! | `patches/` | product sampling in closed form |
//! | `visibility/` | visibility learned from shadow rays, and the resulting weights |
//! | `brdf/` | BRDFs and BRDF sampling |
//! | `sampler/`, `estimator/` | samplers with a pdf; estimators over them |
//! | `spec/` | samplers by name |
//! | `rival/` | samplers from the literature, for comparison |
//! | `points/`, `random.rs` | sample points of renderings; random streams of training and tests |
//! | `tile.rs`, `batch.rs`, `one_point.rs` | shading points as columns, as flat lists, and single points |
//! | `columns.rs`, `simd.rs` | columns of samples and their arena; functions over SIMD lanes |
//! | `linear.rs`, `discrete.rs`, `float16.rs` | affine layers; inversion of running sums; half precision |
//! | `latlong.rs`, `frame.rs` | directions and X; the frame around a normal |
//! | `color.rs`, `morton.rs` | luminance and the tone curve; the Morton curve |
//! | `flat.rs` | samplers as named arrays, for other devices |
//! | `portals/` | portals of rooms, and the light that comes through them |
//! | `file.rs`, `tensor_file.rs`, `path_text.rs` | files; safetensors; paths within text |
//! | `memory.rs`, `large.rs` | memory limits; large tables |
//! | `remark.rs`, `timings.rs` | notes about files; time by stage |
//! | `parallel.rs` | loops over threads |

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
pub(crate) mod float16;
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
pub mod portals;
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
