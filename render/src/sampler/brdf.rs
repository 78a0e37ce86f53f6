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

impl DirectionSampler for BrdfSampler {
    type Prepared = ();

    fn prepare(&self, _at: &ShadingPoint) {}

    fn sample(&self, _prepared: &(), at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        let (wi, pdf) = at.brdf.sample(at.ns, at.wo, u)?;
        Some(DirectionSample { wi, pdf, radiance: self.environment.radiance(wi) })
    }

    fn pdf(&self, _prepared: &(), at: &ShadingPoint, wi: Vec3A) -> f32 {
        at.brdf.pdf(at.ns, at.wo, wi)
    }
}

impl CoversIntegrand for BrdfSampler {}
