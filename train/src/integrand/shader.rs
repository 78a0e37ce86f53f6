//! Targets that shaders of training can draw, see `crate::device`.

use headtail_render::{brdf::Brdf, flat::FlatArray};

/// A surface seen through a tail.
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
#[derive(Clone, Debug, PartialEq)]
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
    /// Measured materials that conditions name by their latents, or a neural one.
    Fitted {
        /// The number of materials, the place of each in this list, and their
        /// [numbers](headtail_render::brdf::Brdf::flat).
        numbers: Vec<f32>,
        /// Whether it is neural.
        is_neural: bool,
    },
}

impl ShaderSurface {
    /// Returns the surface of materials; `None` if one of them has no numbers.
    pub(super) fn fitted<'a>(materials: impl IntoIterator<Item = &'a dyn Brdf>, is_neural: bool) -> Option<Self> {
        let mut own: Vec<Vec<f32>> = materials.into_iter().map(Brdf::flat).collect::<Option<_>>()?;
        if is_neural {
            // Conditions have the features, so that texels, the last of a neural material's numbers, are not read.
            own.iter_mut().for_each(|numbers| numbers.truncate(numbers[3] as usize));
        }
        let mut numbers = vec![own.len() as f32];
        let mut place = 1 + own.len();
        for material in &own {
            numbers.push(place as f32);
            place += material.len();
        }
        numbers.extend(own.concat());
        // Places are exact below 2^24.
        (place < 1 << 24).then_some(Self::Fitted { numbers, is_neural })
    }
}
