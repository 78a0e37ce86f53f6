//! A ray against the boxes of a node and the triangles of a block.

use glam::Vec3A;

use super::{Block, Node, lanes::Eight};
use crate::scene::ray::Ray;

/// Distances to the planes of a box are off by at most three roundings each (6e-8); the far ones are moved out by more than those of
/// both, so that rounding never hides a box (Ize 2013, "Robust BVH Ray Traversal").
pub const OUTWARD: f32 = 1.0 + 4.0 * f32::EPSILON;

/// The least extent of a direction along an axis that is taken as it is.
pub const LEAST: f32 = f32::EPSILON;

/// A ray with what its tests need.
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
    /// The ray's numbers.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let Ray { origin, direction } = *ray;
        // Where a direction has no extent along an axis, a large number stands for infinity: 0 times infinity is not a number.
        let inverse = direction.abs().max(Vec3A::splat(LEAST)).recip().copysign(direction);
        let octant = direction.is_negative_bitmask();
        Self { origin: origin.into(), direction: direction.into(), inverse: inverse.into(), octant }
    }

    /// The distances at which the ray enters the boxes of a node and leaves them; it misses a box that it leaves first.
    ///
    /// A box within another is never entered earlier or left later than that, as rounding keeps order.
    #[inline(always)]
    pub fn cross<E: Eight>(&self, simd: E, node: &Node) -> (E::Floats, E::Floats) {
        let (x, y, z) = (self.planes(simd, node, 0), self.planes(simd, node, 1), self.planes(simd, node, 2));
        // What is not a number goes through from the right.
        let enters = simd.max(x.0, simd.max(y.0, simd.max(simd.splat(0.0), z.0)));
        let leaves = simd.min(x.1, simd.min(y.1, z.1));
        (enters, simd.mul(leaves, simd.splat(OUTWARD)))
    }

    /// The distances of the boxes' planes across an axis: those that are met first, and last.
    #[inline(always)]
    fn planes<E: Eight>(&self, simd: E, node: &Node, axis: usize) -> (E::Floats, E::Floats) {
        let (origin, inverse) = (simd.splat(self.origin[axis]), simd.splat(self.inverse[axis]));
        let low = simd.mul(simd.sub(simd.load(&node.rows[2 * axis]), origin), inverse);
        let high = simd.mul(simd.sub(simd.load(&node.rows[2 * axis + 1]), origin), inverse);
        (simd.min(low, high), simd.max(low, high))
    }

    /// The distances of a block's triangles along the ray, their barycentric weights, and the sign of each that the ray meets.
    #[inline(always)]
    pub fn meet<E: Eight>(&self, simd: E, block: &Block) -> ([E::Floats; 3], E::Floats) {
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

/// The distances of triangles along rays, their barycentric weights, and the sign of each that is met. A triangle is given as
/// a corner, two edges and their product, and a ray as its origin and direction.
#[inline(always)]
pub fn meet<E: Eight>(
    simd: E,
    corner: [E::Floats; 3],
    first: [E::Floats; 3],
    second: [E::Floats; 3],
    normal: [E::Floats; 3],
    o: [E::Floats; 3],
    d: [E::Floats; 3],
) -> ([E::Floats; 3], E::Floats) {
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
    // In the plane of a triangle, w is not a number or below zero; it comes last, so that the least is not a number either.
    let least = simd.min(simd.min(simd.min(u, v), t), w);
    ([t, u, v], simd.at_most(simd.splat(0.0), least))
}

/// Eight vectors of a block, whose x are in a row and y and z in the next.
#[inline(always)]
fn vectors<E: Eight>(simd: E, block: &Block, row: usize) -> [E::Floats; 3] {
    [simd.load(&block.rows[row]), simd.load(&block.rows[row + 1]), simd.load(&block.rows[row + 2])]
}

/// Dot products.
#[inline(always)]
fn dot<E: Eight>(simd: E, a: [E::Floats; 3], b: [E::Floats; 3]) -> E::Floats {
    simd.add(simd.add(simd.mul(a[0], b[0]), simd.mul(a[1], b[1])), simd.mul(a[2], b[2]))
}
