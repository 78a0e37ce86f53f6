//! Metallic-roughness materials and their textures.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use glam::{Vec3A, Vec4};
use image::{DynamicImage, GenericImageView};

use super::{
    document::{Document, in_field},
    json::{self, TextureInfo, Whole},
};
use crate::{
    error::Result,
    image::decode_compressed,
    scene::{Filter, Material, NormalMap, Texture, TexturedMetallicRoughness, Wrap, texture::AlphaTexture},
};

/// Maximum number of texels of all textures of a file (768 MiB, and 256 MiB of alpha if all are masks). One
/// image can be used by any number of textures, and compresses to almost nothing when it is blank.
const MAX_TEXELS: u64 = 1 << 28;

/// Reads the materials of the file in their order, followed by the default one. The textures of materials
/// outside `used` are not read.
pub fn read_all(document: &Document, used: &BTreeSet<usize>, textures: &mut Textures<'_>) -> Result<Vec<Material>> {
    let mut materials = Vec::new();
    for i in 0..document.root().materials.len() {
        materials.push(if used.contains(&i) {
            let material = document.get(&document.root().materials, Whole(i as u64), "materials")?;
            warn_of_what_is_left_out(document, material);
            read_material(document, material, i, textures)?
        } else {
            default_material()
        });
    }
    materials.push(default_material());
    Ok(materials)
}

/// Warns of features of a material that are ignored.
fn warn_of_what_is_left_out(document: &Document, material: &json::Material) {
    let mut extensions: Vec<&String> = material.extensions.others.keys().collect();
    extensions.sort();
    extensions.into_iter().for_each(|name| document.warn_of_extension(name));
    match material.alpha_mode.as_deref() {
        None | Some("OPAQUE" | "MASK") => {}
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
pub struct Textures<'a> {
    document: &'a Document,
    /// Colours by index of the texture.
    read: HashMap<usize, Arc<Texture>>,
    /// Alphas by index of the texture; `None` where the image has no alpha channel.
    alphas: HashMap<usize, Option<Arc<AlphaTexture>>>,
    texels_left: u64,
}

impl<'a> Textures<'a> {
    /// Starts without textures.
    pub fn new(document: &'a Document) -> Self {
        Self { document, read: HashMap::new(), alphas: HashMap::new(), texels_left: MAX_TEXELS }
    }

    /// Returns the texture of an index given in `field`; `None` if its image format is not supported.
    fn get(&mut self, index: Whole, field: &str) -> Result<Option<Arc<Texture>>> {
        if let Some(texture) = self.read.get(&index.index()) {
            return Ok(Some(Arc::clone(texture)));
        }
        let Some(decoded) = self.decode(index, field)? else { return Ok(None) };
        self.keep_color(index, decoded).map(Some)
    }

    /// Returns the alpha channel of the texture of an index given in `field`; `None` if it has none or its
    /// image format is not supported. The colours are kept too, so that the image is decoded once.
    pub fn alpha(&mut self, index: Whole, field: &str) -> Result<Option<Arc<AlphaTexture>>> {
        if let Some(alpha) = self.alphas.get(&index.index()) {
            return Ok(alpha.clone());
        }
        let Some(decoded) = self.decode(index, field)? else { return Ok(None) };
        let alpha = decoded.alpha().map_err(|error| in_field(self.document, &decoded.field, error))?.map(Arc::new);
        self.keep_color(index, decoded)?;
        self.alphas.insert(index.index(), alpha.clone());
        Ok(alpha)
    }

    fn keep_color(&mut self, index: Whole, decoded: Decoded) -> Result<Arc<Texture>> {
        let field = decoded.field.clone();
        let texture = decoded.into_color().map_err(|error| in_field(self.document, &field, error))?;
        let texture = Arc::new(texture);
        self.read.insert(index.index(), Arc::clone(&texture));
        Ok(texture)
    }

    /// Decodes the image of the texture of an index given in `field`; `None` if its format is not supported.
    fn decode(&mut self, index: Whole, field: &str) -> Result<Option<Decoded>> {
        let (document, root) = (self.document, self.document.root());
        let texture = document.get(&root.textures, index, field)?;
        let field = format!("textures[{}]", index.0);
        let (wrap, filter) = match texture.sampler {
            Some(sampler) => {
                let sampler = document.get(&root.samplers, sampler, &format!("{field}.sampler"))?;
                ([wrap(sampler.wrap_s), wrap(sampler.wrap_t)], filter(sampler.mag_filter))
            }
            None => Default::default(),
        };
        let extensions: Vec<String> = texture.extensions.0.iter().map(|name| name.escape_debug().to_string()).collect();
        let Some(source) = texture.source else {
            let by = if extensions.is_empty() { String::new() } else { format!(" ({})", extensions.join(", ")) };
            document.warn(format!("ignored textures without a PNG or JPEG image{by}"));
            return Ok(None);
        };
        let image = document.get(&root.images, source, &format!("{field}.source"))?;
        let field = format!("images[{}]", source.0);
        // The file declares that they are neither PNG nor JPEG.
        if let Some(kind @ ("image/webp" | "image/ktx2" | "image/avif" | "image/vnd-ms.dds")) =
            image.mime_type.as_deref()
        {
            document.warn(format!("ignored textures of type {kind}"));
            return Ok(None);
        }
        let image = match (image.buffer_view, &image.uri) {
            (Some(view), _) => self.decompress(document.view(view, &field)?.0, &field)?,
            (None, Some(uri)) => self.decompress(&document.resolve(uri, &format!("{field}.uri"))?, &field)?,
            (None, None) => return Err(document.invalid(field, "has neither uri nor bufferView")),
        };
        Ok(Some(Decoded { image, wrap, filter, field }))
    }

    /// Decodes a PNG or JPEG file.
    fn decompress(&mut self, bytes: &[u8], field: &str) -> Result<DynamicImage> {
        let invalid = |reason: String| self.document.invalid(field, reason);
        let image = decode_compressed(bytes, self.texels_left).map_err(invalid)?;
        self.texels_left -= u64::from(image.width()) * u64::from(image.height());
        Ok(image)
    }
}

/// The decoded image of a texture.
struct Decoded {
    image: DynamicImage,
    wrap: [Wrap; 2],
    filter: Filter,
    /// The image's field in the file.
    field: String,
}

impl Decoded {
    /// Width and height in texels.
    fn size(&self) -> (usize, usize) {
        (self.image.width() as usize, self.image.height() as usize)
    }

    /// The alpha channel in 8 bits, if the image has one.
    fn alpha(&self) -> Result<Option<AlphaTexture>> {
        if !self.image.color().has_alpha() {
            return Ok(None);
        }
        let (width, height) = self.size();
        let texels = self.image.pixels().map(|(_, _, pixel)| pixel.0[3]).collect();
        AlphaTexture::new(width, height, texels, self.wrap, self.filter).map(Some)
    }

    fn into_color(self) -> Result<Texture> {
        let (width, height) = self.size();
        let texels = self.image.into_rgb8().pixels().map(|pixel| pixel.0).collect();
        Texture::new(width, height, texels, self.wrap).map(|texture| texture.with_filter(self.filter))
    }
}

/// Textures are not reduced, so that the filter for magnification applies at all distances.
fn filter(magnified: Option<Whole>) -> Filter {
    match magnified {
        Some(Whole(9728)) => Filter::Nearest,
        _ => Filter::Bilinear,
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

/// The material of primitives without one.
pub(super) fn default_material() -> Material {
    Material::MetallicRoughness(TexturedMetallicRoughness::default())
}
