//! headtail's integrator for graphics devices: paths of `headtail_render::integrator` in WGSL, around the samplers of
//! [`headtail_shaders`].
//!
//! A [`Program`] is the shader of a sampler in a [`LitScene`], a scene under a map. Its pictures are those of
//! `headtail_render::integrator::render` for the same points, but for rounding. What the shaders do not cover is an error
//! that names it.
//!
//! | file | concept |
//! | --- | --- |
//! | `geometry.rs`, `wgsl/rays.wgsl` | triangles and their hierarchy; rays |
//! | `surfaces.rs`, `wgsl/surface.wgsl` | attributes, materials and textures |
//! | `wgsl/reflection.wgsl` | reflection at a shading point |
//! | `wgsl/fitted_point.wgsl`, `neural_texture.wgsl` | points of measured and neural materials |
//! | `map.rs`, `wgsl/map.wgsl` | the environment map |
//! | `points.rs`, `wgsl/points.wgsl` | the camera, and the numbers of samples |
//! | `visibility.rs`, `wgsl/visibility.wgsl` | weights that the host has learned |
//! | `sampler.rs`, other files of `wgsl/` | SPECs: sources of directions, and how they are combined |
//! | `program.rs`, `wgsl/path.wgsl` | the whole shader |
//! | `renderer.rs` | running it through `wgpu` |

mod error;
mod geometry;
mod map;
mod points;
mod program;
#[cfg(feature = "gpu")]
mod renderer;
mod sampler;
mod surfaces;
mod visibility;

pub use error::{Error, Result};
#[cfg(feature = "gpu")]
pub use headtail_shaders::gpu::{Gpu, GpuError};
pub use points::ViewWords;
pub use program::{BINDINGS, Binding, ENTRY_POINT, FILM_VECTORS, LitScene, Program, WORKGROUP_SIDE};
#[cfg(feature = "gpu")]
pub use renderer::Renderer;
pub use visibility::visibility_words;
