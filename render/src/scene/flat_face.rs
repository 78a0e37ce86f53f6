//! Triangles with all that shading needs of them, for renderers on other devices.

use glam::{Vec2, Vec3, Vec4};

use super::{Material, Scene, Texture, faces::Face, mask::Mask};

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
    /// Index of its alpha mask in [`Scene::flat_masks`].
    pub mask: Option<usize>,
    /// Alphas that multiply those of the mask.
    pub alphas: Option<[f32; 3]>,
}

/// An alpha mask: points are opaque where `factor` times the texture's alpha and that of the corners, at most 1, is at least
/// `cutoff`.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatMask {
    /// The least opaque alpha.
    pub cutoff: f32,
    /// Factor of the alpha.
    pub factor: f32,
    /// Alpha in all channels, at the texture coordinates of the base colour; 1 on faces without them.
    pub texture: Option<Texture>,
}

impl Scene {
    /// Returns the materials that faces refer to.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Returns the alpha mask of each mesh.
    pub fn flat_masks(&self) -> Vec<Option<FlatMask>> {
        let flat = |mask: &Mask| {
            let texture = mask.texture.as_ref().map(|texture| texture.to_texture());
            FlatMask { cutoff: mask.cutoff, factor: mask.factor, texture }
        };
        self.meshes.iter().map(|mesh| mesh.mask.as_ref().map(flat)).collect()
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
        mask: mesh.mask.is_some().then_some(face.number),
        alphas: (!mesh.alphas.is_empty()).then(|| vertices.map(|i| mesh.alphas[i])),
    }
}

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Vec3A};

    use super::*;
    use crate::scene::Mesh;

    #[test]
    fn corners_of_mirrored_copies_are_counter_clockwise_from_outside() {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let (up, uv) = (vec![Vec3::Z; 3], vec![Vec2::ZERO, Vec2::X, Vec2::Y]);
        let mesh = Mesh::new(positions, up, uv, vec![[0, 1, 2]], 0).unwrap();
        let moved = Affine3A::from_translation(Vec3::new(5.0, 0.0, 0.0));
        let places = vec![moved, moved * Affine3A::from_scale(Vec3::new(-1.0, 2.0, 1.0))];
        let scene = Scene::new("copies", vec![Mesh { places, ..mesh }], vec![Material::diffuse(Vec3A::ONE)], None);
        let faces: Vec<FlatFace> = scene.unwrap().flat_faces().collect();
        let expected = [
            ([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]], [Vec2::ZERO, Vec2::X, Vec2::Y]),
            ([[5.0, 0.0, 0.0], [5.0, 2.0, 0.0], [4.0, 0.0, 0.0]], [Vec2::ZERO, Vec2::Y, Vec2::X]),
        ];
        for (face, (corners, uv)) in faces.iter().zip(expected) {
            assert_eq!((face.corners.map(|p| p.to_array()), face.color_uv), (corners, Some(uv)));
            let [a, b, c] = face.corners;
            assert!((b - a).cross(c - a).z > 0.0 && face.normals == Some([Vec3::Z; 3]) && face.is_copied);
        }
        assert_eq!(faces.len(), 2);
    }
}
