//! What a head is conditioned on.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::simd::{LANES, Lanes};

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

    /// The conditions of one strip of shading points, a column for each number. `alpha` is the width of the lobe, 1 for a diffuse surface.
    #[inline(always)]
    pub(super) fn load(self, n: &[Lanes; 3], wo: &[Lanes; 3], alpha: &Lanes, out: &mut [Lanes]) {
        let out = &mut out[..self.length()];
        for lane in 0..LANES {
            let [n, wo] = [n, wo].map(|columns| Vec3::new(columns[0][lane], columns[1][lane], columns[2][lane]));
            let numbers = self.encode(wo, n, alpha[lane]);
            for (out, number) in out.iter_mut().zip(numbers) {
                out[lane] = number;
            }
        }
    }

    /// The condition for a view direction, a normal and a width, in the first [`Condition::length`] numbers.
    #[inline(always)]
    pub fn encode(self, wo: Vec3, n: Vec3, alpha: f32) -> [f32; MAX_CONDITION] {
        if self == Self::Normal {
            return [n.x, n.y, n.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        }
        let cosine = n.dot(wo);
        let mirrored = 2.0 * cosine * n - wo;
        let (width, log) = if self == Self::GgxRoughness { (alpha, alpha.ln()) } else { (0.0, 0.0) };
        [wo.x, wo.y, wo.z, n.x, n.y, n.z, mirrored.x, mirrored.y, mirrored.z, cosine, width, log]
    }
}
