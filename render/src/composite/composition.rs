//! The input of a composite and its settings.

use super::catcher::{Backdrop, Stage};
use crate::{estimator::Estimator, scene::Camera};

/// The input of a composite.
#[derive(Clone, Copy)]
pub struct Composition<'a> {
    /// The object and its catcher.
    pub stage: &'a Stage,
    /// Appearance of the catcher.
    pub backdrop: &'a Backdrop<'a>,
    /// The photograph's camera.
    pub camera: &'a Camera,
    /// Estimator of the map's light.
    pub estimator: &'a dyn Estimator,
}

/// Resolution, sample count and selection of layers.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Samples per pixel; 0 counts as 1.
    pub spp: u32,
    /// Maximum surfaces on a light path, catcher included: 1 is light of the map on the object, and the mask.
    pub depth: u32,
    /// Seed of the samples.
    pub seed: u64,
    /// Compute only the mask, without light on the object.
    pub mask_only: bool,
}
