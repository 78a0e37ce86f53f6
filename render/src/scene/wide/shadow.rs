//! Rays that ask whether anything is in their way.
//!
//! All rays of a batch are on their way at once: a list holds what is left to visit for any of them. Steps of different rays do not
//! wait for each other, and neither how many children a step adds nor whether they are leaves is a branch.

use super::{Child, Node, ROOT, WIDTH, WideBvh, lanes::Eight, probe::Probe};
use crate::scene::ray::Ray;

/// Steps that are taken from the list at once.
const STEPS: usize = 64;

/// Rays and what they are to visit, side by side.
#[derive(Default)]
struct List {
    rays: Vec<u32>,
    children: Vec<u32>,
}

impl List {
    /// Makes room for what `steps` steps add to the first `len` entries.
    fn reserve(&mut self, len: usize, steps: usize) -> Entries<'_> {
        let needed = len + (steps + 1) * WIDTH;
        if self.rays.len() < needed {
            self.rays.resize(2 * needed, 0);
            self.children.resize(2 * needed, 0);
        }
        Entries { rays: &mut self.rays, children: &mut self.children, len }
    }
}

/// The entries of a list.
struct Entries<'a> {
    rays: &'a mut [u32],
    children: &'a mut [u32],
    len: usize,
}

impl Entries<'_> {
    /// Adds the children of a set for a ray.
    #[inline(always)]
    fn push<E: Eight>(&mut self, simd: E, ray: u32, children: E::Floats, set: u32) {
        let children = simd.pick(children, simd.packed(set));
        self.rays[self.len..self.len + WIDTH].copy_from_slice(&[ray; WIDTH]);
        self.children[self.len..self.len + WIDTH].copy_from_slice(&simd.store(children));
        self.len += set.count_ones() as usize;
    }
}

/// Memory that is used again.
#[derive(Default)]
pub struct Scratch {
    probes: Vec<Probe>,
    nodes: List,
    leaves: List,
    /// The lanes of each ray's nodes that still matter: all, or none after a hit.
    open: Vec<u32>,
}

/// All lanes of a node.
const ALL: u32 = (1 << WIDTH) - 1;

impl WideBvh {
    /// Whether each ray hits anything; both slices have equal length.
    #[inline(always)]
    pub fn occluded<E: Eight>(&self, simd: E, rays: &[Ray], occluded: &mut [bool], scratch: &mut Scratch) {
        let Scratch { probes, nodes, leaves, open } = scratch;
        occluded.fill(false);
        let Some(root) = self.nodes.get(ROOT) else { return };
        probes.resize(rays.len(), Probe::default());
        for (probe, ray) in probes.iter_mut().zip(rays) {
            *probe = Probe::new(ray);
        }
        open.clear();
        open.resize(rays.len(), ALL);
        let (probes, open) = (probes.as_slice(), open.as_mut_slice());
        let (mut nodes_left, mut leaves_left);
        {
            let (mut nodes, mut leaves) = (nodes.reserve(0, rays.len()), leaves.reserve(0, rays.len()));
            for (ray, probe) in probes.iter().enumerate() {
                step(simd, root, probe, ray as u32, ALL, &mut nodes, &mut leaves);
            }
            (nodes_left, leaves_left) = (nodes.len, leaves.len);
        }
        loop {
            for (&ray, &leaf) in leaves.rays.iter().zip(&leaves.children).take(leaves_left) {
                let met = simd.signs(probes[ray as usize].meet(simd, &self.blocks[Child(leaf).index()]).1);
                occluded[ray as usize] |= met != 0;
                open[ray as usize] = if met != 0 { 0 } else { open[ray as usize] };
            }
            if nodes_left == 0 {
                return;
            }
            let steps = nodes_left.min(STEPS);
            let first = nodes_left - steps;
            let (mut numbers, mut children) = ([0; STEPS], [0; STEPS]);
            numbers[..steps].copy_from_slice(&nodes.rays[first..nodes_left]);
            children[..steps].copy_from_slice(&nodes.children[first..nodes_left]);
            let (mut nodes, mut leaves) = (nodes.reserve(first, steps), leaves.reserve(0, steps));
            for (&ray, &child) in numbers.iter().zip(&children).take(steps) {
                let node = &self.nodes[Child(child).index()];
                step(simd, node, &probes[ray as usize], ray, open[ray as usize], &mut nodes, &mut leaves);
            }
            (nodes_left, leaves_left) = (nodes.len, leaves.len);
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
    nodes: &mut Entries<'_>,
    leaves: &mut Entries<'_>,
) {
    let entered = simd.signs(probe.enter(simd, node, f32::INFINITY).1) & open;
    let children = simd.load(&node.rows[Child::ROW]);
    nodes.push(simd, ray, children, entered & !node.leaves());
    leaves.push(simd, ray, children, entered & node.leaves());
}
