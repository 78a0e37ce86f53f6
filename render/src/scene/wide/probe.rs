//! Tests of a ray against the boxes of a node and the triangles of a block.

use glam::Vec3A;

use super::{
    lanes::Eight,
    tree::{Block, Node},
};
use crate::scene::ray::Ray;

/// Factor on exit distances. Distances to the planes of a box are off by at most three roundings each (6e-8);
/// exits are moved out by more than both errors, so that rounding never hides a box (Ize 2013, "Robust BVH
/// Ray Traversal").
pub const OUTWARD: f32 = 1.0 + 4.0 * f32::EPSILON;

/// Smallest magnitude of a direction's component that is not replaced.
pub const LEAST: f32 = f32::EPSILON;

/// A ray with the precomputed values of its tests.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Probe {
    origin: [f32; 3],
    direction: [f32; 3],
    inverse: [f32; 3],
    /// The octant that the ray goes to: a bit for each axis, set where the direction is negative.
    pub octant: u32,
}

impl Probe {
    /// Precomputes the values of a ray.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let Ray { origin, direction } = *ray;
        // The inverse of a zero component is a large number, not infinity: 0 times infinity is NaN.
        let inverse = direction.abs().max(Vec3A::splat(LEAST)).recip().copysign(direction);
        let octant = direction.is_negative_bitmask();
        Self { origin: origin.into(), direction: direction.into(), inverse: inverse.into(), octant }
    }

    /// Returns the distances at which the ray enters and leaves the boxes of a node; it misses a box that it
    /// leaves first.
    ///
    /// A box within another is never entered earlier or left later than the outer one, because rounding is
    /// monotonic.
    #[inline(always)]
    pub fn cross<E: Eight>(&self, simd: E, node: &Node) -> (E::Floats, E::Floats) {
        let (x, y, z) = (self.planes(simd, node, 0), self.planes(simd, node, 1), self.planes(simd, node, 2));
        // NaN propagates from the right operand.
        let enters = simd.max(x.0, simd.max(y.0, simd.max(simd.splat(0.0), z.0)));
        let leaves = simd.min(x.1, simd.min(y.1, z.1));
        (enters, simd.mul(leaves, simd.splat(OUTWARD)))
    }

    /// Returns the distances of the boxes' planes across an axis: the nearer ones, then the farther ones.
    #[inline(always)]
    fn planes<E: Eight>(&self, simd: E, node: &Node, axis: usize) -> (E::Floats, E::Floats) {
        let (origin, inverse) = (simd.splat(self.origin[axis]), simd.splat(self.inverse[axis]));
        let low = simd.mul(simd.sub(simd.load(&node.rows[2 * axis]), origin), inverse);
        let high = simd.mul(simd.sub(simd.load(&node.rows[2 * axis + 1]), origin), inverse);
        (simd.min(low, high), simd.max(low, high))
    }

    /// Returns the distances of a block's triangles along the ray, their barycentric weights, the sign of each
    /// that the ray meets, and the sign of each whose back the ray goes towards.
    #[inline(always)]
    pub fn meet<E: Eight>(&self, simd: E, block: &Block) -> ([E::Floats; 3], E::Floats, E::Floats) {
        meet(
            simd,
            vectors(simd, block, 0),
            vectors(simd, block, 3),
            vectors(simd, block, 6),
            vectors(simd, block, 9),
            [simd.splat(self.origin[0]), simd.splat(self.origin[1]), simd.splat(self.origin[2])],
            [simd.splat(self.direction[0]), simd.splat(self.direction[1]), simd.splat(self.direction[2])],
        )
    }
}

/// Returns the distances of triangles along rays, their barycentric weights, the sign of each that is met,
/// and the sign of each whose corners are clockwise along the ray. A triangle is given as a corner, two edges
/// and their cross product, and a ray as its origin and direction.
#[inline(always)]
pub fn meet<E: Eight>(
    simd: E,
    corner: [E::Floats; 3],
    first: [E::Floats; 3],
    second: [E::Floats; 3],
    normal: [E::Floats; 3],
    o: [E::Floats; 3],
    d: [E::Floats; 3],
) -> ([E::Floats; 3], E::Floats, E::Floats) {
    let c = [simd.sub(corner[0], o[0]), simd.sub(corner[1], o[1]), simd.sub(corner[2], o[2])];
    let r = [
        simd.sub(simd.mul(d[1], c[2]), simd.mul(d[2], c[1])),
        simd.sub(simd.mul(d[2], c[0]), simd.mul(d[0], c[2])),
        simd.sub(simd.mul(d[0], c[1]), simd.mul(d[1], c[0])),
    ];
    let one = simd.splat(1.0);
    let inverse = simd.div(one, dot(simd, normal, d));
    let u = simd.mul(dot(simd, second, r), inverse);
    let v = simd.mul(dot(simd, first, r), inverse);
    let t = simd.mul(dot(simd, normal, c), inverse);
    let w = simd.sub(simd.sub(one, u), v);
    // For a ray in a triangle's plane, w is NaN or negative; it comes last, so that the minimum is NaN, too.
    let least = simd.min(simd.min(simd.min(u, v), t), w);
    // The cross product of these edges is opposite to the normal on the front.
    ([t, u, v], simd.at_most(simd.splat(0.0), least), inverse)
}

/// Loads eight vectors of a block: x from `row`, y and z from the next two.
#[inline(always)]
fn vectors<E: Eight>(simd: E, block: &Block, row: usize) -> [E::Floats; 3] {
    [simd.load(&block.rows[row]), simd.load(&block.rows[row + 1]), simd.load(&block.rows[row + 2])]
}

#[inline(always)]
fn dot<E: Eight>(simd: E, a: [E::Floats; 3], b: [E::Floats; 3]) -> E::Floats {
    simd.add(simd.add(simd.mul(a[0], b[0]), simd.mul(a[1], b[1])), simd.mul(a[2], b[2]))
}
