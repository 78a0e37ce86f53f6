//! The tiled integrator of direct light and of paths.
//!
//! | file | concept |
//! | --- | --- |
//! | `render.rs` | passes until a budget is spent |
//! | `rendering.rs`, `view.rs` | budget and result; scene, camera and environment |
//! | `learn.rs` | training visibility before a picture, or for a file |
//! | `film.rs`, `tiles.rs` | the sums of all pixels; tiles in parallel |
//! | `wavefront.rs` | one sample of every pixel of a tile |
//! | `path.rs` | camera rays, shadow rays and bounces |
//! | `features.rs` | albedo, normals and depth |

mod features;
mod film;
mod learn;
pub(crate) mod path;
mod render;
mod rendering;
pub(crate) mod tiles;
mod view;
mod wavefront;

pub use features::{Features, features};
pub(crate) use learn::TrainingPass;
pub use learn::{learn_visibility, learn_weights};
pub use render::{MAX_SIDE, render, render_part};
pub use rendering::{Budget, Rendering};
pub use view::{Part, View};
