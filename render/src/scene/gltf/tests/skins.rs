//! Meshes that follow the joints of a skin.

use glam::{Vec3, Vec3A};
use serde_json::{Value, json};

use super::{
    assert_fails, load, set, triangle,
    unusual::{add_floats, corners, warnings},
};
use crate::scene::Ray;

/// A triangle whose first two corners follow one joint and whose third follows another, half turned by a parent.
fn skinned() -> (Value, Vec<u8>) {
    let (mut json, mut bin) = triangle();
    let weights = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0];
    let weights = add_floats(&mut json, &mut bin, "VEC4", &weights);
    let joints = add_floats(&mut json, &mut bin, "VEC4", &[0.0, 1.0, 0.0, 0.0].repeat(3));
    let at = |z: f32| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, z, 1.0];
    let back = add_floats(&mut json, &mut bin, "MAT4", &[at(-1.0), at(-2.0)].concat());
    let normals = add_floats(&mut json, &mut bin, "VEC3", &[0.0, 0.0, 1.0].repeat(3));
    set(&mut json, "/meshes/0/primitives/0/attributes/NORMAL", json!(normals));
    set(&mut json, "/meshes/0/primitives/0/attributes/JOINTS_0", json!(joints));
    set(&mut json, "/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(weights));
    set(&mut json, "/skins", json!([{"joints": [2, 3], "inverseBindMatrices": back}]));
    let nodes = json!([
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},
        {"children": [2, 3], "scale": [0.01, 0.01, 0.01]},
        {"translation": [0, 0, 1], "scale": [100, 100, 100]},
        {"translation": [50, 0, 2], "scale": [100, 100, 100]},
    ]);
    set(&mut json, "/nodes", nodes);
    set(&mut json, "/scenes/0/nodes", json!([0, 1]));
    (json, bin)
}

#[test]
fn vertices_follow_the_joints_and_not_the_node() {
    let (json, bin) = skinned();
    let scene = load(&json, &bin).unwrap();
    assert!(warnings(&scene).is_empty(), "{:?}", warnings(&scene));
    // Joint 0 moves by 0.01 - 1 along z, joint 1 by 0.5 along x and by 0.02 - 2 along z.
    let expected = [Vec3::new(0.0, 0.0, -0.99), Vec3::new(1.0, 0.0, -0.99), Vec3::new(0.5, 1.0, -1.98)];
    for (corner, expected) in corners(&scene)[0].into_iter().zip(expected) {
        assert!(corner.distance(expected) < 1e-6, "{corner} is not {expected}");
    }
    let at = scene.intersect(&Ray::new(Vec3A::new(0.4, 0.2, 1.0), -Vec3A::Z)).unwrap();
    assert!(at.ns.dot(Vec3A::Z) > 0.9999, "{}", at.ns);
}

#[test]
fn broken_skins_are_refused_by_name() {
    let changes = [
        ("/nodes/0/skin", json!(1), "skin"),
        ("/skins/0/joints", json!([2, 9]), "skins[0].joints[1]"),
        ("/skins/0/joints", json!([2]), "JOINTS_0"),
        ("/skins/0", json!(3), "nodes[0].skin: element 0 cannot be read"),
        ("/skins/0/inverseBindMatrices", json!(0), "MAT4"),
        ("/scenes/0/nodes", json!([0]), "is not a node of the scene"),
        ("/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(0), "VEC4"),
        ("/nodes/2/scale", json!([1e30, 1e30, 1e30]), "positions"),
    ];
    for (pointer, value, word) in changes {
        let (mut json, bin) = skinned();
        set(&mut json, pointer, value);
        assert_fails(load(&json, &bin), word);
    }
    let (mut json, bin) = skinned();
    json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("JOINTS_0");
    assert_fails(load(&json, &bin), "JOINTS_0: is missing");
}

#[test]
fn files_without_nodes_show_all_meshes() {
    let (mut json, bin) = triangle();
    let object = json.as_object_mut().unwrap();
    for part in ["nodes", "scenes", "scene"] {
        object.remove(part);
    }
    let scene = load(&json, &bin).unwrap();
    assert_eq!((scene.triangle_count(), scene.remarks().len(), warnings(&scene).len()), (1, 1, 0));
}
