//! Copies by reference against the same meshes in world space.

use glam::{EulerRot, Quat, Vec2, Vec3, Vec3A};

use super::*;
use crate::{
    random::{Purpose, Stream},
    scene::{Material, Scene},
};

fn point(random: &mut Stream) -> Vec3 {
    2.0 * Vec3::new(random.uniform(), random.uniform(), random.uniform()) - 1.0
}

/// Triangles with normals and texture coordinates in the cube from -1 to 1.
fn soup(count: usize, random: &mut Stream) -> Mesh {
    let positions: Vec<Vec3> = (0..count)
        .flat_map(|_| {
            let center = point(random);
            [0; 3].map(|_| center + 0.4 * point(random))
        })
        .collect();
    let normals = positions.iter().map(|_| point(random)).collect();
    let texcoords = positions.iter().map(|p| Vec2::new(p.x, p.z)).collect();
    let triangles = (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Mesh::new(positions, normals, texcoords, triangles, 0).unwrap()
}

/// Transforms that rotate, stretch and mirror, to places within `reach`.
fn places(count: usize, reach: f32, random: &mut Stream) -> Vec<Affine3A> {
    (0..count)
        .map(|k| {
            let scale = Vec3::new(0.5 + random.uniform(), 0.5 + random.uniform(), 0.5 + random.uniform());
            let scale = if k % 3 == 0 { scale * Vec3::new(-1.0, 1.0, 1.0) } else { scale };
            let turn = Quat::from_euler(EulerRot::XYZ, 6.0 * random.uniform(), 6.0 * random.uniform(), 1.0);
            Affine3A::from_scale_rotation_translation(scale, turn, reach * point(random))
        })
        .collect()
}

/// The copies by reference, and in world space.
fn both(mesh: &Mesh, places: Vec<Affine3A>) -> [Scene; 2] {
    let flat = places.iter().map(|place| mesh.clone().transformed(place)).collect();
    let scene = |meshes| Scene::new("copies", meshes, vec![Material::diffuse(Vec3A::ONE)], None).unwrap();
    [scene(vec![Mesh { places, ..mesh.clone() }]), scene(flat)]
}

#[test]
fn copies_are_hit_as_meshes_in_world_space() {
    let mut random = Stream::new(11, Purpose::Test, 0);
    let mesh = soup(60, &mut random);
    let [copied, flat] = both(&mesh, places(40, 5.0, &mut random));
    assert_eq!(copied.triangle_count(), flat.triangle_count());
    assert!((copied.bounds().extent() - flat.bounds().extent()).abs().max_element() < 1e-4);
    let rays: Vec<Ray> =
        (0..20_000).map(|_| Ray::new(5.0 * Vec3A::from(point(&mut random)), random.direction())).collect();
    let surfaces = |scene: &Scene| rays.iter().map(|ray| scene.intersect(ray)).collect::<Vec<_>>();
    let (own, expected) = (surfaces(&copied), surfaces(&flat));
    let hits = own.iter().flatten().count();
    assert!(hits > 4000 && hits < 18_000, "{hits}");
    // Coordinates are up to 10 m with errors of 1e-6 m: of the 10 edges of 0.5 m that a ray passes at about
    // 0.1 m, one in 1e4 is decided by rounding.
    let differ = own.iter().zip(&expected).filter(|pair| match pair {
        (Some(a), Some(b)) => !(a.p.distance(b.p) < 1e-4 && a.ng.dot(b.ng) > 0.9999 && a.ns.dot(b.ns) > 0.999),
        (a, b) => a.is_some() != b.is_some(),
    });
    assert!(differ.count() <= 6);
    let visible = |scene: &Scene| {
        let mut visible = vec![false; rays.len()];
        scene.visible_batch(&rays, &mut visible);
        visible
    };
    let (own_visible, expected) = (visible(&copied), visible(&flat));
    assert!(own_visible.iter().zip(&expected).filter(|(a, b)| a != b).count() <= 6);
    // Nearest hits and occlusion of the same hierarchy agree.
    assert!(own_visible.iter().zip(&own).filter(|(visible, hit)| **visible == hit.is_some()).count() <= 6);
}

#[test]
fn one_ray_and_a_batch_give_the_same_hits() {
    let mut random = Stream::new(12, Purpose::Test, 0);
    let mesh = soup(30, &mut random);
    let [copied, _] = both(&mesh, places(25, 3.0, &mut random));
    let rays: Vec<Ray> =
        (0..600).map(|_| Ray::new(5.0 * Vec3A::from(point(&mut random)), random.direction())).collect();
    let mut together = vec![None; rays.len()];
    copied.closest_batch(RayKind::Camera, &rays, &mut together);
    for (ray, hit) in rays.iter().zip(together) {
        let mut alone = [None];
        copied.closest_batch(RayKind::Camera, std::slice::from_ref(ray), &mut alone);
        // Packets of neighbouring rays round in another order.
        assert_eq!(alone[0].map(|hit| hit.triangle), hit.map(|hit| hit.triangle));
    }
}

#[test]
fn no_convex_copy_shadows_itself() {
    let mut random = Stream::new(13, Purpose::Test, 0);
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z].map(|p| p - 0.25);
    let sides = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let mesh = Mesh::new(corners.to_vec(), vec![], vec![], sides, 0).unwrap();
    for (reach, scale) in [(1.0, 1.0), (1e3, 1.0), (1e3, 0.02), (1e5, 30.0)] {
        for place in places(100, reach, &mut random) {
            let place = place * Affine3A::from_scale(Vec3::splat(scale));
            let [copied, _] = both(&mesh, vec![place; 2]);
            for _ in 0..40 {
                let center = place.translation;
                let from = center + 5.0 * scale * random.direction();
                let Some(point) = copied.intersect(&Ray::new(from, (center - from).normalize())) else { continue };
                let wi = random.direction();
                let wi = if wi.dot(point.ng) < 0.0 { -wi } else { wi };
                let mut visible = [false];
                copied.visible_batch(&[copied.leaving(point.p, point.ng, wi)], &mut visible);
                assert!(visible[0], "at {} m of scale {scale}: {wi}", center.length());
            }
        }
    }
}

#[test]
fn moved_and_joined_copies_stay_copies() {
    let mut random = Stream::new(14, Purpose::Test, 0);
    let mesh = soup(20, &mut random);
    let [copied, flat] = both(&mesh, places(10, 2.0, &mut random));
    let motion = Affine3A::from_rotation_translation(Quat::from_rotation_y(1.0), Vec3::new(3.0, 0.0, -1.0));
    let scenes = [&copied, &flat].map(|scene| scene.moved(&motion).unwrap().joined(scene).unwrap());
    assert_eq!(scenes[0].meshes.len(), 2);
    for _ in 0..2000 {
        let ray = Ray::new(6.0 * Vec3A::from(point(&mut random)), random.direction());
        let [a, b] = scenes.each_ref().map(|scene| scene.intersect(&ray));
        assert_eq!(a.is_some(), b.is_some());
        assert!(a.zip(b).is_none_or(|(a, b)| a.p.distance(b.p) < 1e-4));
    }
    assert!(scenes[0].geometry_hash() != copied.geometry_hash());
}

#[test]
fn flat_and_infinite_transforms_are_not_placements() {
    assert!(is_placement(&Affine3A::from_scale(Vec3::new(1.0, 2.0, -0.1))));
    for scale in [Vec3::new(1.0, 0.0, 1.0), Vec3::splat(1e-8), Vec3::splat(f32::INFINITY), Vec3::new(1e-3, 1e-3, 1.0)] {
        assert!(!is_placement(&Affine3A::from_scale(scale)), "{scale}");
    }
}
