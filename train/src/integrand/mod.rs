//! Target densities in the intermediate square Y.
//!
//! An exact tail maps uniform points of Y to directions in proportion to radiance, so the ideal intermediate
//! density `q*(y|c)` is BRDF x cosine at the tail's direction: it is evaluated at points of Y without
//! tabulation.
//!
//! | file | concept |
//! | --- | --- |
//! | `target.rs` | the trait `Target` |
//! | `surface.rs` | the trait `Surface`; diffuse surfaces |
//! | `ggx.rs`, `measured.rs`, `textured.rs` | microfacet, measured and neural materials |
//! | `viewpoints.rs` | the distribution of views and normals |
//! | `product.rs`, `tail_map.rs` | a surface seen through a tail |
//! | `patched.rs` | a surface seen through patches and a tail |
//! | `tabulated.rs`, `naive.rs` | the paper's table in X; the product without a tail |
//! | `batch.rs` | strata and BRDF samples with weights |
//! | `shader.rs` | targets that shaders can draw |

mod batch;
mod ggx;
mod measured;
mod naive;
mod patched;
mod product;
mod shader;
mod surface;
mod tabulated;
mod tail_map;
mod target;
mod textured;
mod viewpoints;

pub use batch::{Batch, BatchConditions, ConditionPoints};
pub use ggx::Ggx;
pub use measured::MeasuredSurface;
pub use naive::NaiveTarget;
pub use patched::PatchedTarget;
pub use product::{CosineTarget, ProductTarget};
pub use shader::{ShaderSurface, ShaderTarget};
pub use surface::{Lambert, RenderedSurface, Surface};
pub use tabulated::TabulatedTarget;
pub use tail_map::{TailMap, TailPoint};
pub use target::{BatchShape, PlacedPoints, PointValues, Target};
pub use textured::TexturedSurface;
pub use viewpoints::{SeenPoint, Viewpoints};
