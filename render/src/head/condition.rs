//! What a head is conditioned on.

use glam::Vec3A;
use serde::{Deserialize, Serialize};

use crate::{brdf::Brdf, sampler::ShadingPoint};

/// The layout of a condition vector. Directions are unit vectors in world space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The shading normal `n`: 3 numbers.
    Normal,
    /// Microfacet surfaces of one width alpha: `wo`, `n`, `2 (n . wo) n - wo`, `n . wo`: 10 numbers.
    Ggx,
    /// Microfacet surfaces of any width: the numbers of [`Condition::Ggx`], then `alpha`, `ln alpha`: 12 numbers.
    GgxRoughness,
}

/// The longest condition vector.
pub const MAX_CONDITION: usize = 12;

impl Condition {
    /// How many numbers.
    pub const fn length(self) -> usize {
        match self {
            Self::Normal => 3,
            Self::Ggx => 10,
            Self::GgxRoughness => 12,
        }
    }

    /// The condition of a shading point, in the first [`Condition::length`] numbers. A diffuse surface has width 1.
    pub fn of(self, at: &ShadingPoint) -> [f32; MAX_CONDITION] {
        let alpha = match at.brdf {
            Brdf::Lambert(_) => 1.0,
            Brdf::Ggx(ggx) => ggx.alpha(),
            Brdf::MetallicRoughness(mixture) => mixture.alpha(),
        };
        self.encode(at.wo, at.ns, alpha)
    }

    /// The condition for a view direction, a normal and a width.
    pub fn encode(self, wo: Vec3A, n: Vec3A, alpha: f32) -> [f32; MAX_CONDITION] {
        let mut condition = [0.0; MAX_CONDITION];
        if self == Self::Normal {
            condition[..3].copy_from_slice(&n.to_array());
            return condition;
        }
        let cosine = n.dot(wo);
        condition[..3].copy_from_slice(&wo.to_array());
        condition[3..6].copy_from_slice(&n.to_array());
        condition[6..9].copy_from_slice(&(2.0 * cosine * n - wo).to_array());
        condition[9] = cosine;
        if self == Self::GgxRoughness {
            (condition[10], condition[11]) = (alpha, alpha.ln());
        }
        condition
    }
}
