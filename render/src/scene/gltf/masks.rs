//! Alpha masks of materials: `alphaMode` `MASK`.

use std::collections::{BTreeSet, HashMap};

use super::{document::Document, json, materials::Textures};
use crate::{error::Result, scene::mask::Mask};

/// The cutoff of materials without one.
const DEFAULT_CUTOFF: f32 = 0.5;

/// Reads the masks of the materials in `used`, by index.
///
/// # Errors
/// When a mask cannot be read and `is_strict`. If not strict, a warning is raised and the material
/// has no mask.
pub fn read_all(
    document: &Document,
    used: &BTreeSet<usize>,
    textures: &mut Textures<'_>,
    is_strict: bool,
) -> Result<HashMap<usize, Mask>> {
    let mut masks = HashMap::new();
    for &index in used {
        // The default material is beyond the list.
        let material = document.root().materials.get(index);
        let Some(material) = material.filter(|material| material.is_masked()) else { continue };
        match read_mask(document, material, index, textures) {
            Ok(mask) => drop(masks.insert(index, mask)),
            Err(error) if is_strict => return Err(error),
            Err(_) => document.warn("ignored alphaMode MASK where alpha cannot be read: surfaces are opaque"),
        }
    }
    Ok(masks)
}

fn read_mask(
    document: &Document,
    material: &json::Material,
    index: usize,
    textures: &mut Textures<'_>,
) -> Result<Mask> {
    let pbr = &material.pbr_metallic_roughness;
    let cutoff = material.alpha_cutoff.unwrap_or(DEFAULT_CUTOFF);
    let factor = pbr.base_color_factor[3];
    for (name, value) in [("alphaCutoff", cutoff), ("pbrMetallicRoughness.baseColorFactor", factor)] {
        if !(value.is_finite() && value >= 0.0) {
            return Err(document.invalid(format!("materials[{index}].{name}"), "is negative or not finite"));
        }
    }
    let texture = match &pbr.base_color_texture {
        Some(info) => {
            let field = format!("materials[{index}].pbrMetallicRoughness.baseColorTexture.index");
            textures.alpha(info.index, &field)?
        }
        None => None,
    };
    Ok(Mask { cutoff, factor: factor.min(1.0), texture })
}
