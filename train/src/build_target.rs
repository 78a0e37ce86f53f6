//! The target that a configuration asks for.

use headtail_render::tail::Tail;

use crate::{
    FitConfig, Material,
    config::Points,
    integrand::{
        Ggx, Lambert, MeasuredSurface, NaiveTarget, PatchedTarget, ProductTarget, RenderedSurface, TabulatedTarget,
        Target, TexturedSurface, Viewpoints,
    },
};

/// The target of `config` under an exact tail (of the kind that `config` names), with surfaces seen from `viewpoints`.
///
/// # Panics
/// If a head over patches is asked for and the tail is not hierarchical.
pub fn build_target<'a>(config: &FitConfig, tail: &'a Tail, viewpoints: Viewpoints) -> Box<dyn Target + 'a> {
    let target = match config.material {
        Material::Lambert => of_surface(config, Lambert::seen_from(viewpoints), tail),
        Material::Ggx { low, high } => of_surface(config, Ggx::new(viewpoints, low, high), tail),
        Material::Measured(materials) if materials.texture().is_some() => {
            of_surface(config, TexturedSurface::new(viewpoints, materials), tail)
        }
        Material::Measured(materials) => of_surface(config, MeasuredSurface::new(viewpoints, materials), tail),
    };
    if config.naive { Box::new(NaiveTarget::new(target, tail)) } else { target }
}

fn of_surface<'a, S: RenderedSurface + 'a>(config: &FitConfig, surface: S, tail: &'a Tail) -> Box<dyn Target + 'a> {
    match (config.over.detail(), config.points) {
        (Some(detail), _) => Box::new(PatchedTarget::new(surface, tail, detail)),
        (None, Points::Strata) => Box::new(ProductTarget::of_surface(surface, tail)),
        (None, Points::Tabulated) => Box::new(TabulatedTarget::new(surface, tail)),
    }
}
