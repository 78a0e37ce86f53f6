//! The tiled integrator of direct light and of paths.

mod features;
mod learn;
mod render;
mod view;
mod wavefront;

pub use features::{Features, features};
pub(crate) use learn::Lesson;
pub use learn::learn_visibility;
pub use render::{Budget, MAX_SIDE, Rendering, render, render_part};
pub use view::{Part, View};
