//! The material that a head samples for.

use std::{fmt, str::FromStr};

use headtail_model::Condition;
use headtail_render::scene::MaterialSpec;
use serde::{Deserialize, Serialize};

use crate::Measured;

/// A material, written `lambert`, `ggx:alpha=0.4`, `ggx:alpha=0.2..0.8`, `nbrdf:FILE#NAME`, `nbrdf:FILE#NAME,NAME,...` or `neural:FILE`.
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
    /// Measured: one, or a family that one head serves; or a neural material over a surface.
    Measured(&'static Measured),
}

impl Material {
    /// What a head for this material is conditioned on.
    pub fn condition(self) -> Condition {
        match self {
            Self::Lambert => Condition::Normal,
            Self::Ggx { low, high } if low == high => Condition::Ggx,
            Self::Ggx { .. } => Condition::GgxRoughness,
            Self::Measured(materials) if materials.texture().is_some() => Condition::Texture,
            Self::Measured(materials) if materials.is_family() => Condition::Family,
            Self::Measured(_) => Condition::Ggx,
        }
    }
}

impl fmt::Display for Material {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lambert => f.write_str("lambert"),
            Self::Ggx { low, high } if low == high => write!(f, "ggx:alpha={low}"),
            Self::Ggx { low, high } => write!(f, "ggx:alpha={low}..{high}"),
            Self::Measured(materials) => materials.fmt(f),
        }
    }
}

impl FromStr for Material {
    type Err = String;

    /// As the renderer reads it; what scales a lobe without changing its shape has no place here.
    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<MaterialSpec>().map_err(|error| error.to_string())? {
            MaterialSpec::Lambert { albedo: 1.0 } => Ok(Self::Lambert),
            MaterialSpec::Ggx { alpha, f0: 1.0 } => Ok(Self::Ggx { low: alpha.low, high: alpha.high }),
            MaterialSpec::Measured { file, names } => Measured::open(text, &file, &names).map(Self::Measured),
            MaterialSpec::Neural(spec) => Measured::open_texture(text, &spec).map(Self::Measured),
            MaterialSpec::Lambert { .. } | MaterialSpec::Ggx { .. } => {
                Err(format!("material '{text}': a head serves every albedo and f0: leave them out"))
            }
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
    fn what_is_no_material_is_refused_by_name() {
        for (text, named) in [
            ("", "lambert"),
            ("ggx", "ggx:alpha=0.4"),
            ("ggx:alpha=0", "0.001..=1"),
            ("ggx:alpha=0.8..0.2", "smaller"),
            ("ggx:alpha=0.4,f0=0.5", "leave them out"),
            ("lambert:albedo=0.5", "leave them out"),
        ] {
            let error = text.parse::<Material>().unwrap_err();
            assert!(error.contains(&format!("'{text}'")) && error.contains(named), "{text}: {error}");
        }
    }
}
