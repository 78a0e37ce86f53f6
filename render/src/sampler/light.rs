//! An environment map together with the tail warp that samples it.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::DirectionSample;
use crate::{
    environment::Environment,
    error::Result,
    latlong,
    tail::{Tail, TailKind, TailWarp},
};

/// Samples that are warped together in a batch.
pub(super) const BATCH: usize = 64;

/// Radiance and the tail warp of one environment map; cheap to clone.
#[derive(Clone, Debug)]
pub struct EnvironmentLight {
    environment: Arc<Environment>,
    tail: Arc<Tail>,
}

impl EnvironmentLight {
    /// Builds the tail of a kind for a map.
    ///
    /// # Errors
    /// See [`Tail::new`].
    pub fn new(environment: Arc<Environment>, kind: TailKind) -> Result<Self> {
        let tail = Tail::new(kind, environment.width(), environment.height(), &environment.luminance())?;
        Ok(Self { environment, tail: Arc::new(tail) })
    }

    /// Joins a map to a tail that may have been built for a modification of it.
    pub fn with_tail(environment: Arc<Environment>, tail: Arc<Tail>) -> Self {
        Self { environment, tail }
    }

    /// The map.
    pub fn environment(&self) -> &Arc<Environment> {
        &self.environment
    }

    /// The tail warp.
    pub fn tail(&self) -> &Arc<Tail> {
        &self.tail
    }

    /// [`Self::sample_through_tail`] of many points with their densities; `out` has their length.
    pub fn sample_batch_through_tail(&self, y: &[Vec2], q: &[f32], out: &mut [Option<DirectionSample>]) {
        for ((y, q), out) in y.chunks(BATCH).zip(q.chunks(BATCH)).zip(out.chunks_mut(BATCH)) {
            let mut warped = [(Vec2::ZERO, 0.0); BATCH];
            let warped = &mut warped[..y.len()];
            self.tail.forward_batch(y, warped);
            for ((&(x, jacobian), &q), out) in warped.iter().zip(q).zip(out) {
                *out = self.sample_at(x, q / jacobian);
            }
        }
    }

    /// The direction of a point of X that was drawn with density `density` (over X).
    fn sample_at(&self, x: Vec2, density: f32) -> Option<DirectionSample> {
        let pdf = density * latlong::solid_angle_factor(x.y);
        // A pdf of 0 or infinity comes from the edge of a dark region, which is hit with probability 0.
        (pdf > 0.0 && pdf.is_finite()).then(|| DirectionSample {
            wi: latlong::direction(x),
            pdf,
            radiance: self.environment.radiance_at(x),
        })
    }

    /// The direction of a point `y` of Y that was drawn with density `q` (over Y); `None` where its pdf is 0 or overflows.
    pub fn sample_through_tail(&self, y: Vec2, q: f32) -> Option<DirectionSample> {
        let (x, jacobian) = self.tail.forward(y);
        self.sample_at(x, q / jacobian)
    }

    /// The point of Y that is carried to `wi`, and the solid-angle pdf of `wi` when Y is uniform.
    pub fn pull_back(&self, wi: Vec3A) -> (Vec2, f32) {
        let x = latlong::square(wi);
        let (y, density) = self.tail.inverse(x);
        (y, density * latlong::solid_angle_factor(x.y))
    }

    /// The solid-angle pdf of `wi` when Y is uniform.
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        let x = latlong::square(wi);
        self.tail.density(x) * latlong::solid_angle_factor(x.y)
    }
}
