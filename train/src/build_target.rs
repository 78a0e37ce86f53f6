//! The target of a configuration.

use std::sync::Arc;

use headtail_render::{
    brdf::{NeuralTexture, neural::open_measured},
    scene::MaterialSpec,
    tail::Tail,
};

use crate::{
    FitConfig, Result,
    config::Points,
    integrand::{
        Ggx, Lambert, MeasuredSurface, NaiveTarget, PatchedTarget, ProductTarget, RenderedSurface, TabulatedTarget,
        Target, TexturedSurface, Viewpoints,
    },
};

/// Builds the target of `config` under an exact tail (of the kind in `config`), with surfaces seen from
/// `viewpoints`. Opens the material's file, if it has one.
///
/// # Errors
/// The file cannot be read, or does not hold the material.
///
/// # Panics
/// If `config` has a head over patches and the tail is not hierarchical.
pub fn build_target<'a>(config: &FitConfig, tail: &'a Tail, viewpoints: Viewpoints) -> Result<Box<dyn Target + 'a>> {
    let target = match &config.material {
        MaterialSpec::Lambert { .. } => of_surface(config, Lambert::seen_from(viewpoints), tail),
        MaterialSpec::Ggx { alpha, .. } => of_surface(config, Ggx::new(viewpoints, alpha.low, alpha.high), tail),
        MaterialSpec::Measured { file, names } => {
            of_surface(config, MeasuredSurface::new(viewpoints, open_measured(file, names)?), tail)
        }
        MaterialSpec::Neural(spec) => {
            of_surface(config, TexturedSurface::new(viewpoints, Arc::new(NeuralTexture::read(&spec.file)?)), tail)
        }
    };
    Ok(if config.naive { Box::new(NaiveTarget::new(target, tail)) } else { target })
}

fn of_surface<'a, S: RenderedSurface + 'a>(config: &FitConfig, surface: S, tail: &'a Tail) -> Box<dyn Target + 'a> {
    match (config.over.detail(), config.points) {
        (Some(detail), _) => Box::new(PatchedTarget::new(surface, tail, detail)),
        (None, Points::Strata) => Box::new(ProductTarget::of_surface(surface, tail)),
        (None, Points::Tabulated) => Box::new(TabulatedTarget::new(surface, tail)),
    }
}
