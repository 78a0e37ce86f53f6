//! BRDF sampling; for Lambert surfaces this is cosine sampling.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, ShadingPoint};
use crate::environment::Environment;

/// Samples the BRDF times cosine and nothing else.
#[derive(Clone, Debug)]
pub struct BrdfSampler {
    environment: Arc<Environment>,
}

impl BrdfSampler {
    /// A sampler under an environment (which only gives the radiance of its samples).
    pub fn new(environment: Arc<Environment>) -> Self {
        Self { environment }
    }
}

impl BrdfSampler {
    /// Draws all directions, then looks up the light from all of them.
    fn sample_all<'a>(
        &self,
        at: impl Iterator<Item = &'a ShadingPoint>,
        u: &[Vec2],
        out: &mut [Option<DirectionSample>],
    ) {
        let mut wi = vec![Vec3A::Z; u.len()];
        for (((at, &u), wi), out) in at.zip(u).zip(&mut wi).zip(&mut *out) {
            *out = at.brdf.sample(at.ns, at.wo, u).map(|(drawn, pdf)| {
                *wi = drawn;
                DirectionSample { wi: drawn, pdf, radiance: Vec3A::ZERO }
            });
        }
        let mut radiances = vec![Vec3A::ZERO; u.len()];
        self.environment.radiance_batch(&wi, &mut radiances);
        for (sample, radiance) in out.iter_mut().zip(radiances) {
            if let Some(sample) = sample {
                sample.radiance = radiance;
            }
        }
    }
}

impl DirectionSampler for BrdfSampler {
    type Prepared = ();

    fn prepare(&self, _at: &ShadingPoint) {}

    fn sample(&self, _prepared: &(), at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        let (wi, pdf) = at.brdf.sample(at.ns, at.wo, u)?;
        Some(DirectionSample { wi, pdf, radiance: self.environment.radiance(wi) })
    }

    fn sample_batch(&self, at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        self.sample_all(at.iter(), u, out);
    }

    fn sample_prepared(&self, _: &[&()], at: &[&ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        self.sample_all(at.iter().copied(), u, out);
    }

    fn pdf(&self, _prepared: &(), at: &ShadingPoint, wi: Vec3A) -> f32 {
        at.brdf.pdf(at.ns, at.wo, wi)
    }

    fn pdf_batch(&self, at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        for ((at, &wi), out) in at.iter().zip(wi).zip(out) {
            *out = at.brdf.pdf(at.ns, at.wo, wi);
        }
    }
}

impl CoversIntegrand for BrdfSampler {}
