//! Surface materials: the BRDF at each point of a surface.

use std::{f32::consts::TAU, sync::Arc};

use glam::{Vec2, Vec3A};

use super::{Bounds, neural::NeuralMaterial, normal_map::NormalMap, texture::Texture};
use crate::brdf::{Ggx, Lambert, MAX_PARAMETERS, MetallicRoughness, Surface, neural_texture::Seen};

/// A surface material.
#[derive(Clone, Debug)]
pub enum Material {
    /// Ideal diffuse reflection of a linear Rec.709 albedo, clamped to `[0, 1]`.
    Diffuse(Vec3A),
    /// A rough mirror.
    Ggx {
        /// Trowbridge-Reitz width, which may vary over the surface.
        alpha: AlphaField,
        /// Reflectance per channel at normal incidence.
        f0: Vec3A,
    },
    /// The metallic-roughness material of glTF.
    MetallicRoughness(TexturedMetallicRoughness),
    /// A BRDF without parameters, by its index in the scene's table.
    Indexed(u32),
    /// A neural material over texture coordinates.
    Neural(NeuralMaterial),
}

/// A point at which a material is evaluated.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurfacePoint {
    /// Position in metres.
    pub p: Vec3A,
    /// Texture coordinates, v downwards, of the base colour; `None` where the surface has none.
    pub color_uv: Option<Vec2>,
    /// Texture coordinates of metalness and roughness.
    pub roughness_uv: Option<Vec2>,
    /// Texture coordinates of emitted light.
    pub emission_uv: Option<Vec2>,
    /// Interpolated vertex colour, linear Rec.709, which multiplies the base colour.
    pub vertex_color: Option<Vec3A>,
    /// View in the tangent frame, without texture coordinates; only neural materials use it.
    pub view: Seen,
}

impl Material {
    /// Creates a diffuse material of a linear Rec.709 albedo.
    pub fn diffuse(albedo: Vec3A) -> Self {
        Self::Diffuse(albedo)
    }

    /// Returns whether it reflects like Lambert's BRDF.
    pub fn is_diffuse(&self) -> bool {
        matches!(self, Self::Diffuse(_))
    }

    /// Returns the normal map, if it has one.
    pub fn normal_map(&self) -> Option<&NormalMap> {
        match self {
            Self::MetallicRoughness(textured) => textured.normal_map.as_ref(),
            Self::Diffuse(_) | Self::Ggx { .. } | Self::Indexed(_) | Self::Neural(_) => None,
        }
    }

    /// Returns whether it emits light.
    pub fn is_emissive(&self) -> bool {
        matches!(self, Self::MetallicRoughness(textured) if textured.emission != Vec3A::ZERO)
    }

    /// Returns the radiance that it emits at a point.
    pub fn emission(&self, at: &SurfacePoint) -> Vec3A {
        match self {
            Self::MetallicRoughness(textured) => match (&textured.emission_texture, at.emission_uv) {
                (Some(texture), Some(uv)) => textured.emission * texture.sample(uv),
                _ => textured.emission,
            },
            Self::Diffuse(_) | Self::Ggx { .. } | Self::Indexed(_) | Self::Neural(_) => Vec3A::ZERO,
        }
    }

    /// Returns the BRDF at a point.
    pub fn surface(&self, at: &SurfacePoint) -> Surface {
        match self {
            Self::Diffuse(albedo) => Lambert { albedo: albedo.clamp(Vec3A::ZERO, Vec3A::ONE).into() }.into(),
            Self::Ggx { alpha, f0 } => Ggx::new(alpha.at(at.p), (*f0).into()).into(),
            Self::MetallicRoughness(textured) => textured.at(at).into(),
            Self::Indexed(brdf) => Surface { brdf: *brdf, parameters: [0.0; MAX_PARAMETERS] },
            Self::Neural(neural) => neural.at(at),
        }
    }
}

/// Factors and textures of glTF's metallic-roughness material. Textures are ignored where the surface has no
/// coordinates for them.
#[derive(Clone, Debug)]
pub struct TexturedMetallicRoughness {
    /// Linear Rec.709 base colour, which multiplies the texture.
    pub base_color: Vec3A,
    /// Base colour, sRGB.
    pub base_color_texture: Option<Arc<Texture>>,
    /// Metalness in `[0, 1]`, which multiplies the texture.
    pub metallic: f32,
    /// Roughness in `[0, 1]`, which multiplies the texture; the Trowbridge-Reitz width is its square.
    pub roughness: f32,
    /// Roughness in green and metalness in blue, linear.
    pub metallic_roughness_texture: Option<Arc<Texture>>,
    /// Shading normals.
    pub normal_map: Option<NormalMap>,
    /// Linear Rec.709 radiance that the surface emits to both sides, which multiplies the texture.
    pub emission: Vec3A,
    /// Emitted light, sRGB.
    pub emission_texture: Option<Arc<Texture>>,
}

impl Default for TexturedMetallicRoughness {
    /// Returns glTF's default: a white metal of roughness 1.
    fn default() -> Self {
        Self {
            base_color: Vec3A::ONE,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_map: None,
            emission: Vec3A::ZERO,
            emission_texture: None,
        }
    }
}

impl TexturedMetallicRoughness {
    fn at(&self, at: &SurfacePoint) -> MetallicRoughness {
        let color = match (&self.base_color_texture, at.color_uv) {
            (Some(texture), Some(uv)) => texture.sample(uv),
            _ => Vec3A::ONE,
        };
        let color = at.vertex_color.map_or(color, |vertex| vertex * color);
        let factors = match (&self.metallic_roughness_texture, at.roughness_uv) {
            (Some(texture), Some(uv)) => texture.sample_linear(uv),
            _ => Vec3A::ONE,
        };
        MetallicRoughness::new((self.base_color * color).into(), self.metallic * factors.z, self.roughness * factors.y)
    }
}

/// The waves of an [`AlphaField`] along two directions, in periods across the scene. No component is zero, so
/// that the width varies over every wall and floor.
const WAVES: [Vec3A; 2] = [Vec3A::new(3.0, 1.0, 2.0), Vec3A::new(-1.0, 2.0, 3.0)];

/// A Trowbridge-Reitz width that changes smoothly with the position in world space.
///
/// With `q` the position relative to the scene's centre over its largest extent, and `a`, `b` two fixed directions, the width is
/// `low + (high - low) (1/2 + sin(2 pi a . q) / 4 + sin(2 pi b . q) / 4)`: about three periods across the
/// scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaField {
    low: f32,
    high: f32,
    center: Vec3A,
    /// Radians per metre, for one period across the scene.
    frequency: f32,
}

impl AlphaField {
    /// Creates a field between `low` and `high` over a scene's bounds.
    pub fn new(low: f32, high: f32, bounds: &Bounds) -> Self {
        let extent = bounds.extent().max_element();
        // A scene without extent has a single width: the middle.
        let (center, frequency) = if extent > 0.0 { (bounds.center(), TAU / extent) } else { (Vec3A::ZERO, 0.0) };
        Self { low, high, center, frequency }
    }

    /// Creates a constant field.
    pub fn constant(alpha: f32) -> Self {
        Self { low: alpha, high: alpha, center: Vec3A::ZERO, frequency: 0.0 }
    }

    /// Returns the least and the greatest width, the centre in metres, and the radians per metre of one period across the
    /// scene.
    pub fn parameters(&self) -> ([f32; 2], Vec3A, f32) {
        ([self.low, self.high], self.center, self.frequency)
    }

    /// Returns the width at a position in metres.
    pub fn at(&self, p: Vec3A) -> f32 {
        let q = (p - self.center) * self.frequency;
        let t = 0.5 + 0.25 * WAVES.iter().map(|wave| wave.dot(q).sin()).sum::<f32>();
        self.low + (self.high - self.low) * t.clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alpha_field_spans_its_range_on_every_wall() {
        let bounds = Bounds { min: Vec3A::new(-3.0, 0.0, 10.0), max: Vec3A::new(5.0, 4.0, 16.0) };
        let field = AlphaField::new(0.2, 0.8, &bounds);
        let places = |k: u16| {
            let (x, y) = (f32::from(k % 100) / 99.0, f32::from(k / 100) / 99.0);
            [Vec3A::new(0.0, x, y), Vec3A::new(x, 0.0, y), Vec3A::new(x, y, 0.0)]
        };
        for wall in 0..3 {
            let widths = (0..10_000).map(|k| field.at(bounds.min + places(k)[wall] * 8.0));
            let (least, most) = widths.fold((1.0_f32, 0.0_f32), |(a, b), width| (a.min(width), b.max(width)));
            assert!((0.2..0.23).contains(&least) && (0.77..=0.8).contains(&most), "wall {wall}: {least} to {most}");
        }
    }

    #[test]
    fn alpha_field_is_constant_without_range_or_extent() {
        assert_eq!(AlphaField::constant(0.4).at(Vec3A::splat(7.0)), 0.4);
        assert_eq!(AlphaField::new(0.4, 0.4, &Bounds { min: Vec3A::ZERO, max: Vec3A::ONE }).at(Vec3A::X), 0.4);
        assert_eq!(AlphaField::new(0.25, 0.75, &Bounds::EMPTY).at(Vec3A::X), 0.5);
    }
}
