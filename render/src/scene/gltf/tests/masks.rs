//! Alpha masks: where surfaces have holes, for the camera and for shadows.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::Vec3A;
use serde_json::{Value, json};

use super::{
    assert_fails, color_at, glb, load, set, triangle,
    unusual::{add_floats, warnings},
};
use crate::scene::{Ray, Scene};

/// Points of a square, one for each of 2 x 2 texels, row by row.
const POINTS: [[f32; 2]; 4] = [[0.1, 0.2], [0.9, 0.2], [0.1, 0.8], [0.9, 0.8]];

/// A PNG of 2 x 2 red texels of these alphas.
fn png(alphas: [u8; 4]) -> Vec<u8> {
    let texels = alphas.map(|alpha| [255, 0, 0, alpha]);
    let (kind, mut bytes) = (image::ColorType::Rgba8, std::io::Cursor::new(Vec::new()));
    image::write_buffer_with_format(&mut bytes, texels.as_flattened(), 2, 2, kind, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// A unit square in the xy plane with a mask; texture coordinates are positions.
pub(super) fn square(alphas: [u8; 4]) -> (Value, Vec<u8>) {
    let (mut json, mut bin) = triangle();
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let positions = add_floats(&mut json, &mut bin, "VEC3", &corners);
    let texcoords = add_floats(&mut json, &mut bin, "VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    let attributes = json!({"POSITION": positions, "TEXCOORD_0": texcoords});
    // A strip of two triangles.
    set(&mut json, "/meshes/0/primitives/0", json!({"attributes": attributes, "mode": 5, "material": 0}));
    let pbr = json!({"baseColorTexture": {"index": 0}});
    let material = json!({"alphaMode": "MASK", "doubleSided": true, "pbrMetallicRoughness": pbr});
    set(&mut json, "/materials/0", material);
    set(&mut json, "/textures", json!([{"source": 0, "sampler": 0}]));
    set(&mut json, "/samplers", json!([{"wrapS": 33071, "wrapT": 33071}]));
    let uri = format!("data:image/png;base64,{}", STANDARD.encode(png(alphas)));
    set(&mut json, "/images", json!([{"uri": uri}]));
    (json, bin)
}

/// Which of [`POINTS`] are opaque: as a camera in front sees them, checked with shadow rays from both sides.
fn opaque(scene: &Scene) -> [bool; 4] {
    POINTS.map(|[x, y]| {
        let from_front = Ray::new(Vec3A::new(x, y, 1.0), -Vec3A::Z);
        let from_behind = Ray::new(Vec3A::new(x, y, -1.0), Vec3A::Z);
        let mut visible = [false; 2];
        scene.visible_batch(&[from_front, from_behind], &mut visible);
        let seen = [from_front, from_behind].map(|ray| scene.intersect(&ray).is_some());
        assert_eq!(visible.map(|visible| !visible), seen, "at {x}, {y}");
        assert_eq!(seen[0], seen[1], "at {x}, {y}");
        seen[0]
    })
}

/// Loads a file without its materials.
fn load_bare(json: &Value, bin: &[u8]) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, glb(json.to_string().as_bytes(), bin)).unwrap();
    Scene::open_dressed(path.to_str().unwrap(), false).unwrap()
}

#[test]
fn transparent_texels_are_holes_for_camera_and_shadow_rays() {
    let (mut json, bin) = square([255, 0, 0, 255]);
    let scene = load(&json, &bin).unwrap();
    assert_eq!(opaque(&scene), [true, false, false, true]);
    assert_eq!((scene.triangle_count(), warnings(&scene).len()), (2, 0));
    assert_eq!(color_at(&scene, 0.1, 0.2), Vec3A::X);

    // The floor below is seen through the holes, and lit through them.
    set(&mut json, "/nodes", json!([{"mesh": 0}, {"mesh": 1, "translation": [0, 0, -1]}]));
    set(&mut json, "/scenes/0/nodes", json!([0, 1]));
    let mut floor = json["meshes"][0].clone();
    floor["primitives"][0].as_object_mut().unwrap().remove("material");
    json["meshes"].as_array_mut().unwrap().push(floor);
    let scene = load(&json, &bin).unwrap();
    let heights = POINTS.map(|[x, y]| scene.intersect(&Ray::new(Vec3A::new(x, y, 1.0), -Vec3A::Z)).unwrap().p.z);
    assert_eq!(heights.map(f32::round), [0.0, -1.0, -1.0, 0.0]);
    let lit = POINTS.map(|[x, y]| {
        let mut visible = [false];
        scene.visible_batch(&[Ray::new(Vec3A::new(x, y, -0.99), Vec3A::Z)], &mut visible);
        visible[0]
    });
    assert_eq!(lit, [false, true, true, false]);
}

#[test]
fn alpha_is_linear_and_opaque_from_the_cutoff_on() {
    let (mut json, bin) = square([127, 128, 51, 255]);
    let with = |json: &Value| opaque(&load(json, &bin).unwrap());
    assert_eq!(with(&json), [false, true, false, true]);
    for (cutoff, expected) in [
        (0.2, [true; 4]),
        (0.21, [true, true, false, true]),
        (1.0, [false, false, false, true]),
        (1.5, [false; 4]),
        (0.0, [true; 4]),
    ] {
        set(&mut json, "/materials/0/alphaCutoff", json!(cutoff));
        assert_eq!(with(&json), expected, "{cutoff}");
    }
}

#[test]
fn nearest_texel_decides_where_the_sampler_asks_for_it() {
    // Half-way between texels, interpolated alpha crosses the cutoff; with NEAREST, the border is there.
    let (mut json, bin) = square([255, 100, 255, 100]);
    let is_opaque = |json: &Value, x: f32| {
        let ray = Ray::new(Vec3A::new(x, 0.4, 1.0), -Vec3A::Z);
        load(json, &bin).unwrap().intersect(&ray).is_some()
    };
    // Between the centres of texels, alpha is 1 - 0.608 (2 x - 0.5), which is 0.5 at x = 0.661.
    let near_the_border = [0.49, 0.51, 0.65, 0.67];
    assert_eq!(near_the_border.map(|x| is_opaque(&json, x)), [true, true, true, false]);
    set(&mut json, "/samplers/0/magFilter", json!(9728));
    assert_eq!(near_the_border.map(|x| is_opaque(&json, x)), [true, false, false, false]);
    // A filter for reduction alone changes nothing.
    set(&mut json, "/samplers/0", json!({"minFilter": 9728, "wrapS": 33071, "wrapT": 33071}));
    assert_eq!(near_the_border.map(|x| is_opaque(&json, x)), [true, true, true, false]);
}

#[test]
fn factor_texture_and_vertices_are_multiplied() {
    let (mut json, mut bin) = square([255, 160, 255, 160]);
    set(&mut json, "/materials/0/pbrMetallicRoughness/baseColorFactor", json!([1, 1, 1, 0.75]));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [true, false, true, false]);
    // The vertices' alpha is 0.84 in the upper row and 0.36 in the lower one: the products are 0.63, 0.40, 0.27, 0.17.
    let alphas = [1.0, 1.0, 0.2, 0.2];
    let colors: Vec<f32> = alphas.iter().flat_map(|&alpha| [1.0, 1.0, 1.0, alpha]).collect();
    let colors = add_floats(&mut json, &mut bin, "VEC4", &colors);
    set(&mut json, "/meshes/0/primitives/0/attributes/COLOR_0", json!(colors));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [true, false, false, false]);
    // Vertex alphas only.
    set(&mut json, "/materials/0/pbrMetallicRoughness", json!({}));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [true, true, false, false]);
    // Alphas are checked where a mask needs them, and not read elsewhere.
    let broken = add_floats(&mut json, &mut bin, "VEC4", &[[1.0, 1.0, 1.0, -1.0]; 4].concat());
    set(&mut json, "/meshes/0/primitives/0/attributes/COLOR_0", json!(broken));
    assert_fails(load(&json, &bin), "meshes[0].primitives[0]: alphas");
    set(&mut json, "/materials/0/alphaMode", json!("OPAQUE"));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [true; 4]);
}

#[test]
fn constant_masks_keep_or_remove_their_triangles() {
    let (mut json, bin) = square([255; 4]);
    let count = |json: &Value| {
        let scene = load(json, &bin).unwrap();
        assert!(warnings(&scene).is_empty(), "{:?}", warnings(&scene));
        assert_eq!(scene.bounds().is_empty(), scene.triangle_count() == 0);
        scene.triangle_count()
    };
    for (factor, expected) in [(0.4, 0), (0.6, 2), (0.5, 2)] {
        let pbr = json!({"baseColorFactor": [1, 1, 1, factor]});
        set(&mut json, "/materials/0/pbrMetallicRoughness", pbr);
        assert_eq!(count(&json), expected, "{factor}");
    }
    set(&mut json, "/materials/0/pbrMetallicRoughness", json!({"baseColorFactor": [1, 1, 1, 0.4]}));
    set(&mut json, "/materials/0/alphaMode", json!("OPAQUE"));
    // Without a mask, alpha and cutoff have no effect.
    set(&mut json, "/materials/0/alphaCutoff", json!(-7));
    assert_eq!(count(&json), 2);
}

#[test]
fn masks_of_opaque_texels_change_nothing() {
    let (mut json, bin) = square([255, 200, 128, 255]);
    let masked = load(&json, &bin).unwrap();
    set(&mut json, "/materials/0/alphaMode", json!("OPAQUE"));
    let plain = load(&json, &bin).unwrap();
    assert_eq!(opaque(&masked), [true; 4]);
    assert_eq!(masked.content_hash(), plain.content_hash());
    assert_eq!(masked.geometry_hash(), plain.geometry_hash());
    for [x, y] in POINTS {
        let ray = Ray::new(Vec3A::new(x, y, 1.0), Vec3A::new(0.1, -0.05, -1.0).normalize());
        assert_eq!(masked.intersect(&ray).unwrap().p, plain.intersect(&ray).unwrap().p);
    }
    // Images without an alpha channel are opaque.
    let (mut json, bin) = super::images::textured(&json!({"bufferView": 2}));
    set(&mut json, "/materials/0/alphaMode", json!("MASK"));
    let scene = load(&json, &bin).unwrap();
    assert_eq!((scene.triangle_count(), warnings(&scene).len()), (1, 0));
    assert_eq!(color_at(&scene, 0.1, 0.1), Vec3A::X);
}

#[test]
fn masks_follow_the_coordinates_of_the_base_color() {
    let (mut json, bin) = square([255, 0, 255, 0]);
    let info = "/materials/0/pbrMetallicRoughness/baseColorTexture";
    let moved = json!({"KHR_texture_transform": {"offset": [1, 0], "scale": [-1, 1]}});
    set(&mut json, info, json!({"index": 0, "extensions": moved}));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [false, true, false, true]);
    // A missing set: only the factor applies.
    set(&mut json, info, json!({"index": 0, "texCoord": 1}));
    assert_eq!(opaque(&load(&json, &bin).unwrap()), [true; 4]);
}

#[test]
fn scenes_without_their_materials_keep_holes() {
    let (mut json, bin) = square([255, 0, 0, 255]);
    let bare = load_bare(&json, &bin);
    assert_eq!(opaque(&bare), [true, false, false, true]);
    assert_eq!(bare.geometry_hash(), load(&json, &bin).unwrap().geometry_hash());
    assert_eq!(color_at(&bare, 0.1, 0.2), Vec3A::ONE);

    // A missing mask is an error, or a warning where materials are not read.
    set(&mut json, "/images", json!([{"uri": "missing.png"}]));
    assert_fails(load(&json, &bin), "missing.png");
    let bare = load_bare(&json, &bin);
    assert_eq!(opaque(&bare), [true; 4]);
    let warnings = warnings(&bare);
    assert!(warnings.len() == 1 && warnings[0].contains("alphaMode MASK"), "{warnings:?}");
}

#[test]
fn broken_masks_are_refused() {
    let (plain, bin) = square([255, 0, 0, 255]);
    for (pointer, value, word) in [
        ("/materials/0/alphaCutoff", json!(-0.1), "materials[0].alphaCutoff: is negative or not finite"),
        ("/materials/0/alphaCutoff", json!(1e39), "materials[0].alphaCutoff: is negative or not finite"),
        ("/materials/0/pbrMetallicRoughness/baseColorFactor", json!([1, 1, 1, -1]), "baseColorFactor"),
        ("/materials/0/pbrMetallicRoughness/baseColorTexture/index", json!(3), "baseColorTexture.index: index 3"),
    ] {
        let mut json = plain.clone();
        set(&mut json, pointer, value);
        assert_fails(load(&json, &bin), word);
        // Without materials it is a warning.
        assert_eq!(opaque(&load_bare(&json, &bin)), [true; 4]);
    }
}
