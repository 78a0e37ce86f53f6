//! What is rendered: a scene, a camera and an environment.

use crate::{
    environment::Environment,
    scene::{Camera, Scene},
};

/// What to render.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The camera.
    pub camera: &'a Camera,
    /// The environment.
    pub environment: &'a Environment,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Leave out shadow rays: the environment is seen from everywhere.
    pub unshadowed: bool,
    /// Surfaces that light may visit on its way to the camera: 1 is direct light, and 0 counts as 1.
    pub depth: u32,
}
