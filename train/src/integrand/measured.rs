//! Measured surfaces.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{self, Brdf, BrdfTable, LATENTS, MAX_PARAMETERS, neural::NeuralBrdf},
    head,
    one_point::OnePoint,
    random::Stream,
};

use super::{
    RenderedSurface, ShaderSurface, Surface, Viewpoints,
    surface::{drawn, one_strip},
};

/// One measured material, or a family, with equal probability of each.
pub struct MeasuredSurface {
    viewpoints: Viewpoints,
    materials: Vec<Arc<NeuralBrdf>>,
    latents: Vec<[f32; LATENTS]>,
    /// Each material in a renderer's table.
    tables: Vec<(BrdfTable, u32)>,
}

impl MeasuredSurface {
    /// Builds the surface of materials seen from viewpoints; with several materials, the condition contains
    /// the material's latent code.
    pub fn new(viewpoints: Viewpoints, materials: Vec<Arc<NeuralBrdf>>) -> Self {
        let latents = materials.iter().map(|brdf| brdf.latent()).collect();
        let tables = materials.iter().map(|brdf| BrdfTable::default().with(brdf.clone())).collect();
        Self { viewpoints, materials, latents, tables }
    }

    /// Returns the index of the material of a condition.
    fn index(&self, condition: &[f32]) -> usize {
        let latent = &condition[head::Condition::Ggx.length()..];
        // Conditions contain the exact values of one of the materials.
        let found = self.latents.iter().position(|known| !latent.is_empty() && known == latent);
        found.unwrap_or(0)
    }

    /// Returns the material of a condition.
    fn brdf(&self, condition: &[f32]) -> &NeuralBrdf {
        &self.materials[self.index(condition)]
    }
}

/// Returns `(wo, n)`.
fn directions(condition: &[f32]) -> [Vec3; 2] {
    [Vec3::from_slice(condition), Vec3::from_slice(&condition[3..])]
}

impl Surface for MeasuredSurface {
    fn condition(&self) -> Condition {
        if self.materials.len() > 1 { Condition::Family } else { Condition::Ggx }
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let [wo, n] = self.viewpoints.draw(stream);
        let index = ((stream.uniform() * self.latents.len() as f32) as usize).min(self.latents.len() - 1);
        let encoded = head::Condition::encode_family(wo.into(), n.into(), &self.latents[index]);
        // The shorter layout is a prefix of the longer one.
        condition.copy_from_slice(&encoded[..condition.len()]);
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let [wo, n] = directions(condition);
        let wi: Vec<Vec3> = wi.iter().map(|&wi| wi.into()).collect();
        self.brdf(condition).luminances(n, wo, &wi)
    }

    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        let ([wo, n], mixture) = (directions(condition), self.brdf(condition).mixture());
        u.iter().map(|&u| drawn(mixture.draw_at(n, wo, u))).collect()
    }

    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let ([wo, n], mixture) = (directions(condition), self.brdf(condition).mixture());
        wi.iter().map(|&wi| mixture.pdf_at(n, wo, wi.into())).collect()
    }

    fn in_shaders(&self) -> Option<ShaderSurface> {
        ShaderSurface::fitted(self.materials.iter().map(|material| &**material as &dyn Brdf))
    }
}

impl RenderedSurface for MeasuredSurface {
    fn point(&self, condition: &[f32]) -> OnePoint {
        let (brdfs, brdf) = &self.tables[self.index(condition)];
        let surface = brdf::Surface { brdf: *brdf, parameters: [0.0; MAX_PARAMETERS] };
        one_strip(directions(condition).map(Vec3A::from), surface, brdfs)
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::{
        brdf::neural::{open_measured, write_networks},
        random::Purpose,
    };

    use super::*;
    use crate::test_support::grey_lobe;

    #[test]
    fn conditions_identify_their_material() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("two.safetensors");
        write_networks(&file, &[("dull".into(), grey_lobe(0.5)), ("bright".into(), grey_lobe(3.0))]).unwrap();
        let materials = open_measured(&file, &["dull".into(), "bright".into()]).unwrap();
        let surface = MeasuredSurface::new(Viewpoints::Sphere, materials.clone());
        assert_eq!(surface.condition(), Condition::Family);
        let mut stream = Stream::new(0, Purpose::Test, 0);
        let (mut condition, mut seen) = (vec![0.0; head::Condition::Family.length()], [0; 2]);
        for _ in 0..200 {
            surface.draw_condition(&mut stream, &mut condition);
            let [wo, n] = directions(&condition);
            let which = usize::from(condition[head::Condition::Ggx.length()..] == materials[1].latent());
            seen[which] += 1;
            let brdf = &materials[which];
            let Some(wi) = surface.samples(&condition, &[stream.uniform2()])[0] else { continue };
            assert_eq!(surface.lobes(&condition, &[wi]), brdf.luminances(n, wo, &[wi.into()]));
            let pdfs = surface.pdfs(&condition, &[wi]);
            assert!(pdfs == [brdf.mixture().pdf_at(n, wo, wi.into())] && pdfs[0] > 0.0);
        }
        // 100 each, with a standard deviation of 7.
        assert!(seen.iter().all(|&count| count > 60), "{seen:?}");
        let one = open_measured(&file, &["dull".into()]).unwrap();
        assert_eq!(MeasuredSurface::new(Viewpoints::Sphere, one).condition(), Condition::Ggx);
    }
}
