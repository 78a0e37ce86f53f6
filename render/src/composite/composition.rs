//! What is composited, and how much of it is computed.

use super::catcher::{Backdrop, Stage};
use crate::{estimator::Estimator, scene::Camera};

/// What is put into a photograph.
#[derive(Clone, Copy)]
pub struct Composition<'a> {
    /// The object and its catcher.
    pub stage: &'a Stage,
    /// What the catcher looks like.
    pub backdrop: &'a Backdrop<'a>,
    /// The photograph's camera.
    pub camera: &'a Camera,
    /// What draws directions, and weighs them with the light of the map.
    pub estimator: &'a dyn Estimator,
}

/// How much is computed.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Samples per pixel; 0 counts as 1.
    pub spp: u32,
    /// Surfaces that light may visit on its way to the camera, catcher included: 1 is light of the map on the object, and the mask.
    pub depth: u32,
    /// Seed of the samples.
    pub seed: u64,
    /// Only the mask: the object is not lit.
    pub mask_only: bool,
    /// Leave out the object: the catcher as it is, for the second of two passes.
    pub without_object: bool,
}
