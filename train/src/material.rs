//! Conditions of heads for materials.

use headtail_model::Condition;
use headtail_render::scene::MaterialSpec;

use crate::{Error, Result};

/// Returns the condition of a head for a material.
pub fn condition_of(material: &MaterialSpec) -> Condition {
    match material {
        MaterialSpec::Lambert { .. } => Condition::Normal,
        MaterialSpec::Ggx { alpha, .. } if alpha.fixed().is_some() => Condition::Ggx,
        MaterialSpec::Ggx { .. } => Condition::GgxRoughness,
        MaterialSpec::Measured { names, .. } if names.len() > 1 => Condition::Family,
        MaterialSpec::Measured { .. } => Condition::Ggx,
        MaterialSpec::Neural(_) => Condition::Texture,
    }
}

/// Checks that a material does not scale its lobes: a head serves all albedos and f0.
///
/// # Errors
/// [`Error::Config`] naming the material.
pub(crate) fn check_scale(material: &MaterialSpec) -> Result<()> {
    match material {
        MaterialSpec::Lambert { albedo: 1.0 } | MaterialSpec::Ggx { f0: 1.0, .. } => Ok(()),
        MaterialSpec::Measured { .. } | MaterialSpec::Neural(_) => Ok(()),
        MaterialSpec::Lambert { .. } | MaterialSpec::Ggx { .. } => Err(Error::Config {
            field: "material",
            value: material.to_string(),
            requirement: "without albedo and f0: a head serves all of them",
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FitConfig;

    #[test]
    fn materials_have_conditions() {
        for (text, condition) in [
            ("lambert", Condition::Normal),
            ("ggx:alpha=0.4", Condition::Ggx),
            ("ggx:alpha=0.2..0.8", Condition::GgxRoughness),
            ("nbrdf:a#b", Condition::Ggx),
            ("nbrdf:a#b,c", Condition::Family),
            ("neural:a", Condition::Texture),
        ] {
            assert_eq!(condition_of(&text.parse().unwrap()), condition, "{text}");
        }
    }

    #[test]
    fn scaled_materials_are_rejected_by_name() {
        for text in ["ggx:alpha=0.4,f0=0.5", "lambert:albedo=0.5"] {
            let config = FitConfig::default().for_material(text.parse().unwrap());
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(text) && error.contains("f0"), "{error}");
        }
    }
}
