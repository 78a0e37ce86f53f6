//! Textures: where their images come from, what they change, and what is refused.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::Vec3A;
use serde_json::{Value, json};

use super::{assert_fails, color_at, glb, load, set, surface_at, triangle, unusual::warnings};
use crate::{
    image::encode_png_rgb8,
    scene::{Ray, Scene},
};

/// A PNG of 2 x 2 texels: red, green, blue, white.
fn png() -> Vec<u8> {
    let texels = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, &texels, 2, 2, image::ColorType::Rgb8, image::ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

/// [`triangle`] with a texture whose image is `image`.
pub(super) fn textured(image: &Value) -> (Value, Vec<u8>) {
    let (mut json, mut bin) = triangle();
    set(&mut json, "/materials/0/pbrMetallicRoughness", json!({"baseColorTexture": {"index": 0}}));
    set(&mut json, "/textures", json!([{"source": 0, "sampler": 0}]));
    set(&mut json, "/samplers", json!([{"wrapS": 33071, "wrapT": 33071}]));
    set(&mut json, "/images", json!([image]));
    let png = png();
    let view = json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": png.len()});
    json["bufferViews"].as_array_mut().unwrap().push(view);
    bin.extend(png);
    set(&mut json, "/buffers/0/byteLength", json!(bin.len()));
    (json, bin)
}

#[test]
fn textures_without_coordinates_raise_one_warning() {
    let (mut json, bin) = textured(&json!({"bufferView": 2, "mimeType": "image/png"}));
    set(&mut json, "/materials/0/pbrMetallicRoughness/baseColorTexture/texCoord", json!(1));
    let mut bare = json["meshes"][0]["primitives"][0].clone();
    bare["attributes"].as_object_mut().unwrap().remove("POSITION");
    json["meshes"][0]["primitives"].as_array_mut().unwrap().push(bare);
    let scene = load(&json, &bin).unwrap();
    assert_eq!(color_at(&scene, 0.1, 0.1), Vec3A::ONE);
    let expected =
        ["left out primitives without POSITION", "ignored textures at texture coordinates that a mesh does not have"];
    assert_eq!(warnings(&scene), expected);
}

#[test]
fn textures_come_from_views_data_and_files() {
    let data = format!("data:image/png;base64,{}", STANDARD.encode(png()));
    for image in [json!({"bufferView": 2, "mimeType": "image/png"}), json!({"uri": data})] {
        let (json, bin) = textured(&image);
        let scene = load(&json, &bin).unwrap();
        // Texture coordinates are the positions, v downwards: the first row of texels is at y = 0.
        assert_eq!(color_at(&scene, 0.1, 0.1), Vec3A::X);
        assert_eq!(color_at(&scene, 0.85, 0.1), Vec3A::Y);
        assert_eq!(color_at(&scene, 0.1, 0.85), Vec3A::Z);
    }

    // A .gltf with both files beside it, one name with a space.
    let folder = tempfile::tempdir().unwrap();
    let (mut json, bin) = textured(&json!({"uri": "base%20color.png"}));
    set(&mut json, "/buffers/0/uri", json!("buffer.bin"));
    std::fs::write(folder.path().join("base color.png"), png()).unwrap();
    std::fs::write(folder.path().join("buffer.bin"), bin).unwrap();
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, json.to_string()).unwrap();
    assert_eq!(color_at(&Scene::load(&path).unwrap(), 0.1, 0.1), Vec3A::X);

    // Both in the folder beside the file's, as projects share them.
    let inner = folder.path().join("chair");
    std::fs::create_dir(&inner).unwrap();
    std::fs::rename(folder.path().join("base color.png"), folder.path().join("wood é.png")).unwrap();
    for uri in ["./../chair/../wood%20%C3%A9.png", "../wood é.png"] {
        set(&mut json, "/buffers/0/uri", json!("../buffer.bin"));
        set(&mut json, "/images/0/uri", json!(uri));
        let path = inner.join("scene.gltf");
        std::fs::write(&path, json.to_string()).unwrap();
        assert_eq!(color_at(&Scene::load(&path).unwrap(), 0.1, 0.1), Vec3A::X);
    }
    set(&mut json, "/images/0/uri", json!("../../wood.png"));
    let path = inner.join("scene.gltf");
    std::fs::write(&path, json.to_string()).unwrap();
    assert_fails(Scene::load(&path), "images[0].uri: '../../wood.png' is outside of the parent of the file's folder");

    set(&mut json, "/buffers/0/uri", json!("buffer.bin"));
    set(&mut json, "/images/0/uri", json!("base%20color.png"));
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, json.to_string()).unwrap();
    assert_fails(Scene::load(&path), "images[0].uri: cannot read 'base%20color.png'");
}

#[test]
fn metalness_is_blue_and_roughness_green() {
    let (mut json, bin) = textured(&json!({"bufferView": 2}));
    // The texels are red, green and blue: neither, rough, metallic.
    let info = json!({"index": 0});
    let pbr = json!({"metallicRoughnessTexture": info, "metallicFactor": 0.5, "roughnessFactor": 0.25});
    set(&mut json, "/materials/0/pbrMetallicRoughness", pbr);
    let at = |json: &Value, x, y| {
        let surface = surface_at(&load(json, &bin).unwrap(), x, y);
        (surface.metallic(), surface.roughness())
    };
    assert_eq!(at(&json, 0.1, 0.1), (0.0, 0.0));
    assert_eq!(at(&json, 0.85, 0.1), (0.0, 0.25));
    assert_eq!(at(&json, 0.1, 0.85), (0.5, 0.0));
    assert_eq!(color_at(&load(&json, &bin).unwrap(), 0.1, 0.1), Vec3A::ONE);

    // A coordinate set of its own that the primitive lacks: only the factors apply.
    set(&mut json, "/materials/0/pbrMetallicRoughness/metallicRoughnessTexture/texCoord", json!(1));
    assert_eq!(at(&json, 0.1, 0.1), (0.5, 0.25));
    // Both textures, each with its own set; the second one is the first one's accessor.
    set(&mut json, "/materials/0/pbrMetallicRoughness/baseColorTexture", json!({"index": 0}));
    assert_eq!(at(&json, 0.85, 0.1), (0.5, 0.25));
    set(&mut json, "/meshes/0/primitives/0/attributes/TEXCOORD_1", json!(2));
    assert_eq!(at(&json, 0.85, 0.1), (0.0, 0.25));
    assert_eq!(color_at(&load(&json, &bin).unwrap(), 0.85, 0.1), Vec3A::Y);
    // A missing texture.
    set(&mut json, "/materials/0/pbrMetallicRoughness/metallicRoughnessTexture/index", json!(3));
    assert_fails(load(&json, &bin), "metallicRoughnessTexture.index");
}

#[test]
fn each_texture_has_the_filter_of_its_own_sampler() {
    let (mut json, bin) = textured(&json!({"bufferView": 2}));
    let clamp = json!({"wrapS": 33071, "wrapT": 33071});
    let nearest = json!({"magFilter": 9728, "wrapS": 33071, "wrapT": 33071});
    set(&mut json, "/samplers", json!([clamp, nearest]));
    set(&mut json, "/textures", json!([{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}]));
    // Texels are red, green, blue and white; the point is in the blue one, near the three others.
    let (x, y) = (0.35, 0.55);
    let used = ["baseColorTexture", "metallicRoughnessTexture"];
    let mut seen = |filters: [usize; 3]| {
        let [color, roughness, others] = filters.map(|index| json!({"index": index}));
        let pbr = json!({used[0]: color, used[1]: roughness});
        let material = json!({"pbrMetallicRoughness": pbr, "normalTexture": others, "emissiveTexture": others,
            "emissiveFactor": [1, 1, 1]});
        set(&mut json, "/materials/0", material);
        let scene = load(&json, &bin).unwrap();
        let ray = Ray::new(Vec3A::new(x, y, 1.0), -Vec3A::Z);
        let (mut emission, mut tile) = (Vec::new(), crate::tile::Tile::default());
        let rays = (crate::scene::RayKind::Camera, &[ray][..]);
        scene.intersect_and_emit(rays, 0.0, |_| 0, &mut tile, &mut Vec::new(), Some(&mut emission));
        let surface = surface_at(&scene, x, y);
        let roughness = [surface.metallic(), surface.roughness()];
        (Vec3A::from(surface.base_color()), roughness, scene.intersect(&ray).unwrap().ns, emission[0])
    };
    // Centres are at 0.25 and 0.75: the weights along u are 0.8 and 0.2, those along v 0.4 and 0.6.
    let [red, green, blue, white] = [0.32, 0.08, 0.48, 0.12];
    let mixed = Vec3A::new(red + white, green + white, blue + white);
    let bilinear = seen([0, 0, 0]);
    assert!((bilinear.0 - mixed).abs().max_element() < 1e-6 && (bilinear.3 - mixed).abs().max_element() < 1e-6);
    assert!((bilinear.1[0] - mixed.z).abs() < 1e-6 && (bilinear.1[1] - mixed.y).abs() < 1e-6);
    assert_eq!(seen([1, 0, 0]).0, Vec3A::Z);
    assert_eq!(seen([0, 1, 0]).1, [1.0, 0.0]);
    let nearest = seen([0, 0, 1]);
    assert_eq!((nearest.0, nearest.1, nearest.3), (bilinear.0, bilinear.1, Vec3A::Z));
    // Blue is -1 along u, which is +x, -1 against v, which is +y, and 1 along the normal.
    let expected = Vec3A::new(-1.0, 1.0, 1.0).normalize();
    assert!(nearest.2.distance(expected) < 1e-6 && bilinear.2.distance(expected) > 0.1, "{nearest:?} {bilinear:?}");
}

#[test]
fn material_defaults_are_metallic_and_rough() {
    let (mut json, bin) = triangle();
    for material in [json!({}), json!({"pbrMetallicRoughness": {}})] {
        set(&mut json, "/materials/0", material);
        let surface = surface_at(&load(&json, &bin).unwrap(), 0.2, 0.2);
        assert_eq!((surface.base_color(), surface.metallic(), surface.roughness()), (glam::Vec3::ONE, 1.0, 1.0));
    }
}

#[test]
fn broken_images_are_refused() {
    for (image, word) in [
        (json!({}), "images[0]: has neither"),
        (json!({"bufferView": 9}), "images[0].bufferView"),
        (json!({"bufferView": 0}), "neither PNG nor JPEG"),
        (json!({"uri": "data:image/png;base64,iVBORw0KGgo="}), "cannot be decoded"),
        (json!({"uri": "https://example.org/a.png"}), "images[0].uri"),
    ] {
        let (json, bin) = textured(&image);
        assert_fails(load(&json, &bin), word);
    }
    let (mut json, bin) = textured(&json!({"bufferView": 2}));
    set(&mut json, "/textures/0/source", json!(4));
    assert_fails(load(&json, &bin), "textures[0].source");
    set(&mut json, "/textures/0/sampler", json!(4));
    assert_fails(load(&json, &bin), "textures[0].sampler");
}

/// [`png`] with another size in its header.
fn png_of(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = png();
    let start = bytes.windows(4).position(|four| four == b"IHDR").unwrap();
    bytes[start + 4..start + 8].copy_from_slice(&width.to_be_bytes());
    bytes[start + 8..start + 12].copy_from_slice(&height.to_be_bytes());
    // The checksum of the type and the 13 bytes of the header.
    let checksum = bytes[start..start + 17].iter().fold(!0_u32, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| (sum >> 1) ^ if sum & 1 == 1 { 0xedb8_8320 } else { 0 })
    });
    bytes[start + 17..start + 21].copy_from_slice(&(!checksum).to_be_bytes());
    bytes
}

/// A JPEG of 8 x 8 texels with another size in its header.
fn jpeg_of(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, &[9; 192], 8, 8, image::ColorType::Rgb8, image::ImageFormat::Jpeg)
        .unwrap();
    let mut bytes = bytes.into_inner();
    // Start of frame: marker, length and precision come before the size.
    let start = bytes.windows(2).position(|two| two == [0xff, 0xc0]).unwrap() + 5;
    bytes[start..start + 2].copy_from_slice(&height.to_be_bytes());
    bytes[start + 2..start + 4].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn oversized_images_are_rejected_before_decoding() {
    let cases = [
        (png_of(100_000, 100_000), "100000 x 100000 texels; up to 134217728"),
        (png_of(16_384, 16_384), "16384 x 16384 texels; up to 134217728"),
        (png_of(20_000, 1), "20000 x 1 texels; up to 134217728, and 16384 in a row"),
        (png_of(16_384, 8_192), "16384 x 8192 texels, which take at least 16257 bytes"),
        (jpeg_of(65_000, 65_000), "65000 x 65000 texels; up to 134217728"),
        (jpeg_of(16_000, 8_000), "16000 x 8000 texels, which take at least 250000 bytes"),
    ];
    for (bytes, word) in cases {
        let data = format!("data:;base64,{}", STANDARD.encode(&bytes));
        let (json, bin) = textured(&json!({"uri": data}));
        assert_fails(load(&json, &bin), &format!("images[0]: has {word}"));

        let folder = tempfile::tempdir().unwrap();
        let (json, bin) = textured(&json!({"uri": "image"}));
        std::fs::write(folder.path().join("image"), &bytes).unwrap();
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
        assert_fails(Scene::load(&path), &format!("images[0]: has {word}"));
    }
    // With the true sizes in their headers, both are decoded.
    for bytes in [png_of(2, 2), jpeg_of(8, 8)] {
        let data = format!("data:;base64,{}", STANDARD.encode(&bytes));
        let (json, bin) = textured(&json!({"uri": data}));
        load(&json, &bin).unwrap();
    }
}

#[test]
fn normal_maps_lean_the_shading_normal() {
    // One texel that tilts towards growing u, which is +x on this triangle.
    let png = encode_png_rgb8(1, 1, &[[255, 128, 255]]).unwrap();
    let uri = format!("data:image/png;base64,{}", STANDARD.encode(png));
    let (mut json, bin) = textured(&json!({"uri": uri}));
    set(&mut json, "/materials/0/normalTexture", json!({"index": 0}));
    let normal = |json: &Value| {
        let scene = load(json, &bin).unwrap();
        let at = scene.intersect(&Ray::new(Vec3A::new(0.2, 0.2, 1.0), -Vec3A::Z)).unwrap();
        assert_eq!(at.ng, Vec3A::Z);
        at.ns
    };
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert!((normal(&json) - Vec3A::new(half, 0.0, half)).length() < 5e-3, "{}", normal(&json));
    set(&mut json, "/materials/0/normalTexture/scale", json!(0.0));
    assert_eq!(normal(&json), Vec3A::Z);
    set(&mut json, "/materials/0/normalTexture", json!({"index": 7}));
    assert_fails(load(&json, &bin), "materials[0].normalTexture.index: index 7");
    set(&mut json, "/materials/0/normalTexture", json!({"index": 0, "scale": 1e39}));
    assert_fails(load(&json, &bin), "normalTexture.scale");
    set(&mut json, "/materials/0/normalTexture", json!({"index": 0}));
    set(&mut json, "/meshes/0/primitives/0/attributes/TANGENT", json!(0));
    assert_fails(load(&json, &bin), "accessors[0].type");
}
