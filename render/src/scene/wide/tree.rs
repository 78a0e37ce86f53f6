//! The eight-wide tree of boxes and blocks of triangles, made from a binary one by pulling grandchildren up.

use std::ops::Range;

use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node},
    rt_triangle::RtTriangle,
};

/// Children of a node, and triangles of a block: the lanes of an AVX2 register.
pub(super) const WIDTH: usize = 8;

/// Maximum number of bits for the number of a ray: 256 rays are in flight at once.
pub(super) const MOST_BITS: u32 = 8;

/// Index of the node that all rays start from.
pub(super) const ROOT: usize = 0;

/// The bits of eight numbers.
pub(super) type Row = [u32; WIDTH];

/// Boxes of up to eight children.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// The planes of the children's boxes: least and greatest x, then y, then z; then the children, and last
    /// their order from far to near for a ray into each octant, with three bits each, and in the highest bits
    /// the set of leaves. The planes of empty lanes are NaN, so that no ray enters them.
    pub(super) rows: [Row; 8],
}

/// A node or a block of triangles: its index, shifted left to leave room for the number of a ray, with the
/// highest bit set for a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Child(pub(super) u32);

impl Child {
    /// Rows of a node that hold its children, and their orders.
    pub(super) const ROW: usize = 6;
    pub(super) const ORDERS: usize = 7;

    /// The bit that marks blocks.
    pub(super) const LEAF: u32 = 1 << 31;

    pub(super) fn node(index: usize, shift: u32) -> Self {
        assert!(index < 1 << (31 - shift), "node {index} does not fit into {} bits", 31 - shift);
        Self((index as u32) << shift)
    }

    pub(super) fn leaf(block: usize, shift: u32) -> Self {
        Self(Self::node(block, shift).0 | Self::LEAF)
    }

    #[inline(always)]
    pub(super) fn index(self, shift: u32) -> usize {
        ((self.0 & !Self::LEAF) >> shift) as usize
    }

    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }
}

impl Node {
    /// Creates a node of up to eight children with their boxes.
    pub(super) fn new(children: &[(Child, Aabb)]) -> Self {
        let mut rows = [[f32::NAN.to_bits(); WIDTH]; 8];
        rows[Child::ROW] = [0; WIDTH];
        let mut leaves = 0;
        for (lane, (child, bounds)) in children.iter().enumerate() {
            rows[Child::ROW][lane] = child.0;
            leaves |= u32::from(child.is_leaf()) << lane;
            for axis in 0..3 {
                rows[2 * axis][lane] = bounds.min[axis].to_bits();
                rows[2 * axis + 1][lane] = bounds.max[axis].to_bits();
            }
        }
        for (octant, order) in rows[Child::ORDERS].iter_mut().enumerate() {
            let sign = |axis: usize| if octant >> axis & 1 == 1 { -1.0 } else { 1.0 };
            let distance = |lane: usize| {
                children.get(lane).map_or(f32::NEG_INFINITY, |(_, bounds)| {
                    (0..3).map(|axis| sign(axis) * (bounds.min[axis] + bounds.max[axis])).sum()
                })
            };
            let mut lanes: [usize; WIDTH] = std::array::from_fn(|lane| lane);
            lanes.sort_by(|&a, &b| distance(b).total_cmp(&distance(a)));
            *order = lanes.iter().enumerate().map(|(place, &lane)| (lane as u32) << (3 * place)).sum::<u32>();
            *order |= leaves << 24;
        }
        Self { rows }
    }

    /// The set of children that are leaves.
    #[inline(always)]
    pub(super) fn leaves(&self) -> u32 {
        self.rows[Child::ORDERS][0] >> 24
    }
}

/// Up to eight triangles, one in each lane. Empty lanes have no area and are never hit.
#[derive(Clone, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// x, y and z of a corner of each triangle, of the edge from the second corner to the first, of the edge
    /// from the first to the third, and of their cross product; then the triangles' indices, and last the
    /// planes of the leaf's box, the number of triangles, and the set of single-sided ones.
    pub(super) rows: [Row; 14],
}

impl Block {
    /// The set of single-sided triangles.
    #[inline(always)]
    pub(super) fn single_sided(&self) -> u32 {
        self.rows[13][7]
    }
}

/// Triangles under a hierarchy.
#[derive(Default)]
pub(in crate::scene) struct WideBvh {
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<Block>,
    /// Low bits of a child that are free for the number of a ray.
    pub(super) shift: u32,
    /// Maximum number of a ray's pending visits, with room for one more node's children.
    pub(super) stack: usize,
    /// Whether any triangle is single-sided.
    pub(super) has_single_sided: bool,
}

/// A part of the binary tree that becomes a child of a wide node.
pub(super) enum Part {
    /// A node of the binary tree with two children.
    Inner(u32),
    /// Some entries of a leaf of the binary tree.
    Entries(Range<usize>),
}

impl WideBvh {
    /// Builds the hierarchy over `triangles`, which are in the order of the binary tree's primitive indices.
    pub fn new(tree: &Bvh2, triangles: &[RtTriangle]) -> Self {
        // Neither blocks nor nodes outnumber the entries.
        let bits = usize::BITS - triangles.len().leading_zeros();
        Self::with_shift(tree, triangles, MOST_BITS.min(31_u32.saturating_sub(bits)))
    }

    /// [`Self::new`] with `shift` bits of a child for the number of a ray.
    pub(super) fn with_shift(tree: &Bvh2, triangles: &[RtTriangle], shift: u32) -> Self {
        let mut wide = Self { shift, ..Self::default() };
        if tree.nodes.is_empty() {
            return wide;
        }
        let mut deepest = 0;
        // Nodes to make, each with its part, bounds and depth.
        let mut todo = vec![(ROOT, part(&tree.nodes[0]), tree.nodes[0].aabb().to_owned(), 1)];
        wide.nodes.push(Node::new(&[]));
        while let Some((index, root, bounds, depth)) = todo.pop() {
            deepest = deepest.max(depth);
            let mut children = Vec::with_capacity(WIDTH);
            for (part, bounds) in open(tree, root, bounds) {
                let child = match part {
                    Part::Entries(entries) if entries.len() <= WIDTH => {
                        wide.add_block(tree, triangles, entries, &bounds)
                    }
                    part => {
                        wide.nodes.push(Node::new(&[]));
                        todo.push((wide.nodes.len() - 1, part, bounds, depth + 1));
                        Child::node(wide.nodes.len() - 1, wide.shift)
                    }
                };
                children.push((child, bounds));
            }
            wide.nodes[index] = Node::new(&children);
        }
        // Each visited node leaves up to seven children pending.
        wide.stack = deepest * (WIDTH - 1) + WIDTH;
        wide
    }

    /// Marks the triangles, given by their index, whose back faces are invisible to cameras.
    pub fn set_single_sided(&mut self, is_single_sided: impl Fn(usize) -> bool) {
        for block in &mut self.blocks {
            let lanes = (0..block.rows[13][6]).filter(|&k| is_single_sided(block.rows[12][k as usize] as usize));
            block.rows[13][7] = lanes.map(|k| 1 << k).sum();
            self.has_single_sided |= block.single_sided() != 0;
        }
    }

    /// Adds a block of some of a leaf's triangles.
    fn add_block(&mut self, tree: &Bvh2, triangles: &[RtTriangle], entries: Range<usize>, bounds: &Aabb) -> Child {
        let mut block = Block::default();
        for axis in 0..3 {
            block.rows[13][2 * axis] = bounds.min[axis].to_bits();
            block.rows[13][2 * axis + 1] = bounds.max[axis].to_bits();
        }
        block.rows[13][6] = entries.len() as u32;
        for (lane, entry) in entries.enumerate() {
            let RtTriangle { v0, e1, e2, ng } = triangles[entry];
            for axis in 0..3 {
                for (row, vector) in [v0, e1, e2, ng].into_iter().enumerate() {
                    block.rows[3 * row + axis][lane] = vector[axis].to_bits();
                }
            }
            block.rows[12][lane] = tree.primitive_indices[entry];
        }
        self.blocks.push(block);
        Child::leaf(self.blocks.len() - 1, self.shift)
    }
}

/// Returns the part that a binary node represents.
pub(super) fn part(node: &Bvh2Node) -> Part {
    if node.is_leaf() {
        let first = node.first_index as usize;
        Part::Entries(first..first + node.prim_count as usize)
    } else {
        Part::Inner(node.first_index)
    }
}

/// Returns the children of a wide node: the largest parts are opened until there are eight.
pub(super) fn open(tree: &Bvh2, root: Part, bounds: Aabb) -> Vec<(Part, Aabb)> {
    let mut open = vec![(root, bounds)];
    while open.len() < WIDTH {
        let can_be_opened = |part: &Part| match part {
            Part::Inner(_) => true,
            Part::Entries(entries) => entries.len() > WIDTH,
        };
        let inner = open.iter().enumerate().filter(|(_, (part, _))| can_be_opened(part));
        let area = |(_, (_, bounds)): &(usize, &(Part, Aabb))| bounds.half_area();
        let Some((place, _)) = inner.max_by(|a, b| area(a).total_cmp(&area(b))) else { break };
        let (opened, bounds) = open.swap_remove(place);
        match opened {
            Part::Inner(first) => {
                for node in &tree.nodes[first as usize..first as usize + 2] {
                    open.push((part(node), *node.aabb()));
                }
            }
            Part::Entries(entries) => {
                let middle = entries.start + entries.len() / 2;
                open.push((Part::Entries(entries.start..middle), bounds));
                open.push((Part::Entries(middle..entries.end), bounds));
            }
        }
    }
    open
}
