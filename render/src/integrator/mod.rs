//! The tiled integrator of direct light and of paths.

mod features;
mod film;
mod learn;
pub(crate) mod path;
mod render;
mod rendering;
mod view;
mod wavefront;

pub use features::{Features, features};
pub(crate) use learn::Lesson;
pub use learn::learn_visibility;
pub use render::{MAX_SIDE, render, render_part};
pub use rendering::{Budget, Rendering};
pub use view::{Part, View};
