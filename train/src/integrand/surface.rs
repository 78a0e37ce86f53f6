//! Materials for training: conditions, BRDF x cosine, BRDF sampling.

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{self, BrdfTable, Kernel},
    one_point::OnePoint,
    random::Stream,
    simd::LANES,
    tile::ShadingPoint,
};

use super::{ShaderSurface, Viewpoints};

/// A material and the distribution of conditions under which it is seen.
pub trait Surface: Sync {
    /// Returns the layout of a condition.
    fn condition(&self) -> Condition;

    /// Draws a condition.
    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]);

    /// Returns BRDF x cosine towards directions, up to a factor that may depend on the condition.
    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32>;

    /// Draws directions by BRDF sampling from uniform numbers.
    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>>;

    /// Returns the solid-angle pdfs of [`samples`](Self::samples).
    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32>;

    /// Describes the surface to shaders; `None` for one that they do not know.
    fn in_shaders(&self) -> Option<ShaderSurface> {
        None
    }
}

/// A surface that the renderer also supports.
pub trait RenderedSurface: Surface {
    /// Returns the surface of a condition for the renderer's samplers, as one strip of copies.
    fn point(&self, condition: &[f32]) -> OnePoint;
}

/// Returns one strip of copies of a surface with a BRDF of a table.
pub(super) fn one_strip([wo, n]: [Vec3A; 2], surface: brdf::Surface, brdfs: &BrdfTable) -> OnePoint {
    OnePoint::of_table(&ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, LANES, brdfs)
}

/// Returns the direction of a draw; `None` for a pdf of 0.
pub(super) fn drawn((wi, pdf): (Vec3, f32)) -> Option<Vec3A> {
    (pdf > 0.0).then_some(wi.into())
}

/// Diffuse reflection; the condition is the normal.
pub struct Lambert {
    viewpoints: Viewpoints,
}

impl Lambert {
    /// Draws normals of surfaces seen from `viewpoints`.
    pub fn seen_from(viewpoints: Viewpoints) -> Self {
        Self { viewpoints }
    }
}

impl Default for Lambert {
    /// Draws normals uniformly over the sphere.
    fn default() -> Self {
        Self::seen_from(Viewpoints::Sphere)
    }
}

/// Sampling of a diffuse surface does not depend on albedo or view direction.
const DIFFUSE: brdf::Lambert = brdf::Lambert { albedo: Vec3::ONE };

fn normal(condition: &[f32]) -> Vec3A {
    Vec3A::from_slice(condition)
}

impl Surface for Lambert {
    fn condition(&self) -> Condition {
        Condition::Normal
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        condition.copy_from_slice(&self.viewpoints.draw_normal(stream).to_array());
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let n = normal(condition);
        // Not `max`: it would turn NaN into 0.
        let clamped = |cosine: f32| if cosine < 0.0 { 0.0 } else { cosine };
        wi.iter().map(|&wi| clamped(n.dot(wi))).collect()
    }

    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        let n = normal(condition).into();
        u.iter().map(|&u| drawn(DIFFUSE.sample(n, n, u))).collect()
    }

    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let n = normal(condition).into();
        wi.iter().map(|&wi| DIFFUSE.pdf(n, n, wi.into())).collect()
    }

    fn in_shaders(&self) -> Option<ShaderSurface> {
        Some(ShaderSurface::Lambert)
    }
}

impl RenderedSurface for Lambert {
    fn point(&self, condition: &[f32]) -> OnePoint {
        one_strip([normal(condition); 2], DIFFUSE.into(), &BrdfTable::default())
    }
}
