//! Measured surfaces.

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{Brdf, LATENTS, neural::NeuralBrdf},
    head,
    random::Stream,
};

use super::{Surface, Viewpoints};
use crate::Measured;

/// One measured material, or any of a family, each as often as the others.
pub struct MeasuredSurface {
    viewpoints: Viewpoints,
    materials: &'static Measured,
    latents: Vec<[f32; LATENTS]>,
}

impl MeasuredSurface {
    /// Of materials seen from viewpoints; what tells them apart is part of the condition where there are many.
    pub fn new(viewpoints: Viewpoints, materials: &'static Measured) -> Self {
        Self { viewpoints, materials, latents: materials.brdfs().iter().map(|brdf| brdf.latent()).collect() }
    }

    /// The material of a condition.
    fn brdf(&self, condition: &[f32]) -> &NeuralBrdf {
        let latent = &condition[head::Condition::Ggx.length()..];
        // Conditions hold the very numbers of one of the materials.
        let found = self.latents.iter().position(|known| !latent.is_empty() && known == latent);
        &self.materials.brdfs()[found.unwrap_or(0)]
    }
}

/// `(wo, n)`.
fn directions(condition: &[f32]) -> [Vec3; 2] {
    [Vec3::from_slice(condition), Vec3::from_slice(&condition[3..])]
}

impl Surface for MeasuredSurface {
    fn condition(&self) -> Condition {
        if self.materials.is_family() { Condition::Family } else { Condition::Ggx }
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let [wo, n] = self.viewpoints.draw(stream);
        let index = ((stream.uniform() * self.latents.len() as f32) as usize).min(self.latents.len() - 1);
        let encoded = head::Condition::encode_family(wo.into(), n.into(), &self.latents[index]);
        // The shorter layout is the beginning of the longer one.
        condition.copy_from_slice(&encoded[..condition.len()]);
    }

    fn lobe(&self, condition: &[f32], wi: Vec3A) -> f32 {
        self.lobes(condition, &[wi])[0]
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let [wo, n] = directions(condition);
        let wi: Vec<Vec3> = wi.iter().map(|&wi| wi.into()).collect();
        self.brdf(condition).luminances(n, wo, &wi)
    }

    fn sample(&self, condition: &[f32], u: Vec2) -> Option<Vec3A> {
        let [wo, n] = directions(condition);
        let (wi, pdf) = self.brdf(condition).mixture().draw_at(n, wo, u);
        (pdf > 0.0).then_some(wi.into())
    }

    fn pdf(&self, condition: &[f32], wi: Vec3A) -> f32 {
        let [wo, n] = directions(condition);
        self.brdf(condition).mixture().pdf_at(n, wo, wi.into())
    }
}
