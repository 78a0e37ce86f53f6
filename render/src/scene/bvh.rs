//! The bounding volume hierarchy over all triangles of a scene.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::{
    BvhBuildParams,
    bvh2::{Bvh2, builder::build_bvh2_from_tris},
    ray::{Ray as BvhRay, RayHit},
    rt_triangle::RtTriangle,
    triangle::Triangle,
};

use super::ray::Ray;

/// The nearest intersection along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle, in the order given to [`Bvh::build`].
    pub triangle: usize,
    /// Distance in metres.
    pub t: f32,
    /// Barycentric weight of the triangle's second corner.
    pub u: f32,
    /// Barycentric weight of the triangle's third corner.
    pub v: f32,
}

/// A bounding volume hierarchy of triangles.
pub struct Bvh {
    tree: Bvh2,
    /// Triangles in the order of the leaves (large ones are in several leaves).
    triangles: Vec<RtTriangle>,
}

impl Bvh {
    /// Builds the hierarchy of finite triangles with area; none at all is allowed.
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        if triangles.is_empty() {
            return Self { tree: Bvh2::default(), triangles: Vec::new() };
        }
        let corners: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() }).collect();
        let mut tree = build_bvh2_from_tris(&corners, BvhBuildParams::slow_build(), &mut Duration::default());
        // The builder sizes the traversal stack before it moves nodes, which can make the tree deeper.
        tree.max_depth = tree.max_depth.max(tree.depth(0) + 1);
        let triangles = tree.primitive_indices.iter().map(|&i| RtTriangle::from(&corners[i as usize])).collect();
        Self { tree, triangles }
    }

    /// The nearest triangle that the ray hits.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        let ray = BvhRay::new_inf(ray.origin, ray.direction);
        let mut nearest = RayHit::none();
        let hit = self.tree.ray_traverse(ray, &mut nearest, |ray, i| self.triangles[i].intersect(ray));
        hit.then(|| {
            let leaf = nearest.primitive_id as usize;
            let weights = self.triangles[leaf].compute_barycentric(&ray);
            let triangle = self.tree.primitive_indices[leaf] as usize;
            Hit { triangle, t: nearest.t, u: weights.x, v: weights.y }
        })
    }

    /// Whether the ray hits anything.
    pub fn occluded(&self, origin: Vec3A, direction: Vec3A) -> bool {
        let ray = BvhRay::new_inf(origin, direction);
        !self.tree.ray_traverse_miss(ray, |ray, i| self.triangles[i].intersect(ray))
    }
}
