//! Unbiased estimators of the light that a shading point reflects from the environment.

use glam::Vec3A;

use super::timings::{Stage, timed};
use crate::{
    color::luminance,
    random::{Stream, Streams},
    sampler::{CoversIntegrand, DirectionSample, DirectionSampler, ResampledDirection, ResampledSampler, ShadingPoint},
};

/// Answers shadow rays.
pub trait Visibility: Sync {
    /// Whether the environment is seen from `at` towards `wi` (which is above the geometric surface).
    fn visible(&self, at: &ShadingPoint, wi: Vec3A) -> bool;
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

impl Estimate {
    /// Adds a contribution, if it is not black and not occluded.
    fn add(&mut self, at: &ShadingPoint, visibility: &dyn Visibility, wi: Vec3A, contribution: Vec3A) {
        let weight = luminance(contribution);
        if weight > 0.0 {
            self.max_weight = self.max_weight.max(weight);
            self.rays += 1;
            if timed(Stage::ShadowRays, || visibility.visible(at, wi)) {
                self.radiance += contribution;
            }
        }
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

    fn evaluate(at: &ShadingPoint, visibility: &dyn Visibility, drawn: Option<DirectionSample>) -> Estimate {
        let mut estimate = Estimate::default();
        if let Some(DirectionSample { wi, pdf, radiance }) = drawn {
            let contribution = timed(Stage::Shading, || at.brdf_cosine(wi) * radiance / pdf);
            estimate.add(at, visibility, wi, contribution);
        }
        estimate
    }
}

impl<S: CoversIntegrand> DirectEstimator for SingleSample<S> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let u = random.uniform2();
        let drawn = timed(Stage::Sampling, || self.0.sample(&self.0.prepare(at), at, u));
        Self::evaluate(at, visibility, drawn)
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
        at.iter().zip(samples).map(|(at, sample)| Self::evaluate(at, visibility, sample)).collect()
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

impl<A: DirectionSampler, B: CoversIntegrand> DirectEstimator for TwoSampleMis<A, B> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let mut estimate = Estimate::default();
        let (first, second) = timed(Stage::Sampling, || (self.first.prepare(at), self.second.prepare(at)));
        let mut add = |sample: Option<DirectionSample>, other_pdf: &dyn Fn(Vec3A) -> f32| {
            let Some(DirectionSample { wi, pdf, radiance }) = sample else { return };
            // p^2 / (p^2 + q^2), written so that a large p does not overflow.
            let ratio = timed(Stage::Pdf, || other_pdf(wi)) / pdf;
            let weight = 1.0 / (pdf * (1.0 + ratio * ratio));
            estimate.add(at, visibility, wi, timed(Stage::Shading, || at.brdf_cosine(wi) * radiance * weight));
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
        let at: Vec<&ShadingPoint> = at.iter().collect();
        let (first, second): (Vec<_>, Vec<_>) = (first.iter().collect(), second.iter().collect());
        let mut samples = vec![None; at.len()];
        let mut others = vec![0.0; at.len()];
        let mut estimates = vec![Estimate::default(); at.len()];
        let mut add = |samples: &[Option<DirectionSample>], others: &[f32]| {
            for ((at, estimate), (sample, other)) in at.iter().zip(&mut estimates).zip(samples.iter().zip(others)) {
                let Some(DirectionSample { wi, pdf, radiance }) = *sample else { continue };
                let ratio = other / pdf;
                let contribution =
                    timed(Stage::Shading, || at.brdf_cosine(wi) * radiance / (pdf * (1.0 + ratio * ratio)));
                estimate.add(at, visibility, wi, contribution);
            }
        };
        let u = random.uniform2();
        timed(Stage::Sampling, || self.first.sample_prepared(&first, &at, &u, &mut samples));
        timed(Stage::Pdf, || self.second.pdf_prepared(&second, &at, &directions(&samples), &mut others));
        add(&samples, &others);
        let u = random.uniform2();
        timed(Stage::Sampling, || self.second.sample_prepared(&second, &at, &u, &mut samples));
        timed(Stage::Pdf, || self.first.pdf_prepared(&first, &at, &directions(&samples), &mut others));
        add(&samples, &others);
        estimates
    }
}

/// The samples' directions; where there is no sample, any direction.
fn directions(samples: &[Option<DirectionSample>]) -> Vec<Vec3A> {
    samples.iter().map(|sample| sample.map_or(Vec3A::Z, |sample| sample.wi)).collect()
}

/// One direction from a resampled sampler: `f cos L V W`.
#[derive(Clone, Debug)]
pub struct ResampledEstimator<S>(S);

impl<S: ResampledSampler> ResampledEstimator<S> {
    /// An estimator of a resampled sampler.
    pub fn new(sampler: S) -> Self {
        Self(sampler)
    }

    fn evaluate(at: &ShadingPoint, visibility: &dyn Visibility, drawn: Option<ResampledDirection>) -> Estimate {
        let mut estimate = Estimate::default();
        if let Some(drawn) = drawn {
            let contribution =
                timed(Stage::Shading, || at.brdf_cosine(drawn.wi) * drawn.radiance * drawn.contribution_weight);
            estimate.add(at, visibility, drawn.wi, contribution);
        }
        estimate
    }
}

impl<S: ResampledSampler> DirectEstimator for ResampledEstimator<S> {
    fn estimate(&self, at: &ShadingPoint, visibility: &dyn Visibility, random: &mut Stream) -> Estimate {
        let drawn = timed(Stage::Sampling, || self.0.sample(at, random));
        Self::evaluate(at, visibility, drawn)
    }

    fn estimate_batch(
        &self,
        at: &[ShadingPoint],
        visibility: &dyn Visibility,
        random: &mut Streams<'_>,
    ) -> Vec<Estimate> {
        let drawn = timed(Stage::Sampling, || self.0.sample_batch(at, random));
        at.iter().zip(drawn).map(|(at, drawn)| Self::evaluate(at, visibility, drawn)).collect()
    }
}
