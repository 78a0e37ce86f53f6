//! The ground plane that catches a scene's shadows.

use glam::{Vec3, Vec3A};

use super::{Camera, Material, Mesh, Scene};

/// Width of the ground over the larger horizontal extent of the scene.
const WIDTH: f32 = 20.0;

/// Reflectance of the ground.
const ALBEDO: f32 = 0.5;

impl Scene {
    /// Adds a grey diffuse ground (albedo 0.5), 20 times as wide as the scene, at its lowest point.
    ///
    /// A scene without a camera gets the one that frames it without the ground. An empty scene gets a ground of 20 m.
    pub fn add_ground(&mut self) {
        let bounds = self.bounds();
        self.camera.get_or_insert_with(|| Camera::framing(&bounds));
        let (center, y) = if bounds.is_empty() { (Vec3A::ZERO, 0.0) } else { (bounds.center(), bounds.min.y) };
        let extent = bounds.extent();
        let width = extent.x.max(extent.z).max(extent.y);
        let half = 0.5 * WIDTH * if width > 0.0 { width } else { 1.0 };

        let corner = |x: f32, z: f32| Vec3::new(center.x + x * half, y, center.z + z * half);
        self.meshes.push(Mesh {
            positions: vec![corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: self.materials.len(),
            ..Mesh::default()
        });
        self.materials.push(Material::diffuse(Vec3A::splat(ALBEDO)));
        self.rebuild();
    }
}
