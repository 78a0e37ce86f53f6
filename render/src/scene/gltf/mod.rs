//! Reads glTF 2.0 scenes, `.gltf` and `.glb`.
//!
//! The JSON layer of the `gltf` crate gives the data types. Its wrappers are not used: they unwrap indices, and its
//! validation itself indexes out of range on a bad `POSITION` accessor. Here each index is looked up with a check, and
//! each size is checked before anything is allocated for it.

mod accessor;
mod document;
mod materials;
mod nodes;
mod primitive;
mod uri;

#[cfg(test)]
mod tests;

use std::{collections::BTreeSet, path::Path};

use super::{Material, Mesh, Scene, TexturedMetallicRoughness};
use crate::error::{Error, Result};
use document::Document;

impl Scene {
    /// Loads the default scene of a glTF 2.0 file (`.gltf` or `.glb`), with its first perspective camera if it has one.
    ///
    /// Read are the node hierarchy, triangles with normals and texture coordinates, and metallic-roughness materials with
    /// their textures of base colour, metalness with roughness, and normals. Skins, morph targets, transparency and the other textures
    /// are left out, as is the roll of the camera.
    ///
    /// # Errors
    /// When the file or one that it names cannot be read, or a field does not hold what glTF asks of it. External files
    /// must lie in the folder of `path` or below.
    pub fn load(path: &Path) -> Result<Self> {
        let document = Document::open(path)?;
        let placed = nodes::placed(&document)?;
        let mut meshes = Vec::new();
        for instance in &placed.meshes {
            meshes.extend(primitive::read_mesh(&document, instance)?);
        }
        if meshes.iter().all(|mesh: &Mesh| mesh.triangles.is_empty()) {
            return Err(document.invalid("scenes", "the scene to show has no triangles"));
        }
        let used: BTreeSet<usize> = meshes.iter().map(|mesh| mesh.material).collect();
        let materials = materials::read_all(&document, &used)?;
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        Self::new(name, meshes, materials, placed.camera)
    }
}

/// Turns an error about a value that was made from `field` into one that names the file and the field.
fn in_field(document: &Document, field: &str, error: Error) -> Error {
    match error {
        Error::Argument { what, reason } => document.invalid(format!("{field}: {what}"), reason),
        other => other,
    }
}

/// The material of primitives without one: glTF's defaults, a white metal as rough as can be.
fn default_material() -> Material {
    Material::MetallicRoughness(TexturedMetallicRoughness {
        base_color: glam::Vec3A::ONE,
        base_color_texture: None,
        metallic: 1.0,
        roughness: 1.0,
        metallic_roughness_texture: None,
        normal_map: None,
    })
}
