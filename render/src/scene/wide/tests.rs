//! Tests of the hierarchy alone: leaves, child encoding, and the portable form.

use glam::{Vec3, Vec3A};
use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node},
    rt_triangle::RtTriangle,
    triangle::Triangle,
};

use super::{tree::Child, *};
use crate::random::{Purpose, Stream};

fn vector(random: &mut Stream) -> Vec3A {
    Vec3A::new(random.uniform(), random.uniform(), random.uniform()) * 2.0 - 1.0
}

/// A tree that is one leaf of triangles in the cube from -1 to 1.
fn one_leaf(count: usize, random: &mut Stream) -> (Bvh2, Vec<RtTriangle>) {
    let corners: Vec<Triangle> =
        (0..count).map(|_| Triangle { v0: vector(random), v1: vector(random), v2: vector(random) }).collect();
    let bounds = Aabb::new(Vec3A::splat(-1.0), Vec3A::ONE);
    let tree = Bvh2 {
        nodes: vec![Bvh2Node::new(bounds, count as u32, 0)],
        primitive_indices: (0..count as u32).collect(),
        ..Bvh2::default()
    };
    (tree, corners.iter().map(RtTriangle::from).collect())
}

/// Rays of which half go the same way, in packets.
fn rays(random: &mut Stream) -> Vec<Ray> {
    (0..800)
        .map(|k| {
            let direction = if k % 16 < 8 { Vec3::ONE.into() } else { vector(random) };
            Ray::new(1.5 * vector(random) - direction, direction.normalize())
        })
        .collect()
}

fn nearest(bvh: &WideBvh, rays: &[Ray]) -> Vec<Option<Hit>> {
    let mut hits = vec![None; rays.len()];
    Traversal { bvh, rays, question: Question::Nearest(RayKind::Camera, &mut hits) }.run();
    hits
}

fn occluded(bvh: &WideBvh, rays: &[Ray]) -> Vec<bool> {
    let mut occluded = vec![false; rays.len()];
    Traversal { bvh, rays, question: Question::Occluded(&mut occluded) }.run();
    occluded
}

#[test]
fn large_leaves_are_divided_and_ray_bits_do_not_change_hits() {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let rays = rays(&mut random);
    for count in [1, 8, 9, 64, 65, 500] {
        let (tree, triangles) = one_leaf(count, &mut random);
        let wide = WideBvh::new(&tree, &triangles);
        let mut held: Vec<u32> =
            wide.blocks.iter().flat_map(|block| block.rows[12][..block.rows[13][6] as usize].to_owned()).collect();
        held.sort_unstable();
        assert_eq!(held, tree.primitive_indices);
        let (expected, is_hit) = (nearest(&wide, &rays), occluded(&wide, &rays));
        assert!(expected.iter().zip(&is_hit).all(|(hit, is_hit)| hit.is_some() == *is_hit));
        assert!(is_hit.contains(&true) && is_hit.contains(&false));
        for shift in [0, 2] {
            let wide = WideBvh::with_shift(&tree, &triangles, shift);
            assert_eq!(nearest(&wide, &rays), expected);
            assert_eq!(occluded(&wide, &rays), is_hit);
        }
    }
}

#[test]
fn portable_and_simd_traversals_agree() {
    let mut random = Stream::new(2, Purpose::Test, 0);
    let rays = rays(&mut random);
    let (tree, triangles) = one_leaf(100, &mut random);
    let bvh = &WideBvh::new(&tree, &triangles);
    let mut scratch = Scratch::default();
    let (mut hits, mut is_hit) = (vec![None; rays.len()], vec![false; rays.len()]);
    Traversal { bvh, rays: &rays, question: Question::Nearest(RayKind::Camera, &mut hits) }.answer(Plain, &mut scratch);
    Traversal { bvh, rays: &rays, question: Question::Occluded(&mut is_hit) }.answer(Plain, &mut scratch);
    assert_eq!(hits, nearest(bvh, &rays));
    assert_eq!(is_hit, occluded(bvh, &rays));
}

#[test]
fn children_encode_index_and_kind() {
    let (node, leaf) = (Child::node(70_000, 8), Child::leaf(70_000, 8));
    assert_eq!((node.index(8), node.is_leaf()), (70_000, false));
    assert_eq!((leaf.index(8), leaf.is_leaf()), (70_000, true));
    assert_eq!(Child::leaf((1 << 23) - 1, 8).index(8), (1 << 23) - 1);
}

#[test]
#[should_panic(expected = "does not fit")]
fn block_indices_out_of_range_panic() {
    Child::leaf(1 << 23, 8);
}
