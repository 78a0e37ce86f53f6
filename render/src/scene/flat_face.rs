//! Triangles with all that shading needs of them, for renderers on other devices.

use glam::{Vec2, Vec3, Vec4};

use super::{Material, Scene, faces::Face};

/// A triangle of a scene, in world space. Attributes are those of its corners.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatFace {
    /// Positions in metres, counter-clockwise as seen from outside.
    pub corners: [Vec3; 3],
    /// Shading normals of unit length, or 0; `None` for flat shading.
    pub normals: Option<[Vec3; 3]>,
    /// Texture coordinates of the base colour.
    pub color_uv: Option<[Vec2; 3]>,
    /// Texture coordinates of metalness and roughness.
    pub roughness_uv: Option<[Vec2; 3]>,
    /// Texture coordinates of emitted light.
    pub emission_uv: Option<[Vec2; 3]>,
    /// Linear Rec.709 colours that multiply the base colour.
    pub colors: Option<[Vec3; 3]>,
    /// Texture coordinates of the normal map, and tangents if the file has them.
    pub normal_map: Option<([Vec2; 3], Option<[Vec4; 3]>)>,
    /// Index of its material.
    pub material: usize,
    /// Whether cameras do not see its back.
    pub is_single_sided: bool,
    /// Whether it belongs to a copy of a mesh, whose corners have twice the rounding error.
    pub is_copied: bool,
    /// Whether it has an alpha mask.
    pub is_masked: bool,
}

impl Scene {
    /// Returns the materials that faces refer to.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Returns the triangles that rays can hit: copies are written out.
    pub fn flat_faces(&self) -> impl Iterator<Item = FlatFace> + '_ {
        (0..self.triangle_count()).map(|number| flat(&self.face(number)))
    }
}

fn flat(face: &Face<'_>) -> FlatFace {
    let mesh = face.mesh;
    // A mirrored copy has its corners in the other order.
    let order = if face.is_mirrored() { [0, 2, 1] } else { [0, 1, 2] };
    let vertices = order.map(|k| face.vertices()[k]);
    let uv = |texcoords: &[Vec2]| (!texcoords.is_empty()).then(|| vertices.map(|i| texcoords[i]));
    let color_uv = uv(&mesh.texcoords);
    let own_or_color = |own: &Option<Vec<Vec2>>| own.as_ref().map_or(color_uv, |own| uv(own));
    FlatFace {
        corners: order.map(|k| face.corners()[k]),
        normals: face.normals().map(|normals| order.map(|k| normals[k].into())),
        color_uv,
        roughness_uv: own_or_color(&mesh.roughness_texcoords),
        emission_uv: own_or_color(&mesh.emission_texcoords),
        colors: (!mesh.colors.is_empty()).then(|| vertices.map(|i| mesh.colors[i])),
        normal_map: mesh.tangent_space.as_ref().map(|space| {
            let tangents = face.tangents(space).map(|tangents| order.map(|k| tangents[k]));
            (vertices.map(|i| space.texcoords[i]), tangents)
        }),
        material: mesh.material,
        is_single_sided: mesh.is_single_sided,
        is_copied: face.is_copied(),
        is_masked: mesh.mask.is_some(),
    }
}
