//! The triangles that rays can hit, with their hierarchies.

use glam::{Affine3A, Vec2, Vec3, Vec3A, Vec4};

use super::{
    bvh::Bvh,
    copies::Copies,
    mesh::{Mesh, moved_tangent, normal_matrix},
    normal_map::TangentSpace,
    ray::{Bounds, Hit, Ray, RayKind},
};

/// Mesh and triangle of a triangle in the hierarchy.
#[derive(Clone, Copy, Debug)]
struct Placed {
    mesh: u32,
    triangle: u32,
    /// Unit normal on the side from which the corners are counter-clockwise.
    normal: Vec3,
}

/// The opaque triangles of a scene, or the masked ones: those of meshes in world space, then those of copies.
#[derive(Default)]
pub(super) struct Faces {
    placed: Vec<Placed>,
    bvh: Bvh,
    copies: Copies,
}

impl Faces {
    /// Collects the triangles with an area: those of meshes with a mask if `masked`, else those of the
    /// others.
    pub fn build(meshes: &[Mesh], masked: bool) -> Self {
        let of_kind = || meshes.iter().enumerate().filter(move |(_, mesh)| mesh.mask.is_some() == masked);
        let (mut placed, mut triangles) = (Vec::new(), Vec::new());
        for (m, mesh) in of_kind().filter(|(_, mesh)| mesh.places.is_empty()) {
            for t in (0..mesh.triangles.len()).filter(|&t| !mesh.is_degenerate(t)) {
                let corners = mesh.corners(t);
                triangles.push(corners);
                let [a, b, c] = corners.map(Vec3A::from);
                let normal = (b - a).cross(c - a).normalize().into();
                placed.push(Placed { mesh: m as u32, triangle: t as u32, normal });
            }
        }
        let copies = Copies::build(of_kind().filter(|(_, mesh)| !mesh.places.is_empty()));
        let bvh = Bvh::build(&triangles).with_single_sided(|t| meshes[placed[t].mesh as usize].is_single_sided);
        Self { placed, bvh, copies }
    }

    /// Returns the number of triangles.
    pub fn count(&self) -> usize {
        self.placed.len() + self.copies.face_count()
    }

    /// Returns the box around all faces; `meshes` are those of the scene.
    pub fn bounds(&self, meshes: &[Mesh]) -> Bounds {
        let mut bounds = self.copies.bounds();
        let placed = self.placed.iter().flat_map(|face| meshes[face.mesh as usize].corners(face.triangle as usize));
        placed.for_each(|corner| bounds.extend(corner));
        bounds
    }

    /// Finds the nearest hits of many rays; both slices have equal length.
    pub fn closest_batch(&self, kind: RayKind, rays: &[Ray], hits: &mut [Option<Hit>]) {
        self.bvh.nearest(kind, rays, hits);
        self.copies.add_hits(kind, rays, hits, self.placed.len());
    }

    /// Tests whether rays hit anything; both slices have equal length.
    pub fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.bvh.occluded_batch(rays, occluded);
        self.copies.add_occlusion(rays, occluded);
    }

    /// Returns a face by its number; `meshes` are those of the scene.
    pub(super) fn face<'a>(&'a self, meshes: &'a [Mesh], number: usize) -> Face<'a> {
        if let Some(&Placed { mesh, triangle, normal }) = self.placed.get(number) {
            let own = &meshes[mesh as usize];
            return Face {
                number: mesh as usize,
                mesh: own,
                triangle: triangle as usize,
                wound: normal.into(),
                to_world: None,
            };
        }
        let (number, triangle, copy) = self.copies.face(number - self.placed.len());
        let mesh = &meshes[number];
        let [a, b, c] = mesh.corners(triangle).map(Vec3A::from);
        let wound = (normal_matrix(&copy.to_world) * (b - a).cross(c - a).normalize()).normalize();
        Face { number, mesh, triangle, wound, to_world: Some(&copy.to_world) }
    }
}

/// A triangle that rays can hit, in world space.
pub(super) struct Face<'a> {
    /// Index of its mesh.
    pub number: usize,
    pub mesh: &'a Mesh,
    /// Index of the triangle in its mesh.
    pub triangle: usize,
    /// Unit normal on the side from which the corners are counter-clockwise, before a copy mirrors them.
    pub wound: Vec3A,
    /// Transform of a copy; `None` for meshes in world space.
    to_world: Option<&'a Affine3A>,
}

impl Face<'_> {
    pub fn vertices(&self) -> [usize; 3] {
        self.mesh.triangles[self.triangle].map(|i| i as usize)
    }

    /// Returns the positions of the corners in metres.
    pub fn corners(&self) -> [Vec3; 3] {
        let corners = self.mesh.corners(self.triangle);
        self.to_world.map_or(corners, |to_world| corners.map(|corner| to_world.transform_point3(corner)))
    }

    /// Returns whether it belongs to a copy.
    pub fn is_copied(&self) -> bool {
        self.to_world.is_some()
    }

    /// Returns whether it belongs to a copy that mirrors its mesh: its corners are clockwise as seen from outside.
    pub fn is_mirrored(&self) -> bool {
        self.to_world.is_some_and(|to_world| to_world.matrix3.as_dmat3().determinant() < 0.0)
    }

    /// Returns the shading normals of the corners, of unit length or 0; `None` for flat shading.
    pub fn normals(&self) -> Option<[Vec3A; 3]> {
        let normals = &self.mesh.normals;
        let normal = |vertex: usize| {
            let own = Vec3A::from(normals[vertex]);
            // As in world-space meshes, normals have unit length before they are interpolated.
            self.to_world.map_or(own, |to_world| (normal_matrix(to_world) * own).normalize_or_zero())
        };
        (!normals.is_empty()).then(|| self.vertices().map(normal))
    }

    /// Returns the shading normal at barycentric `weights`, of any length; `None` for flat shading.
    pub fn smooth_normal(&self, weights: [f32; 3]) -> Option<Vec3A> {
        self.normals().map(|normals| (0..3).map(|k| weights[k] * normals[k]).sum())
    }

    /// Returns the tangent for a normal map, with the handedness of the bitangent in `w`.
    pub fn tangent(&self, space: &TangentSpace, uv: [Vec2; 3], weights: [f32; 3], normal: Vec3A) -> Vec4 {
        match self.tangents(space) {
            Some(tangents) => (0..3).map(|k| weights[k] * tangents[k]).sum(),
            None => TangentSpace::of_triangle(self.corners(), uv, normal),
        }
    }

    /// Returns the tangents of the corners, with the handedness of the bitangent in `w`; `None` if the file has none.
    pub fn tangents(&self, space: &TangentSpace) -> Option<[Vec4; 3]> {
        let tangent = |vertex: usize| {
            let own = space.tangents[vertex];
            self.to_world.map_or(own, |to_world| moved_tangent(own, to_world))
        };
        (!space.tangents.is_empty()).then(|| self.vertices().map(tangent))
    }
}
