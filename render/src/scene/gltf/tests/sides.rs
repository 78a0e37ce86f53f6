//! Single-sided surfaces: cameras do not see their back faces, light does not pass them.

use glam::Vec3A;
use serde_json::{Value, json};

use super::{
    glb, load,
    masks::square,
    set, triangle,
    unusual::{add_floats, warnings},
};
use crate::scene::{LoadOptions, Ray, RayKind, Scene, gltf::MOST_COPIED};

/// Whether a camera sees the surface at `(x, y)` from +z and from -z. Shadow rays and bounces hit both sides.
fn seen_at(scene: &Scene, [x, y]: [f32; 2]) -> [bool; 2] {
    [1.0, -1.0].map(|side| {
        let ray = Ray::new(Vec3A::new(x, y, 9.0 * side), -side * Vec3A::Z);
        let mut visible = [false];
        scene.visible_batch(&[ray], &mut visible);
        assert!(!visible[0] && scene.intersect_one(RayKind::Bounce, &ray).is_some(), "{x}, {y}, {side}");
        let alone = scene.intersect(&ray);
        // Eight rays are traced as a packet.
        let mut hits = [None; 8];
        scene.closest_batch(RayKind::Camera, &[ray; 8], &mut hits);
        assert!(hits.iter().all(|hit| hit.is_some() == alone.is_some()), "{x}, {y}, {side}");
        alone.is_some()
    })
}

#[test]
fn cameras_see_single_sided_surfaces_from_the_front_only() {
    let (mut json, bin) = triangle();
    let seen = |json: &Value| seen_at(&load(json, &bin).unwrap(), [0.2, 0.2]);
    assert_eq!(seen(&json), [true, false]);
    set(&mut json, "/materials/0/doubleSided", json!(false));
    assert_eq!(seen(&json), [true, false]);
    set(&mut json, "/materials/0/doubleSided", json!(true));
    assert_eq!(seen(&json), [true, true]);
    // The default material is single-sided.
    json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
    assert_eq!(seen(&json), [true, false]);
}

#[test]
fn transforms_that_mirror_take_the_front_with_them() {
    let (mut json, bin) = triangle();
    let mut seen = |node: Value, at: [f32; 2]| {
        set(&mut json, "/nodes", json!([{"children": [1], "scale": [2, 2, 2]}, node]));
        seen_at(&load(&json, &bin).unwrap(), at)
    };
    let [front, back] = [[true, false], [false, true]];
    assert_eq!(seen(json!({"mesh": 0}), [0.4, 0.4]), front);
    assert_eq!(seen(json!({"mesh": 0, "scale": [-1, 1, 1]}), [-0.4, 0.4]), front);
    assert_eq!(seen(json!({"mesh": 0, "scale": [1, 1, -1]}), [0.4, 0.4]), back);
    assert_eq!(seen(json!({"mesh": 0, "scale": [-1, 1, -1]}), [-0.4, 0.4]), back);
    assert_eq!(seen(json!({"mesh": 0, "scale": [-1, -1, -1]}), [-0.4, -0.4]), back);
    // Half a turn about y.
    assert_eq!(seen(json!({"mesh": 0, "rotation": [0, 1, 0, 0]}), [-0.4, 0.4]), back);
    // The determinant of tiny scales is not lost in 32 bits.
    let (json, bin) = triangle();
    let scene = load(&json, &bin).unwrap();
    let mirrored = scene.meshes[0].clone().transformed(&glam::Affine3A::from_scale(glam::vec3(-1e-18, 1e-18, 1e-18)));
    assert_eq!(mirrored.triangles, [[0, 2, 1]]);
}

#[test]
fn skinned_surfaces_turn_with_the_determinant_of_their_node() {
    let (mut json, mut bin) = triangle();
    let joints = add_floats(&mut json, &mut bin, "VEC4", &[0.0; 12]);
    let weights = add_floats(&mut json, &mut bin, "VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    set(&mut json, "/meshes/0/primitives/0/attributes/JOINTS_0", json!(joints));
    set(&mut json, "/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(weights));
    set(&mut json, "/skins", json!([{"joints": [1]}]));
    let mut seen = |root: Value, at: [f32; 2]| {
        set(&mut json, "/nodes", json!([root, {}, {"mesh": 0, "skin": 0}]));
        seen_at(&load(&json, &bin).unwrap(), at)
    };
    let both = [1, 2];
    assert_eq!(seen(json!({"children": both}), [0.2, 0.2]), [true, false]);
    // A parent mirrors both the joint and the node: the front stays on the same side.
    assert_eq!(seen(json!({"children": both, "scale": [-1, 1, 1]}), [-0.2, 0.2]), [true, false]);
    assert_eq!(seen(json!({"children": both, "scale": [1, 1, -1]}), [0.2, 0.2]), [false, true]);
}

#[test]
fn copies_and_masks_have_the_sides_of_their_material() {
    // A square with holes at two corners, mirrored or turned in four places; shared or copied.
    let (mut json, mut bin) = square([255, 0, 0, 255]);
    let places = [0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 6.0, 0.0, 0.0, 9.0, 0.0, 0.0];
    let places = add_floats(&mut json, &mut bin, "VEC3", &places);
    let sizes =
        add_floats(&mut json, &mut bin, "VEC3", &[1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]);
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": sizes}}});
    set(&mut json, "/nodes", json!([{"mesh": 0, "extensions": extension}]));
    set(&mut json, "/materials/0/doubleSided", json!(false));
    for mode in ["MASK", "OPAQUE"] {
        set(&mut json, "/materials/0/alphaMode", json!(mode));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
        for most in [0, MOST_COPIED] {
            let scene = Scene::load_within(&path, &LoadOptions::default(), most).unwrap();
            assert_eq!(scene.meshes.len(), if most == 0 { 1 } else { 4 });
            let seen = [0.1, 3.9, 6.1, 8.9].map(|x| seen_at(&scene, [x, 0.2]));
            assert_eq!(seen, [[true, false], [true, false], [false, true], [false, true]], "{mode} {most}");
        }
    }
}

#[test]
fn rooms_show_their_inside_and_keep_light_out() {
    // A red square between two walls: the camera is behind the nearer one, and both face the square.
    let (mut json, bin) = square([255; 4]);
    set(
        &mut json,
        "/materials",
        json!([
            {"pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.1, 0.1, 1], "metallicFactor": 0}},
            {"pbrMetallicRoughness": {"baseColorFactor": [0.7, 0.7, 0.7, 1], "metallicFactor": 0}}
        ]),
    );
    let mut wall = json["meshes"][0].clone();
    wall["primitives"][0]["material"] = json!(1);
    json["meshes"].as_array_mut().unwrap().push(wall);
    let far = json!({"mesh": 1, "translation": [-2, -2, -1], "scale": [5, 5, 1]});
    let near = json!({"mesh": 1, "translation": [-2, 3, 1], "scale": [5, 5, 1], "rotation": [1, 0, 0, 0]});
    set(&mut json, "/nodes", json!([{"mesh": 0}, far, near]));
    set(&mut json, "/scenes/0/nodes", json!([0, 1, 2]));
    for materials in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
        let scene = Scene::open_dressed(path.to_str().unwrap(), materials).unwrap();
        assert!(warnings(&scene).is_empty());
        let at = scene.intersect(&Ray::new(Vec3A::new(0.5, 0.5, 5.0), -Vec3A::Z)).unwrap();
        assert!(at.p.z.abs() < 1e-3, "{}", at.p);
        if materials {
            let color = super::surface_at(&scene, 0.5, 0.5).base_color();
            assert!((color - glam::vec3(0.8, 0.1, 0.1)).length() < 1e-6, "{color}");
        }
        let mut visible = [true];
        scene.visible_batch(&[scene.leaving(at.p, at.ng, Vec3A::Z)], &mut visible);
        assert!(!visible[0]);
        // From the inside, the wall is seen.
        assert!(scene.intersect(&Ray::new(Vec3A::new(0.5, 0.5, 0.5), Vec3A::Z)).is_some());
    }
    let [before, after] = [false, true].map(|is_double| {
        set(&mut json, "/materials/1/doubleSided", json!(is_double));
        let scene = load(&json, &bin).unwrap();
        (scene.content_hash(), scene.geometry_hash())
    });
    assert!(before.0 != after.0 && before.1 == after.1);
}
