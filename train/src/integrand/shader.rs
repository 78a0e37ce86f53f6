//! Targets that shaders of training can draw, see `crate::device`.

use headtail_render::tail::Tail;

/// A surface seen through a tail, both in closed form.
#[derive(Clone, Copy)]
pub struct ShaderTarget<'a> {
    /// An exact tail.
    pub tail: &'a Tail,
    /// The surface.
    pub surface: ShaderSurface,
}

/// A surface that shaders know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ShaderSurface {
    /// Diffuse.
    Lambert,
    /// Microfacets of one width.
    Ggx {
        /// The width.
        alpha: f32,
    },
    /// Microfacets whose width is part of the condition.
    GgxOfCondition,
}
