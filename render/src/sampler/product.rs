//! The composed warp: a density over the intermediate square Y, carried to directions by the tail.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, EnvironmentLight, ShadingPoint, light::BATCH};
use crate::environment::Environment;

/// A conditional distribution over the intermediate square Y: a head warp, or a table in its place.
///
/// It must be positive wherever the BRDF times cosine of the direction `t(y)` is.
pub trait IntermediateDensity: Send + Sync {
    /// What depends on the condition alone.
    type Prepared: Send;

    /// Computes what depends on the condition (normal, view direction, material) alone.
    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared;

    /// Carries a uniform point `z` of `[0, 1)^2` to `(y, density over Y)`.
    fn sample(&self, prepared: &Self::Prepared, z: Vec2) -> (Vec2, f32);

    /// [`Self::prepare`] and [`Self::sample`] for many conditions; all slices have equal length.
    fn sample_batch(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        for (((at, &z), y), q) in at.iter().zip(z).zip(y).zip(q) {
            (*y, *q) = self.sample(&self.prepare(at), z);
        }
    }

    /// [`Self::prepare`] and [`Self::density`] for many conditions; all slices have equal length.
    fn density_batch(&self, at: &[ShadingPoint], y: &[Vec2], q: &mut [f32]) {
        let prepared = self.prepare_batch(at);
        self.density_prepared(&prepared.iter().collect::<Vec<_>>(), y, q);
    }

    /// [`Self::share_beside_brdf`] for many conditions; both slices have equal length.
    fn share_batch(&self, at: &[ShadingPoint], shares: &mut [f32]) {
        for (at, share) in at.iter().zip(shares) {
            *share = self.share_beside_brdf(&self.prepare(at));
        }
    }

    /// [`Self::prepare`] for many conditions.
    fn prepare_batch(&self, at: &[ShadingPoint]) -> Vec<Self::Prepared> {
        at.iter().map(|at| self.prepare(at)).collect()
    }

    /// [`Self::sample`] for many prepared conditions; all slices have equal length.
    fn sample_prepared(&self, prepared: &[&Self::Prepared], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        for (((prepared, &z), y), q) in prepared.iter().zip(z).zip(y).zip(q) {
            (*y, *q) = self.sample(prepared, z);
        }
    }

    /// [`Self::density`] for many prepared conditions; all slices have equal length.
    fn density_prepared(&self, prepared: &[&Self::Prepared], y: &[Vec2], q: &mut [f32]) {
        for ((prepared, &y), q) in prepared.iter().zip(y).zip(q) {
            *q = self.density(prepared, y);
        }
    }

    /// Which share of samples to draw from here in a mixture with BRDF sampling, in (0, 1).
    fn share_beside_brdf(&self, _prepared: &Self::Prepared) -> f32 {
        0.5
    }

    /// The density over Y at `y`.
    fn density(&self, prepared: &Self::Prepared, y: Vec2) -> f32;
}

/// Samples directions in proportion to light x BRDF x cosine, as closely as the intermediate density allows (paper, eq. 6:
/// the pdf of the composition is the density over Y divided by the tail's Jacobian).
#[derive(Clone, Debug)]
pub struct ProductSampler<I> {
    light: EnvironmentLight,
    intermediate: I,
}

impl<I: IntermediateDensity> ProductSampler<I> {
    /// Composes an intermediate density with the tail of a light.
    pub fn new(light: EnvironmentLight, intermediate: I) -> Self {
        Self { light, intermediate }
    }

    /// The map.
    pub fn environment(&self) -> &Arc<Environment> {
        self.light.environment()
    }
}

impl<I: IntermediateDensity> DirectionSampler for ProductSampler<I> {
    type Prepared = I::Prepared;

    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared {
        self.intermediate.prepare(at)
    }

    fn sample(&self, prepared: &Self::Prepared, _at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        let (y, q) = self.intermediate.sample(prepared, u);
        self.light.sample_through_tail(y, q)
    }

    fn pdf(&self, prepared: &Self::Prepared, _at: &ShadingPoint, wi: Vec3A) -> f32 {
        let (y, pdf) = self.light.pull_back(wi);
        if pdf > 0.0 { self.intermediate.density(prepared, y) * pdf } else { 0.0 }
    }

    fn share_beside_brdf(&self, prepared: &Self::Prepared) -> f32 {
        self.intermediate.share_beside_brdf(prepared)
    }

    fn sample_batch(&self, at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        for ((at, u), out) in at.chunks(BATCH).zip(u.chunks(BATCH)).zip(out.chunks_mut(BATCH)) {
            let (mut y, mut q) = ([Vec2::ZERO; BATCH], [0.0; BATCH]);
            let (y, q) = (&mut y[..u.len()], &mut q[..u.len()]);
            self.intermediate.sample_batch(at, u, y, q);
            self.light.sample_batch_through_tail(y, q, out);
        }
    }

    fn share_batch(&self, at: &[ShadingPoint], shares: &mut [f32]) {
        self.intermediate.share_batch(at, shares);
    }

    fn pdf_batch(&self, at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        for ((at, wi), out) in at.chunks(BATCH).zip(wi.chunks(BATCH)).zip(out.chunks_mut(BATCH)) {
            let (mut y, mut pdfs) = ([Vec2::ZERO; BATCH], [0.0; BATCH]);
            let (y, pdfs) = (&mut y[..wi.len()], &mut pdfs[..wi.len()]);
            self.light.pull_back_batch(wi, y, pdfs);
            self.intermediate.density_batch(at, y, out);
            join(out, pdfs);
        }
    }

    fn prepare_batch(&self, at: &[ShadingPoint]) -> Vec<Self::Prepared> {
        self.intermediate.prepare_batch(at)
    }

    fn sample_prepared(
        &self,
        prepared: &[&Self::Prepared],
        _at: &[&ShadingPoint],
        u: &[Vec2],
        out: &mut [Option<DirectionSample>],
    ) {
        let (mut y, mut q) = (vec![Vec2::ZERO; u.len()], vec![0.0; u.len()]);
        self.intermediate.sample_prepared(prepared, u, &mut y, &mut q);
        self.light.sample_batch_through_tail(&y, &q, out);
    }

    fn pdf_prepared(&self, prepared: &[&Self::Prepared], _at: &[&ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        let (mut y, mut pdfs) = (vec![Vec2::ZERO; wi.len()], vec![0.0; wi.len()]);
        self.light.pull_back_batch(wi, &mut y, &mut pdfs);
        self.intermediate.density_prepared(prepared, &y, out);
        join(out, &pdfs);
    }
}

/// From densities over Y to pdfs: times the pdf of the tail alone, and 0 where that is 0.
fn join(densities: &mut [f32], pdfs: &[f32]) {
    for (density, &pdf) in densities.iter_mut().zip(pdfs) {
        *density = if pdf > 0.0 { *density * pdf } else { 0.0 };
    }
}

impl<I: IntermediateDensity> CoversIntegrand for ProductSampler<I> {}
