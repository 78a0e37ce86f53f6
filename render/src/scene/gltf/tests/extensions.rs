//! Geometry whose data are in an extension that is used and not required.

use serde_json::{Value, json};

use super::{
    assert_fails, load, set, triangle,
    unusual::{add_floats, corners},
};

/// A triangle, and a mesh 'ball' shown beside it whose primitive has an extension.
fn with_ball(name: &str) -> (Value, Vec<u8>) {
    let (mut json, bin) = triangle();
    let mut ball = json["meshes"][0].clone();
    ball["name"] = json!("ball");
    ball["primitives"][0]["extensions"] = json!({name: {"bufferView": 0, "attributes": {"POSITION": 0}}});
    json["meshes"].as_array_mut().unwrap().push(ball);
    set(&mut json, "/nodes", json!([{"mesh": 0}, {"mesh": 1}]));
    set(&mut json, "/scenes/0/nodes", json!([0, 1]));
    set(&mut json, "/extensionsUsed", json!([name]));
    (json, bin)
}

#[test]
fn meshes_without_a_fallback_are_refused_by_mesh_and_extension() {
    for name in ["KHR_draco_mesh_compression", "EXT_own_mesh_compression"] {
        let (mut json, bin) = with_ball(name);
        assert_eq!(load(&json, &bin).unwrap().triangle_count(), 2);
        let expected = format!("meshes[1].primitives[0]: the data of mesh 'ball' are in the extension {name}");
        // Without a view, accessors are zeros, but for the extension.
        for bare in [json!({"POSITION": 3}), json!({"POSITION": 0, "NORMAL": 3})] {
            set(&mut json, "/meshes/1/primitives/0/attributes", bare);
            let accessors = json["accessors"].as_array_mut().unwrap();
            accessors.truncate(3);
            accessors.push(json!({"componentType": 5126, "count": 3, "type": "VEC3"}));
            assert_fails(load(&json, &bin), &expected);
        }
        // A mesh that no node shows is not missed.
        set(&mut json, "/scenes/0/nodes", json!([0]));
        assert_eq!(load(&json, &bin).unwrap().triangle_count(), 1);
    }
    let (mut json, bin) = with_ball("EXT_own_mesh_compression");
    json["accessors"].as_array_mut().unwrap().push(json!({"componentType": 5123, "count": 3, "type": "SCALAR"}));
    set(&mut json, "/meshes/1/primitives/0/indices", json!(3));
    assert_fails(load(&json, &bin), "EXT_own_mesh_compression");
}

#[test]
fn compressed_views_need_a_fallback_buffer_with_data() {
    let (mut json, bin) = triangle();
    set(&mut json, "/meshes/0/name", json!("ball"));
    let compression =
        json!({"EXT_meshopt_compression": {"buffer": 0, "byteLength": 9, "count": 3, "mode": "ATTRIBUTES"}});
    // The view of the triangle has a fallback in the binary chunk.
    set(&mut json, "/bufferViews/0/extensions", compression.clone());
    assert_eq!(load(&json, &bin).unwrap().triangle_count(), 1);
    // A fallback buffer without a URI has no data.
    set(
        &mut json,
        "/buffers/1",
        json!({"byteLength": 60, "extensions": {"EXT_meshopt_compression": {"fallback": true}}}),
    );
    set(&mut json, "/bufferViews/0", json!({"buffer": 1, "byteLength": 60, "extensions": compression}));
    let expected = "meshes[0].primitives[0]: the data of mesh 'ball' are in the extension EXT_meshopt_compression";
    assert_fails(load(&json, &bin), expected);
}

#[test]
fn accessors_without_data_are_zeros_elsewhere() {
    let (mut json, mut bin) = triangle();
    let plain = corners(&load(&json, &bin).unwrap());
    // Displacements of zero, with an extension that describes the primitive.
    let moves = json!({"componentType": 5126, "count": 3, "type": "VEC3"});
    json["accessors"].as_array_mut().unwrap().push(moves);
    set(&mut json, "/meshes/0/primitives/0/targets", json!([{"POSITION": 3}]));
    set(&mut json, "/meshes/0/weights", json!([1.0]));
    set(&mut json, "/meshes/0/primitives/0/extensions", json!({"EXT_structural_metadata": {}}));
    assert_eq!(corners(&load(&json, &bin).unwrap()), plain);
    // Sparse elements are data.
    let values = add_floats(&mut json, &mut bin, "VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let view = json["accessors"][values]["bufferView"].clone();
    let indices = json!({"bufferView": 1, "componentType": 5123});
    let sparse = json!({"count": 3, "indices": indices, "values": {"bufferView": view}});
    set(&mut json, "/accessors/0", json!({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}));
    assert_eq!(corners(&load(&json, &bin).unwrap()), plain);
}
