//! Targets that shaders of training can draw, see `crate::device`.

use headtail_render::flat::FlatArray;

/// A surface in closed form seen through a tail.
#[derive(Clone, Debug)]
pub struct ShaderTarget {
    /// The arrays of the tail, of patches if there are any, and `light.cells` for points from tables; without these, the
    /// tail is exact.
    pub arrays: Vec<FlatArray>,
    /// The surface.
    pub surface: ShaderSurface,
    /// Whether points and densities are in X.
    pub is_in_x: bool,
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
