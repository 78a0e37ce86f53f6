//! The tiled integrator of direct light and of paths.

mod render;
mod wavefront;

pub use render::{Budget, Rendering, View, render};
