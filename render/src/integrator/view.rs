//! The input of a rendering: a scene, a camera and an environment.

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
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

/// The input of a rendering.
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
    /// Omit shadow rays, as if the environment were visible from everywhere.
    pub unshadowed: bool,
    /// Maximum surfaces on a light path: 1 is direct light, and 0 counts as 1.
    pub depth: u32,
}

impl View<'_> {
    /// Returns the whole image.
    pub fn whole(&self) -> Part {
        Part { left: 0, top: 0, width: self.width, height: self.height }
    }
}
