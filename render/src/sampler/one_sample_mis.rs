//! One-sample multiple importance sampling with the balance heuristic (Veach 1997, section 9.2.4): a mixture of two samplers.

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, ShadingPoint};

/// The largest f32 below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Draws from `first` with the probability that it asks for ([`DirectionSampler::share_beside_brdf`], 1/2 unless it was
/// learned), else from `second`; its pdf is that of the mixture, so it is a sampler like any other. One shadow ray per sample.
///
/// It covers the integrand when `second` does, whatever `first` leaves out.
#[derive(Clone, Debug)]
pub struct OneSampleMis<A, B> {
    first: A,
    second: B,
}

impl<A, B> OneSampleMis<A, B> {
    /// The mixture of two samplers.
    pub fn new(first: A, second: B) -> Self {
        Self { first, second }
    }
}

impl<A: DirectionSampler, B: DirectionSampler> DirectionSampler for OneSampleMis<A, B> {
    type Prepared = (A::Prepared, B::Prepared);

    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared {
        (self.first.prepare(at), self.second.prepare(at))
    }

    fn sample(&self, prepared: &Self::Prepared, at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        let (first, second) = prepared;
        let share = self.first.share_beside_brdf(first);
        // For a share of 1/2 this doubles and subtracts exactly.
        if u.x < share {
            let mut sample = self.first.sample(first, at, Vec2::new((u.x / share).min(BELOW_ONE), u.y))?;
            sample.pdf = share * sample.pdf + (1.0 - share) * self.second.pdf(second, at, sample.wi);
            Some(sample)
        } else {
            let stretched = ((u.x - share) / (1.0 - share)).min(BELOW_ONE);
            let mut sample = self.second.sample(second, at, Vec2::new(stretched, u.y))?;
            sample.pdf = share * self.first.pdf(first, at, sample.wi) + (1.0 - share) * sample.pdf;
            Some(sample)
        }
    }

    fn pdf(&self, (first, second): &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32 {
        let share = self.first.share_beside_brdf(first);
        share * self.first.pdf(first, at, wi) + (1.0 - share) * self.second.pdf(second, at, wi)
    }
}

impl<A: DirectionSampler, B: CoversIntegrand> CoversIntegrand for OneSampleMis<A, B> {}
