//! The part of a glTF document that is read. Optional fields and the notation of numbers are as in the
//! specification and as in files.
//!
//! Other parts (animations, extras, unknown extensions) are skipped unchecked, and broken elements of lists
//! are errors only where they are used, so that unused parts cannot make a file unreadable.

use std::collections::HashMap;

use serde::{Deserialize, Deserializer, de};
use serde_json::Value;

use super::list::{Extensions, List};

/// A whole number, which programs without integers write as `1.0` or `1e3`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Whole(pub u64);

impl Whole {
    /// Returns the number as an index; beyond any array if it does not fit.
    pub fn index(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl de::Visitor<'_> for Visitor {
            type Value = Whole;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a whole number that is not negative")
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<Whole, E> {
                Ok(Whole(value))
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Whole, E> {
                // Above 2^53, f64 does not represent every integer.
                let is_whole = value.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(&value);
                is_whole
                    .then_some(Whole(value as u64))
                    .ok_or_else(|| E::invalid_value(de::Unexpected::Float(value), &self))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// The document.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Root {
    pub asset: Asset,
    pub accessors: List<Accessor>,
    pub buffers: List<Buffer>,
    pub buffer_views: List<BufferView>,
    pub cameras: List<Camera>,
    pub extensions_required: Vec<String>,
    pub extensions_used: Vec<String>,
    pub images: List<Image>,
    pub materials: List<Material>,
    pub meshes: List<Mesh>,
    pub nodes: List<Node>,
    pub samplers: List<Sampler>,
    pub scene: Option<Whole>,
    pub scenes: List<Scene>,
    pub skins: List<Skin>,
    pub textures: List<Texture>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct Asset {
    pub version: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Accessor {
    pub buffer_view: Option<Whole>,
    #[serde(default)]
    pub byte_offset: Whole,
    pub component_type: Whole,
    pub count: Whole,
    #[serde(default)]
    pub extensions: Extensions,
    #[serde(default)]
    pub normalized: bool,
    pub sparse: Option<Sparse>,
    #[serde(rename = "type")]
    pub kind: String,
}

/// Elements of an accessor that differ from its buffer view, or from zero.
#[derive(Deserialize)]
pub struct Sparse {
    pub count: Whole,
    pub indices: SparsePart,
    pub values: SparsePart,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct SparsePart {
    pub buffer_view: Whole,
    #[serde(default)]
    pub byte_offset: Whole,
    /// For indices only.
    pub component_type: Option<Whole>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Buffer {
    pub byte_length: Whole,
    #[serde(default)]
    pub extensions: Extensions,
    pub uri: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct BufferView {
    pub buffer: Whole,
    pub byte_length: Whole,
    #[serde(default)]
    pub byte_offset: Whole,
    pub byte_stride: Option<Whole>,
    #[serde(default)]
    pub extensions: Extensions,
}

#[derive(Deserialize)]
pub struct Camera {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    /// A [`Perspective`].
    pub perspective: Option<Value>,
    /// An [`Orthographic`].
    pub orthographic: Option<Value>,
}

#[derive(Deserialize)]
pub struct Perspective {
    /// Radians.
    pub yfov: f32,
}

/// Half the image's height in metres.
#[derive(Deserialize)]
pub struct Orthographic {
    pub ymag: f32,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Image {
    pub buffer_view: Option<Whole>,
    pub mime_type: Option<String>,
    pub uri: Option<String>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Material {
    /// For alpha mode `MASK` only.
    pub alpha_cutoff: Option<f32>,
    pub alpha_mode: Option<String>,
    pub double_sided: bool,
    pub emissive_factor: [f32; 3],
    pub emissive_texture: Option<TextureInfo>,
    pub extensions: MaterialExtensions,
    pub normal_texture: Option<TextureInfo>,
    pub pbr_metallic_roughness: Pbr,
}

impl Material {
    /// Returns whether surfaces are opaque where alpha is at least the cutoff, and absent elsewhere.
    pub fn is_masked(&self) -> bool {
        self.alpha_mode.as_deref() == Some("MASK")
    }
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct MaterialExtensions {
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub emissive_strength: Option<EmissiveStrength>,
    /// All other extensions.
    #[serde(flatten)]
    pub others: HashMap<String, de::IgnoredAny>,
}

/// `KHR_materials_emissive_strength`.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct EmissiveStrength {
    pub emissive_strength: Option<f32>,
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Pbr {
    pub base_color_factor: [f32; 4],
    pub base_color_texture: Option<TextureInfo>,
    pub metallic_factor: f32,
    pub metallic_roughness_texture: Option<TextureInfo>,
    pub roughness_factor: f32,
}

impl Default for Pbr {
    fn default() -> Self {
        Self {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            metallic_roughness_texture: None,
            roughness_factor: 1.0,
        }
    }
}

/// A texture and how a surface refers to it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct TextureInfo {
    pub index: Whole,
    #[serde(default)]
    pub tex_coord: Whole,
    /// For normal textures only.
    pub scale: Option<f32>,
    #[serde(default)]
    pub extensions: TextureInfoExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct TextureInfoExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub transform: Option<TextureTransform>,
}

/// `KHR_texture_transform`.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(default, rename_all = "camelCase")]
pub struct TextureTransform {
    pub offset: [f32; 2],
    pub rotation: f32,
    pub scale: [f32; 2],
    pub tex_coord: Option<Whole>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2], tex_coord: None }
    }
}

#[derive(Deserialize)]
pub struct Mesh {
    #[serde(default)]
    pub extensions: Extensions,
    pub name: Option<String>,
    pub primitives: Vec<Primitive>,
    #[serde(default)]
    pub weights: Vec<f32>,
}

#[derive(Deserialize)]
pub struct Primitive {
    pub attributes: HashMap<String, Whole>,
    #[serde(default)]
    pub extensions: Extensions,
    pub indices: Option<Whole>,
    pub material: Option<Whole>,
    pub mode: Option<Whole>,
    #[serde(default)]
    pub targets: Vec<HashMap<String, Whole>>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct Node {
    /// The index of a camera, checked when the camera is opened.
    pub camera: Option<Value>,
    pub children: Vec<Whole>,
    pub matrix: Option<[f64; 16]>,
    pub mesh: Option<Whole>,
    pub name: Option<String>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub skin: Option<Whole>,
    pub translation: Option<[f64; 3]>,
    pub weights: Option<Vec<f32>>,
    pub extensions: NodeExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub instancing: Option<Instancing>,
    #[serde(rename = "KHR_lights_punctual")]
    pub light: Option<de::IgnoredAny>,
}

/// `EXT_mesh_gpu_instancing`: accessors of TRANSLATION, ROTATION and SCALE.
#[derive(Deserialize)]
pub struct Instancing {
    pub attributes: HashMap<String, Whole>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Sampler {
    pub mag_filter: Option<Whole>,
    pub wrap_s: Option<Whole>,
    pub wrap_t: Option<Whole>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct Scene {
    pub name: Option<String>,
    pub nodes: Vec<Whole>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Skin {
    pub joints: Vec<Whole>,
    pub inverse_bind_matrices: Option<Whole>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub struct Texture {
    pub extensions: Extensions,
    pub sampler: Option<Whole>,
    pub source: Option<Whole>,
}
