//! Metallic-roughness materials and their textures.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use glam::{Vec3A, Vec4};

use super::{
    default_material,
    document::Document,
    in_field,
    json::{self, TextureInfo, Whole},
};
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
            warn_of_what_is_left_out(document, material);
            read_material(document, material, i, &mut textures)?
        } else {
            default_material()
        });
    }
    materials.push(default_material());
    Ok(materials)
}

/// What a material has that the model has not.
fn warn_of_what_is_left_out(document: &Document, material: &json::Material) {
    let mut extensions: Vec<&String> = material.extensions.others.keys().collect();
    extensions.sort();
    extensions.into_iter().for_each(|name| document.warn_of_extension(name));
    match material.alpha_mode.as_deref() {
        None | Some("OPAQUE") => {}
        Some(mode) => {
            document.warn(format!("ignored alphaMode {}: surfaces are opaque", mode.escape_debug()));
        }
    }
}

fn read_material(
    document: &Document,
    material: &json::Material,
    index: usize,
    textures: &mut Textures<'_>,
) -> Result<Material> {
    let field = format!("materials[{index}].pbrMetallicRoughness");
    let pbr = &material.pbr_metallic_roughness;
    let color = Vec4::from_array(pbr.base_color_factor);
    let unit = |name: &str, values: &[f32]| {
        if values.iter().all(|value| value.is_finite() && *value >= 0.0) {
            Ok(())
        } else {
            Err(document.invalid(format!("{field}.{name}"), "is negative or not finite"))
        }
    };
    unit("baseColorFactor", &color.to_array())?;
    unit("metallicFactor", &[pbr.metallic_factor])?;
    unit("roughnessFactor", &[pbr.roughness_factor])?;
    let normal_map = match &material.normal_texture {
        Some(info) => {
            let scale = info.scale.unwrap_or(1.0);
            if !scale.is_finite() {
                return Err(document.invalid(format!("materials[{index}].normalTexture.scale"), "is not finite"));
            }
            let texture = textures.get(info.index, &format!("materials[{index}].normalTexture.index"))?;
            texture.map(|texture| NormalMap { texture, scale })
        }
        None => None,
    };
    let strength = material.extensions.emissive_strength.as_ref().and_then(|own| own.emissive_strength).unwrap_or(1.0);
    let emission = strength * Vec3A::from_array(material.emissive_factor);
    if !(emission.is_finite() && emission.min_element() >= 0.0) {
        return Err(document.invalid(format!("materials[{index}].emissiveFactor"), "is negative or not finite"));
    }
    let emission_texture = match &material.emissive_texture {
        Some(info) if emission != Vec3A::ZERO => {
            textures.get(info.index, &format!("materials[{index}].emissiveTexture.index"))?
        }
        _ => None,
    };
    let mut texture = |info: &Option<TextureInfo>, name: &str| match info {
        Some(info) => textures.get(info.index, &format!("{field}.{name}.index")),
        None => Ok(None),
    };
    Ok(Material::MetallicRoughness(TexturedMetallicRoughness {
        base_color: Vec3A::from(color.truncate()),
        base_color_texture: texture(&pbr.base_color_texture, "baseColorTexture")?,
        metallic: pbr.metallic_factor.min(1.0),
        roughness: pbr.roughness_factor.min(1.0),
        metallic_roughness_texture: texture(&pbr.metallic_roughness_texture, "metallicRoughnessTexture")?,
        normal_map,
        emission,
        emission_texture,
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
    /// The texture of that index, which stands in `field`; `None` where it has no image that can be read.
    fn get(&mut self, index: Whole, field: &str) -> Result<Option<Arc<Texture>>> {
        if let Some(texture) = self.read.get(&index.index()) {
            return Ok(Some(Arc::clone(texture)));
        }
        let (document, root) = (self.document, self.document.root());
        let texture = document.get(&root.textures, index, field)?;
        let field = format!("textures[{}]", index.0);
        let wrap = match texture.sampler {
            Some(sampler) => {
                let sampler = document.get(&root.samplers, sampler, &format!("{field}.sampler"))?;
                [wrap(sampler.wrap_s), wrap(sampler.wrap_t)]
            }
            None => [Wrap::Repeat; 2],
        };
        let mut extensions: Vec<String> =
            texture.extensions.keys().map(|name| name.escape_debug().to_string()).collect();
        extensions.sort();
        let Some(source) = texture.source else {
            let by = if extensions.is_empty() { String::new() } else { format!(" ({})", extensions.join(", ")) };
            document.warn(format!("ignored textures without a PNG or JPEG image{by}"));
            return Ok(None);
        };
        let image = document.get(&root.images, source, &format!("{field}.source"))?;
        let field = format!("images[{}]", source.0);
        // The file itself says that they are neither PNG nor JPEG.
        if let Some(kind @ ("image/webp" | "image/ktx2" | "image/avif" | "image/vnd-ms.dds")) =
            image.mime_type.as_deref()
        {
            document.warn(format!("ignored textures of type {kind}"));
            return Ok(None);
        }
        let (width, height, texels) = match (image.buffer_view, &image.uri) {
            (Some(view), _) => self.decode(document.view(view, &field)?.0, &field)?,
            (None, Some(uri)) => self.decode(&document.resolve(uri, &format!("{field}.uri"))?, &field)?,
            (None, None) => return Err(document.invalid(field, "has neither uri nor bufferView")),
        };
        let texture = Texture::new(width, height, texels, wrap).map_err(|error| in_field(document, &field, error))?;
        let texture = Arc::new(texture);
        self.read.insert(index.index(), Arc::clone(&texture));
        Ok(Some(texture))
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
fn wrap(mode: Option<Whole>) -> Wrap {
    match mode {
        Some(Whole(33_071)) => Wrap::Clamp,
        Some(Whole(33_648)) => Wrap::Mirror,
        _ => Wrap::Repeat,
    }
}
