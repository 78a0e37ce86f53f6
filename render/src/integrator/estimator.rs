//! Unbiased estimators of the light that a shading point reflects from the environment.

use glam::Vec3A;

use super::timings::{Stage, timed};
use crate::{
    color::luminance,
    random::{Stream, Streams},
    sampler::{
        CoversIntegrand, DirectionSample, DirectionSampler, ResampledDirection, ResampledSampler, ShadingPoint,
        directions,
    },
};

/// Answers shadow rays.
pub trait Visibility: Sync {
    /// Whether the environment is seen from `at` towards `wi` (which is above the geometric surface).
    fn visible(&self, at: &ShadingPoint, wi: Vec3A) -> bool;

    /// [`Self::visible`] of many pairs; both slices have equal length.
    fn visible_batch(&self, rays: &[(&ShadingPoint, Vec3A)], out: &mut [bool]) {
        for (&(at, wi), out) in rays.iter().zip(out) {
            *out = self.visible(at, wi);
        }
    }
}

/// No occluders at all: for unshadowed figures.
#[derive(Clone, Copy, Debug)]
pub struct Unshadowed;

impl Visibility for Unshadowed {
    fn visible(&self, _at: &ShadingPoint, _wi: Vec3A) -> bool {
        true
    }
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

/// What a direction adds to an estimate if the environment is seen along it.
#[derive(Clone, Copy, Debug)]
struct Contribution {
    wi: Vec3A,
    /// Reflected radiance per channel.
    radiance: Vec3A,
}

impl Estimate {
    /// Counts a contribution before its visibility test; whether there is anything to test for.
    fn count(&mut self, contribution: &Contribution) -> bool {
        let weight = luminance(contribution.radiance);
        let counts = weight > 0.0;
        if counts {
            self.max_weight = self.max_weight.max(weight);
            self.rays += 1;
        }
        counts
    }

    /// Adds a contribution, if it is not black and not occluded.
    fn add(&mut self, at: &ShadingPoint, visibility: &dyn Visibility, contribution: Option<Contribution>) {
        let Some(contribution) = contribution else { return };
        if self.count(&contribution) && timed(Stage::ShadowRays, || visibility.visible(at, contribution.wi)) {
            self.radiance += contribution.radiance;
        }
    }
}

/// [`Estimate::add`] for each point of a batch.
fn add_batch(
    estimates: &mut [Estimate],
    at: &[ShadingPoint],
    visibility: &dyn Visibility,
    contribution: impl Fn(usize) -> Option<Contribution>,
) {
    let (mut of, mut rays) = (Vec::with_capacity(at.len()), Vec::with_capacity(at.len()));
    timed(Stage::Shading, || {
        for (k, estimate) in estimates.iter_mut().enumerate() {
            if let Some(contribution) = contribution(k).filter(|contribution| estimate.count(contribution)) {
                of.push((k, contribution.radiance));
                rays.push((&at[k], contribution.wi));
            }
        }
    });
    let mut visible = vec![false; rays.len()];
    timed(Stage::ShadowRays, || visibility.visible_batch(&rays, &mut visible));
    for ((k, radiance), _) in of.into_iter().zip(visible).filter(|(_, visible)| *visible) {
        estimates[k].radiance += radiance;
    }
}

/// One draw of an unbiased estimator of the light that a shading point reflects from the environment.
pub trait DirectEstimator: Send + Sync {
    /// Estimates the reflected radiance at `at`; all randomness comes from `random`.
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate;

    /// [`Self::estimate`] for many shading points, each with its stream: the wavefront form, in which samplers work on
    /// many points at once.
    fn estimate_batch(
        &self,
        at: &[ShadingPoint],
        visibility: &dyn Visibility,
        random: &mut Streams<'_>,
    ) -> Vec<Estimate> {
        at.iter().enumerate().map(|(k, at)| self.estimate(at, visibility, random.of(k))).collect()
    }
}

/// One direction from one sampler: `f cos L V / pdf`.
#[derive(Clone, Debug)]
pub struct SingleSample<S>(S);

impl<S: CoversIntegrand> SingleSample<S> {
    /// An estimator of a sampler that covers the whole integrand.
    pub fn new(sampler: S) -> Self {
        Self(sampler)
    }

    /// The direction and what it contributes if it is seen.
    fn contribution(at: &ShadingPoint, drawn: Option<DirectionSample>) -> Option<Contribution> {
        let DirectionSample { wi, pdf, radiance } = drawn?;
        Some(Contribution { wi, radiance: at.brdf_cosine(wi) * radiance / pdf })
    }
}

impl<S: CoversIntegrand> DirectEstimator for SingleSample<S> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let u = random.uniform2();
        let drawn = timed(Stage::Sampling, || self.0.sample(&self.0.prepare(at), at, u));
        let mut estimate = Estimate::default();
        estimate.add(at, visibility, timed(Stage::Shading, || Self::contribution(at, drawn)));
        estimate
    }

    fn estimate_batch(
        &self,
        at: &[ShadingPoint],
        visibility: &dyn Visibility,
        random: &mut Streams<'_>,
    ) -> Vec<Estimate> {
        let mut samples = vec![None; at.len()];
        let u = random.uniform2();
        timed(Stage::Sampling, || self.0.sample_batch(at, &u, &mut samples));
        let mut estimates = vec![Estimate::default(); at.len()];
        add_batch(&mut estimates, at, visibility, |k| Self::contribution(&at[k], samples[k]));
        estimates
    }
}

/// Two-sample MIS with the power heuristic, beta = 2 (Veach 1997, section 9.2.3): one direction, and at most one shadow ray, from
/// each of two samplers.
#[derive(Clone, Debug)]
pub struct TwoSampleMis<A, B> {
    first: A,
    second: B,
}

impl<A: DirectionSampler, B: CoversIntegrand> TwoSampleMis<A, B> {
    /// Combines two samplers, of which the second covers the integrand.
    pub fn new(first: A, second: B) -> Self {
        Self { first, second }
    }
}

impl<A: DirectionSampler, B: CoversIntegrand> TwoSampleMis<A, B> {
    /// What a direction of one sampler contributes if it is seen, when the other sampler draws it with `other_pdf`.
    fn contribution(at: &ShadingPoint, drawn: Option<DirectionSample>, other_pdf: f32) -> Option<Contribution> {
        let DirectionSample { wi, pdf, radiance } = drawn?;
        // p^2 / (p^2 + q^2), written so that a large p does not overflow.
        let ratio = other_pdf / pdf;
        Some(Contribution { wi, radiance: at.brdf_cosine(wi) * radiance / (pdf * (1.0 + ratio * ratio)) })
    }
}

impl<A: DirectionSampler, B: CoversIntegrand> DirectEstimator for TwoSampleMis<A, B> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let mut estimate = Estimate::default();
        let (first, second) = timed(Stage::Sampling, || (self.first.prepare(at), self.second.prepare(at)));
        let mut add = |drawn: Option<DirectionSample>, other_pdf: &dyn Fn(Vec3A) -> f32| {
            let other_pdf = timed(Stage::Pdf, || drawn.map_or(0.0, |drawn| other_pdf(drawn.wi)));
            estimate.add(at, visibility, timed(Stage::Shading, || Self::contribution(at, drawn, other_pdf)));
        };
        let (u, v) = (random.uniform2(), random.uniform2());
        add(timed(Stage::Sampling, || self.first.sample(&first, at, u)), &|wi| self.second.pdf(&second, at, wi));
        add(timed(Stage::Sampling, || self.second.sample(&second, at, v)), &|wi| self.first.pdf(&first, at, wi));
        estimate
    }

    fn estimate_batch(
        &self,
        at: &[ShadingPoint],
        visibility: &dyn Visibility,
        random: &mut Streams<'_>,
    ) -> Vec<Estimate> {
        let (first, second) = timed(Stage::Sampling, || (self.first.prepare_batch(at), self.second.prepare_batch(at)));
        let (first, second): (Vec<_>, Vec<_>) = (first.iter().collect(), second.iter().collect());
        let of: Vec<&ShadingPoint> = at.iter().collect();
        let mut samples = vec![None; at.len()];
        let mut others = vec![0.0; at.len()];
        let mut estimates = vec![Estimate::default(); at.len()];
        let u = random.uniform2();
        timed(Stage::Sampling, || self.first.sample_prepared(&first, &of, &u, &mut samples));
        timed(Stage::Pdf, || self.second.pdf_prepared(&second, &of, &directions(&samples), &mut others));
        add_batch(&mut estimates, at, visibility, |k| Self::contribution(&at[k], samples[k], others[k]));
        let u = random.uniform2();
        timed(Stage::Sampling, || self.second.sample_prepared(&second, &of, &u, &mut samples));
        timed(Stage::Pdf, || self.first.pdf_prepared(&first, &of, &directions(&samples), &mut others));
        add_batch(&mut estimates, at, visibility, |k| Self::contribution(&at[k], samples[k], others[k]));
        estimates
    }
}

/// One direction from a resampled sampler: `f cos L V W`.
#[derive(Clone, Debug)]
pub struct ResampledEstimator<S>(S);

impl<S: ResampledSampler> ResampledEstimator<S> {
    /// An estimator of a resampled sampler.
    pub fn new(sampler: S) -> Self {
        Self(sampler)
    }

    /// The direction and what it contributes if it is seen.
    fn contribution(at: &ShadingPoint, drawn: Option<ResampledDirection>) -> Option<Contribution> {
        let ResampledDirection { wi, radiance, contribution_weight } = drawn?;
        Some(Contribution { wi, radiance: at.brdf_cosine(wi) * radiance * contribution_weight })
    }
}

impl<S: ResampledSampler> DirectEstimator for ResampledEstimator<S> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let drawn = timed(Stage::Sampling, || self.0.sample(at, random));
        let mut estimate = Estimate::default();
        estimate.add(at, visibility, timed(Stage::Shading, || Self::contribution(at, drawn)));
        estimate
    }

    fn estimate_batch(
        &self,
        at: &[ShadingPoint],
        visibility: &dyn Visibility,
        random: &mut Streams<'_>,
    ) -> Vec<Estimate> {
        let drawn = timed(Stage::Sampling, || self.0.sample_batch(at, random));
        let mut estimates = vec![Estimate::default(); at.len()];
        add_batch(&mut estimates, at, visibility, |k| Self::contribution(&at[k], drawn[k]));
        estimates
    }
}
