//! Faces, materials and textures as `surface.wgsl` reads them.

use std::{collections::HashMap, sync::Arc};

use glam::{Vec3, Vec3A};
use headtail_render::{
    brdf::{Brdf, BrdfTable, FlatBrdf, flat_lobe_albedo},
    color::srgb_decode,
    flat::FlatNumbers,
    scene::{Filter, FlatFace, FlatMask, Material, Scene, Texture, TexturedMetallicRoughness, Wrap},
};

use crate::error::{Error, Result};

/// A place that refers to nothing.
const NONE: u32 = u32::MAX;
/// Kinds of materials.
const DIFFUSE: u32 = 0;
const MIRROR: u32 = 1;
const METALLIC_ROUGHNESS: u32 = 2;
const MEASURED: u32 = 3;
const NEURAL: u32 = 4;
/// Words of a face.
const OF_FACE: usize = 10;
/// Words of a material, and the places of its textures and its emission in them.
const OF_MATERIAL: usize = 16;
const COLOR_TEXTURE: usize = 10;
const ROUGHNESS_TEXTURE: usize = 11;
const NORMAL_TEXTURE: usize = 12;
const NORMAL_SCALE: usize = 13;
const EMISSION: usize = 14;

/// The words of all surfaces, and where they lie.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// Content of `headtail_surfaces`.
    pub words: Vec<u32>,
    /// Place of the first material.
    pub materials: usize,
    /// Place of the first face.
    pub faces: usize,
    /// Place of the table of directional albedos.
    pub albedo: usize,
    /// Place of the linear values of sRGB codes.
    pub srgb: usize,
    /// Whether anything emits light.
    pub is_emissive: bool,
    /// Whether a material is measured or neural.
    pub has_fitted: bool,
    textures: HashMap<*const Texture, u32>,
    /// The place of each mesh's mask.
    masks: Vec<u32>,
}

impl Surfaces {
    /// Flattens the surfaces of a scene, whose faces are given.
    ///
    /// # Errors
    /// If devices do not have a material, or room for the words.
    pub fn new(scene: &Scene, faces: &[FlatFace]) -> Result<Self> {
        let mut surfaces = Self::default();
        surfaces.masks = scene.flat_masks().into_iter().map(|mask| surfaces.mask(mask)).collect::<Result<_>>()?;
        let mut used = vec![false; scene.materials().len()];
        faces.iter().for_each(|face| used[face.material] = true);
        let of_material = |(index, material): (usize, _)| match used[index] {
            true => surfaces.material(scene.brdfs(), material),
            false => Ok([NONE; OF_MATERIAL]),
        };
        let materials = scene.materials().iter().enumerate().map(of_material).collect::<Result<Vec<_>>>()?;
        surfaces.materials = surfaces.words.len();
        surfaces.words.extend(materials.as_flattened());
        let heads: Vec<u32> = faces.iter().flat_map(|face| surfaces.face(face)).collect();
        surfaces.faces = surfaces.words.len();
        surfaces.words.extend(heads);
        surfaces.add_tables(&materials);
        let most = NONE as usize / 4;
        match surfaces.words.len() {
            count if count > most => Err(Error::TooMany { count, what: "words of surfaces", most }),
            _ => Ok(surfaces),
        }
    }

    /// Adds the tables of the metallic-roughness material where the scene has it; without, they are not read.
    fn add_tables(&mut self, materials: &[[u32; OF_MATERIAL]]) {
        self.albedo = self.words.len();
        if materials.iter().any(|words| words[0] == METALLIC_ROUGHNESS) {
            if let FlatNumbers::Floats(numbers) = flat_lobe_albedo().numbers {
                self.add(&numbers);
            }
            self.srgb = self.words.len();
            let linear: Vec<f32> = (0..256).map(|code| srgb_decode(code as f32 / 255.0)).collect();
            self.add(&linear);
        }
    }

    /// Adds numbers and returns their place.
    fn add(&mut self, numbers: &[f32]) -> u32 {
        let place = self.words.len();
        self.words.extend(numbers.iter().map(|number| number.to_bits()));
        place as u32
    }

    fn add_if<const N: usize, const M: usize>(&mut self, numbers: Option<[[f32; N]; M]>) -> u32 {
        numbers.map_or(NONE, |numbers| self.add(numbers.as_flattened()))
    }

    /// Adds the attributes of a face, and returns its words.
    fn face(&mut self, face: &FlatFace) -> [u32; OF_FACE] {
        let color_uv = self.add_if(face.color_uv.map(|uv| uv.map(|uv| uv.to_array())));
        let mut own_or_color = |own: Option<[glam::Vec2; 3]>| match own == face.color_uv {
            true => color_uv,
            false => self.add_if(own.map(|uv| uv.map(|uv| uv.to_array()))),
        };
        let [roughness_uv, emission_uv] = [face.roughness_uv, face.emission_uv].map(&mut own_or_color);
        let map_uv = own_or_color(face.normal_map.map(|(uv, _)| uv));
        let map_uv = if face.normal_map.is_some() { map_uv } else { NONE };
        let tangents = face.normal_map.and_then(|(_, tangents)| tangents);
        let vectors = |vectors: Option<[Vec3; 3]>| vectors.map(|vectors| vectors.map(|v| v.to_array()));
        [
            face.material as u32,
            self.add_if(vectors(face.normals)),
            color_uv,
            roughness_uv,
            emission_uv,
            map_uv,
            self.add_if(tangents.map(|tangents| tangents.map(|t| t.to_array()))),
            self.add_if(vectors(face.colors)),
            face.mask.map_or(NONE, |mask| self.masks[mask]),
            self.add_if(face.alphas.map(|alphas| [alphas])),
        ]
    }

    /// Adds a mask, and returns its place.
    fn mask(&mut self, mask: Option<FlatMask>) -> Result<u32> {
        let Some(FlatMask { cutoff, factor, texture }) = mask else { return Ok(NONE) };
        let texture = texture.as_ref().map_or(Ok(NONE), |texture| self.add_texture(texture))?;
        let place = self.add(&[cutoff, factor]);
        self.words.push(texture);
        Ok(place)
    }

    /// Adds what a material refers to, and returns its words.
    fn material(&mut self, brdfs: &BrdfTable, material: &Material) -> Result<[u32; OF_MATERIAL]> {
        let mut words = [NONE; OF_MATERIAL];
        let mut set = |at: usize, numbers: &[f32]| {
            for (word, number) in words[at..].iter_mut().zip(numbers) {
                *word = number.to_bits();
            }
        };
        let unit = |color: Vec3A| color.clamp(Vec3A::ZERO, Vec3A::ONE).to_array();
        match material {
            Material::Diffuse(albedo) => {
                set(1, &unit(*albedo));
                words[0] = DIFFUSE;
            }
            Material::Ggx { alpha, f0 } => {
                let (range, center, frequency) = alpha.parameters();
                set(1, &unit(*f0));
                set(4, &center.to_array());
                set(7, &[frequency / std::f32::consts::TAU]);
                set(8, &range);
                words[0] = MIRROR;
            }
            Material::MetallicRoughness(textured) => {
                let TexturedMetallicRoughness { base_color, metallic, roughness, emission, .. } = textured;
                set(1, &base_color.to_array());
                set(4, &[*metallic, *roughness]);
                set(NORMAL_SCALE, &[textured.normal_map.as_ref().map_or(1.0, |map| map.scale)]);
                words[0] = METALLIC_ROUGHNESS;
                words[COLOR_TEXTURE] = self.texture(textured.base_color_texture.as_ref())?;
                words[ROUGHNESS_TEXTURE] = self.texture(textured.metallic_roughness_texture.as_ref())?;
                words[NORMAL_TEXTURE] = self.texture(textured.normal_map.as_ref().map(|map| &map.texture))?;
                if *emission != Vec3A::ZERO {
                    let texture = self.texture(textured.emission_texture.as_ref())?;
                    words[EMISSION] = self.add(&emission.to_array());
                    self.words.push(texture);
                    self.is_emissive = true;
                }
            }
            Material::Indexed(brdf) => {
                words[0] = MEASURED;
                words[1] = self.fitted(MEASURED, brdfs.get(*brdf))?;
            }
            Material::Neural(neural) => {
                set(2, &[neural.repeat()]);
                words[0] = NEURAL;
                words[1] = self.fitted(NEURAL, brdfs.get(neural.brdf()))?;
            }
        }
        Ok(words)
    }

    /// Adds the numbers of a measured or neural material, and returns their place.
    fn fitted(&mut self, kind: u32, brdf: &dyn Brdf) -> Result<u32> {
        self.has_fitted = true;
        match (kind, brdf.flat()) {
            (MEASURED, Some(FlatBrdf::Measured(numbers))) | (NEURAL, Some(FlatBrdf::Neural(numbers))) => {
                Ok(self.add(&numbers))
            }
            _ => Err(Error::NotCovered {
                what: format!("the material {brdf:?}"),
                instead: "choose --material lambert or ggx:alpha=0.4",
            }),
        }
    }

    /// Adds a texture that was not added before, and returns its place.
    fn texture(&mut self, texture: Option<&Arc<Texture>>) -> Result<u32> {
        let Some(texture) = texture else { return Ok(NONE) };
        if let Some(&place) = self.textures.get(&Arc::as_ptr(texture)) {
            return Ok(place);
        }
        let place = self.add_texture(texture)?;
        self.textures.insert(Arc::as_ptr(texture), place);
        Ok(place)
    }

    fn add_texture(&mut self, texture: &Texture) -> Result<u32> {
        let ([width, height], (wrap, filter)) = (texture.size(), texture.sampling());
        let most = 1 << 30;
        if width.max(height) > most {
            return Err(Error::TooMany { count: width.max(height), what: "texels along a texture", most });
        }
        let mode = |wrap: Wrap| match wrap {
            Wrap::Repeat => 0,
            Wrap::Mirror => 1,
            Wrap::Clamp => 2,
        };
        let nearest = if filter == Filter::Nearest { 16 } else { 0 };
        let place = self.words.len() as u32;
        self.words.extend([width as u32, height as u32, mode(wrap[0]) | (mode(wrap[1]) << 2) | nearest, place + 4]);
        self.words.extend(texture.texels().iter().map(|&[r, g, b]| u32::from_le_bytes([r, g, b, 0])));
        Ok(place)
    }
}
