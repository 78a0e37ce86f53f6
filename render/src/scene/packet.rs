//! Rays in packets: several go down the hierarchy together, one in each SIMD lane.
//!
//! A node is visited when any ray of the packet enters it. The arithmetic of each ray is that of the library's own traversal, one
//! operation after the other, so a ray finds the same triangle at the same distance whatever company it is in.

use obvhs::{
    bvh2::{Bvh2, node::Bvh2Node},
    ray::safe_inverse,
    rt_triangle::RtTriangle,
};

use super::ray::Ray;
use crate::simd::{Simd, Vectorized};

/// Rays in a packet: one AVX2 register of each coordinate. With 16, what rays do not share costs more than what they do saves.
pub(super) const RAYS: usize = 8;

/// A number for each ray.
type Lanes = [f32; RAYS];

/// What a lane holds that has hit nothing.
pub(super) const MISS: u32 = u32::MAX;

/// One component of a vector for each ray.
type Coordinates = [Lanes; 3];

/// At most [`RAYS`] rays and their nearest hits so far.
pub(super) struct Packet {
    origin: Coordinates,
    direction: Coordinates,
    inverse_direction: Coordinates,
    /// Distances to the nearest hits; less than 0 in lanes that look for nothing any more.
    pub t: Lanes,
    /// Which leaf entry was hit, or [`MISS`].
    pub entry: [u32; RAYS],
}

impl Packet {
    /// A packet of rays without hits.
    ///
    /// # Panics
    /// When there are more than [`RAYS`].
    pub fn new(rays: &[Ray]) -> Self {
        let zero = [[0.0; RAYS]; 3];
        let (t, entry) = ([-1.0; RAYS], [MISS; RAYS]);
        let mut packet = Self { origin: zero, direction: zero, inverse_direction: [[1.0; RAYS]; 3], t, entry };
        for (k, ray) in rays.iter().enumerate() {
            for axis in 0..3 {
                packet.origin[axis][k] = ray.origin[axis];
                packet.direction[axis][k] = ray.direction[axis];
                packet.inverse_direction[axis][k] = safe_inverse(ray.direction[axis]);
            }
            packet.t[k] = f32::INFINITY;
        }
        packet
    }

    /// The least distance at which a ray that still looks for hits enters the box of a node; infinity when none does.
    #[inline(always)]
    fn entry_distance(&self, node: &Bvh2Node) -> f32 {
        let (min, max) = (node.aabb().min, node.aabb().max);
        let mut nearest = [f32::INFINITY; RAYS];
        for k in 0..RAYS {
            let (x_in, x_out) = slab(min.x, max.x, self.origin[0][k], self.inverse_direction[0][k]);
            let (y_in, y_out) = slab(min.y, max.y, self.origin[1][k], self.inverse_direction[1][k]);
            let (z_in, z_out) = slab(min.z, max.z, self.origin[2][k], self.inverse_direction[2][k]);
            let enters = greatest(greatest(x_in, y_in), greatest(z_in, 0.0));
            let leaves = least(least(x_out, y_out), least(z_out, self.t[k]));
            nearest[k] = if enters <= leaves { enters } else { f32::INFINITY };
        }
        minimum(&nearest)
    }

    /// Moves hits nearer where a ray hits the triangle of a leaf entry; whether any does.
    #[inline(always)]
    fn intersect(&mut self, triangle: &RtTriangle, entry: u32) -> bool {
        let mut nearer = [0.0; RAYS];
        let RtTriangle { v0, e1, e2, ng } = *triangle;
        for k in 0..RAYS {
            let [d_x, d_y, d_z] = [self.direction[0][k], self.direction[1][k], self.direction[2][k]];
            let [c_x, c_y, c_z] = [v0.x - self.origin[0][k], v0.y - self.origin[1][k], v0.z - self.origin[2][k]];
            let [r_x, r_y, r_z] = [d_y * c_z - d_z * c_y, d_z * c_x - d_x * c_z, d_x * c_y - d_y * c_x];
            let inverse = 1.0 / (ng.x * d_x + ng.y * d_y + ng.z * d_z);
            let u = (r_x * e2.x + r_y * e2.y + r_z * e2.z) * inverse;
            let v = (r_x * e1.x + r_y * e1.y + r_z * e1.z) * inverse;
            let w = 1.0 - u - v;
            let t = (ng.x * c_x + ng.y * c_y + ng.z * c_z) * inverse;
            let inside = ((u.to_bits() | v.to_bits() | w.to_bits()) as i32) >= 0;
            let hit = inside & (t >= 0.0) & (t < self.t[k]);
            nearer[k] = if hit { t } else { f32::INFINITY };
        }
        if minimum(&nearer) == f32::INFINITY {
            return false;
        }
        for k in 0..RAYS {
            self.entry[k] = if nearer[k] < self.t[k] { entry } else { self.entry[k] };
            self.t[k] = least(self.t[k], nearer[k]);
        }
        true
    }

    /// Ends the search of rays that have hit something; whether any goes on.
    #[inline(always)]
    fn retire(&mut self) -> bool {
        let mut farthest = [0.0_f32; RAYS];
        for k in 0..RAYS {
            self.t[k] = if self.entry[k] == MISS { self.t[k] } else { -1.0 };
            farthest[k] = -self.t[k];
        }
        minimum(&farthest) < 0.0
    }
}

/// The distances at which a ray enters and leaves the space between two planes across an axis.
#[inline(always)]
fn slab(min: f32, max: f32, origin: f32, inverse_direction: f32) -> (f32, f32) {
    let (low, high) = ((min - origin) * inverse_direction, (max - origin) * inverse_direction);
    (least(low, high), greatest(low, high))
}

/// The smaller of two numbers, as processors have it: no branch.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The greater of two numbers.
#[inline(always)]
fn greatest(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The least of all lanes.
#[inline(always)]
fn minimum(lanes: &Lanes) -> f32 {
    let mut half = *lanes;
    let mut width = RAYS / 2;
    while width > 0 {
        for k in 0..width {
            half[k] = least(half[k], half[k + width]);
        }
        width /= 2;
    }
    half[0]
}

/// A packet on its way through a hierarchy.
pub(super) struct Traversal<'a> {
    pub tree: &'a Bvh2,
    /// Triangles in the order of the leaves.
    pub triangles: &'a [RtTriangle],
    pub packet: &'a mut Packet,
    /// Nodes to visit; empty before and after.
    pub stack: &'a mut Vec<u32>,
    /// Whether any hit will do, instead of the nearest.
    pub any: bool,
}

impl Vectorized for Traversal<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { tree, triangles, packet, stack, any } = self;
        let Some(root) = tree.nodes.first() else { return };
        if packet.entry_distance(root) == f32::INFINITY {
            return;
        }
        if root.is_leaf() {
            for entry in root.first_index..root.first_index + root.prim_count {
                packet.intersect(&triangles[entry as usize], entry);
            }
            return;
        }
        let mut pair = root.first_index as usize;
        loop {
            let [mut near, mut far] = [&tree.nodes[pair], &tree.nodes[pair + 1]];
            let (mut near_t, mut far_t) = (packet.entry_distance(near), packet.entry_distance(far));
            if near_t > far_t {
                (near, far, near_t, far_t) = (far, near, far_t, near_t);
            }
            let mut next = None;
            for (node, t) in [(far, far_t), (near, near_t)] {
                if t == f32::INFINITY || node.is_leaf() {
                    continue;
                }
                if let Some(later) = next.replace(node.first_index) {
                    stack.push(later);
                }
            }
            for (node, t) in [(near, near_t), (far, far_t)] {
                if t == f32::INFINITY || !node.is_leaf() {
                    continue;
                }
                let mut hit = false;
                for entry in node.first_index..node.first_index + node.prim_count {
                    hit |= packet.intersect(&triangles[entry as usize], entry);
                }
                if any && hit && !packet.retire() {
                    stack.clear();
                    return;
                }
            }
            let Some(index) = next.or_else(|| stack.pop()) else { return };
            pair = index as usize;
        }
    }
}
