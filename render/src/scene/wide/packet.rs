//! Packets of eight nearly parallel rays, such as those of a camera, that traverse the hierarchy as one.
//!
//! A node's boxes are tested, side by side, against the whole span of the rays; only at the leaves is each
//! ray tested, the rays side by side. No box that a ray of the packet enters is ever skipped, because
//! rounding is monotonic. So each ray finds the same hit as alone.

use super::{
    lanes::{Eight, Lanes},
    probe::{LEAST, OUTWARD, meet},
    tree::{Block, Child, Node, ROOT, WIDTH, WideBvh},
};
use crate::scene::ray::{Hit, Ray};

/// Maximum difference of a packet's directions along an axis.
const SPREAD: f32 = 0.1;

/// Reusable memory.
#[derive(Default)]
pub struct Scratch {
    children: Vec<u32>,
    enters: Vec<u32>,
}

/// Rays side by side, and the nearest hit of each so far.
pub struct Packet<E: Eight> {
    origin: [E::Floats; 3],
    direction: [E::Floats; 3],
    inverse: [E::Floats; 3],
    /// For each axis, which of a box's planes is met first.
    near: [u32; 3],
    /// For each axis, the origins that are farthest ahead and farthest behind.
    ahead: [f32; 3],
    behind: [f32; 3],
    /// For each axis, the least and the greatest inverse direction.
    least: [f32; 3],
    greatest: [f32; 3],
    t: E::Floats,
    u: E::Floats,
    v: E::Floats,
    triangle: E::Floats,
}

/// The smallest and the largest of eight numbers.
#[inline(always)]
fn range(numbers: &Lanes) -> (f32, f32) {
    let (mut least, mut greatest) = (numbers[0], numbers[0]);
    for &x in numbers {
        least = if x < least { x } else { least };
        greatest = if x > greatest { x } else { greatest };
    }
    (least, greatest)
}

impl<E: Eight> Packet<E> {
    /// Creates a packet of eight rays, if they share an octant and differ by less than [`SPREAD`].
    #[inline(always)]
    pub fn new(simd: E, rays: &[Ray; WIDTH]) -> Option<Self> {
        let (mut origins, mut directions) = ([[0.0; WIDTH]; 3], [[0.0; WIDTH]; 3]);
        for (k, ray) in rays.iter().enumerate() {
            for axis in 0..3 {
                origins[axis][k] = ray.origin[axis];
                directions[axis][k] = ray.direction[axis];
            }
        }
        let zero = simd.splat(0.0);
        let mut packet = Self {
            origin: [zero; 3],
            direction: [zero; 3],
            inverse: [zero; 3],
            near: [0; 3],
            ahead: [0.0; 3],
            behind: [0.0; 3],
            least: [0.0; 3],
            greatest: [0.0; 3],
            t: simd.splat(f32::INFINITY),
            u: zero,
            v: zero,
            triangle: simd.splat(f32::from_bits(u32::MAX)),
        };
        for axis in 0..3 {
            let (origin, direction) = (&origins[axis], &directions[axis]);
            let (o, d) = (simd.load(&bytemuck::cast(*origin)), simd.load(&bytemuck::cast(*direction)));
            let signs = simd.signs(d);
            let (least, greatest) = range(direction);
            let together = (signs == 0 || signs == 0xff) && greatest - least < SPREAD;
            if !together {
                return None;
            }
            let inverse = simd.with_signs(simd.div(simd.splat(1.0), simd.max(simd.abs(d), simd.splat(LEAST))), d);
            (packet.least[axis], packet.greatest[axis]) = range(&bytemuck::cast(simd.store(inverse)));
            let (first, last) = range(origin);
            let negative = signs != 0;
            (packet.behind[axis], packet.ahead[axis]) = if negative { (last, first) } else { (first, last) };
            packet.near[axis] = 2 * axis as u32 + u32::from(negative);
            (packet.origin[axis], packet.direction[axis], packet.inverse[axis]) = (o, d, inverse);
        }
        Some(packet)
    }

    /// The octant that the rays go to.
    #[inline(always)]
    fn octant(&self) -> usize {
        let [x, y, z] = self.near;
        (x | (y & 1) << 1 | (z & 1) << 2) as usize
    }

    /// Returns lower bounds of the distances at which rays enter the boxes of a node, and the sign of each
    /// box that some ray may enter at up to `limit`.
    #[inline(always)]
    fn enter(&self, simd: E, node: &Node, limit: f32) -> (E::Floats, E::Floats) {
        let (mut enters, mut leaves) = (simd.splat(0.0), simd.splat(f32::INFINITY));
        for axis in 0..3 {
            let (least, greatest) = (simd.splat(self.least[axis]), simd.splat(self.greatest[axis]));
            let near = simd.load(&node.rows[self.near[axis] as usize % 8]);
            let way = simd.sub(near, simd.splat(self.ahead[axis]));
            enters = simd.max(enters, simd.min(simd.mul(way, least), simd.mul(way, greatest)));
            let far = simd.load(&node.rows[(self.near[axis] as usize % 8) ^ 1]);
            let way = simd.sub(far, simd.splat(self.behind[axis]));
            leaves = simd.min(leaves, simd.max(simd.mul(way, least), simd.mul(way, greatest)));
        }
        let leaves = simd.min(simd.mul(leaves, simd.splat(OUTWARD)), simd.splat(limit));
        (enters, simd.at_most(enters, leaves))
    }

    /// Looks for nearer hits among the triangles of a leaf; if it `culls`, without the back faces of
    /// single-sided triangles.
    #[inline(always)]
    fn visit(&mut self, simd: E, block: &Block, culls: bool) {
        let planes = &block.rows[13];
        let (mut enters, mut leaves) = (simd.splat(0.0), simd.splat(f32::INFINITY));
        for axis in 0..3 {
            let near = simd.splat(f32::from_bits(planes[self.near[axis] as usize % 8]));
            enters = simd.max(simd.mul(simd.sub(near, self.origin[axis]), self.inverse[axis]), enters);
            let far = simd.splat(f32::from_bits(planes[(self.near[axis] as usize % 8) ^ 1]));
            leaves = simd.min(simd.mul(simd.sub(far, self.origin[axis]), self.inverse[axis]), leaves);
        }
        let leaves = simd.min(simd.mul(leaves, simd.splat(OUTWARD)), self.t);
        let inside = simd.at_most(enters, leaves);
        if simd.signs(inside) == 0 {
            return;
        }
        for k in 0..block.rows[13][6] as usize {
            let ([t, u, v], mut met, back) = meet(
                simd,
                corner(simd, block, 0, k),
                corner(simd, block, 3, k),
                corner(simd, block, 6, k),
                corner(simd, block, 9, k),
                self.origin,
                self.direction,
            );
            if culls && block.single_sided() >> k & 1 == 1 {
                met = simd.select(back, simd.splat(0.0), met);
            }
            let t = simd.max(t, enters);
            let met = simd.both(simd.both(met, inside), simd.at_most(t, self.t));
            let set = simd.signs(met);
            if set == 0 {
                continue;
            }
            // At equal distance, the triangle with the lower index wins.
            let mut nearer = met;
            let index = block.rows[12][k];
            let tied = simd.signs(simd.at_most(self.t, t)) & set;
            if tied != 0 {
                let indices = simd.store(self.triangle);
                let mut lanes = [0.0_f32; WIDTH];
                for lane in 0..WIDTH {
                    let wins = set >> lane & 1 == 1 && (tied >> lane & 1 == 0 || index < indices[lane]);
                    lanes[lane] = if wins { -1.0 } else { 0.0 };
                }
                nearer = simd.load(&bytemuck::cast(lanes));
            }
            self.t = simd.select(nearer, t, self.t);
            self.u = simd.select(nearer, u, self.u);
            self.v = simd.select(nearer, v, self.v);
            self.triangle = simd.select(nearer, simd.splat(f32::from_bits(index)), self.triangle);
        }
    }
}

/// A vector of one triangle of a block, for all lanes.
#[inline(always)]
fn corner<E: Eight>(simd: E, block: &Block, row: usize, k: usize) -> [E::Floats; 3] {
    let k = k % WIDTH;
    [
        simd.splat(f32::from_bits(block.rows[row][k])),
        simd.splat(f32::from_bits(block.rows[row + 1][k])),
        simd.splat(f32::from_bits(block.rows[row + 2][k])),
    ]
}

impl WideBvh {
    /// Finds the nearest hits of a packet, as [`Self::nearest`].
    #[inline(always)]
    pub fn nearest_of_packet<E: Eight>(
        &self,
        simd: E,
        mut packet: Packet<E>,
        hits: &mut [Option<Hit>],
        culls: bool,
        scratch: &mut Scratch,
    ) {
        let Scratch { children, enters } = scratch;
        if children.len() < self.stack {
            children.resize(self.stack, 0);
            enters.resize(self.stack, 0);
        }
        let (children, enters) = (children.as_mut_slice(), enters.as_mut_slice());
        let octant = packet.octant();
        let mut limit = f32::INFINITY;
        let mut top = 1;
        (children[0], enters[0]) = (Child::node(ROOT, self.shift).0, 0);
        while top > 0 {
            top -= 1;
            if f32::from_bits(enters[top]) > limit {
                continue;
            }
            let child = Child(children[top]);
            if child.is_leaf() {
                packet.visit(simd, &self.blocks[child.index(self.shift)], culls);
                limit = range(&bytemuck::cast(simd.store(packet.t))).1;
                continue;
            }
            let node = &self.nodes[child.index(self.shift)];
            let (distances, entered) = packet.enter(simd, node, limit);
            let order = simd.places(node.rows[Child::ORDERS][octant]);
            let set = simd.signs(simd.pick(entered, order));
            let places = simd.pick_places(order, simd.packed(set));
            let found = simd.pick(simd.load(&node.rows[Child::ROW]), places);
            children[top..top + WIDTH].copy_from_slice(&simd.store(found));
            enters[top..top + WIDTH].copy_from_slice(&simd.store(simd.pick(distances, places)));
            top += set.count_ones() as usize;
        }
        let (t, u, v): (Lanes, Lanes, Lanes) = (
            bytemuck::cast(simd.store(packet.t)),
            bytemuck::cast(simd.store(packet.u)),
            bytemuck::cast(simd.store(packet.v)),
        );
        let triangles = simd.store(packet.triangle);
        for (k, hit) in hits.iter_mut().enumerate().take(WIDTH) {
            *hit = (t[k] < f32::INFINITY).then_some(Hit { triangle: triangles[k] as usize, t: t[k], u: u[k], v: v[k] });
        }
    }
}
