//! Valid but unusual files: their meaning and their remarks.

use glam::{Vec3, Vec3A};
use serde_json::{Value, json};

use super::{color_at, glb, load, load_bytes, set, triangle};
use crate::{
    remark::Remark,
    scene::{LoadOptions, Ray, Scene},
};

/// The texts of a scene's warnings.
pub(super) fn warnings(scene: &Scene) -> Vec<&str> {
    scene.remarks().iter().filter(|remark| remark.is_warning()).map(Remark::text).collect()
}

/// Adds floats as a buffer view and an accessor of a type; returns the accessor's index.
pub(super) fn add_floats(json: &mut Value, bin: &mut Vec<u8>, kind: &str, values: &[f32]) -> usize {
    let components = match kind {
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        "MAT4" => 16,
        _ => 1,
    };
    let view = json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": 4 * values.len()});
    bin.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    set(json, "/buffers/0/byteLength", json!(bin.len()));
    let views = json["bufferViews"].as_array_mut().unwrap();
    views.push(view);
    let accessor =
        json!({"bufferView": views.len() - 1, "componentType": 5126, "count": values.len() / components, "type": kind});
    let accessors = json["accessors"].as_array_mut().unwrap();
    accessors.push(accessor);
    accessors.len() - 1
}

pub(super) fn corners(scene: &Scene) -> Vec<[Vec3; 3]> {
    scene.triangles().collect()
}

#[test]
fn unused_parts_do_not_make_files_unreadable() {
    let (plain, bin) = triangle();
    let expected = corners(&load(&plain, &bin).unwrap());
    let pointer = json!({"KHR_animation_pointer": {"pointer": "/materials/0/x"}});
    let channel = json!({"sampler": 0, "target": {"path": "pointer", "extensions": pointer}});
    let changes = [
        ("/animations", json!([{"channels": [channel], "samplers": [{"input": 99, "output": 99}]}])),
        ("/asset/extras", json!("text")),
        ("/nodes/0/extras", Value::Null),
        ("/nodes/0/extensions", json!({"ACME_thing": 3})),
        ("/skins", json!("no skins at all")),
        ("/skins", json!([{"joints": "none"}, 7])),
        ("/cameras", json!({})),
        ("/cameras", json!([{"type": 3}, null])),
        ("/images", json!([{"bufferView": -1}, {"uri": "../../../absent.png"}, {"uri": 5}])),
        ("/samplers", json!([{"magFilter": "sharp"}])),
        ("/textures", json!([{"source": "x"}, {"source": 99}])),
        ("/materials/1", json!({"pbrMetallicRoughness": {"baseColorFactor": "red"}})),
        ("/materials/1", json!({"normalTexture": {"index": 99}, "emissiveFactor": [-1, 0, 0]})),
        ("/meshes/1", json!({"primitives": [{"attributes": {"POSITION": 99}}]})),
        ("/meshes/1", json!({})),
        ("/nodes/1", json!({"mesh": 99, "rotation": [0, 0, 0, 0]})),
        ("/nodes/1", json!({"matrix": [1, 2, 3]})),
        ("/scenes/1", json!({"nodes": "all"})),
        ("/accessors/3", json!({"count": "many"})),
        ("/bufferViews/2", json!({"buffer": 99, "byteLength": -1})),
        ("/buffers", json!([{"byteLength": 68}, {"byteLength": 1}, {"byteLength": 1, "uri": "absent.bin"}])),
        ("/accessors/0/count", json!(3.0)),
        ("/accessors/0/componentType", json!(5126.0)),
        ("/nodes/0/mesh", json!(0.0)),
        ("/extensionsUsed", json!(["KHR_animation_pointer", "KHR_xmp_json_ld"])),
    ];
    for (pointer, value) in changes {
        let mut json = plain.clone();
        match pointer.rsplit_once('/').map(|(list, _)| json.pointer_mut(list)) {
            // One more element than there are.
            Some(Some(Value::Array(list))) if pointer.ends_with(&format!("/{}", list.len())) => list.push(value),
            _ => set(&mut json, pointer, value),
        }
        let scene = load(&json, &bin).unwrap_or_else(|error| panic!("{pointer}: {error}"));
        assert_eq!(corners(&scene), expected, "{pointer}");
        assert!(warnings(&scene).is_empty(), "{pointer}: {:?}", warnings(&scene));
    }
    let with_mark = [b"\xef\xbb\xbf", plain.to_string().as_bytes()].concat();
    assert_eq!(corners(&load_bytes(&glb(&with_mark, &bin)).unwrap()), expected);
    for wrong in [json!(0.5), json!(-1), json!(1e300), json!("0")] {
        let mut json = plain.clone();
        set(&mut json, "/nodes/0/mesh", wrong);
        assert!(load(&json, &bin).is_err());
    }
}

#[test]
fn without_scenes_all_root_nodes_are_shown() {
    let (mut json, bin) = triangle();
    for key in ["scene", "scenes"] {
        json.as_object_mut().unwrap().remove(key);
    }
    set(&mut json, "/nodes", json!([{"children": [2]}, {"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]));
    assert_eq!(load(&json, &bin).unwrap().triangle_count(), 2);
}

#[test]
fn scenes_and_cameras_are_chosen_by_name_or_number() {
    let (mut json, bin) = triangle();
    set(&mut json, "/scenes", json!([{"nodes": [0]}, {"name": "two", "nodes": [1, 2, 3]}]));
    let view = json!({"type": "perspective", "name": "wide", "perspective": {"yfov": 1.0, "znear": 0.1}});
    set(&mut json, "/cameras", json!([view]));
    let camera = |name: &str, x: f32| json!({"camera": 0, "name": name, "translation": [x, 0, 4]});
    set(
        &mut json,
        "/nodes",
        json!([{"mesh": 0}, {"children": [4], "mesh": 0}, camera("left", -1.0), camera("right", 1.0), {"mesh": 0}]),
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
    let of = |scene| Scene::load_with(&path, &LoadOptions { scene, ..LoadOptions::default() });
    assert_eq!([None, Some("two"), Some("1")].map(|scene| of(scene).unwrap().triangle_count()), [1, 2, 2]);
    let error = of(Some("three")).err().unwrap().to_string();
    assert!(error.contains("no scene is called 'three'; the file has 0, 'two'"), "{error}");

    let mut scene = Scene::open(&format!("{}#two", path.display())).unwrap();
    assert_eq!(scene.camera_names().collect::<Vec<_>>(), ["left", "right"]);
    assert_eq!(scene.camera().look_from().x, -1.0);
    scene.use_camera("right").unwrap();
    assert_eq!(scene.camera().look_from().x, 1.0);
    scene.use_camera("0").unwrap();
    assert_eq!(scene.camera().look_from().x, -1.0);
    assert!(scene.use_camera("up").unwrap_err().to_string().contains("'left', 'right'"));
}

#[test]
fn vertex_colors_multiply_the_base_color() {
    let base = Vec3A::new(0.5, 0.25, 0.125);
    for (kind, values) in [
        ("VEC3", vec![1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
        ("VEC4", vec![1.0, 0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.5]),
    ] {
        let (mut json, mut bin) = triangle();
        let colors = add_floats(&mut json, &mut bin, kind, &values);
        set(&mut json, "/meshes/0/primitives/0/attributes/COLOR_0", json!(colors));
        assert_eq!(color_at(&load(&json, &bin).unwrap(), 0.2, 0.2), base * Vec3A::X, "{kind}");
    }
    // They are interpolated, and bytes are fractions of 255.
    let (mut json, mut bin) = triangle();
    let start = bin.len();
    bin.extend([255, 255, 255, 255, 0, 0, 0, 255, 0, 0, 0, 255]);
    set(&mut json, "/buffers/0/byteLength", json!(bin.len()));
    json["bufferViews"].as_array_mut().unwrap().push(json!({"buffer": 0, "byteOffset": start, "byteLength": 12}));
    let accessor = json!({"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"});
    json["accessors"].as_array_mut().unwrap().push(accessor);
    set(&mut json, "/meshes/0/primitives/0/attributes/COLOR_0", json!(3));
    let seen = color_at(&load(&json, &bin).unwrap(), 0.25, 0.25);
    assert!((seen - 0.5 * base).abs().max_element() < 1e-6, "{seen}");
}

#[test]
fn texture_coordinates_are_moved() {
    // Texels are red, green, blue and white, clamped at the edges.
    let (plain, bin) = super::images::textured(&json!({"bufferView": 2}));
    let seen = |transform: Value, x: f32, y: f32| {
        let mut json = plain.clone();
        let info = json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
        set(&mut json, "/materials/0/pbrMetallicRoughness/baseColorTexture", info);
        set(&mut json, "/extensionsUsed", json!(["KHR_texture_transform"]));
        let scene = load(&json, &bin).unwrap();
        (color_at(&scene, x, y), warnings(&scene).len())
    };
    let color = |transform: Value, x: f32, y: f32| {
        let (color, warnings) = seen(transform, x, y);
        assert_eq!(warnings, 0);
        color
    };
    assert_eq!(color(json!({}), 0.1, 0.1), Vec3A::X);
    assert_eq!(color(json!({"offset": [0.8, 0]}), 0.1, 0.1), Vec3A::Y);
    assert_eq!(color(json!({"scale": [1, 9]}), 0.1, 0.1), Vec3A::Z);
    // A quarter turn takes (u, v) to (v, -u): right of the origin is above it, so that an offset brings it back.
    let quarter = json!({"rotation": std::f32::consts::FRAC_PI_2, "offset": [0, 1]});
    assert_eq!(color(quarter.clone(), 0.1, 0.1), Vec3A::Z);
    assert_eq!(color(quarter, 0.85, 0.1), Vec3A::X);
    // A missing set of coordinates: only the factor applies, with a warning.
    assert_eq!(seen(json!({"texCoord": 1}), 0.1, 0.1), (Vec3A::ONE, 1));
}

#[test]
fn sparse_elements_replace_others() {
    let (mut json, mut bin) = triangle();
    let moved = add_floats(&mut json, &mut bin, "VEC3", &[3.0, 0.0, 0.0]);
    let values = json["accessors"][moved]["bufferView"].clone();
    // Two bytes of index 1 are in the list of indices.
    let indices = json!({"bufferView": 1, "byteOffset": 2, "componentType": 5123});
    set(&mut json, "/accessors/0/sparse", json!({"count": 1, "indices": indices, "values": {"bufferView": values}}));
    assert_eq!(corners(&load(&json, &bin).unwrap())[0][1], Vec3::new(3.0, 0.0, 0.0));
}

#[test]
fn morph_targets_move_vertices_by_their_weights() {
    let (mut json, mut bin) = triangle();
    let moves = add_floats(&mut json, &mut bin, "VEC3", &[0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0]);
    set(&mut json, "/meshes/0/primitives/0/targets", json!([{"POSITION": moves}]));
    let height = |json: &Value| corners(&load(json, &bin).unwrap())[0][0].z;
    assert_eq!(height(&json), 0.0);
    set(&mut json, "/meshes/0/weights", json!([0.5]));
    assert_eq!(height(&json), 1.0);
    set(&mut json, "/nodes/0/weights", json!([0.25]));
    assert_eq!(height(&json), 0.5);
}

#[test]
fn instances_are_placed_by_their_node() {
    let (mut json, mut bin) = triangle();
    let places = add_floats(&mut json, &mut bin, "VEC3", &[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let sizes = add_floats(&mut json, &mut bin, "VEC3", &[1.0, 1.0, 1.0, 3.0, 3.0, 3.0]);
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": sizes}}});
    set(&mut json, "/nodes/0", json!({"mesh": 0, "translation": [0, 0, 1], "extensions": extension}));
    set(&mut json, "/extensionsRequired", json!(["EXT_mesh_gpu_instancing"]));
    let all = corners(&load(&json, &bin).unwrap());
    let found = |expected: Vec3| all.iter().flatten().any(|corner| *corner == expected);
    assert!(all.len() == 2 && found(Vec3::new(1.0, 0.0, 1.0)) && found(Vec3::new(5.0, 0.0, 1.0)), "{all:?}");
    set(&mut json, "/nodes/0/extensions/EXT_mesh_gpu_instancing/attributes/SCALE", json!(0));
    assert!(load(&json, &bin).err().unwrap().to_string().contains("different counts"));
}

#[test]
fn scenes_far_from_the_origin_keep_their_shape() {
    let (mut json, bin) = triangle();
    let near = corners(&load(&json, &bin).unwrap());
    set(&mut json, "/nodes/0/translation", json!([3_133_805.25, 5_447_439.5, -992_857.75]));
    let scene = load(&json, &bin).unwrap();
    let far = corners(&scene);
    for (a, b) in near[0].iter().zip(far[0]) {
        // The origin moved by whole metres.
        assert_eq!((*a - near[0][0]).to_array(), (b - far[0][0]).to_array());
        assert!(b.abs().max_element() < 2.0);
    }
    assert!(
        scene
            .remarks()
            .iter()
            .any(|remark| !remark.is_warning() && remark.text().contains("moved the scene by -31338"))
    );
}

#[test]
fn invalid_normals_are_replaced_by_those_of_triangles() {
    let (mut json, mut bin) = triangle();
    let values = [f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let normals = add_floats(&mut json, &mut bin, "VEC3", &values);
    set(&mut json, "/meshes/0/primitives/0/attributes/NORMAL", json!(normals));
    let scene = load(&json, &bin).unwrap();
    let at = scene.intersect(&Ray::new(Vec3A::new(0.2, 0.2, 1.0), -Vec3A::Z)).unwrap();
    assert_eq!((at.ng, at.ns), (Vec3A::Z, Vec3A::Z));
    assert_eq!(warnings(&scene), ["replaced 2 invalid normals by those of adjacent triangles"]);
}

#[test]
fn ignored_features_are_reported_once() {
    let (mut json, bin) = triangle();
    let lamp = json!({"KHR_lights_punctual": {"light": 0}});
    set(&mut json, "/scenes/0/nodes", json!([0, 1, 2]));
    set(&mut json, "/nodes", json!([{"mesh": 0}, {"extensions": lamp}, {"extensions": lamp}]));
    let material = json!({
        "alphaMode": "BLEND",
        "extensions": {"KHR_materials_sheen": {}, "KHR_materials_pbrSpecularGlossiness": {}}
    });
    set(&mut json, "/materials", json!([material.clone(), material]));
    set(&mut json, "/extensionsUsed", json!(["KHR_lights_punctual", "KHR_materials_sheen"]));
    let scene = load(&json, &bin).unwrap();
    for word in ["KHR_lights_punctual", "sheen", "pbrSpecularGlossiness", "punctual lights", "BLEND"] {
        assert_eq!(
            warnings(&scene).iter().filter(|text| text.contains(word)).count(),
            1,
            "{word} in {:?}",
            warnings(&scene)
        );
    }
}

#[test]
fn emissive_surfaces_are_visible_and_light_others() {
    use crate::{
        environment::built_in,
        integrator::{Budget, View, render},
        points::{PointSet, Points},
        spec::SamplerSpec,
    };
    // A square of emission 3 x the texture's red above a grey floor.
    let (mut json, mut bin) = super::images::textured(&json!({"bufferView": 2}));
    let corners = [-9.0, 0.0, -9.0, 9.0, 0.0, -9.0, 9.0, 0.0, 9.0, -9.0, 0.0, 9.0];
    let positions = add_floats(&mut json, &mut bin, "VEC3", &corners);
    let places = add_floats(&mut json, &mut bin, "VEC2", &[0.1; 8]);
    let first = bin.len();
    bin.extend([0, 1, 2, 0, 2, 3].iter().flat_map(|i: &u16| i.to_le_bytes()));
    set(&mut json, "/buffers/0/byteLength", json!(bin.len()));
    json["bufferViews"].as_array_mut().unwrap().push(json!({"buffer": 0, "byteOffset": first, "byteLength": 12}));
    let view = json["bufferViews"].as_array().unwrap().len() - 1;
    json["accessors"]
        .as_array_mut()
        .unwrap()
        .push(json!({"bufferView": view, "componentType": 5123, "count": 6, "type": "SCALAR"}));
    let indices = json["accessors"].as_array().unwrap().len() - 1;
    let square = |material: usize| {
        let attributes = json!({"POSITION": positions, "TEXCOORD_0": places});
        json!({"primitives": [{"attributes": attributes, "indices": indices, "material": material}]})
    };
    set(&mut json, "/meshes", json!([square(0), square(1)]));
    set(&mut json, "/scenes/0/nodes", json!([0, 1]));
    set(&mut json, "/nodes", json!([{"mesh": 0}, {"mesh": 1, "translation": [0, 1, 0]}]));
    let grey = json!({"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0});
    let strength = json!({"KHR_materials_emissive_strength": {"emissiveStrength": 6}});
    let texture = json!({"index": 0});
    let lamp =
        json!({"doubleSided": true, "emissiveFactor": [0.5, 1, 1], "emissiveTexture": texture, "extensions": strength});
    set(&mut json, "/materials", json!([{"doubleSided": true, "pbrMetallicRoughness": grey}, lamp]));
    let scene = load(&json, &bin).unwrap();
    assert!(scene.is_emissive() && warnings(&scene).is_empty());
    let environment = std::sync::Arc::new(built_in("overcast").unwrap());
    let estimator = SamplerSpec::mis().build(&environment).unwrap();
    let picture = |from: Vec3A, at: Vec3A, depth: u32| {
        let camera = crate::scene::Camera::new(from, at, 1.0).unwrap();
        let view = View {
            scene: &scene,
            camera: &camera,
            environment: &environment,
            width: 4,
            height: 4,
            unshadowed: false,
            depth,
        };
        let points = Points::new(PointSet::Sobol, 1);
        let stop = std::sync::atomic::AtomicBool::new(false);
        Vec3A::from_array(render(view, &*estimator, Budget::Spp(1024), points, &stop, &|_| {}).surfaces.pixels[5])
    };
    let lit = |depth| picture(Vec3A::new(0.0, 0.5, 0.0), Vec3A::new(0.01, 1.0, 0.0), depth);
    // From below, the environment hardly reaches the lamp: only its own light, which is red, is visible.
    assert!((lit(1).x - 3.0).abs() < 0.2 && lit(1).y < 0.2, "{}", lit(1));
    let floor = |depth| picture(Vec3A::new(0.0, 0.5, 0.0), Vec3A::new(0.01, 0.0, 0.0), depth);
    let added = floor(2).x - floor(1).x;
    // Only the lamp lights the floor, which reflects about 50 % of its light.
    assert!((1.2..2.1).contains(&added), "{added}");
}

#[test]
fn textures_in_unsupported_formats_are_ignored_with_a_warning() {
    let (plain, bin) = super::images::textured(&json!({"bufferView": 2}));
    let webp = json!({"EXT_texture_webp": {"source": 0}});
    for (texture, image, word) in [
        (json!({}), json!({"bufferView": 2}), "without a PNG or JPEG image"),
        (json!({"extensions": webp}), json!({"bufferView": 2}), "(EXT_texture_webp)"),
        (json!({"source": 0}), json!({"bufferView": 2, "mimeType": "image/webp"}), "image/webp"),
    ] {
        let mut json = plain.clone();
        set(&mut json, "/textures", json!([texture]));
        set(&mut json, "/images", json!([image]));
        let scene = load(&json, &bin).unwrap();
        assert_eq!(color_at(&scene, 0.1, 0.1), Vec3A::ONE);
        assert!(warnings(&scene).iter().any(|text| text.contains(word)), "{word} in {:?}", warnings(&scene));
    }
    // Textures are not read where other materials replace them.
    let mut json = plain;
    set(&mut json, "/images", json!([{"uri": "missing.png"}]));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
    assert!(Scene::load(&path).is_err());
    assert_eq!(Scene::open_dressed(path.to_str().unwrap(), false).unwrap().triangle_count(), 1);
}
