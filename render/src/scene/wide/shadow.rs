//! Traversal for occlusion: whether rays hit anything.
//!
//! All rays of a batch are in flight at once: a list holds the pending visits of all of them. Steps of
//! different rays do not wait for each other, and a step does not branch on how many children it adds or on
//! whether they are leaves.

use super::{
    lanes::Eight,
    probe::Probe,
    tree::{Child, MOST_BITS, Node, ROOT, WIDTH, WideBvh},
};
use crate::scene::ray::Ray;

/// Rays in flight at once.
const RAYS: usize = 1 << MOST_BITS;

/// Steps taken from the list at once.
const STEPS: usize = 64;

/// All lanes of a node.
const ALL: u32 = (1 << WIDTH) - 1;

/// Children to visit, each with the number of a ray in its lowest bits.
#[derive(Default)]
struct List(Vec<u32>);

impl List {
    /// The first `len` children, with room for what `steps` steps add.
    fn with_room(&mut self, len: usize, steps: usize) -> Visits<'_> {
        let needed = len + (steps + 1) * WIDTH;
        if self.0.len() < needed {
            self.0.resize(2 * needed, 0);
        }
        Visits { places: &mut self.0, len: len as u32 }
    }
}

/// A list that grows.
struct Visits<'a> {
    places: &'a mut [u32],
    len: u32,
}

impl Visits<'_> {
    /// Adds the children whose lanes are in `set`.
    #[inline(always)]
    fn push<E: Eight>(&mut self, simd: E, children: E::Floats, set: u32) {
        let places = &mut self.places[self.len as usize..self.len as usize + WIDTH];
        places.copy_from_slice(&simd.store(simd.pick(children, simd.packed(set))));
        self.len += set.count_ones();
    }
}

/// Reusable memory.
pub struct Scratch {
    probes: [Probe; RAYS],
    /// For each ray, the lanes that are still visited: all, or none after a hit.
    open: [u32; RAYS],
    nodes: List,
    leaves: List,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { probes: [Probe::default(); RAYS], open: [ALL; RAYS], nodes: List::default(), leaves: List::default() }
    }
}

impl WideBvh {
    /// Tests whether each ray hits anything; both slices have equal length.
    #[inline(always)]
    pub fn occluded<E: Eight>(&self, simd: E, rays: &[Ray], occluded: &mut [bool], scratch: &mut Scratch) {
        if self.nodes.is_empty() {
            occluded.fill(false);
            return;
        }
        let at_once = 1 << self.shift;
        for (rays, occluded) in rays.chunks(at_once).zip(occluded.chunks_mut(at_once)) {
            self.follow_all(simd, rays, scratch);
            for (occluded, &open) in occluded.iter_mut().zip(&scratch.open) {
                *occluded = open == 0;
            }
        }
    }

    /// Traces at most `1 << shift` rays until each has hit something or nothing is left to visit.
    #[inline(always)]
    fn follow_all<E: Eight>(&self, simd: E, rays: &[Ray], scratch: &mut Scratch) {
        let Scratch { probes, open, nodes, leaves } = scratch;
        for (probe, ray) in probes.iter_mut().zip(rays) {
            *probe = Probe::new(ray);
        }
        open[..rays.len()].fill(ALL);
        let numbers = (1 << self.shift) - 1;
        let mut to_node = nodes.with_room(0, rays.len());
        let mut to_leaf = leaves.with_room(0, rays.len());
        for (ray, probe) in probes.iter().enumerate().take(rays.len()) {
            step(simd, &self.nodes[ROOT], probe, ray as u32, ALL, &mut to_node, &mut to_leaf);
        }
        let (mut nodes_left, mut leaves_left) = (to_node.len as usize, to_leaf.len as usize);
        loop {
            for &leaf in leaves.0.iter().take(leaves_left) {
                let ray = (leaf & numbers) as usize % RAYS;
                let (_, met, _) = probes[ray].meet(simd, &self.blocks[Child(leaf).index(self.shift)]);
                open[ray] &= if simd.signs(met) == 0 { ALL } else { 0 };
            }
            if nodes_left == 0 {
                return;
            }
            let steps = nodes_left.min(STEPS);
            let first = nodes_left - steps;
            let mut now = [0; STEPS];
            now[..steps].copy_from_slice(&nodes.0[first..nodes_left]);
            let (mut to_node, mut to_leaf) = (nodes.with_room(first, steps), leaves.with_room(0, steps));
            for &child in now.iter().take(steps) {
                let ray = (child & numbers) as usize % RAYS;
                let node = &self.nodes[Child(child).index(self.shift)];
                step(simd, node, &probes[ray], ray as u32, open[ray], &mut to_node, &mut to_leaf);
            }
            (nodes_left, leaves_left) = (to_node.len as usize, to_leaf.len as usize);
        }
    }
}

/// Adds those children of a node that a ray enters.
#[inline(always)]
fn step<E: Eight>(
    simd: E,
    node: &Node,
    probe: &Probe,
    ray: u32,
    open: u32,
    to_node: &mut Visits<'_>,
    to_leaf: &mut Visits<'_>,
) {
    let (enters, leaves) = probe.cross(simd, node);
    let entered = simd.signs(simd.at_most(enters, leaves)) & open;
    let children = simd.tag(simd.load(&node.rows[Child::ROW]), ray);
    to_node.push(simd, children, entered & !node.leaves());
    to_leaf.push(simd, children, entered & node.leaves());
}
