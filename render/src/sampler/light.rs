//! An environment map together with the tail warp that samples it.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::DirectionSample;
use crate::{
    environment::Environment,
    error::Result,
    latlong,
    simd::{self, LANES, Simd, Vectorized},
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
            simd::dispatch(SamplesAt { environment: &self.environment, warped, q, out });
        }
    }

    /// The direction of a point `y` of Y that was drawn with density `q` (over Y); `None` where its pdf is 0 or overflows.
    pub fn sample_through_tail(&self, y: Vec2, q: f32) -> Option<DirectionSample> {
        let (x, jacobian) = self.tail.forward(y);
        let (wi, factor) = latlong::direction_and_factor(x);
        sample_of(wi, q / jacobian * factor, self.environment.radiance_at(x))
    }

    /// The point of Y that is carried to `wi`, and the solid-angle pdf of `wi` when Y is uniform.
    pub fn pull_back(&self, wi: Vec3A) -> (Vec2, f32) {
        let x = latlong::square(wi);
        let (y, density) = self.tail.inverse(x);
        (y, density * latlong::solid_angle_factor(x.y))
    }

    /// [`Self::pull_back`] of many directions; all slices have equal length.
    pub fn pull_back_batch(&self, wi: &[Vec3A], y: &mut [Vec2], pdfs: &mut [f32]) {
        simd::dispatch(PullBacks { tail: &self.tail, wi, y, pdfs });
    }

    /// [`Self::pdf`] of many directions; both slices have equal length.
    pub fn pdf_batch(&self, wi: &[Vec3A], pdfs: &mut [f32]) {
        simd::dispatch(Pdfs { tail: &self.tail, wi, pdfs });
    }

    /// The solid-angle pdf of `wi` when Y is uniform.
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        let x = latlong::square(wi);
        self.tail.density(x) * latlong::solid_angle_factor(x.y)
    }
}

/// A pdf of 0 or infinity comes from the edge of a dark region, which is hit with probability 0.
#[inline(always)]
fn sample_of(wi: Vec3A, pdf: f32, radiance: Vec3A) -> Option<DirectionSample> {
    (pdf > 0.0 && pdf < f32::INFINITY).then_some(DirectionSample { wi, pdf, radiance })
}

/// The directions of points of X, each with the Jacobian of the tail and the density over Y that it was drawn with.
struct SamplesAt<'a> {
    environment: &'a Environment,
    warped: &'a [(Vec2, f32)],
    q: &'a [f32],
    out: &'a mut [Option<DirectionSample>],
}

impl Vectorized for SamplesAt<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let chunks = self.warped.chunks(LANES).zip(self.q.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((warped, q), out) in chunks {
            let (mut u, mut v, mut pdfs) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
            for (k, (&(x, jacobian), q)) in warped.iter().zip(q).enumerate() {
                (u[k], v[k], pdfs[k]) = (x.x, x.y, q / jacobian);
            }
            let mut wi = [[0.0; LANES]; 3];
            for k in 0..LANES {
                let ([x, y, z], factor) = latlong::components_and_factor(u[k], v[k]);
                (wi[0][k], wi[1][k], wi[2][k]) = (x, y, z);
                pdfs[k] *= factor;
            }
            let radiances = self.environment.radiance_lanes(&u, &v);
            for (k, out) in out.iter_mut().enumerate() {
                *out = sample_of(Vec3A::new(wi[0][k], wi[1][k], wi[2][k]), pdfs[k], radiances[k]);
            }
        }
    }
}

/// Pdfs of directions.
struct Pdfs<'a> {
    tail: &'a Tail,
    wi: &'a [Vec3A],
    pdfs: &'a mut [f32],
}

impl Vectorized for Pdfs<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        for (wi, pdfs) in self.wi.chunks(LANES).zip(self.pdfs.chunks_mut(LANES)) {
            let [u, v] = latlong::square_lanes(wi);
            let mut out = self.tail.density_lanes(&u, &v);
            for k in 0..LANES {
                out[k] *= latlong::factor_at(v[k]);
            }
            pdfs.copy_from_slice(&out[..pdfs.len()]);
        }
    }
}

/// Points of Y that are carried to directions, and the pdfs of these.
struct PullBacks<'a> {
    tail: &'a Tail,
    wi: &'a [Vec3A],
    y: &'a mut [Vec2],
    pdfs: &'a mut [f32],
}

impl Vectorized for PullBacks<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let chunks = self.wi.chunks(LANES).zip(self.y.chunks_mut(LANES)).zip(self.pdfs.chunks_mut(LANES));
        for ((wi, y), pdfs) in chunks {
            let [u, v] = latlong::square_lanes(wi);
            let mut factors = [0.0; LANES];
            for k in 0..LANES {
                factors[k] = latlong::factor_at(v[k]);
            }
            for (k, (y, pdf)) in y.iter_mut().zip(pdfs).enumerate() {
                let (at, density) = self.tail.inverse(Vec2::new(u[k], v[k]));
                (*y, *pdf) = (at, density * factors[k]);
            }
        }
    }
}
