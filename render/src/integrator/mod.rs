//! The tiled integrator of direct light and of paths.

mod learn;
mod render;
mod view;
mod wavefront;

pub use learn::learn_visibility;
pub use render::{Budget, MAX_SIDE, Rendering, render};
pub use view::View;
