//! The tiled integrator of direct light and of paths.

mod render;
mod stages;
mod view;
mod wavefront;

pub use render::{Budget, MAX_SIDE, Rendering, render};
pub use view::View;
