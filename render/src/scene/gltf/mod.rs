//! Reads glTF 2.0 scenes, `.gltf` and `.glb`.
//!
//! The document is parsed into the types of [`json`], which are as lenient as the specification and as files
//! require. Each index is checked before its use, and each size before anything is allocated for it.
//!
//! | file | concept |
//! | --- | --- |
//! | `json.rs`, `list.rs` | the part of a document that is read; its lists |
//! | `document.rs`, `uri.rs` | the file with its buffers; where bytes are |
//! | `accessor.rs` | typed elements of buffers |
//! | `nodes.rs`, `cameras.rs`, `instances.rs` | the node hierarchy; cameras; placed meshes |
//! | `primitive.rs`, `skins.rs` | the triangles of a mesh; vertices moved by joints |
//! | `materials.rs`, `masks.rs` | materials with textures; alpha masks |

mod accessor;
mod cameras;
mod document;
mod instances;
mod json;
mod list;
mod masks;
mod materials;
mod nodes;
mod primitive;
mod skins;
mod uri;

#[cfg(test)]
mod tests;

use std::{collections::BTreeSet, path::Path};

use glam::{DAffine3, DVec3, Vec2};

use super::{Camera, Material, Mesh, Scene};
use crate::{error::Result, remark::Remark};
use cameras::PlacedCamera;
use document::Document;
use materials::{Textures, default_material};
use nodes::Placed;

/// A scene whose middle is farther from the origin than this many times its size is moved there: f32
/// positions would resolve only 1e-4 of its size.
const FAR: f64 = 1e3;

/// Scenes of more triangles share meshes between nodes: a copied triangle takes about 250 bytes. In smaller
/// scenes, copies in world space are faster to trace.
const MOST_COPIED: usize = 1 << 21;

/// Options for reading a glTF file.
#[derive(Clone, Debug)]
pub struct LoadOptions<'a> {
    /// The name or the number of the scene; `None` for the file's default.
    pub scene: Option<&'a str>,
    /// Whether materials and textures are read; without them, all surfaces have glTF's default material.
    ///
    /// Alpha masks are read in both cases, with the textures they need, because they change visibility.
    /// A mask that cannot be read is an error with materials. Without them it raises a warning, and its
    /// surfaces are opaque.
    pub materials: bool,
}

impl Default for LoadOptions<'_> {
    fn default() -> Self {
        Self { scene: None, materials: true }
    }
}

impl Scene {
    /// Loads the default scene of a glTF 2.0 file (`.gltf` or `.glb`) with its cameras; see [`Self::load_with`].
    ///
    /// # Errors
    /// As [`Self::load_with`].
    pub fn load(path: &Path) -> Result<Self> {
        Self::load_with(path, &LoadOptions::default())
    }

    /// Loads a scene of a glTF 2.0 file.
    ///
    /// The loader reads the node hierarchy with instances, triangles with normals, texture coordinates and
    /// vertex colours, morph targets at their weights, skins in the pose of the nodes, cameras, and
    /// metallic-roughness materials with their textures of base colour, metalness with roughness, normals and
    /// emission, and their alpha masks. [`Self::remarks`] names the features of the file that are ignored. A
    /// scene far from the origin is moved there.
    ///
    /// # Errors
    /// When the file or one that it references cannot be read, or a field that the scene uses is not valid
    /// glTF. External files must lie below the folder of `path` or its parent.
    pub fn load_with(path: &Path, options: &LoadOptions<'_>) -> Result<Self> {
        Self::load_within(path, options, MOST_COPIED)
    }

    /// [`Self::load_with`] that shares meshes between their nodes if there would be more than `most_copied`
    /// triangles.
    pub(super) fn load_within(path: &Path, options: &LoadOptions<'_>, most_copied: usize) -> Result<Self> {
        let document = Document::open(path)?;
        let Placed { meshes: instances, cameras } = nodes::placed(&document, options.scene)?;
        let meshes = instances::read(&document, instances, most_copied)?;
        if meshes.iter().all(|(mesh, _)| mesh.triangles.is_empty()) {
            return Err(document.invalid("scenes", "the scene to show has no triangles"));
        }
        let origin = origin(&meshes);
        if origin != DVec3::ZERO {
            let [x, y, z] = origin.to_array();
            document.remark(Remark::Note(format!("moved the scene by {}, {}, {} to the origin", -x, -y, -z)));
        }
        let meshes = meshes
            .into_iter()
            .map(|(mesh, places)| instances::place(&document, mesh, &places, origin))
            .collect::<Result<_>>()?;
        let (meshes, materials) = with_materials(&document, meshes, options.materials)?;
        let first = default_camera(&document, &cameras, origin);
        let cameras = cameras.into_iter().map(|placed| (placed.open(origin), placed.name));
        let cameras = cameras.map(|(camera, name)| (name, camera)).collect();
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let scene = Self::new(name, meshes, materials, first)?;
        Ok(Self { cameras, remarks: document.into_remarks(), ..scene })
    }
}

/// Returns the first perspective camera, or else the first one. Warns of each that cannot be opened before
/// one can.
fn default_camera(document: &Document, cameras: &[PlacedCamera<'_>], origin: DVec3) -> Option<Camera> {
    let (perspective, others): (Vec<_>, Vec<_>) = cameras.iter().partition(|camera| camera.is_perspective());
    perspective.into_iter().chain(others).find_map(|camera| match camera.open(origin) {
        Ok(camera) => Some(camera),
        Err(reason) => {
            document.warn(format!("left out a camera: {reason}"));
            None
        }
    })
}

/// Returns the meshes with their alpha masks and sidedness, and the materials they refer to: the file's or, if
/// not `materials`, copies of the default one.
fn with_materials(document: &Document, meshes: Vec<Mesh>, materials: bool) -> Result<(Vec<Mesh>, Vec<Material>)> {
    let used: BTreeSet<usize> = meshes.iter().map(|mesh| mesh.material).collect();
    let mut textures = Textures::new(document);
    let masks = masks::read_all(document, &used, &mut textures, materials)?;
    let own = |mesh: Mesh| {
        let material = document.root().materials.get(mesh.material);
        // The default material is single-sided, too.
        let mesh = Mesh { is_single_sided: !material.is_some_and(|material| material.double_sided), ..mesh };
        match masks.get(&mesh.material) {
            Some(mask) => mesh.with_mask(mask.clone()),
            None => mesh,
        }
    };
    let materials = if materials {
        meshes.iter().for_each(|mesh| warn_of_missing_texcoords(document, mesh));
        materials::read_all(document, &used, &mut textures)?
    } else {
        vec![default_material(); document.root().materials.len() + 1]
    };
    Ok((meshes.into_iter().map(own).collect(), materials))
}

/// Warns of textures at coordinates that a mesh does not have.
fn warn_of_missing_texcoords(document: &Document, mesh: &Mesh) {
    let Some(material) = document.root().materials.get(mesh.material) else { return };
    let pbr = &material.pbr_metallic_roughness;
    let or_shared = |own: &Option<Vec<Vec2>>| own.as_ref().unwrap_or(&mesh.texcoords).is_empty();
    let missing = [
        (&pbr.base_color_texture, mesh.texcoords.is_empty()),
        (&pbr.metallic_roughness_texture, or_shared(&mesh.roughness_texcoords)),
        (&material.normal_texture, mesh.tangent_space.is_none()),
        (&material.emissive_texture, or_shared(&mesh.emission_texcoords)),
    ];
    if !mesh.triangles.is_empty() && missing.iter().any(|(texture, is_missing)| texture.is_some() && *is_missing) {
        document.warn("ignored textures at texture coordinates that a mesh does not have");
    }
}

/// Returns the new origin of the scene, in whole metres: its middle if that is far away, else zero.
fn origin(meshes: &[(Mesh, Vec<DAffine3>)]) -> DVec3 {
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (mesh, places) in meshes {
        for (to_world, position) in places.iter().flat_map(|place| mesh.positions.iter().map(move |p| (place, p))) {
            let p = to_world.transform_point3(position.as_dvec3());
            (min, max) = (min.min(p), max.max(p));
        }
    }
    let (middle, extent) = (0.5 * (min + max), (max - min).max_element());
    let is_far = middle.is_finite() && middle.abs().max_element() > FAR * extent.max(1e-3);
    if is_far { middle.round() } else { DVec3::ZERO }
}
