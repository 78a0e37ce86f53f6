//! The material that a head samples for.

use std::{fmt, str::FromStr};

use headtail_model::Condition;
use headtail_render::brdf::Ggx;
use serde::{Deserialize, Serialize};

/// A material, written `lambert`, `ggx:alpha=0.4` or `ggx:alpha=0.2..0.8`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Material {
    /// Diffuse.
    Lambert,
    /// Microfacets of Trowbridge and Reitz, of a width that is uniform in a range (both ends the same: one width).
    Ggx {
        /// The smallest width alpha.
        low: f32,
        /// The largest.
        high: f32,
    },
}

impl Material {
    /// What a head for this material is conditioned on.
    pub fn condition(self) -> Condition {
        match self {
            Self::Lambert => Condition::Normal,
            Self::Ggx { low, high } if low == high => Condition::Ggx,
            Self::Ggx { .. } => Condition::GgxRoughness,
        }
    }
}

impl fmt::Display for Material {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lambert => f.write_str("lambert"),
            Self::Ggx { low, high } if low == high => write!(f, "ggx:alpha={low}"),
            Self::Ggx { low, high } => write!(f, "ggx:alpha={low}..{high}"),
        }
    }
}

impl FromStr for Material {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "lambert" {
            return Ok(Self::Lambert);
        }
        let widths = text.strip_prefix("ggx:alpha=").map(|range| range.split_once("..").unwrap_or((range, range)));
        let parsed = widths.and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
        let smallest = Ggx::MIN_ALPHA;
        match parsed {
            Some((low, high)) if smallest <= low && low <= high && high <= 1.0 => Ok(Self::Ggx { low, high }),
            Some(_) => Err(format!("'{text}': alpha must be in {smallest}..1, the smaller number first")),
            None => Err(format!("'{text}' is no material: write lambert, ggx:alpha=0.4 or ggx:alpha=0.2..0.8")),
        }
    }
}

impl TryFrom<String> for Material {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Material> for String {
    fn from(material: Material) -> Self {
        material.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_read_as_they_are_written() {
        for (text, condition) in [
            ("lambert", Condition::Normal),
            ("ggx:alpha=0.4", Condition::Ggx),
            ("ggx:alpha=0.2..0.8", Condition::GgxRoughness),
        ] {
            let material: Material = text.parse().unwrap();
            assert_eq!((material.to_string().as_str(), material.condition()), (text, condition));
        }
    }

    #[test]
    fn what_is_no_material_is_refused_with_an_example() {
        for text in ["", "ggx", "ggx:0.4", "ggx:alpha=", "ggx:alpha=0.4..", "ggx:alpha=x", "Lambert"] {
            assert!(text.parse::<Material>().unwrap_err().contains("ggx:alpha=0.4"), "{text}");
        }
        for text in ["ggx:alpha=0", "ggx:alpha=-1", "ggx:alpha=1.5", "ggx:alpha=0.8..0.2", "ggx:alpha=nan"] {
            assert!(text.parse::<Material>().unwrap_err().contains("smaller"), "{text}");
        }
    }
}
