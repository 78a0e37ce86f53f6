//! Microfacet surfaces.

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{self, BrdfTable, Kernel},
    head,
    one_point::OnePoint,
    random::Stream,
};

use super::{
    RenderedSurface, ShaderSurface, Surface, Viewpoints,
    surface::{drawn, one_strip},
};

/// Trowbridge-Reitz microfacets with F = 1: the renderer applies the colour of a surface and its change with
/// the angle.
pub struct Ggx {
    viewpoints: Viewpoints,
    low: f32,
    high: f32,
}

impl Ggx {
    /// Draws widths alpha uniformly in `low..=high`; alpha is part of the condition unless both are equal.
    pub fn new(viewpoints: Viewpoints, low: f32, high: f32) -> Self {
        Self { viewpoints, low, high }
    }

    fn alpha(&self, condition: &[f32]) -> f32 {
        condition.get(10).copied().unwrap_or(self.low)
    }

    /// Returns `(wo, n)` and the BRDF.
    fn decode(&self, condition: &[f32]) -> ([Vec3; 2], brdf::Ggx) {
        let directions = [Vec3::from_slice(condition), Vec3::from_slice(&condition[3..])];
        (directions, brdf::Ggx::new(self.alpha(condition), Vec3::ONE))
    }
}

impl Surface for Ggx {
    fn condition(&self) -> Condition {
        if self.low == self.high { Condition::Ggx } else { Condition::GgxRoughness }
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let [wo, n] = self.viewpoints.draw(stream);
        let alpha = if self.low == self.high { self.low } else { self.low + (self.high - self.low) * stream.uniform() };
        // The shorter layout is a prefix of the longer one.
        let encoded = head::Condition::GgxRoughness.encode(wo.into(), n.into(), alpha);
        condition.copy_from_slice(&encoded[..condition.len()]);
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let ([wo, n], ggx) = self.decode(condition);
        wi.iter().map(|&wi| ggx.lobe_cosine(n, wo, wi.into())).collect()
    }

    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        let ([wo, n], ggx) = self.decode(condition);
        u.iter().map(|&u| drawn(ggx.sample(n, wo, u))).collect()
    }

    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        let ([wo, n], ggx) = self.decode(condition);
        wi.iter().map(|&wi| ggx.pdf(n, wo, wi.into())).collect()
    }

    fn in_shaders(&self) -> Option<ShaderSurface> {
        let fixed = self.low == self.high;
        Some(if fixed { ShaderSurface::Ggx { alpha: self.low } } else { ShaderSurface::GgxOfCondition })
    }
}

impl RenderedSurface for Ggx {
    fn point(&self, condition: &[f32]) -> OnePoint {
        let ([wo, n], ggx) = self.decode(condition);
        one_strip([wo.into(), n.into()], ggx.into(), &BrdfTable::default())
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::random::Purpose;

    use super::*;

    #[test]
    fn conditions_are_laid_out_as_documented() {
        let mut stream = Stream::new(0, Purpose::Test, 0);
        for (low, high, length) in [(0.4, 0.4, 10), (0.2, 0.8, 12)] {
            let surface = Ggx::new(Viewpoints::Sphere, low, high);
            assert_eq!(surface.condition().length(), length);
            let mut c = vec![0.0; length];
            surface.draw_condition(&mut stream, &mut c);
            let [wo, n, reflected] = [0, 3, 6].map(|start| Vec3A::from_slice(&c[start..]));
            assert!((c[9] - n.dot(wo)).abs() < 1e-6 && c[9] > 0.0);
            // Both directions of a mirror have the same angle to the normal and are coplanar with it.
            assert!((reflected.dot(n) - c[9]).abs() < 1e-6 && (reflected + wo).cross(n).length() < 1e-6);
            if let [alpha, log] = c[10..] {
                assert!((low..=high).contains(&alpha) && (log.exp() - alpha).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn lobe_and_sampling_match_the_renderer() {
        let surface = Ggx::new(Viewpoints::Sphere, 0.2, 0.8);
        let mut stream = Stream::new(0, Purpose::Test, 1);
        let mut c = [0.0; 12];
        for _ in 0..100 {
            surface.draw_condition(&mut stream, &mut c);
            let (wo, n) = (Vec3::from_slice(&c), Vec3::from_slice(&c[3..]));
            let ggx = brdf::Ggx::new(c[10], Vec3::ONE);
            let Some(wi) = surface.samples(&c, &[stream.uniform2()])[0] else { continue };
            assert_eq!(surface.pdfs(&c, &[wi]), [ggx.pdf(n, wo, wi.into())]);
            assert_eq!(surface.lobes(&c, &[wi]), [ggx.lobe_cosine(n, wo, wi.into())]);
            assert!(surface.lobes(&c, &[wi])[0] <= 1.0001 * surface.pdfs(&c, &[wi])[0]);
        }
    }
}
