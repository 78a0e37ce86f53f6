//! Emitter sampling: directions in proportion to the map's luminance, the tail warp alone.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, EnvironmentLight, ShadingPoint, light::BATCH};
use crate::{error::Result, tail::Tail};

/// Samples the environment map and nothing else.
#[derive(Clone, Debug)]
pub struct EmitterSampler {
    light: EnvironmentLight,
}

impl EmitterSampler {
    /// A sampler of a light.
    pub fn new(light: EnvironmentLight) -> Self {
        Self { light }
    }
}

impl DirectionSampler for EmitterSampler {
    type Prepared = ();

    fn prepare(&self, _at: &ShadingPoint) {}

    fn sample(&self, _prepared: &(), _at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        self.light.sample_through_tail(u, 1.0)
    }

    fn pdf(&self, _prepared: &(), _at: &ShadingPoint, wi: Vec3A) -> f32 {
        self.light.pdf(wi)
    }

    fn sample_batch(&self, _at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        for (u, out) in u.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
            self.light.sample_batch_through_tail(u, &[1.0; BATCH][..u.len()], out);
        }
    }

    fn sample_prepared(&self, _: &[&()], _: &[&ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        self.sample_batch(&[], u, out);
    }

    fn pdf_batch(&self, _at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        self.light.pdf_batch(wi, out);
    }

    fn pdf_prepared(&self, _: &[&()], _: &[&ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        self.light.pdf_batch(wi, out);
    }
}

impl CoversIntegrand for EmitterSampler {}

/// Emitter sampling for use beside BRDF sampling: MIS compensation (Karlik et al. 2019).
///
/// The mean luminance is subtracted from the map and what is negative is cut off: dim regions are left to the partner, so
/// this sampler has no [`CoversIntegrand`] and cannot be used alone.
#[derive(Clone, Debug)]
pub struct CompensatedEmitterSampler(EmitterSampler);

impl CompensatedEmitterSampler {
    /// Builds the compensated tail of a light. A constant map, of which nothing would be left, is kept as it is.
    ///
    /// # Errors
    /// See [`Tail::new`].
    pub fn new(light: &EnvironmentLight) -> Result<Self> {
        let environment = light.environment();
        let (width, height) = (environment.width(), environment.height());
        let luminance = environment.luminance();
        let mean = solid_angle_mean(width, height, &luminance);
        let compensated: Vec<f32> = luminance.iter().map(|value| (value - mean).max(0.0)).collect();
        // What is left of a constant map is rounding noise.
        let left = solid_angle_mean(width, height, &compensated);
        let kept = if left > 1e-4 * mean { &compensated } else { &luminance };
        let tail = Tail::new(light.tail().kind(), width, height, kept)?;
        Ok(Self(EmitterSampler::new(EnvironmentLight::with_tail(environment.clone(), Arc::new(tail)))))
    }
}

/// The mean of a map over the sphere.
fn solid_angle_mean(width: usize, height: usize, luminance: &[f32]) -> f32 {
    let (mut sum, mut weights) = (0.0_f64, 0.0_f64);
    for (row, values) in luminance.chunks_exact(width).enumerate() {
        let weight = (std::f64::consts::PI * row as f64 / (height - 1) as f64).sin().max(1e-6);
        sum += weight * values.iter().map(|&value| f64::from(value)).sum::<f64>();
        weights += weight * width as f64;
    }
    (sum / weights) as f32
}

impl DirectionSampler for CompensatedEmitterSampler {
    type Prepared = ();

    fn prepare(&self, _at: &ShadingPoint) {}

    fn sample(&self, prepared: &(), at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        self.0.sample(prepared, at, u)
    }

    fn pdf(&self, prepared: &(), at: &ShadingPoint, wi: Vec3A) -> f32 {
        self.0.pdf(prepared, at, wi)
    }

    fn sample_batch(&self, at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        self.0.sample_batch(at, u, out);
    }

    fn pdf_batch(&self, at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        self.0.pdf_batch(at, wi, out);
    }

    fn sample_prepared(&self, prepared: &[&()], at: &[&ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        self.0.sample_prepared(prepared, at, u, out);
    }

    fn pdf_prepared(&self, prepared: &[&()], at: &[&ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        self.0.pdf_prepared(prepared, at, wi, out);
    }
}
