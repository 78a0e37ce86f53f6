//! Traversal for nearest hits.
//!
//! Several rays are in flight and step in turn: each visits its boxes from near to far, and its steps do not
//! wait for those of the others.

use super::{
    lanes::{Eight, Lanes},
    probe::Probe,
    tree::{Child, ROOT, WIDTH, WideBvh},
};
use crate::scene::ray::{Hit, Ray};

/// Rays in flight at once.
pub const GROUP: usize = 32;

/// A ray in flight.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// Distance of the nearest hit so far; infinity before the first.
    t: f32,
    u: f32,
    v: f32,
    triangle: u32,
    /// The child to visit next, and the distance at which the ray enters it.
    child: u32,
    enters: f32,
    /// Where the ray's part of the stack ends.
    top: u32,
}

impl Way {
    const START: Self = Self { t: f32::INFINITY, u: 0.0, v: 0.0, triangle: u32::MAX, child: 0, enters: 0.0, top: 0 };

    fn hit(&self) -> Option<Hit> {
        let Self { t, u, v, triangle, .. } = *self;
        (t < f32::INFINITY).then_some(Hit { triangle: triangle as usize, t, u, v })
    }
}

/// Reusable memory.
#[derive(Default)]
pub struct Scratch {
    probes: Vec<Probe>,
    ways: Vec<Way>,
    /// The pending visits of each ray, the nearest last.
    children: Vec<u32>,
    enters: Vec<u32>,
}

/// Rays to step next.
#[derive(Clone, Copy)]
struct Turn {
    rays: [u8; GROUP],
    len: usize,
}

impl Turn {
    const NONE: Self = Self { rays: [0; GROUP], len: 0 };

    /// Adds a ray if `really`, without a branch.
    #[inline(always)]
    fn push(&mut self, ray: u8, really: bool) {
        self.rays[self.len % GROUP] = ray;
        self.len += usize::from(really);
    }
}

impl WideBvh {
    /// Finds the nearest hits of the rays numbered in `which`, at most [`GROUP`]; if it `culls`, without the
    /// back faces of single-sided triangles.
    #[inline(always)]
    pub fn nearest<E: Eight>(
        &self,
        simd: E,
        rays: &[Ray],
        which: &[u8],
        hits: &mut [Option<Hit>],
        culls: bool,
        scratch: &mut Scratch,
    ) {
        let room = self.stack * GROUP;
        if scratch.children.len() < room {
            scratch.children.resize(room, 0);
            scratch.enters.resize(room, 0);
        }
        scratch.probes.clear();
        scratch.ways.clear();
        for &ray in which {
            scratch.probes.push(Probe::new(&rays[ray as usize]));
            scratch.ways.push(Way::START);
        }
        self.follow(simd, culls, scratch);
        for (&ray, way) in which.iter().zip(&scratch.ways) {
            hits[ray as usize] = way.hit();
        }
    }

    /// Steps all rays until they have nothing left to visit.
    #[inline(always)]
    fn follow<E: Eight>(&self, simd: E, culls: bool, scratch: &mut Scratch) {
        let Scratch { probes, ways, children, enters } = scratch;
        let mut turns = [Turn::NONE; 4];
        let [at_nodes, at_leaves, nodes, leaves] = &mut turns;
        let (mut at_nodes, mut at_leaves, mut nodes, mut leaves) = (at_nodes, at_leaves, nodes, leaves);
        for (ray, way) in ways.iter_mut().enumerate() {
            way.child = Child::node(ROOT, self.shift).0;
            way.top = (ray * self.stack) as u32;
            at_nodes.push(ray as u8, true);
        }
        while at_nodes.len + at_leaves.len > 0 {
            std::mem::swap(&mut nodes, &mut at_nodes);
            std::mem::swap(&mut leaves, &mut at_leaves);
            (at_nodes.len, at_leaves.len) = (0, 0);
            for &ray in nodes.rays.iter().take(nodes.len) {
                let (way, probe) = (&mut ways[ray as usize], &probes[ray as usize]);
                let node = &self.nodes[Child(way.child).index(self.shift)];
                let (distances, leaves) = probe.cross(simd, node);
                let entered = simd.at_most(distances, simd.min(leaves, simd.splat(way.t)));
                let order = simd.places(node.rows[Child::ORDERS][probe.octant as usize % 8]);
                let set = simd.signs(simd.pick(entered, order));
                let places = simd.pick_places(order, simd.packed(set));
                let top = way.top as usize;
                let found = simd.pick(simd.load(&node.rows[Child::ROW]), places);
                children[top..top + WIDTH].copy_from_slice(&simd.store(found));
                enters[top..top + WIDTH].copy_from_slice(&simd.store(simd.pick(distances, places)));
                way.top += set.count_ones();
                next(way, ray, self.stack, children, enters, at_nodes, at_leaves);
            }
            for &ray in leaves.rays.iter().take(leaves.len) {
                let (way, probe) = (&mut ways[ray as usize], &probes[ray as usize]);
                let block = &self.blocks[Child(way.child).index(self.shift)];
                let ([t, u, v], met, back) = probe.meet(simd, block);
                // No hit is nearer than the entry into its box, so that hits do not depend on the order of
                // visits.
                let t = simd.max(t, simd.splat(way.enters));
                let mut found = simd.signs(met) & simd.signs(simd.at_most(t, simd.splat(way.t)));
                if culls {
                    found &= !(simd.signs(back) & block.single_sided());
                }
                if found != 0 {
                    let (t, u, v): (Lanes, Lanes, Lanes) =
                        (bytemuck::cast(simd.store(t)), bytemuck::cast(simd.store(u)), bytemuck::cast(simd.store(v)));
                    while found != 0 {
                        let k = found.trailing_zeros() as usize % WIDTH;
                        let triangle = block.rows[12][k];
                        if t[k] < way.t || (t[k] == way.t && triangle < way.triangle) {
                            (way.t, way.u, way.v, way.triangle) = (t[k], u[k], v[k], triangle);
                        }
                        found &= found - 1;
                    }
                }
                next(way, ray, self.stack, children, enters, at_nodes, at_leaves);
            }
        }
    }
}

/// Pops a ray's next visit from its stack, skipping those behind its nearest hit.
#[inline(always)]
fn next(
    way: &mut Way,
    ray: u8,
    stack: usize,
    children: &[u32],
    enters: &[u32],
    at_nodes: &mut Turn,
    at_leaves: &mut Turn,
) {
    let bottom = (ray as usize * stack) as u32;
    while way.top > bottom {
        way.top -= 1;
        let top = way.top as usize;
        (way.child, way.enters) = (children[top], f32::from_bits(enters[top]));
        if way.enters <= way.t {
            let is_leaf = Child(way.child).is_leaf();
            at_nodes.push(ray, !is_leaf);
            at_leaves.push(ray, is_leaf);
            return;
        }
    }
}
