//! Masked sheets: agreement with brute force, and edge cases.

use glam::{DVec3, Vec3};

use super::*;
use crate::{
    random::{Purpose, Stream},
    scene::{Filter, Material, Wrap},
};

/// A parallelogram of two triangles; texture coordinates are 0 to 1 along both edges.
fn sheet(corner: Vec3, [a, b]: [Vec3; 2]) -> Mesh {
    let positions = vec![corner, corner + a, corner + a + b, corner + b];
    let texcoords = vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    Mesh::new(positions, vec![], texcoords, vec![[0, 1, 2], [0, 2, 3]], 0).unwrap()
}

/// The mask of a texture with `columns` texels in a row.
fn mask(columns: usize, alphas: &[u8]) -> Mask {
    let texture =
        AlphaTexture::new(columns, alphas.len() / columns, alphas.to_vec(), [Wrap::Clamp; 2], Filter::default())
            .unwrap();
    Mask { cutoff: 0.5, factor: 1.0, texture: Some(Arc::new(texture)) }
}

fn scene(meshes: Vec<Mesh>) -> Scene {
    Scene::new("masked", meshes, vec![Material::diffuse(Vec3A::ONE)], None).unwrap()
}

/// A point of the cube from -1 to 1.
fn point(random: &mut Stream) -> Vec3 {
    Vec3::new(random.uniform(), random.uniform(), random.uniform()) * 2.0 - 1.0
}

/// Squares of width 0.8, every other one parallel to two axes; one in eight has no mask.
fn squares(count: usize, random: &mut Stream) -> Vec<Mesh> {
    let square = |k: usize| {
        let a = if k.is_multiple_of(2) { Vec3A::AXES[k / 2 % 3] } else { random.direction() };
        let b = if k.is_multiple_of(2) { Vec3A::AXES[(k / 2 + 1) % 3] } else { a.any_orthonormal_vector() };
        let own = sheet(point(random), [a, b].map(|edge| Vec3::from(0.8 * edge)));
        let alphas = [0; 16].map(|_| if random.uniform() < 0.35 { 255 } else { 0 });
        if k % 8 == 3 { own } else { own.with_mask(mask(4, &alphas)) }
    };
    (0..count).map(square).collect()
}

/// Rays from around the cube and within, one in three along an axis.
fn rays(count: usize, random: &mut Stream) -> Vec<Ray> {
    let ray = |k: usize| {
        let along = if k.is_multiple_of(2) { Vec3A::AXES[k / 3 % 3] } else { -Vec3A::AXES[k / 3 % 3] };
        let direction = if k.is_multiple_of(3) { along } else { random.direction() };
        Ray::new(1.5 * Vec3A::from(point(random)), direction)
    };
    (0..count).map(ray).collect()
}

fn closest(scene: &Scene, rays: &[Ray]) -> Vec<Option<Hit>> {
    let mut hits = vec![None; rays.len()];
    scene.closest_batch(RayKind::Camera, rays, &mut hits);
    hits
}

fn visible(scene: &Scene, rays: &[Ray]) -> Vec<bool> {
    let mut visible = vec![false; rays.len()];
    scene.visible_batch(rays, &mut visible);
    visible
}

/// A point where a ray goes through a triangle.
#[derive(Debug)]
struct Crossing {
    t: f64,
    alpha: f32,
    /// Absolute cosine of the angle between the ray and the triangle's normal.
    cosine: f64,
}

/// The crossings of a ray by distance, in f64; `margin` enlarges triangles in barycentric units.
fn crossings(scene: &Scene, ray: &Ray, margin: f64) -> Vec<Crossing> {
    let (origin, direction) = (DVec3::from(Vec3::from(ray.origin)), DVec3::from(Vec3::from(ray.direction)));
    let mut crossings = Vec::new();
    for mesh in &scene.meshes {
        for (triangle, vertices) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = mesh.corners(triangle).map(DVec3::from);
            let normal = (b - a).cross(c - a);
            let t = normal.dot(a - origin) / normal.dot(direction);
            let p = origin + t * direction;
            let area = |x: DVec3, y: DVec3| (x - p).cross(y - p).dot(normal) / normal.length_squared();
            let weights = [area(b, c), area(c, a), area(a, b)];
            if !(t >= 0.0 && t.is_finite() && weights.iter().all(|&weight| weight >= -margin)) {
                continue;
            }
            let uv = (0..3).map(|k| weights[k] as f32 * mesh.texcoords[vertices[k] as usize]).sum::<Vec2>();
            let texture = mesh.mask.as_ref().and_then(|mask| mask.texture.as_ref());
            let alpha = texture.map_or(1.0, |texture| texture.sample(uv));
            crossings.push(Crossing { t, alpha, cosine: normal.normalize().dot(direction).abs() });
        }
    }
    crossings.sort_by(|x, y| x.t.total_cmp(&y.t));
    crossings
}

/// [`crossings`], unless rounding may decide: at edges, at grazing angles, where alpha is close to
/// the cutoff, and between surfaces that touch.
fn decided_crossings(scene: &Scene, ray: &Ray) -> Option<Vec<Crossing>> {
    let all = crossings(scene, ray, 1e-3);
    let is_decided = crossings(scene, ray, -1e-3).len() == all.len()
        && all.iter().all(|crossing| (crossing.alpha - 0.5).abs() > 5e-3 && crossing.cosine > 1e-2)
        && all.windows(2).all(|pair| pair[1].t - pair[0].t > 1e-4);
    is_decided.then_some(all)
}

#[test]
fn layers_agree_with_brute_force() {
    let mut random = Stream::new(6, Purpose::Test, 0);
    let scene = scene(squares(100, &mut random));
    assert!(scene.masked.count() > 0 && scene.triangle_count() > 180);
    let rays = rays(6000, &mut random);
    let (hits, visible) = (closest(&scene, &rays), visible(&scene, &rays));
    let (mut decided, mut passed) = (0, 0);
    for ((ray, hit), visible) in rays.iter().zip(hits).zip(visible) {
        let Some(crossings) = decided_crossings(&scene, ray) else { continue };
        let first = crossings.iter().position(|crossing| crossing.alpha >= 0.5);
        decided += 1;
        passed += usize::from(first.unwrap_or(crossings.len()) >= 2);
        assert_eq!((hit.is_some(), visible), (first.is_some(), first.is_none()), "{ray:?}: {crossings:?}");
        let (Some(hit), Some(first)) = (hit, first) else { continue };
        let expected = crossings[first].t;
        assert!((f64::from(hit.t) - expected).abs() <= 1e-4 * (1.0 + expected), "{ray:?}: {hit:?}, not {expected}");
        let p = scene.intersect(ray).unwrap().p;
        assert_eq!(p, scene.surface(ray, &hit, 0.0).p);
        assert!((p - ray.at(hit.t)).length() < 1e-3, "{p} against {}", ray.at(hit.t));
    }
    assert!(2 * decided > rays.len(), "only {decided} rays say anything");
    assert!(passed > 200, "only {passed} rays pass two layers");
}

#[test]
fn masks_without_holes_change_no_hit() {
    let mut random = Stream::new(7, Purpose::Test, 0);
    let plain: Vec<Mesh> = squares(60, &mut random).into_iter().map(|own| Mesh { mask: None, ..own }).collect();
    // Set by hand, because `with_mask` would drop it.
    let masked = plain.iter().map(|own| Mesh { mask: Some(mask(1, &[255])), ..own.clone() });
    let (masked, plain) = (scene(masked.collect()), scene(plain));
    assert!(masked.masked.count() > 0 && plain.masked.count() == 0);
    let rays = rays(3000, &mut random);
    assert_eq!(closest(&masked, &rays), closest(&plain, &rays));
    assert_eq!(visible(&masked, &rays), visible(&plain, &rays));
}

#[test]
fn masks_without_effect_are_dropped() {
    let own = |alphas: &[u8], factor: f32| {
        let own = sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]).with_mask(Mask { factor, ..mask(2, alphas) });
        (own.mask.is_some(), own.triangles.len())
    };
    assert_eq!(own(&[255, 128], 1.0), (false, 2));
    assert_eq!(own(&[255, 127], 1.0), (true, 2));
    assert_eq!(own(&[127, 0], 1.0), (false, 0));
    assert_eq!(own(&[255, 254], 0.4), (false, 0));
    assert_eq!(own(&[255, 128], 0.9), (true, 2));
    // Vertex alphas apply; without coordinates, texels do not.
    let bare = Mesh { texcoords: vec![], ..sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]) };
    assert!(bare.clone().with_mask(mask(2, &[255, 0])).mask.is_none());
    let faded = bare.with_alphas(vec![1.0, 0.2, 0.2, 1.0]).unwrap();
    assert!(faded.clone().with_mask(mask(2, &[255, 0])).mask.is_some());
    assert!(faded.with_mask(Mask { cutoff: 0.1, ..mask(2, &[255, 0]) }).mask.is_none());
    assert!(sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]).with_alphas(vec![1.0, f32::NAN, 1.0, 1.0]).is_err());
    assert!(sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]).with_alphas(vec![1.0; 3]).is_err());
}

/// An opaque floor at z = 0 under `count` sheets at z = 0.01, 0.02, ..., transparent for x < 0.5.
fn stack(count: usize) -> Scene {
    let left = mask(2, &[0, 255]);
    let layer = |k: usize| {
        let corner = Vec3::new(0.0, 0.0, 0.01 * k as f32);
        let own = sheet(corner, [Vec3::X, Vec3::Y]);
        if k == 0 { own } else { own.with_mask(left.clone()) }
    };
    scene((0..=count).map(layer).collect())
}

#[test]
fn rays_pass_255_surfaces_and_stop_at_the_next() {
    let height = |scene: &Scene, x: f32| {
        let ray = Ray::new(Vec3A::new(x, 0.3, 10.0), -Vec3A::Z);
        scene.intersect(&ray).unwrap().p.z
    };
    let passed = stack(MOST_LAYERS - 1);
    assert!(height(&passed, 0.1).abs() < 1e-3, "{}", height(&passed, 0.1));
    assert!((height(&passed, 0.9) - 2.55).abs() < 1e-3);
    let up = [0.1, 0.9].map(|x| Ray::new(Vec3A::new(x, 0.3, 0.005), Vec3A::Z));
    assert_eq!(visible(&passed, &up), [true, false]);

    let deep = stack(300);
    // From above, the 256th of 300 sheets is the 45th from below.
    assert!((height(&deep, 0.1) - 0.45).abs() < 1e-3, "{}", height(&deep, 0.1));
    assert_eq!(visible(&deep, &up), [false, false]);
}

#[test]
fn grazing_rays_pass_coplanar_copies() {
    let layer = sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]).with_mask(mask(2, &[0, 255]));
    let floor = sheet(Vec3::new(-1e3, -1e3, -0.01), [2e3 * Vec3::X, 2e3 * Vec3::Y]);
    let scene = scene([vec![layer; 50], vec![floor]].concat());
    for cosine in [1.0, 0.1, 1e-2, 1e-3, 1e-4] {
        let direction = Vec3A::new(0.0, 1.0, -cosine).normalize();
        let through = |x: f32| Ray::new(Vec3A::new(x, 0.3, 0.0) - 0.2 * direction, direction);
        let [hole, solid] = [0.1, 0.9].map(|x| scene.intersect(&through(x)).unwrap().p.z);
        assert!((-0.0101..-0.005).contains(&hole), "{cosine}: {hole}");
        assert!(solid.abs() < 1e-5, "{cosine}: {solid}");
    }
}

#[test]
fn hits_behind_masks_are_measured_from_the_origin() {
    let scene = stack(3);
    let ray = Ray::new(Vec3A::new(0.1, 0.3, 5.0), -Vec3A::Z);
    let hit = closest(&scene, &[ray])[0].unwrap();
    assert!((hit.t - 5.0).abs() < 1e-5, "{hit:?}");
    let hit = closest(&scene, &[Ray::new(Vec3A::new(0.9, 0.3, 5.0), -Vec3A::Z)])[0].unwrap();
    assert!((hit.t - 4.97).abs() < 1e-5 && scene.mesh_of(&hit) == 3, "{hit:?}");
}

#[test]
fn parts_and_other_materials_keep_masks() {
    let scene = stack(2);
    let moved = scene.moved(&glam::Affine3A::from_translation(Vec3::X)).unwrap();
    let joined = scene.joined(&moved).unwrap().with_material(Material::diffuse(Vec3A::X));
    let down = [0.1, 0.9, 1.1, 1.9].map(|x| Ray::new(Vec3A::new(x, 0.3, 5.0), -Vec3A::Z));
    let meshes = closest(&joined, &down).into_iter().map(|hit| joined.mesh_of(&hit.unwrap()));
    assert_eq!(meshes.collect::<Vec<_>>(), [0, 2, 3, 5]);
}

#[test]
fn hashes_distinguish_masks() {
    let of = |mask: Option<Mask>, alphas: Vec<f32>| {
        let own = sheet(Vec3::ZERO, [Vec3::X, Vec3::Y]).with_alphas(alphas).unwrap();
        let own = match mask {
            Some(mask) => own.with_mask(mask),
            None => own,
        };
        let scene = scene(vec![own]);
        [scene.geometry_hash(), scene.content_hash()]
    };
    let own = mask(2, &[0, 255]);
    let plain = of(None, vec![]);
    assert_eq!(of(Some(mask(2, &[255, 255])), vec![]), plain);
    assert_eq!(of(Some(own.clone()), vec![]), of(Some(mask(2, &[0, 255])), vec![]));
    let mut hashes = vec![
        plain,
        of(Some(own.clone()), vec![]),
        of(Some(mask(2, &[1, 255])), vec![]),
        of(Some(mask(1, &[0, 255])), vec![]),
        of(Some(Mask { cutoff: 0.25, ..own.clone() }), vec![]),
        of(Some(Mask { factor: 0.75, ..own.clone() }), vec![]),
        of(Some(own), vec![0.75; 4]),
    ];
    for kind in 0..2 {
        hashes.sort_by(|x, y| x[kind].cmp(&y[kind]));
        assert!(hashes.windows(2).all(|pair| pair[0][kind] != pair[1][kind]), "{hashes:?}");
    }
}
