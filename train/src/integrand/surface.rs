//! Materials as training sees them: conditions, BRDF x cosine, BRDF sampling.

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{self, BrdfTable, Kernel},
    one_point::OnePoint,
    random::Stream,
    simd::LANES,
    tile::ShadingPoint,
};

use super::Viewpoints;

/// A material and the distribution of conditions under which it is seen.
pub trait Surface: Sync {
    /// The layout of a condition.
    fn condition(&self) -> Condition;

    /// Draws a condition.
    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]);

    /// BRDF x cosine towards `wi`, up to a factor that may depend on the condition.
    fn lobe(&self, condition: &[f32], wi: Vec3A) -> f32;

    /// [`Self::lobe`] towards many directions.
    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        wi.iter().map(|&wi| self.lobe(condition, wi)).collect()
    }

    /// BRDF sampling: a direction for uniform numbers.
    fn sample(&self, condition: &[f32], u: Vec2) -> Option<Vec3A>;

    /// [`Self::sample`] for many numbers.
    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        u.iter().map(|&u| self.sample(condition, u)).collect()
    }

    /// The solid-angle pdf of [`sample`](Self::sample).
    fn pdf(&self, condition: &[f32], wi: Vec3A) -> f32;

    /// [`Self::pdf`] of many directions.
    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        wi.iter().map(|&wi| self.pdf(condition, wi)).collect()
    }
}

/// A surface that the renderer has, too.
pub trait RenderedSurface: Surface {
    /// The surface of a condition as the renderer's samplers see it, one strip of copies.
    fn point(&self, condition: &[f32]) -> OnePoint;
}

/// One strip of copies of a surface with a BRDF of a table.
pub(super) fn one_strip([wo, n]: [Vec3A; 2], surface: brdf::Surface, brdfs: &BrdfTable) -> OnePoint {
    OnePoint::of_table(&ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, LANES, brdfs)
}

/// Diffuse reflection; the condition is the normal.
pub struct Lambert {
    viewpoints: Viewpoints,
}

impl Lambert {
    /// Normals of surfaces that are seen from `viewpoints`.
    pub fn seen_from(viewpoints: Viewpoints) -> Self {
        Self { viewpoints }
    }
}

impl Default for Lambert {
    /// Normals uniform over the sphere.
    fn default() -> Self {
        Self::seen_from(Viewpoints::Sphere)
    }
}

/// A diffuse surface draws and weighs directions the same whatever its albedo and wherever it is seen from.
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

    fn lobe(&self, condition: &[f32], wi: Vec3A) -> f32 {
        let cosine = normal(condition).dot(wi);
        // Not `max`: it would turn NaN into 0.
        if cosine < 0.0 { 0.0 } else { cosine }
    }

    fn sample(&self, condition: &[f32], u: Vec2) -> Option<Vec3A> {
        let n = normal(condition).into();
        let (wi, pdf) = DIFFUSE.sample(n, n, u);
        (pdf > 0.0).then_some(wi.into())
    }

    fn pdf(&self, condition: &[f32], wi: Vec3A) -> f32 {
        let n = normal(condition).into();
        DIFFUSE.pdf(n, n, wi.into())
    }
}

impl RenderedSurface for Lambert {
    fn point(&self, condition: &[f32]) -> OnePoint {
        one_strip([normal(condition); 2], DIFFUSE.into(), &BrdfTable::default())
    }
}
