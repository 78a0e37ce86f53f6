//! What is rendered: a scene, a camera and an environment.

use crate::{
    environment::Environment,
    scene::{Camera, Scene},
};

/// A rectangle of an image, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// The first column.
    pub left: usize,
    /// The first row.
    pub top: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

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

impl View<'_> {
    /// The whole image.
    pub fn whole(&self) -> Part {
        Part { left: 0, top: 0, width: self.width, height: self.height }
    }
}
