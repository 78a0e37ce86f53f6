//! Unbiased estimators of the light that a shading point reflects from the environment.

use glam::Vec3A;

use crate::{random::Stream, sampler::ShadingPoint};

/// Answers shadow rays.
pub trait Visibility: Sync {
    /// Whether the environment is seen from `at` towards `wi` (which is above the geometric surface).
    fn visible(&self, at: &ShadingPoint, wi: Vec3A) -> bool;
}

/// One estimate of reflected radiance.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    /// Reflected radiance per channel.
    pub radiance: Vec3A,
    /// Shadow rays traced.
    pub rays: u32,
    /// The luminance of the largest single contribution before the visibility test: what makes fireflies.
    pub max_weight: f32,
}

/// One draw of an unbiased estimator of the light that a shading point reflects from the environment.
pub trait DirectEstimator: Send + Sync {
    /// Estimates the reflected radiance at `at`; all randomness comes from `random`.
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate;
}
