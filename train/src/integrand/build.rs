//! The target that a configuration asks for.

use headtail_render::tail::Tail;

use super::{
    Ggx, Lambert, MeasuredSurface, NaiveTarget, ProductTarget, Surface, TabulatedTarget, Target, TexturedSurface,
    Viewpoints,
};
use crate::{FitConfig, Material, config::Points};

/// The target of `config` under an exact tail (of the kind that `config` names), with surfaces seen from `viewpoints`.
pub fn build_target<'a>(config: &FitConfig, tail: &'a Tail, viewpoints: Viewpoints) -> Box<dyn Target + 'a> {
    let target = match config.material {
        Material::Lambert => with_points(config.points, Lambert::seen_from(viewpoints), tail),
        Material::Ggx { low, high } => with_points(config.points, Ggx::new(viewpoints, low, high), tail),
        Material::Measured(materials) if materials.texture().is_some() => {
            with_points(config.points, TexturedSurface::new(viewpoints, materials), tail)
        }
        Material::Measured(materials) => with_points(config.points, MeasuredSurface::new(viewpoints, materials), tail),
    };
    if config.naive { Box::new(NaiveTarget::new(target, tail)) } else { target }
}

fn with_points<'a, S: Surface + 'a>(points: Points, surface: S, tail: &'a Tail) -> Box<dyn Target + 'a> {
    match points {
        Points::Strata => Box::new(ProductTarget::of_surface(surface, tail)),
        Points::Tabulated => Box::new(TabulatedTarget::new(surface, tail)),
    }
}
