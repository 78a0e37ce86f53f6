//! Metallic-roughness materials and their textures.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use glam::{Vec3A, Vec4};
use gltf::json::{self, Index, texture::WrappingMode, validation::Checked};

use super::{default_material, document::Document, in_field};
use crate::{
    error::Result,
    image::decode_compressed,
    scene::{Material, NormalMap, Texture, TexturedMetallicRoughness, Wrap},
};

/// The most texels that all textures of a file may have together (768 MiB). One image can be named by any number of
/// textures, and compresses to almost nothing when it is blank.
const MAX_TEXELS: u64 = 1 << 28;

/// The materials of the file in their order, and the default one behind them. The textures of materials outside of
/// `used` are not read.
pub fn read_all(document: &Document, used: &BTreeSet<usize>) -> Result<Vec<Material>> {
    let mut textures = Textures { document, read: HashMap::new(), texels_left: MAX_TEXELS };
    let mut materials = Vec::new();
    for (i, material) in document.root().materials.iter().enumerate() {
        materials.push(if used.contains(&i) {
            read_material(document, material, i, &mut textures)?
        } else {
            default_material()
        });
    }
    materials.push(default_material());
    Ok(materials)
}

fn read_material(
    document: &Document,
    material: &json::Material,
    index: usize,
    textures: &mut Textures<'_>,
) -> Result<Material> {
    let field = format!("materials[{index}].pbrMetallicRoughness");
    let pbr = &material.pbr_metallic_roughness;
    let color = Vec4::from_array(pbr.base_color_factor.0);
    let unit = |name: &str, values: &[f32]| {
        if values.iter().all(|value| value.is_finite() && *value >= 0.0) {
            Ok(())
        } else {
            Err(document.invalid(format!("{field}.{name}"), "is negative or not finite"))
        }
    };
    unit("baseColorFactor", &color.to_array())?;
    unit("metallicFactor", &[pbr.metallic_factor.0])?;
    unit("roughnessFactor", &[pbr.roughness_factor.0])?;
    let normal_map = match &material.normal_texture {
        Some(info) if !info.scale.is_finite() => {
            return Err(document.invalid(format!("materials[{index}].normalTexture.scale"), "is not finite"));
        }
        Some(info) => {
            let texture = textures.get(info.index, &format!("materials[{index}].normalTexture.index"))?;
            Some(NormalMap { texture, scale: info.scale })
        }
        None => None,
    };
    let mut texture = |info: &Option<json::texture::Info>, name: &str| match info {
        Some(info) => textures.get(info.index, &format!("{field}.{name}.index")).map(Some),
        None => Ok(None),
    };
    Ok(Material::MetallicRoughness(TexturedMetallicRoughness {
        base_color: Vec3A::from(color.truncate()),
        base_color_texture: texture(&pbr.base_color_texture, "baseColorTexture")?,
        metallic: pbr.metallic_factor.0.min(1.0),
        roughness: pbr.roughness_factor.0.min(1.0),
        metallic_roughness_texture: texture(&pbr.metallic_roughness_texture, "metallicRoughnessTexture")?,
        normal_map,
    }))
}

/// The textures read so far.
struct Textures<'a> {
    document: &'a Document,
    /// By index of the texture.
    read: HashMap<usize, Arc<Texture>>,
    texels_left: u64,
}

impl Textures<'_> {
    /// The texture of that index, which stands in `field`.
    fn get(&mut self, index: Index<json::Texture>, field: &str) -> Result<Arc<Texture>> {
        if let Some(texture) = self.read.get(&index.value()) {
            return Ok(Arc::clone(texture));
        }
        let document = self.document;
        let texture = document.get(index, field)?;
        let wrap = match texture.sampler {
            Some(sampler) => {
                let sampler = document.get(sampler, &format!("textures[{}].sampler", index.value()))?;
                [wrap(sampler.wrap_s), wrap(sampler.wrap_t)]
            }
            None => [Wrap::Repeat; 2],
        };
        let source = texture.source;
        let image = document.get(source, &format!("textures[{}].source", index.value()))?;
        let field = format!("images[{}]", source.value());
        let (width, height, texels) = match (image.buffer_view, &image.uri) {
            (Some(view), _) => self.decode(document.view(view.value(), &field)?.0, &field)?,
            (None, Some(uri)) => self.decode(&document.resolve(uri, &format!("{field}.uri"))?, &field)?,
            (None, None) => return Err(document.invalid(field, "has neither uri nor bufferView")),
        };
        let texture = Texture::new(width, height, texels, wrap).map_err(|error| in_field(document, &field, error))?;
        let texture = Arc::new(texture);
        self.read.insert(index.value(), Arc::clone(&texture));
        Ok(texture)
    }

    /// Width, height and texels of a PNG or JPEG file.
    fn decode(&mut self, bytes: &[u8], field: &str) -> Result<(usize, usize, Vec<[u8; 3]>)> {
        let invalid = |reason: String| self.document.invalid(field, reason);
        let image = decode_compressed(bytes, self.texels_left).map_err(invalid)?.into_rgb8();
        self.texels_left -= u64::from(image.width()) * u64::from(image.height());
        let texels = image.pixels().map(|pixel| pixel.0).collect();
        Ok((image.width() as usize, image.height() as usize, texels))
    }
}

/// An unknown mode is the default one, as in WebGL.
fn wrap(mode: Checked<WrappingMode>) -> Wrap {
    match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
    }
}
