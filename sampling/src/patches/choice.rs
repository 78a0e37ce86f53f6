//! Chooses patches: divides a map so that few rectangles describe light x cosine.

use std::{cmp::Ordering, collections::BinaryHeap};

use glam::{DVec3, Vec3};

use super::moments::MomentMap;
use crate::{
    columns::vectorized,
    tail::{Hierarchical, Node},
};

/// Number of normals for which the description is evaluated.
const NORMALS: usize = 96;
/// Normals whose sums are kept in registers.
const BLOCK: usize = 32;
/// A node is evaluated by its parts this many levels below.
const LEVELS: u32 = 8;
/// Smallest side of a patch's rectangle in Y: 16 steps of f32 below 1.
const LEAST_SIDE: f32 = 1.0 / (1 << 20) as f32;
/// Irradiance of normals is summed over parts this many levels below the root.
const IRRADIANCE_LEVELS: u32 = 11;

/// Chooses patches greedily.
pub struct Choice<'a> {
    map: &'a MomentMap<'a>,
    tail: &'a Hierarchical,
    normals: [[f32; NORMALS]; 3],
    /// Irradiance for each normal.
    irradiance: [f64; NORMALS],
}

/// A node with the gain of dividing it.
struct Candidate {
    gain: f64,
    node: Node,
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.gain.total_cmp(&other.gain).then_with(|| self.node.cmp(&other.node))
    }
}

impl<'a> Choice<'a> {
    /// Prepares the choice for a map.
    pub fn new(map: &'a MomentMap<'a>, tail: &'a Hierarchical) -> Self {
        let mut normals = [[0.0; NORMALS]; 3];
        for k in 0..NORMALS {
            // A spiral of equal areas.
            let z = 1.0 - (k as f64 + 0.5) / (0.5 * NORMALS as f64);
            let turn = k as f64 * 2.399_963_229_728_653;
            let radius = (1.0 - z * z).sqrt();
            let n = DVec3::new(radius * turn.cos(), radius * turn.sin(), z);
            (normals[0][k], normals[1][k], normals[2][k]) = (n.x as f32, n.y as f32, n.z as f32);
        }
        let mut choice = Self { map, tail, normals, irradiance: [0.0; NORMALS] };
        choice.irradiance = choice.cosine_sums(map.root(), IRRADIANCE_LEVELS).0.map(f64::from);
        choice
    }

    /// Returns at most `count` nodes that tile the lit part of `start`, in tree order, chosen to describe
    /// light x cosine.
    pub fn divide(&self, start: Node, count: usize) -> Vec<Node> {
        self.divide_by(start, count, |node| self.gain(node))
    }

    /// The same, chosen to minimize the largest product of energy and variance of directions.
    pub fn divide_by_spread(&self, start: Node, count: usize) -> Vec<Node> {
        let spread = |node| {
            let moments = self.map.moments(node);
            let covariance = moments.covariance();
            moments.energy * (covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z)
        };
        self.divide_by(start, count, |node| if self.is_divisible(node) { spread(node) } else { 0.0 })
    }

    fn divide_by(&self, start: Node, count: usize, gain: impl Fn(Node) -> f64) -> Vec<Node> {
        let candidate = |node| Candidate { gain: gain(node), node };
        let mut heap = BinaryHeap::from([candidate(start)]);
        while heap.len() < count && heap.peek().is_some_and(|best| best.gain > 0.0) {
            let Some(Candidate { node, .. }) = heap.pop() else { break };
            let lit = node.children().into_iter().filter(|&child| self.map.moments(child).energy > 0.0);
            heap.extend(lit.map(candidate));
        }
        let mut chosen: Vec<Node> = heap.into_iter().map(|candidate| candidate.node).collect();
        chosen.sort_unstable_by_key(|node| node.order());
        chosen
    }

    /// Returns the loss of keeping a node as one patch: the sum over normals of the excess of the cosine's
    /// root mean square over its mean, relative to the irradiance of the normal. With the root mean square as
    /// mass, this is the excess of the standard deviation.
    fn gain(&self, node: Node) -> f64 {
        if !self.is_divisible(node) {
            return 0.0;
        }
        let energy = self.map.moments(node).energy;
        let (first, second) = self.cosine_sums(node, LEVELS);
        let mut gain = 0.0;
        for k in 0..NORMALS {
            let excess = (energy * f64::from(second[k])).sqrt() - f64::from(first[k]);
            gain += excess.max(0.0) / self.irradiance[k].max(1e-9);
        }
        gain
    }

    /// Whether the halves of a node can be distinguished.
    fn is_divisible(&self, node: Node) -> bool {
        !node.is_cell() && node.children().into_iter().all(|child| self.is_resolved(child))
    }

    /// Whether a node is dark, or its rectangle of Y contains enough distinct points.
    fn is_resolved(&self, node: Node) -> bool {
        let [left, right, top, bottom] = self.tail.rectangle(node);
        self.map.moments(node).energy == 0.0 || (right - left).min(bottom - top) >= LEAST_SIDE
    }

    /// Returns for each normal the light of a node's parts times the clamped cosine, and times its square.
    fn cosine_sums(&self, node: Node, levels: u32) -> ([f32; NORMALS], [f32; NORMALS]) {
        let parts = node.descendants(levels).into_iter().map(|part| self.map.moments(part));
        let lights: Vec<(Vec3, f32)> = parts
            .filter(|moments| moments.energy > 0.0)
            .map(|moments| (moments.centroid().as_vec3(), moments.energy as f32))
            .collect();
        let (mut first, mut second) = ([0.0; NORMALS], [0.0; NORMALS]);
        sum_cosines(&lights, &self.normals, &mut first, &mut second);
        (first, second)
    }
}

vectorized! {
/// Sums light times the clamped cosine, and times its square, for each normal.
fn sum_cosines['a](
    _simd, lights: &'a [(Vec3, f32)], normals: &'a [[f32; NORMALS]; 3], first: &'a mut [f32; NORMALS],
    second: &'a mut [f32; NORMALS],
) {
    let [x, y, z] = normals;
    for start in (0..NORMALS).step_by(BLOCK) {
        let ([x, y, z], mut sums) = ([x, y, z].map(|axis| &axis[start..][..BLOCK]), [[0.0; BLOCK]; 2]);
        for &(w, energy) in lights {
            for k in 0..BLOCK {
                let cosine = x[k] * w.x + y[k] * w.y + z[k] * w.z;
                let cosine = if cosine > 0.0 { cosine } else { 0.0 };
                sums[0][k] += energy * cosine;
                sums[1][k] += energy * cosine * cosine;
            }
        }
        first[start..][..BLOCK].copy_from_slice(&sums[0]);
        second[start..][..BLOCK].copy_from_slice(&sums[1]);
    }
}
}
