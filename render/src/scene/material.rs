//! Surface materials.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::texture::Texture;
use crate::brdf::{Brdf, Lambert};

/// The metallic-roughness material of glTF.
///
/// Today's BRDF is Lambert's with the base colour as albedo; metalness and roughness are kept as they were read.
#[derive(Clone, Debug)]
pub struct Material {
    /// Linear Rec.709 base colour, which multiplies the texture.
    pub base_color: Vec3A,
    /// Base-colour texture.
    pub base_color_texture: Option<Arc<Texture>>,
    /// Metalness in `[0, 1]`.
    pub metallic: f32,
    /// Roughness in `[0, 1]`; the Trowbridge-Reitz width is its square.
    pub roughness: f32,
}

impl Material {
    /// A diffuse material of a linear Rec.709 albedo.
    pub fn diffuse(albedo: Vec3A) -> Self {
        Self { base_color: albedo, base_color_texture: None, metallic: 0.0, roughness: 1.0 }
    }

    /// The BRDF at texture coordinates `uv`; a texture is left out where the surface has no coordinates.
    pub fn brdf(&self, uv: Option<Vec2>) -> Brdf {
        let texture = match (&self.base_color_texture, uv) {
            (Some(texture), Some(uv)) => texture.sample(uv),
            _ => Vec3A::ONE,
        };
        let albedo = (self.base_color * texture).clamp(Vec3A::ZERO, Vec3A::ONE);
        Brdf::Lambert(Lambert { albedo })
    }
}
