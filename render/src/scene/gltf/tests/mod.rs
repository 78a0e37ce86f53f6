//! Generated files: a valid one in many forms, and ways to break it.

mod cameras;
mod extensions;
mod images;
mod instances;
mod masks;
mod sides;
mod skins;
mod unusual;

use glam::{Vec3, Vec3A};
use serde_json::{Value, json};

use crate::{
    brdf::{BrdfTable, Kernel, MetallicRoughness},
    error::Result,
    random::{Purpose, Stream},
    scene::{Ray, Scene},
};

/// One triangle in the xy plane with indices and texture coordinates.
fn triangle() -> (Value, Vec<u8>) {
    let mut bin = Vec::new();
    for value in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0] {
        bin.extend(value.to_le_bytes());
    }
    for index in [0_u16, 1, 2, 0] {
        bin.extend(index.to_le_bytes());
    }
    let json = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1.0]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
            {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC2"}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 60}, {"buffer": 0, "byteOffset": 60, "byteLength": 6}],
        "buffers": [{"byteLength": 68}, {"byteLength": 6}]
    });
    (json, bin)
}

/// A `.glb` of a JSON text and a binary chunk.
fn glb(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8], fill: u8| {
        let mut padded = data.to_vec();
        padded.resize(data.len().next_multiple_of(4), fill);
        [&(padded.len() as u32).to_le_bytes()[..], kind, &padded].concat()
    };
    let chunks = [chunk(b"JSON", json, b' '), chunk(b"BIN\0", bin, 0)].concat();
    [&b"glTF"[..], &2_u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
}

fn load_bytes(bytes: &[u8]) -> Result<Scene> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, bytes).unwrap();
    Scene::load(&path)
}

fn load(json: &Value, bin: &[u8]) -> Result<Scene> {
    load_bytes(&glb(json.to_string().as_bytes(), bin))
}

/// Sets the value at a JSON pointer; its last part may be new.
fn set(json: &mut Value, pointer: &str, value: Value) {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match json.pointer_mut(parent).unwrap() {
        Value::Object(map) => drop(map.insert(key.into(), value)),
        Value::Array(array) => array[key.parse::<usize>().unwrap()] = value,
        other => panic!("{other} has no parts"),
    }
}

/// Asserts that loading fails with one line that names the file and contains `word`.
fn assert_fails(loaded: Result<Scene>, word: &str) {
    let message = loaded.err().unwrap_or_else(|| panic!("loaded, but expected: {word}")).to_string();
    assert!(message.contains("scene.gl") && message.contains(word) && !message.contains('\n'), "{word}: {message}");
}

fn surface_at(scene: &Scene, x: f32, y: f32) -> MetallicRoughness {
    let at = scene.intersect(&Ray::new(Vec3A::new(x, y, 1.0), -Vec3A::Z)).expect("a hit");
    assert_eq!(at.surface.brdf, BrdfTable::METALLIC_ROUGHNESS);
    MetallicRoughness::of_parameters(&at.surface.parameters)
}

fn color_at(scene: &Scene, x: f32, y: f32) -> Vec3A {
    surface_at(scene, x, y).base_color().into()
}

#[test]
fn a_triangle_with_its_color() {
    let (json, bin) = triangle();
    let scene = load(&json, &bin).unwrap();
    assert_eq!((scene.triangle_count(), scene.name()), (1, "scene"));
    assert_eq!(color_at(&scene, 0.2, 0.2), Vec3A::new(0.5, 0.25, 0.125));
}

#[test]
fn broken_fields_are_named() {
    let broken: &[(&str, Value, &str)] = &[
        ("/asset/version", json!("1.0"), "asset.version"),
        ("/extensionsRequired", json!(["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        ("/scene", json!(1), "scene: index 1"),
        ("/scenes/0/nodes", json!([7]), "scenes[0].nodes: index 7"),
        ("/scenes/0/nodes", json!([0, 0]), "node 0 is reached a second time"),
        ("/nodes/0/children", json!([0]), "node 0 is reached a second time"),
        ("/nodes/0/children", json!([1]), "nodes[0].children: index 1"),
        ("/nodes/0/mesh", json!(3), "nodes[0].mesh"),
        ("/nodes/0/rotation", json!([0, 0, 0, 0]), "nodes[0].rotation"),
        ("/nodes/0/scale", json!([1e39, 1, 1]), "nodes[0]"),
        ("/nodes/0/scale", json!([1e30, 1, 1]), "positions"),
        ("/nodes/0/scale", json!([0, 0, 0]), ""),
        ("/meshes/0/primitives/0/mode", json!(9), "primitives[0].mode"),
        ("/meshes/0/primitives/0/mode", json!(1), "no triangles"),
        ("/meshes/0/primitives/0/material", json!(5), "primitives[0].material"),
        ("/meshes/0/primitives/0/indices", json!(9), "primitives[0].indices: index 9"),
        ("/meshes/0/primitives/0/indices", json!(0), "accessors[0].type"),
        ("/meshes/0/primitives/0/attributes", json!({}), "has no triangles"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(4_000_000_000_u32), "POSITION: index 4000000000"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(1), "accessors[1].type"),
        ("/meshes/0/primitives/0/attributes/NORMAL", json!(2), "accessors[2].type"),
        ("/accessors/0/bufferView", json!(2), "accessors[0].bufferView"),
        // Zeros, as the specification says, but a limited number of them.
        ("/accessors/0/bufferView", Value::Null, ""),
        ("/accessors/0", json!({"componentType": 5126, "count": 5_000_000, "type": "VEC3"}), "accessors[0].bufferView"),
        ("/accessors/0/componentType", json!(5130), "accessors[0].componentType"),
        ("/accessors/0/type", json!("VEC9"), "accessors[0].type"),
        ("/accessors/0/count", json!(6), "accessors[0].count"),
        ("/accessors/0/count", json!(u64::MAX), "accessors[0].count"),
        ("/accessors/0/byteOffset", json!(u64::MAX), "accessors[0].count"),
        ("/accessors/0/count", json!(2), "indices: index 2 is out of range"),
        (
            "/accessors/0/sparse",
            json!({"count": 1, "indices": {"bufferView": 0, "componentType": 5126}, "values": {"bufferView": 0}}),
            "accessors[0].sparse.indices.componentType",
        ),
        (
            "/accessors/0/sparse",
            json!({"count": 1, "indices": {"bufferView": 0, "byteOffset": 12, "componentType": 5125}, "values": {"bufferView": 0}}),
            "accessors[0].sparse.indices: index 1065353216 is out of range",
        ),
        (
            "/accessors/0/sparse",
            json!({"count": 9, "indices": {"bufferView": 0, "componentType": 5121}, "values": {"bufferView": 0}}),
            "accessors[0].sparse.values.count",
        ),
        ("/accessors/1/componentType", json!(5122), "I16"),
        ("/accessors/1/byteOffset", json!(4), "accessors[1].count"),
        ("/bufferViews/0/buffer", json!(9), "bufferViews[0].buffer"),
        ("/bufferViews/0/byteLength", json!(69), "bufferViews[0].byteLength"),
        ("/bufferViews/0/byteOffset", json!(u64::MAX), "bufferViews[0].byteLength"),
        ("/bufferViews/0/byteStride", json!(0), "bufferViews[0].byteStride"),
        ("/bufferViews/0/byteStride", json!(u64::MAX), "accessors[0].count"),
        ("/buffers/0/byteLength", json!(1_u64 << 40), "buffers[0].byteLength"),
        ("/buffers/0/uri", json!("absent.bin"), "buffers[0].uri: cannot read 'absent.bin'"),
        ("/buffers/0/uri", json!("../../scene.glb"), "buffers[0].uri: '../../scene.glb' is outside of the parent"),
        ("/buffers/0/uri", json!("/dev/zero"), "buffers[0].uri"),
        ("/buffers/0/uri", json!("."), "buffers[0].uri"),
        ("/bufferViews/1", json!({"buffer": 1, "byteLength": 6}), "buffers[1].uri: is missing"),
        ("/materials/0/pbrMetallicRoughness/baseColorFactor", json!([-1, 0, 0, 1]), "baseColorFactor"),
        ("/materials/0/pbrMetallicRoughness/roughnessFactor", json!(1e39), "roughnessFactor"),
        ("/materials/0/pbrMetallicRoughness/baseColorTexture", json!({"index": 0}), "baseColorTexture.index"),
    ];
    for (pointer, value, word) in broken {
        let (mut json, bin) = triangle();
        set(&mut json, pointer, value.clone());
        if word.is_empty() {
            // A flattened mesh is valid; its triangles are dropped.
            assert_eq!(load(&json, &bin).unwrap().triangle_count(), 0, "{pointer}");
        } else {
            assert_fails(load(&json, &bin), word);
        }
    }
}

#[test]
fn cycles_of_several_nodes_are_refused() {
    let (mut json, bin) = triangle();
    set(&mut json, "/nodes", json!([{"children": [1]}, {"children": [2]}, {"children": [1]}]));
    assert_fails(load(&json, &bin), "nodes[2].children: node 1 is reached a second time");
}

#[test]
fn invalid_positions_are_rejected() {
    for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30] {
        let (json, mut bin) = triangle();
        bin[16..20].copy_from_slice(&bad.to_le_bytes());
        assert_fails(load(&json, &bin), "meshes[0].primitives[0]: positions");
    }
}

#[test]
fn number_of_elements_is_limited() {
    let (mut json, mut bin) = triangle();
    // 4 Mi indices of one byte in 200 primitives: 280 million triangles from a file of 4 MiB.
    bin.resize(68 + (4 << 20), 0);
    set(&mut json, "/buffers/0/byteLength", json!(bin.len()));
    set(&mut json, "/bufferViews/1", json!({"buffer": 0, "byteOffset": 68, "byteLength": 4 << 20}));
    set(&mut json, "/accessors/1", json!({"bufferView": 1, "componentType": 5121, "count": 4 << 20, "type": "SCALAR"}));
    let primitive = json["meshes"][0]["primitives"][0].clone();
    set(&mut json, "/meshes/0/primitives", Value::Array(vec![primitive; 200]));
    assert_fails(load(&json, &bin), "has more than");
}

#[test]
fn number_of_json_objects_is_limited() {
    let nodes = vec!["{}"; 3 << 20].join(",");
    assert_fails(load_bytes(format!("{{\"asset\": {{}}, \"nodes\": [{nodes}]}}").as_bytes()), "objects");
}

#[test]
fn cut_off_files_are_refused_wherever_they_end() {
    let (json, bin) = triangle();
    let whole = glb(json.to_string().as_bytes(), &bin);
    for length in 0..whole.len() {
        assert!(load_bytes(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
    }
    assert_fails(load_bytes(&whole[..whole.len() - 1]), "cut off");
    assert_fails(load_bytes(&[&b"glTF"[..], &2_u32.to_le_bytes(), &3_u32.to_le_bytes()].concat()), "GLB header");
    assert_fails(load_bytes(b"not a scene"), "JSON");
}

#[test]
fn garbled_files_never_panic() {
    let (json, bin) = triangle();
    let whole = glb(json.to_string().as_bytes(), &bin);
    let mut random = Stream::new(5, Purpose::Test, 0);
    let mut loaded = 0;
    for _ in 0..3000 {
        let mut bytes = whole.clone();
        for _ in 0..1 + (3.0 * random.uniform()) as usize {
            let at = (random.uniform() * bytes.len() as f32) as usize;
            bytes[at] = match (4.0 * random.uniform()) as usize {
                0 => (256.0 * random.uniform()) as u8,
                1 => b'9',
                2 => b'-',
                _ => bytes[at] ^ (1 << (8.0 * random.uniform()) as u32),
            };
        }
        loaded += usize::from(load_bytes(&bytes).is_ok());
    }
    // Some files load, and some fail.
    assert!((100..2900).contains(&loaded), "{loaded} of 3000");
}

#[test]
fn parents_move_children_and_mirrors_keep_the_outside() {
    let (mut json, bin) = triangle();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    set(
        &mut json,
        "/nodes",
        json!([
            {"children": [1], "translation": [10, 0, 0], "rotation": [0, 0, half, half]},
            {"mesh": 0, "matrix": [-2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 3, 0, 0, 1]}
        ]),
    );
    let scene = load(&json, &bin).unwrap();
    // Child: (x, y) -> (3 - 2x, 2y). Parent: a quarter turn, (x, y) -> (-y, x), then 10 along x.
    let corners: Vec<[Vec3; 3]> = scene.triangles().collect();
    let [a, b, c] = corners[0];
    for expected in [Vec3::new(10.0, 3.0, 0.0), Vec3::new(10.0, 1.0, 0.0), Vec3::new(8.0, 3.0, 0.0)] {
        assert!(corners[0].iter().any(|corner| (corner - expected).length() < 1e-5), "{expected} in {corners:?}");
    }
    // The file's triangle is counter-clockwise seen from +Z, and so is its mirror image.
    assert!((b - a).cross(c - a).z > 0.0);
}

#[test]
fn strips_without_indices_and_deep_hierarchies() {
    let (mut json, bin) = triangle();
    set(&mut json, "/meshes/0/primitives/0", json!({"attributes": {"POSITION": 0}, "mode": 5}));
    let depth = 20_000;
    let chain: Vec<Value> =
        (0..depth).map(|i| if i + 1 < depth { json!({"children": [i + 1]}) } else { json!({"mesh": 0}) }).collect();
    set(&mut json, "/nodes", Value::Array(chain));
    let scene = load(&json, &bin).unwrap();
    assert_eq!(scene.triangle_count(), 1);
    // The default material is white.
    assert_eq!(color_at(&scene, 0.2, 0.2), Vec3A::ONE);
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_folders_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Nothing writes to the pipe: opening it would block forever.
    assert!(std::process::Command::new("mkfifo").arg(at("scene.glb")).status().unwrap().success());
    assert_fails(Scene::load(&at("scene.glb")), "it is a pipe or a device");
    std::fs::create_dir(at("scene.gltf")).unwrap();
    assert_fails(Scene::load(&at("scene.gltf")), "it is a folder");
    std::os::unix::fs::symlink("/dev/zero", at("zero")).unwrap();
    let (json, bin) = images::textured(&json!({"uri": "zero"}));
    let path = at("scene.glb2");
    std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
    assert_fails(Scene::load(&path), "images[0].uri: cannot read 'zero': it is a pipe or a device");
}
