//! The ground plane that catches a scene's shadows.

use glam::{Vec3, Vec3A};

use super::{MAX_COORDINATE, Material, Mesh, Scene};

/// Minimum half width of the ground over the longest edge of the scene's bounds: seen from the height of the
/// scene, its border is 8e-6 radians below the horizon, 20 % of a pixel of the largest images.
const REACH: f32 = 1.2e5;

/// Width of a ring over that of the square inside it. Positions on a triangle are as exact as its corners'
/// coordinates, so triangles are small near the scene.
const GROWTH: f32 = 2.0;

/// Reflectance of the ground.
const ALBEDO: f32 = 0.5;

impl Scene {
    /// Adds a grey diffuse ground (albedo 0.5) at the scene's lowest point, from horizon to horizon. Cameras frame the
    /// scene without it.
    pub fn add_ground(&mut self) {
        let bounds = self.bounds();
        let (center, y) = if bounds.is_empty() { (Vec3A::ZERO, 0.0) } else { (bounds.center(), bounds.min.y) };
        let width = bounds.extent().max_element();
        let width = if width > 0.0 { width } else { 1.0 };
        let reach = (REACH * width).min(0.25 * MAX_COORDINATE);

        let square = |half: f32| {
            let corner = |x: f32, z: f32| Vec3::new(center.x + x * half, y, center.z + z * half);
            [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)]
        };
        let mut positions = Vec::from(square(width));
        let mut triangles = vec![[0, 1, 2], [0, 2, 3]];
        let mut half = width;
        while half < reach {
            half *= GROWTH;
            let inner = positions.len() as u32 - 4;
            positions.extend(square(half));
            for side in 0..4 {
                let (a, b) = (inner + side, inner + (side + 1) % 4);
                triangles.extend([[a + 4, b + 4, b], [a + 4, b, a]]);
            }
        }
        let material = self.materials.len();
        self.meshes.push(Mesh { positions, triangles, material, is_ground: true, ..Mesh::default() });
        self.materials.push(Material::diffuse(Vec3A::splat(ALBEDO)));
        self.rebuild();
    }
}
