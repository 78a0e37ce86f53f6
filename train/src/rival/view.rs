//! A view of a rival's material.

use headtail_render::brdf::neural_texture::FEATURES;

/// Inputs of a sampler at a point, in the tangent frame: features and the direction to the viewer.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub(super) features: [f32; FEATURES],
    pub(super) wo: [f32; 3],
}
