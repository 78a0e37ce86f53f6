//! A hierarchy with eight children to a node: one ray is tested against all of them at once, one in each SIMD lane, and against
//! eight triangles of a leaf in the same way (Wald, Benthin and Boulos 2008, "Getting Rid of Packets").
//!
//! It is made from a binary tree by drawing grandchildren up.

use glam::Vec3A;
use obvhs::{
    bvh2::{Bvh2, node::Bvh2Node},
    rt_triangle::RtTriangle,
};

use super::ray::Ray;
use crate::simd::{Simd, Vectorized};

/// Children of a node, and triangles of a block: one AVX2 register of each of their numbers.
const WIDTH: usize = 8;

/// A number for each child or triangle.
type Lanes = [f32; WIDTH];

/// Boxes of up to eight children.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Node {
    /// The planes of the children's boxes: least and greatest x, then y, then z. An empty place has its planes the wrong way round.
    planes: [Lanes; 6],
    children: [Child; WIDTH],
}

/// A node, or the blocks of triangles of a leaf: the index of the (first), times 16, and in the low four bits how many blocks; 0 for
/// a node.
#[derive(Clone, Copy, Debug, Default)]
struct Child(u32);

impl Child {
    const ROOT: Self = Self::node(0);

    const fn node(index: usize) -> Self {
        Self((index as u32) << 4)
    }

    const fn leaf(first_block: usize, blocks: usize) -> Self {
        Self((first_block as u32) << 4 | blocks as u32)
    }

    #[inline(always)]
    fn index(self) -> usize {
        self.0 as usize >> 4
    }

    #[inline(always)]
    fn blocks(self) -> usize {
        self.0 as usize & 15
    }
}

impl Node {
    const EMPTY: Self = Self {
        planes: [
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
        ],
        children: [Child::ROOT; WIDTH],
    };
}

/// Up to eight triangles, one in each lane. Empty places have no area and are never hit.
#[derive(Clone, Debug, Default)]
#[repr(C, align(64))]
struct Block {
    /// A corner of each triangle.
    corner: [Lanes; 3],
    /// From the second corner to the first.
    first_edge: [Lanes; 3],
    /// From the first corner to the third.
    second_edge: [Lanes; 3],
    /// Cross product of the edges.
    normal: [Lanes; 3],
    /// Indices of the triangles.
    triangles: [u32; WIDTH],
}

/// Triangles under a hierarchy.
#[derive(Default)]
pub(super) struct WideBvh {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
}

/// A hit on the way, or at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WideHit {
    /// Index of the triangle.
    pub triangle: u32,
    /// Distance in metres; infinity before there is a hit.
    pub t: f32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
}

impl WideHit {
    /// No hit yet.
    const NONE: Self = Self { triangle: u32::MAX, t: f32::INFINITY, u: 0.0, v: 0.0 };

    /// Whether there is a hit.
    #[inline(always)]
    pub fn is_some(&self) -> bool {
        self.t < f32::INFINITY
    }
}

impl WideBvh {
    /// The hierarchy over `triangles`, which are in the order of the indices of a binary tree's primitives.
    pub fn new(tree: &Bvh2, triangles: &[RtTriangle]) -> Self {
        let mut wide = Self::default();
        if tree.nodes.is_empty() {
            return wide;
        }
        wide.nodes.push(Node::EMPTY);
        // Nodes to fill, each with the binary node that it stands for.
        let mut todo = vec![(0, 0_u32)];
        while let Some((index, root)) = todo.pop() {
            let children = children(tree, root);
            for (lane, child) in children.into_iter().enumerate() {
                let binary = &tree.nodes[child as usize];
                let reference = if binary.is_leaf() {
                    wide.add_leaf(tree, triangles, binary)
                } else {
                    wide.nodes.push(Node::EMPTY);
                    todo.push((wide.nodes.len() - 1, child));
                    Child::node(wide.nodes.len() - 1)
                };
                let node = &mut wide.nodes[index];
                node.children[lane] = reference;
                for axis in 0..3 {
                    node.planes[2 * axis][lane] = binary.aabb().min[axis];
                    node.planes[2 * axis + 1][lane] = binary.aabb().max[axis];
                }
            }
        }
        wide
    }

    /// Adds the triangles of a leaf.
    fn add_leaf(&mut self, tree: &Bvh2, triangles: &[RtTriangle], leaf: &Bvh2Node) -> Child {
        let first = self.blocks.len();
        let entries = leaf.first_index as usize..(leaf.first_index + leaf.prim_count) as usize;
        let indices = tree.primitive_indices[entries.clone()].chunks(WIDTH);
        for (triangles, indices) in triangles[entries].chunks(WIDTH).zip(indices) {
            let mut block = Block::default();
            block.triangles[..indices.len()].copy_from_slice(indices);
            for (lane, RtTriangle { v0, e1, e2, ng }) in triangles.iter().enumerate() {
                for axis in 0..3 {
                    block.corner[axis][lane] = v0[axis];
                    block.first_edge[axis][lane] = e1[axis];
                    block.second_edge[axis][lane] = e2[axis];
                    block.normal[axis][lane] = ng[axis];
                }
            }
            self.blocks.push(block);
        }
        // One, as the builder puts at most eight triangles into a leaf.
        Child::leaf(first, self.blocks.len() - first)
    }
}

/// The binary nodes that become the children of a wide node: the largest are opened until there are eight.
fn children(tree: &Bvh2, root: u32) -> Vec<u32> {
    let mut open = vec![root];
    while open.len() < WIDTH {
        let inner = open.iter().enumerate().filter(|(_, node)| !tree.nodes[**node as usize].is_leaf());
        let area = |node: u32| tree.nodes[node as usize].aabb().half_area();
        let Some((place, &node)) = inner.max_by(|a, b| area(*a.1).total_cmp(&area(*b.1))) else { break };
        let first = tree.nodes[node as usize].first_index;
        open[place] = first;
        open.push(first + 1);
    }
    open
}

/// A ray with what its tests need.
struct Probe {
    origin: Vec3A,
    direction: Vec3A,
    inverse: Vec3A,
    /// For each axis, which of a box's planes is met first and which last.
    near: [usize; 3],
    far: [usize; 3],
}

impl Probe {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let Ray { origin, direction } = *ray;
        // Where a direction has no extent along an axis, a large number stands for infinity: 0 times infinity is not a number.
        let least = Vec3A::splat(f32::EPSILON).copysign(direction);
        let inverse = Vec3A::select(direction.abs().cmple(Vec3A::splat(f32::EPSILON)), least, direction).recip();
        let negative = direction.is_negative_bitmask() as usize;
        let (x, y, z) = (negative & 1, negative >> 1 & 1, negative >> 2 & 1);
        Self { origin, direction, inverse, near: [x, 2 + y, 4 + z], far: [1 - x, 3 - y, 5 - z] }
    }

    /// The distances at which the ray enters the boxes of a node, and a bit for each that it enters before `limit`.
    #[inline(always)]
    fn enter(&self, node: &Node, limit: f32) -> (Lanes, u32) {
        let [near_x, near_y, near_z] =
            [&node.planes[self.near[0]], &node.planes[self.near[1]], &node.planes[self.near[2]]];
        let [far_x, far_y, far_z] = [&node.planes[self.far[0]], &node.planes[self.far[1]], &node.planes[self.far[2]]];
        let (origin, inverse) = (self.origin, self.inverse);
        let (mut distances, mut bits) = ([0.0; WIDTH], [0; WIDTH]);
        for k in 0..WIDTH {
            let x = (near_x[k] - origin.x) * inverse.x;
            let y = (near_y[k] - origin.y) * inverse.y;
            let z = (near_z[k] - origin.z) * inverse.z;
            let enters = greatest(greatest(x, y), greatest(z, 0.0));
            let x = (far_x[k] - origin.x) * inverse.x;
            let y = (far_y[k] - origin.y) * inverse.y;
            let z = (far_z[k] - origin.z) * inverse.z;
            let leaves = least(least(x, y), least(z, limit));
            distances[k] = enters;
            bits[k] = u32::from(enters <= leaves) << k;
        }
        (distances, union(bits))
    }

    /// The nearest of `hit` and of the hits with a block's triangles.
    #[inline(always)]
    fn intersect(&self, block: &Block, hit: WideHit) -> WideHit {
        let [corner_x, corner_y, corner_z] = &block.corner;
        let [first_x, first_y, first_z] = &block.first_edge;
        let [second_x, second_y, second_z] = &block.second_edge;
        let [normal_x, normal_y, normal_z] = &block.normal;
        let (o, d) = (self.origin, self.direction);
        let (mut us, mut vs, mut ts, mut bits) = ([0.0; WIDTH], [0.0; WIDTH], [0.0; WIDTH], [0; WIDTH]);
        for k in 0..WIDTH {
            let [c_x, c_y, c_z] = [corner_x[k] - o.x, corner_y[k] - o.y, corner_z[k] - o.z];
            let [r_x, r_y, r_z] = [d.y * c_z - d.z * c_y, d.z * c_x - d.x * c_z, d.x * c_y - d.y * c_x];
            let inverse = 1.0 / (normal_x[k] * d.x + normal_y[k] * d.y + normal_z[k] * d.z);
            let u = (r_x * second_x[k] + r_y * second_y[k] + r_z * second_z[k]) * inverse;
            let v = (r_x * first_x[k] + r_y * first_y[k] + r_z * first_z[k]) * inverse;
            let w = 1.0 - u - v;
            let t = (normal_x[k] * c_x + normal_y[k] * c_y + normal_z[k] * c_z) * inverse;
            // Comparisons with what is not a number fail: a ray in the plane of a triangle does not hit it.
            let inside = (u >= 0.0) & (v >= 0.0) & (w >= 0.0);
            bits[k] = u32::from(inside & (t >= 0.0) & (t < hit.t)) << k;
            (us[k], vs[k], ts[k]) = (u, v, t);
        }
        let mut found = union(bits);
        let mut hit = hit;
        while found != 0 {
            let k = found.trailing_zeros() as usize % WIDTH;
            if ts[k] < hit.t {
                hit = WideHit { triangle: block.triangles[k], t: ts[k], u: us[k], v: vs[k] };
            }
            found &= found - 1;
        }
        hit
    }
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

/// All bits that are set in any lane.
#[inline(always)]
fn union(bits: [u32; WIDTH]) -> u32 {
    let mut all = 0;
    for bits in bits {
        all |= bits;
    }
    all
}

/// A node or leaf to visit.
#[derive(Clone, Copy, Debug)]
struct Visit {
    /// Where the ray enters its box.
    t: f32,
    child: Child,
}

/// Rays on their way to their nearest hits, or to any.
pub(super) struct Traversal<'a, T, const ANY: bool> {
    pub bvh: &'a WideBvh,
    pub rays: &'a [Ray],
    /// What is found for each ray; of as many rays as there are places.
    pub out: &'a mut [T],
}

impl<T, const ANY: bool> Vectorized for Traversal<'_, T, ANY>
where
    WideHit: Into<T>,
{
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let mut stack: Vec<Visit> = Vec::with_capacity(128);
        for (ray, out) in self.rays.iter().zip(self.out) {
            *out = traverse::<ANY>(self.bvh, &Probe::new(ray), &mut stack).into();
        }
    }
}

/// The nearest hit, or some hit if any will do.
#[inline(always)]
fn traverse<const ANY: bool>(bvh: &WideBvh, probe: &Probe, stack: &mut Vec<Visit>) -> WideHit {
    let mut hit = WideHit::NONE;
    stack.clear();
    if !bvh.nodes.is_empty() {
        stack.push(Visit { t: 0.0, child: Child::ROOT });
    }
    while let Some(Visit { t, child }) = stack.pop() {
        if !ANY && t > hit.t {
            continue;
        }
        let (index, blocks) = (child.index(), child.blocks());
        if blocks > 0 {
            for block in &bvh.blocks[index..index + blocks] {
                hit = probe.intersect(block, hit);
            }
            if ANY && hit.is_some() {
                return hit;
            }
            continue;
        }
        let node = &bvh.nodes[index];
        let (distances, mut entered) = probe.enter(node, hit.t);
        let base = stack.len();
        while entered != 0 {
            let k = entered.trailing_zeros() as usize % WIDTH;
            entered &= entered - 1;
            let visit = Visit { t: distances[k], child: node.children[k] };
            stack.push(visit);
            if !ANY {
                // The nearest last, so that it comes first.
                let mut place = stack.len() - 1;
                while place > base && stack[place - 1].t < visit.t {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place] = visit;
            }
        }
    }
    hit
}
