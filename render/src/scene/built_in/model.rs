//! Meshes and materials of a built-in scene under construction.

use super::super::{
    camera::Camera,
    material::{Material, TexturedMetallicRoughness},
    mesh::Mesh,
    texture::Texture,
};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use std::sync::Arc;

/// Names a shape so that it takes a fabric (`--material neural:FILE`); it needs texture coordinates.
pub(super) fn fabric(shape: Mesh) -> Mesh {
    Mesh { name: "fabric".into(), ..shape }
}

/// A scene under construction.
pub(super) struct Model {
    pub(super) meshes: Vec<Mesh>,
    pub(super) materials: Vec<Material>,
    pub(super) camera: Camera,
}

/// The index of a material in its [`Model`].
#[derive(Clone, Copy)]
pub(super) struct Paint(usize);

impl Model {
    /// Creates an empty model with a camera: positions in metres, vertical field of view in degrees.
    pub(super) fn seen(look_from: [f32; 3], look_at: [f32; 3], vertical_fov: f32) -> Self {
        let camera = Camera::aimed(look_from.into(), look_at.into(), vertical_fov);
        Self { meshes: Vec::new(), materials: Vec::new(), camera }
    }

    /// Adds a diffuse material of a linear Rec.709 albedo.
    pub(super) fn paint(&mut self, albedo: [f32; 3]) -> Paint {
        self.materials.push(Material::diffuse(Vec3A::from_array(albedo)));
        Paint(self.materials.len() - 1)
    }

    /// Adds a metallic-roughness material of a linear Rec.709 base colour.
    pub(super) fn gloss(&mut self, base_color: [f32; 3], metallic: f32, roughness: f32) -> Paint {
        self.textured(base_color, metallic, roughness, None)
    }

    /// [`Self::gloss`] whose roughness varies over the surface between the two given; shapes need
    /// [`super::worn::mapped`].
    pub(super) fn worn(&mut self, base_color: [f32; 3], metallic: f32, roughness: [f32; 2]) -> Paint {
        self.textured(base_color, metallic, roughness[1], Some(super::worn::texture(roughness[0] / roughness[1])))
    }

    fn textured(&mut self, base_color: [f32; 3], metallic: f32, roughness: f32, wear: Option<Texture>) -> Paint {
        self.materials.push(Material::MetallicRoughness(TexturedMetallicRoughness {
            base_color: base_color.into(),
            base_color_texture: None,
            metallic,
            roughness,
            metallic_roughness_texture: wear.map(Arc::new),
            ..TexturedMetallicRoughness::default()
        }));
        Paint(self.materials.len() - 1)
    }

    /// Adds a shape, turned by `turn` degrees about the y axis, at a place.
    pub(super) fn add_turned(&mut self, paint: Paint, shape: &Mesh, turn: f32, place: [f32; 3]) {
        let turn = Quat::from_rotation_y(turn.to_radians());
        self.add(paint, shape.clone().transformed(&Affine3A::from_rotation_translation(turn, Vec3::from(place))));
    }

    /// Adds a shape.
    pub(super) fn add(&mut self, paint: Paint, mut shape: Mesh) {
        shape.material = paint.0;
        self.meshes.push(shape);
    }

    /// Adds a copy of a shape at each of the given places.
    pub(super) fn add_at(&mut self, paint: Paint, shape: &Mesh, places: impl IntoIterator<Item = [f32; 3]>) {
        for place in places {
            self.add(paint, shape.clone().transformed(&Affine3A::from_translation(place.into())));
        }
    }
}
