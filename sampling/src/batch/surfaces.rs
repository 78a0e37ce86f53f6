//! The surfaces of a list of points.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::{check_range, check_shared_length, entry};
use crate::{
    brdf::{
        Brdf, BrdfTable, Ggx, Lambert, MetallicRoughness, NeuralTexture, Surface,
        neural::{NeuralBrdf, open_measured, parse_measured},
        neural_texture::Seen,
    },
    error::{Error, Result},
    path_text::path_of,
};

/// BRDFs of surfaces; lists have one entry for all points, or one per point.
#[derive(Clone, Copy, Debug)]
pub enum SurfaceList<'a> {
    /// White diffuse surfaces.
    Diffuse,
    /// Trowbridge-Reitz surfaces.
    Glossy {
        /// Widths, from [`Ggx::MIN_ALPHA`] to 1.
        alpha: &'a [f32],
        /// Reflectances at normal incidence, in `[0, 1]`.
        f0: &'a [f32],
    },
    /// Metallic-roughness surfaces of glTF.
    MetallicRoughness {
        /// Base colours per channel, linear Rec.709, in `[0, 1]`.
        base_color: &'a [[f32; 3]],
        /// Metalness, in `[0, 1]`.
        metallic: &'a [f32],
        /// Roughness, the square root of the width, in `[0, 1]`.
        roughness: &'a [f32],
    },
    /// Surfaces of a measured or neural material. The lists are of neural ones, and empty for measured ones.
    Fitted {
        /// The material of all points.
        material: &'a FittedMaterial,
        /// Texture coordinates; the texture repeats with period 1.
        uv: &'a [[f32; 2]],
        /// Directions in world space in which u grows, of any length, and the handedness, as in glTF: v grows along
        /// that times `n` x tangent. It is 1, or -1 where the texture is mirrored.
        tangent: &'a [[f32; 4]],
        /// Standard deviations of pixels' footprints on the surface, in units of the texture coordinates; if empty, 0,
        /// which is the finest detail.
        footprint: &'a [f32],
    },
}

/// A measured or neural material.
#[derive(Clone, Debug)]
pub struct FittedMaterial {
    brdfs: BrdfTable,
    brdf: u32,
    texture: Option<Arc<NeuralTexture>>,
}

impl FittedMaterial {
    /// Opens `nbrdf:FILE#NAME` or `neural:FILE`.
    ///
    /// # Errors
    /// If the file cannot be read, or does not hold the material.
    pub fn open(name: &str) -> Result<Self> {
        let wrong = |reason: String| Error::argument(format!("material '{name}'"), reason);
        match name.split_once(':') {
            Some(("neural", file)) if !file.is_empty() => {
                Ok(Self::neural(Arc::new(NeuralTexture::read(&path_of(file))?)))
            }
            Some(("nbrdf", text)) => {
                let (file, names) = parse_measured(text).map_err(wrong)?;
                match &open_measured(&file, &names)?[..] {
                    [one] => Ok(Self::measured(one.clone())),
                    all => Err(wrong(format!("names {} materials; points have one", all.len()))),
                }
            }
            _ => Err(wrong("is neither nbrdf:FILE#NAME nor neural:FILE".into())),
        }
    }

    /// A measured material.
    pub fn measured(material: Arc<NeuralBrdf>) -> Self {
        Self::of(material, None)
    }

    /// A neural material.
    pub fn neural(material: Arc<NeuralTexture>) -> Self {
        Self::of(material.clone(), Some(material))
    }

    fn of(material: Arc<dyn Brdf>, texture: Option<Arc<NeuralTexture>>) -> Self {
        let (brdfs, brdf) = BrdfTable::default().with(material);
        Self { brdfs, brdf, texture }
    }
}

impl SurfaceList<'_> {
    pub(super) fn check_lengths(&self, count: usize) -> Result<()> {
        match *self {
            Self::Diffuse => Ok(()),
            Self::Glossy { alpha, f0 } => {
                check_shared_length("alpha", alpha.len(), count)?;
                check_shared_length("f0", f0.len(), count)
            }
            Self::MetallicRoughness { base_color, metallic, roughness } => {
                check_shared_length("base_color", base_color.len(), count)?;
                check_shared_length("metallic", metallic.len(), count)?;
                check_shared_length("roughness", roughness.len(), count)
            }
            Self::Fitted { material, uv, tangent, footprint } if material.texture.is_some() => {
                check_shared_length("uv", uv.len(), count)?;
                check_shared_length("tangent", tangent.len(), count)?;
                if footprint.is_empty() { Ok(()) } else { check_shared_length("footprint", footprint.len(), count) }
            }
            Self::Fitted { uv, tangent, footprint, .. } => {
                let lists = [("uv", uv.len()), ("tangent", tangent.len()), ("footprint", footprint.len())];
                match lists.into_iter().find(|(_, length)| *length > 0) {
                    Some((name, _)) => Err(Error::argument(name, "is of neural materials; this one is measured")),
                    None => Ok(()),
                }
            }
        }
    }

    /// The table that the BRDFs of [`Self::surface`] are in.
    pub(super) fn brdfs(&self) -> BrdfTable {
        match self {
            Self::Fitted { material, .. } => material.brdfs.clone(),
            _ => BrdfTable::default(),
        }
    }

    /// The surface of a point with a normal and a direction to the viewer.
    pub(super) fn surface(&self, place: usize, [n, wo]: [[f32; 3]; 2]) -> Result<Surface> {
        Ok(match *self {
            Self::Diffuse => Lambert { albedo: Vec3::ONE }.into(),
            Self::Glossy { alpha, f0 } => {
                let alpha = check_range("alpha", place, entry(alpha, place), Ggx::MIN_ALPHA)?;
                Ggx::new(alpha, Vec3::splat(check_range("f0", place, entry(f0, place), 0.0)?)).into()
            }
            Self::MetallicRoughness { base_color, metallic, roughness } => {
                let color = entry(base_color, place);
                for channel in color {
                    check_range("base_color", place, channel, 0.0)?;
                }
                let metallic = check_range("metallic", place, entry(metallic, place), 0.0)?;
                let roughness = check_range("roughness", place, entry(roughness, place), 0.0)?;
                MetallicRoughness::new(Vec3::from_array(color), metallic, roughness).into()
            }
            Self::Fitted { material, uv, tangent, footprint } => {
                let FittedMaterial { brdf, texture, .. } = material;
                let Some(texture) = texture else { return Ok(Surface { brdf: *brdf, parameters: Default::default() }) };
                let footprint = if footprint.is_empty() { 0.0 } else { entry(footprint, place) };
                let seen = seen(place, [n, wo], entry(uv, place), entry(tangent, place), footprint)?;
                Surface { brdf: *brdf, parameters: texture.parameters(&seen) }
            }
        })
    }
}

fn seen(place: usize, [n, wo]: [[f32; 3]; 2], uv: [f32; 2], tangent: [f32; 4], footprint: f32) -> Result<Seen> {
    if !uv.iter().all(|number| number.is_finite()) {
        return Err(Error::argument("uv", format!("row {place} is ({}, {}), which is not finite", uv[0], uv[1])));
    }
    if !(footprint.is_finite() && footprint >= 0.0) {
        return Err(Error::argument("footprint", format!("row {place} is {footprint}, which is not a length")));
    }
    let [n, wo] = [n, wo].map(Vec3::from_array);
    let [x, y, z, hand] = tangent;
    let along = Vec3::new(x, y, z);
    if !(along.is_finite() && hand.abs() == 1.0) {
        let reason = format!("row {place} is ({x}, {y}, {z}, {hand}), which is not a direction and 1 or -1");
        return Err(Error::argument("tangent", reason));
    }
    Ok(Seen { uv: Vec2::from_array(uv), width: footprint, ..Seen::new(n, wo, [along, hand * n.cross(along)]) })
}
