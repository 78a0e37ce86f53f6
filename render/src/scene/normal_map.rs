//! Normal maps: shading normals from a texture, in the tangent space of the surface.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec3A, Vec4};

use super::texture::Texture;

/// A normal map of glTF: red is along the tangent, green along the bitangent (up in the texture), blue along
/// the normal; 0 to 1 represent -1 to 1.
#[derive(Clone, Debug)]
pub struct NormalMap {
    /// The texture, linear.
    pub texture: Arc<Texture>,
    /// Factor on red and green.
    pub scale: f32,
}

impl NormalMap {
    /// Returns the unit normal at texture coordinates `uv` of a surface of unit `normal`, with the tangent's
    /// handedness in `w`; the normal itself where the tangent is parallel to it.
    pub fn bend(&self, normal: Vec3A, tangent: Vec4, uv: Vec2) -> Vec3A {
        let Some(along) = Vec3A::from(tangent.truncate()).reject_from_normalized(normal).try_normalize() else {
            return normal;
        };
        let across = normal.cross(along) * 1.0_f32.copysign(tangent.w);
        let texel = 2.0 * self.texture.sample_linear(uv) - Vec3A::ONE;
        let bent = self.scale * (texel.x * along + texel.y * across) + texel.z.max(0.0) * normal;
        bent.try_normalize().unwrap_or(normal)
    }
}

/// Attributes of a mesh with a normal map, besides its normals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TangentSpace {
    /// `[vertices]` texture coordinates of the normal map, v downwards.
    pub texcoords: Vec<Vec2>,
    /// `[vertices]` tangents, with the handedness of the bitangent in `w`; empty if derived from the
    /// coordinates.
    pub tangents: Vec<Vec4>,
}

impl TangentSpace {
    /// Returns the tangent of a triangle of the given corners and coordinates: the direction in which u
    /// grows, and in `w` the side of `normal x tangent` to which v *decreases*. Zero where the coordinates do
    /// not span the triangle.
    pub fn of_triangle(corners: [Vec3; 3], uv: [Vec2; 3], normal: Vec3A) -> Vec4 {
        let [a, b] = [corners[1] - corners[0], corners[2] - corners[0]].map(Vec3A::from);
        let [s, t] = [uv[1] - uv[0], uv[2] - uv[0]];
        // Cramer's rule without the determinant's magnitude: only its sign affects a direction.
        let sign = s.perp_dot(t).signum();
        let along_u = sign * (a * t.y - b * s.y);
        let along_v = sign * (b * s.x - a * t.x);
        let handedness = -normal.cross(along_u).dot(along_v);
        along_u.normalize_or_zero().extend(1.0_f32.copysign(handedness))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Wrap;

    /// A map that leans by 45 degrees to red and green.
    fn leaning(red: u8, green: u8) -> NormalMap {
        let texture = Texture::new(1, 1, vec![[red, green, 255]], [Wrap::Repeat; 2]).unwrap();
        NormalMap { texture: Arc::new(texture), scale: 1.0 }
    }

    /// A wall in the xy plane seen from +z, whose texture stands upright (v downwards), or is mirrored along u.
    fn tangent(mirrored: bool) -> Vec4 {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let sign = if mirrored { -1.0 } else { 1.0 };
        let uv = [Vec2::new(0.0, 1.0), Vec2::new(sign, 1.0), Vec2::new(0.0, 0.0)];
        TangentSpace::of_triangle(corners, uv, Vec3A::Z)
    }

    #[test]
    fn red_leans_to_growing_u_and_green_upwards() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        for (mirrored, side) in [(false, half), (true, -half)] {
            let right = leaning(255, 128).bend(Vec3A::Z, tangent(mirrored), Vec2::ZERO);
            // 128 represents 0.004.
            assert!((right - Vec3A::new(side, 0.0, half)).length() < 5e-3, "{mirrored}: {right}");
            let up = leaning(128, 255).bend(Vec3A::Z, tangent(mirrored), Vec2::ZERO);
            assert!((up - Vec3A::new(0.0, half, half)).length() < 5e-3, "{mirrored}: {up}");
        }
    }

    #[test]
    fn the_scale_flattens_and_degenerate_tangents_change_nothing() {
        let flat = NormalMap { scale: 0.0, ..leaning(255, 0) };
        assert_eq!(flat.bend(Vec3A::Z, tangent(false), Vec2::ZERO), Vec3A::Z);
        for tangent in [Vec4::ZERO, Vec4::new(0.0, 0.0, 2.0, 1.0)] {
            assert_eq!(leaning(255, 0).bend(Vec3A::Z, tangent, Vec2::ZERO), Vec3A::Z);
        }
        let same = [Vec2::ONE; 3];
        let none = TangentSpace::of_triangle([Vec3::ZERO, Vec3::X, Vec3::Y], same, Vec3A::Z);
        assert_eq!(none.truncate(), Vec3::ZERO);
    }
}
