//! What a head is conditioned on.

use serde::{Deserialize, Serialize};

/// The layout of a condition vector. Directions are unit vectors in world space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The shading normal `n`: 3 numbers.
    Normal,
    /// Microfacet surfaces of one width alpha: `wo`, `n`, `2 (n . wo) n - wo`, `n . wo`: 10 numbers.
    ///
    /// The last four follow from the first six; a small network learns faster when it need not find them itself.
    Ggx,
    /// Microfacet surfaces of any width: the numbers of [`Condition::Ggx`], then `alpha`, `ln alpha`: 12 numbers.
    GgxRoughness,
}

impl Condition {
    /// How many numbers.
    pub const fn length(self) -> usize {
        match self {
            Self::Normal => 3,
            Self::Ggx => 10,
            Self::GgxRoughness => 12,
        }
    }

    /// The name used in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Ggx => "ggx",
            Self::GgxRoughness => "ggx-roughness",
        }
    }
}
