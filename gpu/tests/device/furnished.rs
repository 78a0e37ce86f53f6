//! A glTF file with all that surfaces can have: textures and their wrap modes, a normal map, vertex colours, an alpha mask with
//! alphas of vertices, single-sided faces and emission.

use std::path::Path;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use headtail_render::{image::encode_png_rgb8, scene::Scene};
use serde_json::{Value, json};

/// Buffers of a file in progress.
#[derive(Default)]
struct Content {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Content {
    /// Adds an attribute and returns its index.
    fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let count = numbers.len() / kind[3..].parse::<usize>().unwrap();
        let start = self.bytes.len();
        self.bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start}));
        let mut accessor =
            json!({"bufferView": self.views.len() - 1, "componentType": 5126, "count": count, "type": kind});
        if kind == "VEC3" {
            let of = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..3).map(|axis| numbers.iter().skip(axis).step_by(3).copied().reduce(pick).unwrap()).collect()
            };
            (accessor["min"], accessor["max"]) = (json!(of(f32::min)), json!(of(f32::max)));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds a unit square, moved and scaled, as a strip of two triangles; `axes` are its sides.
    fn square(&mut self, corner: [f32; 3], axes: [[f32; 3]; 2], repeats: f32) -> Value {
        let place = |[s, t]: [f32; 2]| [0, 1, 2].map(|k| corner[k] + s * axes[0][k] + t * axes[1][k]);
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let positions = self.floats("VEC3", corners.map(place).as_flattened());
        let texcoords = self.floats("VEC2", corners.map(|corner| corner.map(|x| repeats * x - 0.3)).as_flattened());
        let colors: Vec<f32> =
            corners.iter().flat_map(|&[s, t]| [1.0, 0.5 + 0.5 * s, 1.0 - 0.4 * t, 1.0 - 0.5 * s]).collect();
        let colors = self.floats("VEC4", &colors);
        json!({"POSITION": positions, "TEXCOORD_0": texcoords, "COLOR_0": colors})
    }
}

/// A PNG of 8 x 8 texels, as a URI.
fn picture(texel: impl Fn(usize, usize) -> [u8; 3]) -> Value {
    let texels: Vec<[u8; 3]> = (0..64).map(|k| texel(k % 8, k / 8)).collect();
    json!({"uri": format!("data:image/png;base64,{}", STANDARD.encode(encode_png_rgb8(8, 8, &texels).unwrap()))})
}

/// Writes the file into a folder and opens it.
pub fn scene(folder: &Path) -> Scene {
    let mut content = Content::default();
    let ground = content.square([-3.0, 0.0, 3.0], [[6.0, 0.0, 0.0], [0.0, 0.0, -6.0]], 3.0);
    let leaf = content.square([-1.5, 0.2, 0.0], [[1.2, 0.0, 0.3], [0.0, 1.5, 0.0]], 1.7);
    let lamp = content.square([0.2, 0.1, -0.5], [[0.8, 0.0, 0.0], [0.0, 0.8, 0.1]], 1.0);
    let away = content.square([1.2, 0.1, 0.5], [[0.0, 1.0, 0.0], [0.8, 0.0, 0.2]], 1.0);
    let primitive =
        |attributes, material| json!({"primitives": [{"attributes": attributes, "mode": 5, "material": material}]});
    let rough = |base: Value| {
        let mut pbr = json!({"metallicFactor": 0.7, "roughnessFactor": 0.8, "metallicRoughnessTexture": {"index": 1}});
        pbr["baseColorTexture"] = base;
        pbr
    };
    let file = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2, 3, 4]}],
        "nodes": [{"mesh": 0}, {"mesh": 1}, {"mesh": 2}, {"mesh": 3}, {"camera": 0, "translation": [0.3, 1.2, 4.5], "rotation": [-0.1, 0.0, 0.0, 0.995]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [primitive(ground, 0), primitive(leaf, 1), primitive(lamp, 2), primitive(away, 3)],
        "materials": [
            {"doubleSided": true, "normalTexture": {"index": 2, "scale": 0.6}, "pbrMetallicRoughness": rough(json!({"index": 0}))},
            {"doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.8, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.5}},
            {"doubleSided": true, "emissiveFactor": [0.9, 0.5, 0.2], "emissiveTexture": {"index": 0}, "pbrMetallicRoughness": {"roughnessFactor": 0.6}},
            {"doubleSided": false, "pbrMetallicRoughness": {"metallicFactor": 0.2}},
        ],
        // Repeated, mirrored and clamped.
        "samplers": [{"wrapS": 10497, "wrapT": 33648}, {"wrapS": 33071, "wrapT": 10497}, {"wrapS": 10497, "wrapT": 10497, "magFilter": 9728, "minFilter": 9728}],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1, "sampler": 1}, {"source": 2, "sampler": 2}],
        "images": [
            picture(|x, y| [(40 + 30 * x) as u8, (250 - 25 * y) as u8, if (x + y) % 2 == 0 { 220 } else { 60 }]),
            picture(|x, y| [0, (90 + 20 * y) as u8, (30 * x) as u8]),
            picture(|x, y| [(100 + 8 * x) as u8, (150 - 6 * y) as u8, 240]),
        ],
        "accessors": content.accessors,
        "bufferViews": content.views,
        "buffers": [{"byteLength": content.bytes.len(), "uri": format!("data:application/octet-stream;base64,{}", STANDARD.encode(&content.bytes))}],
    });
    let path = folder.join("furnished.gltf");
    std::fs::write(&path, file.to_string()).unwrap();
    Scene::load(&path).unwrap()
}
