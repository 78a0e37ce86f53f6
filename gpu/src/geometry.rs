//! Triangles and their hierarchy as `rays.wgsl` reads them.

use std::time::Duration;

use headtail_render::scene::FlatFace;
use obvhs::{
    BvhBuildParams,
    bvh2::{Bvh2, builder::build_bvh2_from_tris, node::Bvh2Node},
    triangle::Triangle,
};

use crate::error::{Error, Result};

/// Largest number of triangles in the hierarchy, where large ones can be in several leaves.
const MOST: usize = 1 << 24;
/// A child's word that refers to nothing.
const NONE: u32 = u32::MAX;
/// The bit of a leaf's word, and the place of its number of triangles.
const LEAF: u32 = 1 << 31;
const COUNT: u32 = 24;
/// Flags of triangles.
const SINGLE_SIDED: u32 = 1;
const COPIED: u32 = 2;
const MASKED: u32 = 4;
/// Triangles per leaf: a node costs about as much as this many triangles.
const PER_LEAF: f32 = 2.0;

/// The hierarchy.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Nodes, then triangles: vectors of four numbers.
    pub numbers: Vec<[f32; 4]>,
    /// The word of the root.
    pub root: u32,
    /// Place of the first triangle.
    pub triangles: usize,
    /// Largest number of nodes that wait while a ray is traced.
    pub stack: usize,
}

impl Geometry {
    /// Builds the hierarchy of the faces of a scene.
    ///
    /// # Errors
    /// If there are too many triangles.
    pub fn build(faces: &[FlatFace]) -> Result<Self> {
        if faces.is_empty() {
            return Ok(Self { numbers: vec![[0.0; 4]], root: NONE, triangles: 0, stack: 1 });
        }
        let corners: Vec<Triangle> = faces
            .iter()
            .map(|face| {
                let [v0, v1, v2] = face.corners.map(Into::into);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let parameters = BvhBuildParams { collapse_traversal_cost: PER_LEAF, ..BvhBuildParams::slow_build() };
        let tree = build_bvh2_from_tris(&corners, parameters, &mut Duration::default());
        let count = tree.primitive_indices.len();
        if count > MOST {
            return Err(Error::TooMany { count, what: "triangles in its hierarchy", most: MOST });
        }
        Ok(Self::of(&tree, faces))
    }

    fn of(tree: &Bvh2, faces: &[FlatFace]) -> Self {
        // Inner nodes are numbered in the tree's order.
        let mut places = vec![NONE; tree.nodes.len()];
        let inner = tree.nodes.iter().enumerate().filter(|(_, node)| !node.is_leaf());
        for (place, (index, _)) in (0..).zip(inner) {
            places[index] = place;
        }
        let word = |index: usize| match &tree.nodes[index] {
            node if node.is_leaf() => LEAF | (node.prim_count << COUNT) | node.first_index,
            _ => places[index],
        };
        let mut numbers = Vec::new();
        for node in tree.nodes.iter().filter(|node| !node.is_leaf()) {
            for child in [0, 1] {
                let index = node.first_index as usize + child;
                let Bvh2Node { aabb, .. } = &tree.nodes[index];
                let [low, high] = [aabb.min, aabb.max];
                numbers.push([low.x, low.y, low.z, f32::from_bits(word(index))]);
                numbers.push([high.x, high.y, high.z, 0.0]);
            }
        }
        let triangles = numbers.len();
        for &number in &tree.primitive_indices {
            let face = &faces[number as usize];
            let flag = |is: bool, flag: u32| if is { flag } else { 0 };
            let flags = flag(face.is_single_sided, SINGLE_SIDED) | flag(face.is_copied, COPIED);
            let flags = flags | flag(face.mask.is_some(), MASKED);
            let words = [f32::from_bits(number), f32::from_bits(flags), 0.0];
            numbers.extend(face.corners.iter().zip(words).map(|(p, word)| [p.x, p.y, p.z, word]));
        }
        Self { numbers, root: word(0), triangles, stack: depth(tree, 0).max(1) }
    }
}

/// Returns the number of inner nodes on the longest way down.
fn depth(tree: &Bvh2, root: usize) -> usize {
    let (mut waiting, mut deepest) = (vec![(root, 0)], 0);
    while let Some((index, above)) = waiting.pop() {
        let node = &tree.nodes[index];
        if node.is_leaf() {
            deepest = deepest.max(above);
        } else {
            waiting.extend([0, 1].map(|child| (node.first_index as usize + child, above + 1)));
        }
    }
    deepest
}
