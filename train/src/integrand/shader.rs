//! Targets that shaders of training can draw, see `crate::device`.

use headtail_render::{
    brdf::{Brdf, FlatBrdf},
    flat::FlatArray,
};

/// A surface seen through a tail.
#[derive(Clone, Debug)]
pub struct ShaderTarget {
    /// The arrays of the tail, of patches if there are any, `light.cells` for points from tables, and for others `light.nodes`, the
    /// density of the light at the map's texels, if the tail is not exact.
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
        /// The number of materials, the place of each in this list, and their [numbers](FlatBrdf).
        numbers: Vec<f32>,
        /// Whether it is neural.
        is_neural: bool,
    },
}

impl ShaderSurface {
    /// Returns the surface of measured materials, or of a neural one; `None` for others.
    pub(super) fn fitted<'a>(materials: impl IntoIterator<Item = &'a dyn Brdf>) -> Option<Self> {
        let (mut own, mut is_neural) = (Vec::new(), false);
        for material in materials {
            own.push(match material.flat()? {
                FlatBrdf::Measured(numbers) => numbers,
                FlatBrdf::Neural(mut numbers) => {
                    is_neural = true;
                    // Conditions have the features, so that texels, which are last, are not read.
                    numbers.truncate(numbers[3] as usize);
                    numbers
                }
            });
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
