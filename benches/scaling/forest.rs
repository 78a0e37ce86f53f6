//! A forest as a glTF file: one tree, placed many times by `EXT_mesh_gpu_instancing`.

use std::{f32::consts::TAU, fs, path::Path};

use glam::{Quat, Vec3};
use headtail_render::random::{Purpose, Stream};
use serde_json::{Value, json};

/// Leaves of a tree, of two triangles each.
const LEAVES: usize = 4_980;

/// Sides of a trunk, of two triangles each.
const SIDES: usize = 20;

/// Triangles of a tree.
pub const TRIANGLES: usize = 2 * (LEAVES + SIDES);

/// Metres between neighbouring trees.
const SPACING: f32 = 6.0;

/// Writes a forest of `trees` trees with a ground and a camera.
pub fn write(path: &Path, trees: usize) {
    let mut file = File::default();
    let mut random = Stream::new(1, Purpose::Test, 0);
    let trunk = file.mesh(&trunk(), 1);
    let leaves = file.mesh(&leaves(&mut random), 2);
    let across = (trees as f32).sqrt().ceil();
    let (mut places, mut turns, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
    for tree in 0..trees {
        let cell = [tree as f32 % across, (tree as f32 / across).floor()];
        let [x, z] = cell.map(|cell| SPACING * (cell + 0.8 * random.uniform() - 0.5 * across));
        places.push([x, 0.0, z]);
        turns.push(Quat::from_rotation_y(TAU * random.uniform()).to_array());
        sizes.push([0.7 + 0.6 * random.uniform(); 3]);
    }
    let attributes = json!({
        "TRANSLATION": file.accessor(&places, "VEC3"),
        "ROTATION": file.accessor(&turns, "VEC4"),
        "SCALE": file.accessor(&sizes, "VEC3"),
    });
    let half = SPACING * across;
    let ground = [[-half, half], [half, half], [half, -half], [-half, half], [half, -half], [-half, -half]];
    let ground = file.mesh(&ground.map(|[x, z]| Vec3::new(x, 0.0, z)), 0);
    let color = |color: [f32; 3]| {
        let [r, g, b] = color;
        json!({"pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0}, "doubleSided": true})
    };
    let instances = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    // Just above the trees at the edge, looking down to the centre.
    let down = Quat::from_rotation_x(-0.35).to_array();
    let json = json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["EXT_mesh_gpu_instancing"],
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [
            {"mesh": 0, "name": "tree", "extensions": instances},
            {"mesh": 1, "name": "ground"},
            {"camera": 0, "translation": [0.0, 14.0, 0.5 * SPACING * across + 4.0], "rotation": down},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [{"primitives": [trunk, leaves]}, {"primitives": [ground]}],
        "materials": [color([0.25, 0.2, 0.15]), color([0.2, 0.12, 0.06]), color([0.1, 0.25, 0.05])],
        "accessors": file.accessors,
        "bufferViews": file.views,
        "buffers": [{"byteLength": file.bytes.len()}],
    });
    fs::write(path, file.glb(&json)).expect("a file that can be written");
}

/// Returns triangle corners.
fn trunk() -> Vec<Vec3> {
    let at = |side: usize, radius: f32, y: f32| {
        let (sin, cos) = (TAU * side as f32 / SIDES as f32).sin_cos();
        Vec3::new(radius * cos, y, radius * sin)
    };
    (0..SIDES)
        .flat_map(|side| {
            let [a, b] = [at(side, 0.25, 0.0), at(side + 1, 0.25, 0.0)];
            let [c, d] = [at(side + 1, 0.1, 5.0), at(side, 0.1, 5.0)];
            [a, c, b, a, d, c]
        })
        .collect()
}

/// Returns triangle corners: randomly rotated squares in a ball.
fn leaves(random: &mut Stream) -> Vec<Vec3> {
    let mut leaf = || {
        let center = 2.5 * random.uniform().cbrt() * Vec3::from(random.direction()) + 5.5 * Vec3::Y;
        let normal = Vec3::from(random.direction());
        let (a, b) = normal.any_orthonormal_pair();
        let corner = |x: f32, y: f32| center + 0.09 * (x * a + y * b);
        let [a, b, c, d] = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        [a, b, c, a, c, d]
    };
    (0..LEAVES).flat_map(|_| leaf()).collect()
}

/// A glTF file under construction.
#[derive(Default)]
struct File {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl File {
    /// Adds triangles by their corners and returns the primitive.
    fn mesh(&mut self, corners: &[Vec3], material: usize) -> Value {
        let corners: Vec<[f32; 3]> = corners.iter().map(Vec3::to_array).collect();
        json!({"attributes": {"POSITION": self.accessor(&corners, "VEC3")}, "material": material})
    }

    /// Adds a list of vectors and returns its index.
    fn accessor<const N: usize>(&mut self, vectors: &[[f32; N]], kind: &str) -> usize {
        let first = self.bytes.len();
        self.bytes.extend(vectors.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        self.views.push(json!({"buffer": 0, "byteOffset": first, "byteLength": self.bytes.len() - first}));
        let view = self.views.len() - 1;
        self.accessors.push(json!({"bufferView": view, "componentType": 5126, "count": vectors.len(), "type": kind}));
        self.accessors.len() - 1
    }

    /// Returns the bytes of the file.
    fn glb(&self, json: &Value) -> Vec<u8> {
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let size = 12 + 8 + text.len() + 8 + self.bytes.len();
        let word = |number: usize| (number as u32).to_le_bytes();
        let header = [&b"glTF"[..], &word(2), &word(size), &word(text.len()), b"JSON", &text].concat();
        [&header[..], &word(self.bytes.len()), b"BIN\0", &self.bytes].concat()
    }
}
