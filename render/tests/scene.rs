//! Scenes: built-in ones, files, hits and shadows.

use std::path::{Path, PathBuf};

use glam::{Affine3A, EulerRot, Quat, Vec3, Vec3A};
use headtail_render::{
    brdf::{BrdfTable, Ggx, Kernel, Lambert, MetallicRoughness},
    random::{Purpose, Stream},
    scene::{Camera, Material, Mesh, Ray, Scene, built_in_names},
    tile::ShadingPoint,
};

/// Returns the folder of test data beside the project, if present.
fn shared_data() -> Option<PathBuf> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().map(|folder| folder.join("shared/data")).find(|data| data.is_dir())
}

/// Returns a box with the given corners, transformed.
fn moved_block(min: Vec3, max: Vec3, transform: &Affine3A) -> Scene {
    let corner = |i: u32| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
        Vec3::new(pick(0), pick(1), pick(2))
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = Mesh::new((0..8).map(corner).collect(), vec![], vec![], triangles, 0).unwrap().transformed(transform);
    Scene::new("block", vec![mesh], vec![Material::diffuse(Vec3A::splat(0.5))], None).unwrap()
}

fn block(min: Vec3, max: Vec3) -> Scene {
    moved_block(min, max, &Affine3A::IDENTITY)
}

fn albedo(at: &ShadingPoint) -> Vec3A {
    let parameters = &at.surface.parameters;
    let albedo = match at.surface.brdf {
        BrdfTable::LAMBERT => Lambert::of_parameters(parameters).albedo,
        BrdfTable::METALLIC_ROUGHNESS => MetallicRoughness::of_parameters(parameters).base_color(),
        BrdfTable::GGX => Ggx::of_parameters(parameters).f0(),
        other => panic!("BRDF {other}"),
    };
    albedo.into()
}

/// Returns whether the environment is visible from a point.
fn is_visible(scene: &Scene, at: &ShadingPoint, wi: Vec3A) -> bool {
    let mut visible = [false];
    scene.visible_batch(&[scene.leaving(at.p, at.ng, wi)], &mut visible);
    visible[0]
}

/// Checks the hit of each pixel of a small image and returns the number of hits.
fn look_at(scene: &Scene) -> usize {
    const SIDE: usize = 64;
    let camera = scene.camera();
    let hit = |i: usize| {
        let ray = camera.ray((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5, SIDE, SIDE);
        scene.intersect(&ray).inspect(|at| {
            assert!(at.p.is_finite());
            assert!(at.ng.is_normalized() && at.ns.is_normalized() && at.wo.is_normalized());
            assert!(at.ng.dot(at.wo) >= 0.0 && at.ns.dot(at.wo) > 0.0, "{at:?}");
            assert!(albedo(at).cmpge(Vec3A::ZERO).all() && albedo(at).cmple(Vec3A::ONE).all());
        })
    };
    (0..SIDE * SIDE).filter_map(hit).count()
}

#[test]
fn built_in_scenes_are_valid_and_visible_to_their_cameras() {
    for name in built_in_names() {
        let scene = Scene::built_in(name).unwrap();
        assert_eq!(scene.name(), name);
        assert!(scene.triangle_count() > 0);
        assert!(scene.triangles().flatten().all(Vec3::is_finite));
        let seen = look_at(&scene);
        assert!(seen > 64 * 64 / 5, "{name}: only {seen} of 4096 pixels see a surface");
    }
}

#[test]
fn the_scenes_of_the_test_data_load() {
    let Some(data) = shared_data() else {
        println!("shared/data is not there: this test used the built-in scenes only");
        return;
    };
    for (file, triangles) in [
        ("japanese_temple.glb", 29_696),
        ("terrarium_robots.glb", 55_682),
        ("japanese_bridge_garden.glb", 21_883),
        ("usd_shaderball.glb", 63_856),
        ("spot.glb", 5_856),
        ("flight_helmet/FlightHelmet.gltf", 94_722),
    ] {
        let path = data.join("scenes").join(file);
        let mut scene = Scene::load(&path).unwrap();
        // The files contain a few degenerate triangles, which are dropped.
        assert!(scene.triangle_count() <= triangles && scene.triangle_count() > triangles * 99 / 100, "{file}");
        assert_eq!(scene.name(), path.file_stem().unwrap().to_str().unwrap());
        assert!(look_at(&scene) > 300, "{file}");
        scene.add_ground();
        assert!(look_at(&scene) > 2000, "{file}");
    }
    // The helmet's leather is brown if the texture is found, decoded and not upside down.
    let scene = Scene::load(&data.join("scenes/flight_helmet/FlightHelmet.gltf")).unwrap();
    let bounds = scene.bounds();
    let above = bounds.center() + Vec3A::Y * bounds.extent().y;
    let top = albedo(&scene.intersect(&Ray::new(above, -Vec3A::Y)).unwrap());
    assert!(top.x > 1.2 * top.z && top.max_element() < 0.5, "{top}");
}

#[test]
fn unknown_names_list_the_built_in_ones() {
    let message = Scene::open("no such scene").err().unwrap().to_string();
    assert!(built_in_names().all(|name| message.contains(name)), "{message}");
    assert!(Scene::open("sphere").is_ok());
    assert!(Scene::built_in("no such scene").is_none());
}

#[test]
fn the_sphere_is_a_sphere() {
    let scene = Scene::built_in("sphere").unwrap();
    let mut random = Stream::new(1, Purpose::Test, 0);
    for _ in 0..20_000 {
        let outside = 3.0 * random.direction();
        let target = 0.9 * random.uniform() * random.direction();
        let at = scene.intersect(&Ray::new(outside, (target - outside).normalize())).unwrap();
        // Sagitta of facets of 2 pi / 256, in both directions.
        assert!((at.p.length() - 1.0).abs() < 2e-4, "{}", at.p.length());
        assert!(at.ns.dot(at.p) > 1.0 - 1e-3, "{at:?}");
        assert_eq!(albedo(&at), Vec3A::ONE);
    }
}

#[test]
fn no_ray_leaves_a_closed_surface_between_its_triangles() {
    let scene = Scene::built_in("sphere").unwrap();
    let mut random = Stream::new(2, Purpose::Test, 0);
    let escaped = (0..300_000)
        .filter(|_| {
            let from = 0.9 * random.uniform() * random.direction();
            scene.intersect(&Ray::new(from, random.direction())).is_none()
        })
        .count();
    assert_eq!(escaped, 0);
}

#[test]
fn surfaces_do_not_shadow_themselves_at_any_scale_place_and_angle() {
    let mut random = Stream::new(4, Purpose::Test, 0);
    let turned = Quat::from_euler(EulerRot::XYZ, 0.3, 1.1, -0.7);
    for size in [1e-4, 1.0, 1e5] {
        for place in [0.0, 3.0, 1e3] {
            for (turn, least_cosine) in [(Quat::IDENTITY, 0.0), (turned, 1e-3)] {
                // A box is convex: every direction above a face is unoccluded. Rounding of a rotated box's
                // corners (6e-5 of its size at the farthest place) can fold a face and occlude grazing
                // directions.
                let center = place * size * Vec3::new(1.0, -0.7, 0.4);
                let half = size * Vec3::new(1.0, 0.3, 0.6);
                let scene = moved_block(-half, half, &Affine3A::from_rotation_translation(turn, center));
                for _ in 0..4000 {
                    let outside = Vec3A::from(center) + 4.0 * size * random.direction();
                    let target = Vec3A::from(center) + 0.5 * size * random.direction() * random.uniform();
                    let Some(at) = scene.intersect(&Ray::new(outside, (target - outside).normalize())) else {
                        continue;
                    };
                    let wi = random.direction();
                    let wi = if wi.dot(at.ng) < 0.0 { -wi } else { wi };
                    if wi.dot(at.ng) > least_cosine {
                        assert!(is_visible(&scene, &at, wi), "size {size}, place {place}, {turn}: {at:?} towards {wi}");
                    }
                }
            }
        }
    }
}

#[test]
fn blocks_cast_shadows_on_the_ground() {
    let mut scene = block(Vec3::new(-1.0, 1.0, -1.0), Vec3::new(1.0, 2.0, 1.0));
    scene.add_ground();
    // The ground touches the block's underside, so it is viewed from above, beside the block.
    let beside = scene.intersect(&Ray::new(Vec3A::new(1.5, 5.0, 0.0), -Vec3A::Y)).unwrap();
    assert!((beside.p.y - 1.0).abs() < 1e-5 && albedo(&beside) == Vec3A::splat(0.5));
    assert!(is_visible(&scene, &beside, Vec3A::Y));
    assert!(!is_visible(&scene, &beside, Vec3A::new(-1.0, 0.5, 0.0).normalize()));
    assert!(is_visible(&scene, &beside, Vec3A::new(-1.0, 3.0, 0.0).normalize()));
    // Towards the horizon, down to 1e-4 rad.
    for azimuth in 0..16 {
        let (z, x) = (azimuth as f32 * std::f32::consts::TAU / 16.0).sin_cos();
        let eye = Vec3A::new(0.3, 5.0, -0.2);
        let far = scene.intersect(&Ray::new(eye, Vec3A::new(x, -1e-4, z).normalize())).unwrap();
        assert!((far.p.y - 1.0).abs() < 1.0 && far.ng.y > 0.999 && is_visible(&scene, &far, Vec3A::Y), "{far:?}");
        assert!(scene.intersect(&Ray::new(eye, Vec3A::new(x, 1e-4, z).normalize())).is_none());
    }
}

#[test]
fn ground_to_the_horizon_does_not_reduce_precision_near_the_object() {
    let mut scene = block(Vec3::new(-1.0, 1.0, -1.0), Vec3::new(1.0, 2.0, 1.0));
    scene.add_ground();
    let mut random = Stream::new(8, Purpose::Test, 0);
    let mut near = 0;
    for _ in 0..100_000 {
        // From the size of the block to 4,000 times it.
        let distance = (1.0 + 11.0 * random.uniform()).exp2();
        let (z, x) = (random.uniform() * std::f32::consts::TAU).sin_cos();
        let eye = Vec3A::new(0.0, 8.0, 0.0);
        let target = Vec3A::new(x * distance, 1.0, z * distance);
        let Some(at) = scene.intersect(&Ray::new(eye, (target - eye).normalize())) else { continue };
        if at.p.y < 1.5 && at.ng.y > 0.5 {
            // 1e-6 of the corner coordinates, which are within four times the distance, plus that of the
            // block.
            assert!(at.p.y >= 1.0 && at.p.y - 1.0 < 6e-6 * distance.max(2.0), "{at:?}");
            // Flat ground has no self-shadowing, not even along triangle edges.
            let wi = random.direction();
            let away = Vec3A::new(wi.x.abs() * x.signum(), wi.y.abs(), wi.z.abs() * z.signum()).normalize();
            assert!(away.y < 1e-3 || distance < 4.0 || is_visible(&scene, &at, away), "{at:?} {away}");
            near += 1;
        }
    }
    assert!(near > 90_000, "{near}");
}

#[test]
fn adding_ground_does_not_move_the_camera() {
    let mut scene = block(Vec3::ZERO, Vec3::ONE);
    let cameras = |scene: &Scene| [4.0 / 3.0, 16.0 / 9.0, 0.5].map(|aspect| scene.camera_for(aspect));
    let before = cameras(&scene);
    scene.add_ground();
    assert_eq!(cameras(&scene), before);
}

#[test]
fn one_material_can_replace_all() {
    let red = Vec3A::new(0.8, 0.1, 0.1);
    let scene = Scene::built_in("dishes").unwrap().with_material(Material::diffuse(red));
    let camera = scene.camera();
    for x in 0..32 {
        if let Some(at) = scene.intersect(&camera.ray(x as f32, 20.0, 32, 32)) {
            assert_eq!(albedo(&at), red);
        }
    }
}

#[test]
fn albedos_are_clamped_to_energy_conservation() {
    let scene = block(Vec3::ZERO, Vec3::ONE).with_material(Material::diffuse(Vec3A::new(2.0, -1.0, 0.5)));
    let at = scene.intersect(&Ray::new(Vec3A::new(0.5, 0.5, 3.0), -Vec3A::Z)).unwrap();
    assert_eq!(albedo(&at), Vec3A::new(1.0, 0.0, 0.5));
}

#[test]
fn empty_scenes_and_missing_materials() {
    let mut empty = Scene::new("empty", vec![], vec![], None).unwrap();
    assert!(empty.bounds().is_empty());
    assert!(empty.intersect(&Ray::new(Vec3A::ZERO, Vec3A::Z)).is_none());
    assert!(empty.camera().look_from().is_finite());
    empty.add_ground();
    assert!(empty.triangle_count() > 2 && empty.bounds().extent().x > 1e5);

    let mesh = Mesh::new(vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![], vec![], vec![[0, 1, 2]], 1).unwrap();
    let camera = Camera::new(Vec3A::Z, Vec3A::ZERO, 40.0).ok();
    assert!(Scene::new("bad", vec![mesh], vec![Material::diffuse(Vec3A::ONE)], camera).is_err());
}

#[test]
fn scenes_have_equal_hashes_if_and_only_if_their_contents_are_equal() {
    let of = |name: &str| Scene::built_in(name).unwrap().content_hash();
    let mut hashes: Vec<String> = built_in_names().map(of).collect();
    assert_eq!(hashes[0], of("temple"));
    let sphere = || Scene::built_in("sphere").unwrap();
    hashes.push(sphere().with_material(Material::diffuse(Vec3A::splat(0.5))).content_hash());
    hashes.push(sphere().with_material(Material::diffuse(Vec3A::new(0.5, 0.5, 0.500_000_06))).content_hash());
    let mut grounded = sphere();
    grounded.add_ground();
    hashes.push(grounded.content_hash());
    let count = hashes.len();
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), count);
}
