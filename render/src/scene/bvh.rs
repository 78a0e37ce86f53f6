//! The bounding volume hierarchy over all triangles of a scene.
//!
//! `obvhs` builds a binary tree; rays traverse the eight-wide tree that is made from it ([`super::wide`]),
//! which is faster for single rays and for batches.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2_from_tris, rt_triangle::RtTriangle, triangle::Triangle};

use super::{
    ray::{Hit, Ray, RayKind},
    wide::{Question, Traversal, WideBvh},
};

/// A bounding volume hierarchy of triangles.
#[derive(Default)]
pub struct Bvh(WideBvh);

impl Bvh {
    /// Maximum number of triangles: with the parts of split ones, their number fits into the 31 bits that
    /// name a leaf.
    pub const MOST_TRIANGLES: usize = 1 << 26;

    /// Builds the hierarchy of at most [`Self::MOST_TRIANGLES`] finite triangles with area; the list may be
    /// empty.
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        if triangles.is_empty() {
            return Self(WideBvh::default());
        }
        let corners: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() }).collect();
        // Visiting a node costs as much as a block of eight triangles, so leaves should be full.
        let parameters = BvhBuildParams { collapse_traversal_cost: 8.0, ..BvhBuildParams::slow_build() };
        let tree = build_bvh2_from_tris(&corners, parameters, &mut Duration::default());
        // Large triangles are in several leaves.
        let entries: Vec<_> = tree.primitive_indices.iter().map(|&i| RtTriangle::from(&corners[i as usize])).collect();
        Self(WideBvh::new(&tree, &entries))
    }

    /// Returns the hierarchy with marks on the triangles, given by their index, whose back faces are invisible
    /// to cameras.
    pub(super) fn with_single_sided(mut self, is_single_sided: impl Fn(usize) -> bool) -> Self {
        self.0.set_single_sided(is_single_sided);
        self
    }

    /// Returns the nearest hit of a ray.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        let mut hit = [None];
        self.closest_batch(std::slice::from_ref(ray), &mut hit);
        hit[0]
    }

    /// Returns whether a ray hits anything.
    pub fn occluded(&self, origin: Vec3A, direction: Vec3A) -> bool {
        let mut occluded = [false];
        self.occluded_batch(&[Ray::new(origin, direction)], &mut occluded);
        occluded[0]
    }

    /// [`Self::closest`] for many rays; both slices have equal length.
    pub fn closest_batch(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        self.nearest(RayKind::Bounce, rays, hits);
    }

    /// [`Self::closest_batch`] for rays of a kind.
    pub(super) fn nearest(&self, kind: RayKind, rays: &[Ray], hits: &mut [Option<Hit>]) {
        Traversal { bvh: &self.0, rays, question: Question::Nearest(kind, hits) }.run();
    }

    /// [`Self::occluded`] for many rays; both slices have equal length.
    pub fn occluded_batch(&self, rays: &[Ray], occluded: &mut [bool]) {
        Traversal { bvh: &self.0, rays, question: Question::Occluded(occluded) }.run();
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::random::{Purpose, Stream};

    fn point(random: &mut Stream) -> Vec3 {
        Vec3::new(random.uniform(), random.uniform(), random.uniform()) * 2.0 - 1.0
    }

    /// Triangles of about `size` in the cube from -1 to 1.
    fn soup(count: usize, size: f32, random: &mut Stream) -> Vec<[Vec3; 3]> {
        (0..count)
            .map(|_| {
                let center = point(random);
                [0; 3].map(|_| center + size * point(random))
            })
            .collect()
    }

    /// The nearest hit in f64 over all triangles, each grown by `margin` in its barycentric coordinates.
    fn by_brute_force(triangles: &[[Vec3; 3]], ray: &Ray, margin: f64) -> Option<f64> {
        let (origin, direction) = (DVec3::from(Vec3::from(ray.origin)), DVec3::from(Vec3::from(ray.direction)));
        let hit = |corners: &[Vec3; 3]| {
            let [a, b, c] = corners.map(DVec3::from);
            let normal = (b - a).cross(c - a);
            let t = normal.dot(a - origin) / normal.dot(direction);
            let p = origin + t * direction;
            let area = |x: DVec3, y: DVec3| (x - p).cross(y - p).dot(normal) / normal.length_squared();
            let inside = area(b, c) >= -margin && area(c, a) >= -margin && area(a, b) >= -margin;
            (inside && t >= 0.0 && t.is_finite()).then_some(t)
        };
        triangles.iter().filter_map(hit).min_by(f64::total_cmp)
    }

    /// Compares with brute force, except for rays that pass an edge so closely that f32 may decide either
    /// way.
    fn assert_equals_brute_force(triangles: &[[Vec3; 3]], random: &mut Stream, rays: usize) {
        let bvh = Bvh::build(triangles);
        let mut decided = 0;
        for _ in 0..rays {
            let ray = Ray::new(1.5 * Vec3A::from(point(random)), random.direction());
            let grown = by_brute_force(triangles, &ray, 1e-3);
            if grown != by_brute_force(triangles, &ray, -1e-3) {
                continue;
            }
            decided += 1;
            let found = bvh.closest(&ray);
            assert_eq!(bvh.occluded(ray.origin, ray.direction), found.is_some());
            match (found, grown) {
                (None, None) => {}
                (Some(hit), Some(t)) => {
                    assert!((f64::from(hit.t) - t).abs() <= 1e-4 * (1.0 + t), "{hit:?} instead of {t}");
                    let [a, b, c] = triangles[hit.triangle].map(Vec3A::from);
                    let p = (1.0 - hit.u - hit.v) * a + hit.u * b + hit.v * c;
                    // Grazing rays move far along the plane for a rounding error across it.
                    assert!(
                        (p - ray.at(hit.t)).length() <= 1e-3 * (1.0 + hit.t),
                        "{hit:?}: {p} against {}",
                        ray.at(hit.t)
                    );
                }
                other => panic!("{ray:?}: {other:?}"),
            }
        }
        assert!(2 * decided > rays, "only {decided} of {rays} rays say anything");
    }

    #[test]
    fn random_triangles_agree_with_brute_force() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        for (count, size) in [(1, 1.0), (2, 1.0), (9, 0.8), (100, 0.4), (1000, 0.1)] {
            let triangles = soup(count, size, &mut random);
            assert_equals_brute_force(&triangles, &mut random, 2000);
        }
    }

    #[test]
    fn batches_agree_with_single_rays() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for (count, size) in [(1, 1.0), (9, 0.8), (1000, 0.1), (5000, 0.03)] {
            let bvh = Bvh::build(&soup(count, size, &mut random));
            let rays: Vec<Ray> = (0..200)
                .map(|k| {
                    // Along an axis, the inverse of the direction would be infinite.
                    let direction = if k % 5 == 0 { Vec3A::AXES[k % 3] } else { random.direction() };
                    Ray::new(1.2 * Vec3A::from(point(&mut random)), direction)
                })
                .collect();
            let (mut hits, mut occluded) = (vec![None; rays.len()], vec![false; rays.len()]);
            bvh.closest_batch(&rays, &mut hits);
            bvh.occluded_batch(&rays, &mut occluded);
            for ((ray, hit), occluded) in rays.iter().zip(hits).zip(occluded) {
                assert_eq!(hit, bvh.closest(ray));
                assert_eq!(occluded, hit.is_some());
            }
        }
    }

    #[test]
    fn packets_agree_with_single_rays() {
        let mut random = Stream::new(5, Purpose::Test, 0);
        let mut piled = soup(400, 0.2, &mut random);
        piled.extend(piled.clone());
        piled.iter_mut().skip(200).step_by(3).flatten().for_each(|p| p.x = 0.25);
        let bvh = Bvh::build(&piled);
        let mut found = 0;
        for tile in 0..40 {
            // Some tiles look along an axis: their rays go to different octants.
            let towards = if tile % 4 == 0 { Vec3A::AXES[tile / 4 % 3] } else { random.direction() };
            let origin = 0.3 * Vec3A::from(point(&mut random)) - 2.0 * towards;
            let rays: Vec<Ray> = (0..256)
                .map(|_| Ray::new(origin, (towards + 0.02 * Vec3A::from(point(&mut random))).normalize()))
                .collect();
            let mut hits = vec![None; rays.len()];
            bvh.closest_batch(&rays, &mut hits);
            for (ray, hit) in rays.iter().zip(hits) {
                assert_eq!(hit, bvh.closest(ray));
                found += usize::from(hit.is_some());
            }
        }
        assert!(found > 1000, "only {found} rays hit anything");
    }

    #[test]
    fn rays_along_the_axes_agree_with_brute_force() {
        let mut random = Stream::new(4, Purpose::Test, 0);
        let triangles = soup(300, 0.2, &mut random);
        let bvh = Bvh::build(&triangles);
        let mut hits = 0;
        for k in 0..3000 {
            let direction = if k % 2 == 0 { Vec3A::AXES[k % 3] } else { -Vec3A::AXES[k % 3] };
            let ray = Ray::new(1.5 * Vec3A::from(point(&mut random)), direction);
            let grown = by_brute_force(&triangles, &ray, 1e-3);
            if grown == by_brute_force(&triangles, &ray, -1e-3) {
                let found = bvh.closest(&ray).map(|hit| f64::from(hit.t));
                assert_eq!(found.is_some(), grown.is_some(), "{ray:?}");
                hits += usize::from(found.is_some());
                assert!(found.zip(grown).is_none_or(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b)));
            }
        }
        assert!(hits > 300, "only {hits} rays hit anything");
    }

    #[test]
    fn flat_and_piled_up_triangles_agree_with_brute_force() {
        let mut random = Stream::new(2, Purpose::Test, 0);
        let mut flat = soup(200, 0.3, &mut random);
        flat.iter_mut().flatten().for_each(|p| p.y = 0.25);
        assert_equals_brute_force(&flat, &mut random, 2000);
        let mut needles = soup(200, 1.0, &mut random);
        needles.iter_mut().for_each(|t| t[1] = t[0] + 0.05 * (t[1] - t[0]));
        assert_equals_brute_force(&needles, &mut random, 2000);
        let piled = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 500];
        assert_equals_brute_force(&piled, &mut random, 2000);
    }

    #[test]
    fn sizes_from_the_tiny_to_the_largest_coordinate_build_and_are_hit() {
        let triangles: Vec<[Vec3; 3]> = (0..400)
            .map(|i| {
                let size = 10.0_f32.powf(9.0 - 18.0 * i as f32 / 400.0);
                [Vec3::new(0.0, 0.0, size), Vec3::new(size, 0.0, size), Vec3::new(0.0, size, size)]
            })
            .collect();
        let bvh = Bvh::build(&triangles);
        let smallest = triangles[399][0].z;
        let hit = bvh.closest(&Ray::new(Vec3A::new(0.2, 0.2, 0.0) * smallest, Vec3A::Z)).unwrap();
        assert_eq!(hit.triangle, 399);
        let hit = bvh.closest(&Ray::new(Vec3A::new(2e8, 2e8, -1.0), Vec3A::Z)).unwrap();
        assert!((hit.t - triangles[hit.triangle][0].z).abs() <= 1e-5 * hit.t);
    }

    #[test]
    fn empty_hierarchies_have_no_hits() {
        let bvh = Bvh::build(&[]);
        assert_eq!(bvh.closest(&Ray::new(Vec3A::ZERO, Vec3A::X)), None);
        assert!(!bvh.occluded(Vec3A::ZERO, Vec3A::X));
    }
}
