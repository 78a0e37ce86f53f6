//! Material specifications: `lambert`, `lambert:albedo=0.5`, `ggx:alpha=0.4`, `ggx:alpha=0.2..0.8,f0=0.9`, `nbrdf:FILE#NAME`,
//! `neural:FILE,repeat=24`.

use std::{fmt, path::PathBuf, str::FromStr, sync::Arc};

use glam::Vec3A;
use serde::{Deserialize, Serialize};

use super::{AlphaField, Bounds, Material, Scene, neural::NeuralSpec};
use crate::{
    brdf::{
        Brdf, Ggx,
        neural::{open_measured, parse_measured},
    },
    error::{Error, Result},
    path_text::text_of,
};

/// A Trowbridge-Reitz width, or the range that it varies in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaRange {
    /// The least width.
    pub low: f32,
    /// The greatest width; equal to `low` where there is only one.
    pub high: f32,
}

impl AlphaRange {
    /// Returns the width if there is only one.
    pub fn fixed(self) -> Option<f32> {
        (self.low == self.high).then_some(self.low)
    }
}

/// A material specification, written as text in configuration files. Analytic materials are grey, and white
/// by default. Parsing a specification does not open files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum MaterialSpec {
    /// `lambert[:albedo=A]`.
    Lambert {
        /// Reflectance in `[0, 1]`; 1 by default.
        albedo: f32,
    },
    /// `ggx:alpha=A[,f0=F]` or `ggx:alpha=LOW..HIGH[,f0=F]`.
    Ggx {
        /// Within [`Ggx::MIN_ALPHA`]` ..= 1`.
        alpha: AlphaRange,
        /// Reflectance at normal incidence in `[0, 1]`; 1 by default, so that F = 1.
        f0: f32,
    },
    /// Measured materials: `nbrdf:FILE` for a file of one material, or `nbrdf:FILE#NAME,NAME,...`. The meshes
    /// of a scene take them in turn.
    Measured {
        /// A file for [`crate::brdf::neural::read_networks`].
        file: PathBuf,
        /// Names of materials; empty for the only one of the file.
        names: Vec<String>,
    },
    /// `neural:FILE[,repeat=N][,on=NAME]`: a neural material over texture coordinates.
    Neural(NeuralSpec),
}

impl MaterialSpec {
    /// `lambert`.
    pub const LAMBERT: Self = Self::Lambert { albedo: 1.0 };

    /// Returns `ggx:alpha=LOW..HIGH`.
    pub const fn ggx(low: f32, high: f32) -> Self {
        Self::Ggx { alpha: AlphaRange { low, high }, f0: 1.0 }
    }

    /// Returns whether it is an analytic diffuse material.
    pub fn is_lambert(&self) -> bool {
        matches!(self, Self::Lambert { .. })
    }

    /// Returns whether it replaces the materials of all surfaces.
    pub fn is_for_all(&self) -> bool {
        !matches!(self, Self::Neural(_))
    }

    /// Returns the scene with these materials. A range of widths varies over `bounds` as in [`AlphaField`].
    ///
    /// # Errors
    /// When a file cannot be read or does not hold the requested materials.
    pub fn dress(&self, scene: Scene, bounds: &Bounds) -> Result<Scene> {
        Ok(match self {
            Self::Lambert { albedo } => scene.with_material(Material::diffuse(Vec3A::splat(*albedo))),
            Self::Ggx { alpha, f0 } => {
                let alpha = match alpha.fixed() {
                    Some(alpha) => AlphaField::constant(alpha),
                    None => AlphaField::new(alpha.low, alpha.high, bounds),
                };
                scene.with_material(Material::Ggx { alpha, f0: Vec3A::splat(*f0) })
            }
            Self::Measured { file, names } => {
                let own = open_measured(file, names)?;
                scene.with_brdfs(own.into_iter().map(|brdf| -> Arc<dyn Brdf> { brdf }).collect())
            }
            Self::Neural(spec) => spec.dress(scene)?,
        })
    }
}

impl FromStr for MaterialSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |reason: String| Error::argument(format!("material '{text}'"), reason);
        let (name, settings) = text.split_once(':').unwrap_or((text, ""));
        if name == "nbrdf" {
            let (file, names) = parse_measured(settings).map_err(wrong)?;
            return Ok(Self::Measured { file, names });
        }
        if name == "neural" {
            return settings.parse().map(Self::Neural).map_err(wrong);
        }
        let known: &[&str] = match name {
            "lambert" => &["albedo"],
            "ggx" => &["alpha", "f0"],
            _ => {
                return Err(wrong(
                    "is none of lambert, as in lambert:albedo=0.5, ggx, as in ggx:alpha=0.4, nbrdf:FILE#NAME and neural:FILE"
                        .into(),
                ));
            }
        };
        let mut values: Vec<(&str, &str)> = Vec::new();
        if text.contains(':') {
            for setting in settings.split(',') {
                let Some((key, value)) = setting.split_once('=').filter(|(key, _)| known.contains(key)) else {
                    return Err(wrong(format!("'{setting}' is not one of {}", known.join("=, ") + "=")));
                };
                if values.iter().any(|(other, _)| *other == key) {
                    return Err(wrong(format!("{key} is given twice")));
                }
                values.push((key, value));
            }
        }
        let value = |key: &str| values.iter().find(|(other, _)| *other == key).map(|(_, value)| *value);
        let number = |key: &str, text: &str, least: f32| match text.parse::<f32>() {
            Ok(number) if (least..=1.0).contains(&number) => Ok(number),
            _ => Err(wrong(format!("{key} '{text}' is not a number in {least}..=1"))),
        };
        let unit = |key: &str| value(key).map_or(Ok(1.0), |text| number(key, text, 0.0));
        if name == "lambert" {
            return Ok(Self::Lambert { albedo: unit("albedo")? });
        }
        let Some(alpha) = value("alpha") else {
            return Err(wrong("name a width, as in ggx:alpha=0.4 or ggx:alpha=0.2..0.8".into()));
        };
        let (low, high) = alpha.split_once("..").unwrap_or((alpha, alpha));
        let width = |text| number("alpha", text, Ggx::MIN_ALPHA);
        let alpha = AlphaRange { low: width(low)?, high: width(high)? };
        if alpha.low > alpha.high {
            return Err(wrong(format!("alpha goes from {low} down to {high}: write the smaller width first")));
        }
        Ok(Self::Ggx { alpha, f0: unit("f0")? })
    }
}

impl TryFrom<String> for MaterialSpec {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<MaterialSpec> for String {
    fn from(material: MaterialSpec) -> Self {
        material.to_string()
    }
}

impl fmt::Display for MaterialSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lambert { albedo: 1.0 } => f.write_str("lambert"),
            Self::Lambert { albedo } => write!(f, "lambert:albedo={albedo}"),
            Self::Ggx { alpha: AlphaRange { low, high }, f0 } => {
                write!(f, "ggx:alpha={low}")?;
                if low != high {
                    write!(f, "..{high}")?;
                }
                if *f0 == 1.0 { Ok(()) } else { write!(f, ",f0={f0}") }
            }
            Self::Measured { file, names } => {
                write!(f, "nbrdf:{}", text_of(file))?;
                if names.is_empty() { Ok(()) } else { write!(f, "#{}", names.join(",")) }
            }
            Self::Neural(spec) => write!(f, "neural:{spec}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specifications_print_as_they_parse() {
        for text in [
            "lambert",
            "lambert:albedo=0.5",
            "ggx:alpha=0.4",
            "ggx:alpha=0.2..0.8",
            "ggx:alpha=0.001..1,f0=0.04",
            "nbrdf:a/b.f32",
            "nbrdf:a#b.f32#merl/x,y",
            "neural:a/b.safetensors",
            "neural:a,repeat=24",
            "neural:a,b,repeat=2.5,on=sheet",
        ] {
            assert_eq!(text.parse::<MaterialSpec>().unwrap().to_string(), text);
        }
        let alpha = AlphaRange { low: 0.2, high: 0.8 };
        assert_eq!("ggx:f0=0.5,alpha=0.2..0.8".parse::<MaterialSpec>().unwrap(), MaterialSpec::Ggx { alpha, f0: 0.5 });
        assert_eq!("lambert:albedo=1".parse::<MaterialSpec>().unwrap(), MaterialSpec::Lambert { albedo: 1.0 });
        assert_eq!("ggx:alpha=0.3..0.3".parse::<MaterialSpec>().unwrap().to_string(), "ggx:alpha=0.3");
    }

    #[test]
    fn invalid_specifications_are_named_in_errors() {
        for (text, word) in [
            ("", "is none of lambert"),
            ("phong", "is none of lambert"),
            ("nbrdf", "name a file"),
            ("nbrdf:#a", "name a file"),
            ("nbrdf:a#", "'' is not the name"),
            ("nbrdf:a#b,,c", "'' is not the name"),
            ("neural:", "name a file"),
            ("neural:a,repeat=0", "repeat '0' is not"),
            ("neural:a,size=2", "'size=2' is not one of repeat=, on="),
            ("lambert:", "'' is not one of albedo="),
            ("lambert:alpha=0.4", "'alpha=0.4' is not one of albedo="),
            ("lambert:albedo=2", "albedo '2' is not a number in 0..=1"),
            ("ggx", "name a width"),
            ("ggx:f0=0.5", "name a width"),
            ("ggx:alpha=x", "alpha 'x' is not"),
            ("ggx:alpha=NaN", "alpha 'NaN' is not"),
            ("ggx:alpha=0", "alpha '0' is not a number in 0.001..=1"),
            ("ggx:alpha=0.2..", "alpha '' is not"),
            ("ggx:alpha=0.8..0.2", "from 0.8 down to 0.2"),
            ("ggx:alpha=0.4,alpha=0.5", "alpha is given twice"),
            ("ggx:alpha=0.4,f0=-1", "f0 '-1' is not"),
            ("ggx:alpha=0.4,", "'' is not one of alpha=, f0="),
        ] {
            let error = text.parse::<MaterialSpec>().unwrap_err().to_string();
            assert!(error.contains(&format!("'{text}'")) && error.contains(word), "{text}: {error}");
        }
    }
}
