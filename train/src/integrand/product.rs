//! Light x BRDF x cosine, seen through a tail.

use glam::{Vec2, Vec3A};
use headtail_model::Condition;
use headtail_render::{flat::FlatArray, random::Stream, tail::TailKind};

use super::{
    Lambert, ShaderTarget, Surface, TailMap, TailPoint,
    target::{PointValues, Target},
};

/// Largest density of BRDF sampling over Y: it has poles where the light vanishes, and infinity times zero is
/// NaN.
pub(super) const MAX_BRDF_DENSITY: f32 = 1e12;

/// `q*(y|c)`: a surface's lobe at the tail's direction for `y`, times the ratio of light to the tail's
/// density.
pub struct ProductTarget<'a, S> {
    surface: S,
    tail: &'a dyn TailMap,
}

/// The product with a diffuse surface: `max(0, n . w(t(y)))`.
pub type CosineTarget<'a> = ProductTarget<'a, Lambert>;

impl<'a> CosineTarget<'a> {
    /// Builds the target of a diffuse surface.
    pub fn new(tail: &'a dyn TailMap) -> Self {
        Self::of_surface(Lambert::default(), tail)
    }
}

impl<'a, S: Surface> ProductTarget<'a, S> {
    /// Builds the target of a surface.
    pub fn of_surface(surface: S, tail: &'a dyn TailMap) -> Self {
        Self { surface, tail }
    }

    /// Returns the surface.
    pub fn surface(&self) -> &S {
        &self.surface
    }
}

impl<S: Surface> Target for ProductTarget<'_, S> {
    fn condition(&self) -> Condition {
        self.surface.condition()
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        self.surface.draw_condition(stream, condition);
    }

    fn at_points(&self, condition: &[f32], y: &[[f32; 2]]) -> Vec<PointValues> {
        let there = self.tail.forward(y);
        let directions: Vec<Vec3A> = there.iter().map(|there| there.direction).collect();
        let pdfs =
            if self.tail.is_invertible() { self.surface.pdfs(condition, &directions) } else { vec![0.0; y.len()] };
        let values = |((there, lobe), pdf): ((TailPoint, f32), f32)| {
            let brdf = if pdf > 0.0 { (pdf / there.pdf).min(MAX_BRDF_DENSITY) } else { 0.0 };
            PointValues { target: lobe * there.light, brdf, tail: there.density }
        };
        there.into_iter().zip(self.surface.lobes(condition, &directions)).zip(pdfs).map(values).collect()
    }

    fn has_brdf_sampling(&self) -> bool {
        self.tail.is_invertible()
    }

    fn shader_target(&self) -> Option<ShaderTarget> {
        let (tail, surface) = (self.tail.as_tail()?, self.surface.in_shaders()?);
        let mut arrays = tail.flat();
        if tail.kind() == TailKind::Flow {
            let light = tail.light();
            let shape = vec![light.rows() + 1, light.columns()];
            arrays.push(FlatArray::floats("light.nodes", shape, light.nodes().collect()));
        }
        Some(ShaderTarget { arrays, surface, is_in_x: false })
    }

    fn brdf_samples(&self, condition: &[f32], u: &[[f32; 2]]) -> Vec<Option<[f32; 2]>> {
        let u: Vec<Vec2> = u.iter().map(|&u| Vec2::from_array(u)).collect();
        let drawn = self.surface.samples(condition, &u);
        let directions: Vec<Vec3A> = drawn.iter().flatten().copied().collect();
        let mut found = self.tail.inverse(&directions).into_iter();
        drawn.into_iter().map(|drawn| drawn.and_then(|_| found.next().flatten())).collect()
    }
}
