//! One-sample multiple importance sampling with the balance heuristic (Veach 1997, section 9.2.4): a mixture of two samplers.

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, ShadingPoint};

/// Draws from `first` with probability 1/2, else from `second`; its pdf is that of the mixture, so it is a sampler like any
/// other. One shadow ray per sample.
///
/// It covers the integrand when `second` does, whatever `first` leaves out.
#[derive(Clone, Debug)]
pub struct OneSampleMis<A, B> {
    first: A,
    second: B,
}

impl<A, B> OneSampleMis<A, B> {
    /// The mixture of two samplers in equal parts.
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
        // Doubling and subtracting are exact: the stretched coordinate loses no randomness but the bit that chose.
        let mut sample = if u.x < 0.5 {
            let mut sample = self.first.sample(first, at, Vec2::new(2.0 * u.x, u.y))?;
            sample.pdf += self.second.pdf(second, at, sample.wi);
            sample
        } else {
            let mut sample = self.second.sample(second, at, Vec2::new(2.0 * u.x - 1.0, u.y))?;
            sample.pdf += self.first.pdf(first, at, sample.wi);
            sample
        };
        sample.pdf *= 0.5;
        Some(sample)
    }

    fn pdf(&self, prepared: &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32 {
        0.5 * (self.first.pdf(&prepared.0, at, wi) + self.second.pdf(&prepared.1, at, wi))
    }
}

impl<A: DirectionSampler, B: CoversIntegrand> CoversIntegrand for OneSampleMis<A, B> {}
