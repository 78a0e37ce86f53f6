//! The tiled integrator of direct light and of paths.

mod features;
mod render;
mod stages;
mod view;
mod wavefront;

pub use features::{Features, features};
pub use render::{Budget, MAX_SIDE, Rendering, render, render_part};
pub use view::{Part, View};
