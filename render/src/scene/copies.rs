//! Copies by reference: a hierarchy for each mesh in its own coordinates, and one over the boxes of all copies.
//!
//! Rays visit the copies whose boxes they enter from near to far. Rays of a batch that enter the same copy
//! next are transformed to its coordinates and traced together.

#[cfg(test)]
mod tests;

use std::{ops::Range, time::Duration};

use glam::Affine3A;
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, builder::build_bvh2},
};

use super::{Bounds, Bvh, Hit, Mesh, OFFSET, Ray, ray::RayKind};

/// A mesh that has copies.
struct Prototype {
    /// Index of the mesh in the scene.
    mesh: usize,
    /// Its triangles that have an area, in the order of the hierarchy.
    triangles: Vec<u32>,
    /// In the mesh's coordinates.
    bvh: Bvh,
}

/// One copy of a mesh.
pub(super) struct Copy {
    /// Index of the prototype.
    prototype: usize,
    pub to_world: Affine3A,
    to_mesh: Affine3A,
    /// The number of its first face.
    first: usize,
}

impl Copy {
    /// Transforms a ray to mesh coordinates, and returns the length there of a metre along it.
    fn localize(&self, ray: &Ray) -> (Ray, f32) {
        let direction = self.to_mesh.transform_vector3a(ray.direction);
        let length = direction.length();
        (Ray { origin: self.to_mesh.transform_point3a(ray.origin), direction: direction / length }, length)
    }
}

/// All copies of a scene that are opaque, or all that have alpha masks.
#[derive(Default)]
pub(super) struct Copies {
    prototypes: Vec<Prototype>,
    copies: Vec<Copy>,
    /// The boxes of copies, in world space.
    boxes: Vec<Aabb>,
    tree: Bvh2,
    faces: usize,
    /// Around all copies.
    bounds: Bounds,
}

/// Returns whether a transform can place copies of a mesh: rays are transformed by its inverse.
pub(super) fn is_placement(to_world: &Affine3A) -> bool {
    /// Smallest volume of the transformed unit cube, over that of a cube of its longest edge: flatter ones
    /// lose precision.
    const LEAST_VOLUME: f32 = 1e-4;
    let m = to_world.matrix3;
    let longest = [m.x_axis, m.y_axis, m.z_axis].into_iter().fold(0.0_f32, |longest, axis| longest.max(axis.length()));
    let volume = m.determinant().abs();
    to_world.is_finite() && (1e-6..1e6).contains(&longest) && volume > LEAST_VOLUME * longest.powi(3)
}

impl Copies {
    /// Builds the copies of `meshes`, each given with its index in the scene.
    pub fn build<'a>(meshes: impl Iterator<Item = (usize, &'a Mesh)>) -> Self {
        let mut copies = Self::default();
        for (index, mesh) in meshes {
            copies.add(index, mesh);
        }
        if !copies.boxes.is_empty() {
            let (parameters, mut time) = (BvhBuildParams::medium_build(), Duration::default());
            copies.tree = build_bvh2(&copies.boxes, parameters, &mut time);
        }
        copies
    }

    fn add(&mut self, index: usize, mesh: &Mesh) {
        let triangles: Vec<u32> =
            (0..mesh.triangles.len()).filter(|&t| !mesh.is_degenerate(t)).map(|t| t as u32).collect();
        if triangles.is_empty() {
            return;
        }
        let corners: Vec<_> = triangles.iter().map(|&t| mesh.corners(t as usize)).collect();
        for &to_world in &mesh.places {
            let mut bounds = Aabb::empty();
            for &corner in corners.as_flattened() {
                bounds.extend(to_world.transform_point3(corner).into());
            }
            [bounds.min, bounds.max].into_iter().for_each(|corner| self.bounds.extend(corner.into()));
            // Room for the rounding errors of transforming rays to the mesh, as in `Scene::surface`.
            let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
            bounds = Aabb::new(bounds.min - 2.0 * OFFSET * reach, bounds.max + 2.0 * OFFSET * reach);
            let prototype = self.prototypes.len();
            self.boxes.push(bounds);
            self.copies.push(Copy { prototype, to_world, to_mesh: to_world.inverse(), first: self.faces });
            self.faces += triangles.len();
        }
        // A ray meets the same side of a triangle in both coordinates, also where a copy mirrors.
        let bvh = Bvh::build(&corners).with_single_sided(|_| mesh.is_single_sided);
        self.prototypes.push(Prototype { mesh: index, bvh, triangles });
    }

    /// Returns the box around all copies.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Returns the number of faces of all copies.
    pub fn face_count(&self) -> usize {
        self.faces
    }

    /// Returns the mesh index and the triangle of a face, and its copy.
    pub fn face(&self, number: usize) -> (usize, usize, &Copy) {
        let copy = &self.copies[self.copies.partition_point(|copy| copy.first <= number) - 1];
        let prototype = &self.prototypes[copy.prototype];
        (prototype.mesh, prototype.triangles[number - copy.first] as usize, copy)
    }

    /// Replaces hits by nearer ones of copies, whose faces are numbered from `first`; both slices have equal length.
    pub fn add_hits(&self, kind: RayKind, rays: &[Ray], hits: &mut [Option<Hit>], first: usize) {
        self.visit(rays, &mut Nearest { kind, hits, first, found: Vec::new() });
    }

    /// Marks the rays that copies occlude; both slices have equal length.
    pub fn add_occlusion(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.visit(rays, &mut Occlusion { occluded, found: Vec::new() });
    }

    /// Traces each ray through the copies whose boxes it enters.
    fn visit(&self, rays: &[Ray], query: &mut impl Query) {
        if self.copies.is_empty() {
            return;
        }
        let mut entries = Vec::new();
        let mut open = Vec::new();
        for (ray, own) in rays.iter().enumerate() {
            let left = self.enter(own, query.limit(ray), &mut entries);
            if !left.is_empty() {
                open.push(Open { ray, left });
            }
        }
        let (mut next, mut local) = (Vec::new(), Vec::new());
        while !open.is_empty() {
            next.clear();
            open.retain_mut(|Open { ray, left }| {
                let Some(entry) = left.next().map(|i| entries[i]).filter(|entry| entry.distance < query.limit(*ray))
                else {
                    return false;
                };
                next.push((entry.copy, *ray));
                true
            });
            next.sort_unstable();
            for group in next.chunk_by(|a, b| a.0 == b.0) {
                let copy = &self.copies[group[0].0];
                local.clear();
                local.extend(group.iter().map(|&(_, ray)| (ray, copy.localize(&rays[ray]))));
                query.ask(&self.prototypes[copy.prototype].bvh, copy.first, &local);
            }
        }
    }

    /// Appends the copies whose boxes a ray enters before `limit`, from near to far.
    fn enter(&self, ray: &Ray, limit: f32, entries: &mut Vec<Entry>) -> Range<usize> {
        let first = entries.len();
        let own = obvhs::ray::Ray::new(ray.origin, ray.direction, 0.0, limit);
        self.tree.ray_traverse_anyhit(own, |own, place| {
            let copy = self.tree.primitive_indices[place] as usize;
            let distance = self.boxes[copy].intersect_ray(own);
            if distance < limit {
                entries.push(Entry { distance, copy });
            }
        });
        entries[first..].sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance).then(a.copy.cmp(&b.copy)));
        first..entries.len()
    }
}

/// A copy whose box a ray enters.
#[derive(Clone, Copy)]
struct Entry {
    /// In metres; negative where the ray starts inside.
    distance: f32,
    /// Index of the copy.
    copy: usize,
}

/// A ray and its entries still to be visited.
struct Open {
    ray: usize,
    left: Range<usize>,
}

/// A ray's index, the ray in mesh coordinates, and the length there of a metre along it.
type Local = (usize, (Ray, f32));

/// A query for nearest hits or occlusion.
trait Query {
    /// Returns the distance in metres beyond which a ray need not be traced.
    fn limit(&self, ray: usize) -> f32;

    /// Traces rays through the mesh of the copy whose first face has the number `first`.
    fn ask(&mut self, bvh: &Bvh, first: usize, rays: &[Local]);
}

struct Nearest<'a> {
    kind: RayKind,
    hits: &'a mut [Option<Hit>],
    /// The number of the first face of all copies.
    first: usize,
    found: Vec<Option<Hit>>,
}

impl Query for Nearest<'_> {
    fn limit(&self, ray: usize) -> f32 {
        self.hits[ray].map_or(f32::INFINITY, |hit| hit.t)
    }

    fn ask(&mut self, bvh: &Bvh, first: usize, rays: &[Local]) {
        let local: Vec<Ray> = rays.iter().map(|&(_, (ray, _))| ray).collect();
        self.found.clear();
        self.found.resize(rays.len(), None);
        bvh.nearest(self.kind, &local, &mut self.found);
        for (&(ray, (_, length)), found) in rays.iter().zip(&self.found) {
            let Some(found) = found else { continue };
            let hit = Hit { triangle: self.first + first + found.triangle, t: found.t / length, ..*found };
            if hit.t < self.limit(ray) {
                self.hits[ray] = Some(hit);
            }
        }
    }
}

struct Occlusion<'a> {
    occluded: &'a mut [bool],
    found: Vec<bool>,
}

impl Query for Occlusion<'_> {
    fn limit(&self, ray: usize) -> f32 {
        if self.occluded[ray] { f32::NEG_INFINITY } else { f32::INFINITY }
    }

    fn ask(&mut self, bvh: &Bvh, _: usize, rays: &[Local]) {
        let local: Vec<Ray> = rays.iter().map(|&(_, (ray, _))| ray).collect();
        self.found.clear();
        self.found.resize(rays.len(), false);
        bvh.occluded_batch(&local, &mut self.found);
        for (&(ray, _), &found) in rays.iter().zip(&self.found) {
            self.occluded[ray] |= found;
        }
    }
}
