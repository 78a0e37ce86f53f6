//! Condition vectors of heads.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::{
    brdf::{LATENTS, OF_MATERIAL},
    simd::{LANES, Lanes},
};

/// The layout of a condition vector. Directions are unit vectors in world space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The shading normal `n`: 3 numbers.
    Normal,
    /// Microfacet surfaces of one width alpha: `wo`, `n`, `2 (n . wo) n - wo`, `n . wo`: 10 numbers.
    Ggx,
    /// Microfacet surfaces of any width: the numbers of [`Condition::Ggx`], then `alpha`, `ln alpha`:
    /// 12 numbers.
    GgxRoughness,
    /// A family of measured materials: the numbers of [`Condition::Ggx`], then
    /// [`crate::brdf::Brdf::latent`]: 16 numbers.
    Family,
    /// A neural material over a surface: the numbers of [`Condition::Ggx`], the features, the first
    /// tangent in world space, and the handedness, 1, or -1 where the texture is mirrored: 22 numbers.
    /// Features, tangent and handedness are 0 on other surfaces.
    Texture,
}

/// The longest condition vector.
pub const MAX_CONDITION: usize = GEOMETRY + OF_MATERIAL;

/// Number of entries for view direction and normal.
const GEOMETRY: usize = 10;

impl Condition {
    /// Length of the condition vector.
    pub const fn length(self) -> usize {
        match self {
            Self::Normal => 3,
            Self::Ggx => 10,
            Self::GgxRoughness => 12,
            Self::Family => GEOMETRY + LATENTS,
            Self::Texture => MAX_CONDITION,
        }
    }

    /// Number of the material's entries, without logarithms.
    pub(super) const fn of_material(self) -> usize {
        match self {
            Self::Normal | Self::Ggx => 0,
            Self::GgxRoughness => 1,
            Self::Family => LATENTS,
            Self::Texture => OF_MATERIAL,
        }
    }

    /// Fills the conditions of one strip of shading points, one column per number. `material` is the
    /// width of the lobe, the latents, or the columns of the texture.
    #[inline(always)]
    pub(super) fn load(self, n: &[Lanes; 3], wo: &[Lanes; 3], material: &[Lanes; OF_MATERIAL], out: &mut [Lanes]) {
        let out = &mut out[..self.length()];
        for lane in 0..LANES {
            let [n, wo] = [n, wo].map(|columns| Vec3::new(columns[0][lane], columns[1][lane], columns[2][lane]));
            let numbers = self.encode(wo, n, material[0][lane]);
            for (out, number) in out.iter_mut().zip(numbers) {
                out[lane] = number;
            }
        }
        if matches!(self, Self::Family | Self::Texture) {
            let count = self.of_material();
            out[GEOMETRY..].copy_from_slice(&material[..count]);
        }
    }

    /// Makes the condition of a measured material.
    pub fn encode_family(wo: Vec3, n: Vec3, latent: &[f32; LATENTS]) -> [f32; MAX_CONDITION] {
        let mut condition = Self::Family.encode(wo, n, 1.0);
        condition[GEOMETRY..GEOMETRY + LATENTS].copy_from_slice(latent);
        condition
    }

    /// Makes the condition of a point of a neural material, from its features, tangent and handedness.
    pub fn encode_texture(wo: Vec3, n: Vec3, material: &[f32; OF_MATERIAL]) -> [f32; MAX_CONDITION] {
        let mut condition = Self::Texture.encode(wo, n, 1.0);
        condition[GEOMETRY..].copy_from_slice(material);
        condition
    }

    /// Makes the condition for a view direction, a normal and a width, in the first
    /// [`Condition::length`] numbers; latents are zero.
    #[inline(always)]
    pub fn encode(self, wo: Vec3, n: Vec3, alpha: f32) -> [f32; MAX_CONDITION] {
        if self == Self::Normal {
            let mut condition = [0.0; MAX_CONDITION];
            (condition[0], condition[1], condition[2]) = (n.x, n.y, n.z);
            return condition;
        }
        let cosine = n.dot(wo);
        let mirrored = 2.0 * cosine * n - wo;
        let (width, log) = if self == Self::GgxRoughness { (alpha, alpha.ln()) } else { (0.0, 0.0) };
        let mut condition = [0.0; MAX_CONDITION];
        let numbers = [wo.x, wo.y, wo.z, n.x, n.y, n.z, mirrored.x, mirrored.y, mirrored.z, cosine, width, log];
        condition[..12].copy_from_slice(&numbers);
        condition
    }
}
