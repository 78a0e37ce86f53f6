//! Resampled importance sampling: a few candidates, one of which survives in proportion to the unshadowed integrand.

use glam::Vec3A;

use super::{CoversIntegrand, ShadingPoint};
use crate::{color::luminance, random::Stream};

/// A direction drawn by resampling: no closed pdf, but an unbiased estimate of its reciprocal.
#[derive(Clone, Copy, Debug)]
pub struct ResampledDirection {
    /// Unit direction.
    pub wi: Vec3A,
    /// The environment's radiance from `wi`.
    pub radiance: Vec3A,
    /// Unbiased contribution weight: multiplies the integrand where `1 / pdf` would stand.
    pub contribution_weight: f32,
}

/// Samplers without a closed pdf. They cannot take part in MIS, and the type says so.
pub trait ResampledSampler: Send + Sync {
    /// Draws a direction; all randomness comes from `random`. `None`: the estimate is zero.
    fn sample(&self, at: &ShadingPoint, random: &mut Stream) -> Option<ResampledDirection>;
}

/// Streaming RIS (Talbot et al. 2005, with a weighted reservoir) over `candidates` draws, alternately of two techniques, with
/// balance-heuristic weights between them. The target is the luminance of light x BRDF x cosine without visibility.
#[derive(Clone, Debug)]
pub struct Resampled<A, B> {
    first: A,
    second: B,
    candidates: u32,
}

impl<A: CoversIntegrand, B: CoversIntegrand> Resampled<A, B> {
    /// RIS with `candidates` draws in all, the first technique having the odd one.
    ///
    /// # Errors
    /// There must be 1 to 4096 candidates.
    pub fn new(first: A, second: B, candidates: u32) -> crate::Result<Self> {
        if !(1..=4096).contains(&candidates) {
            return Err(crate::Error::argument("ris", format!("{candidates} candidates: choose 1 to 4096")));
        }
        Ok(Self { first, second, candidates })
    }
}

impl<A: CoversIntegrand, B: CoversIntegrand> ResampledSampler for Resampled<A, B> {
    fn sample(&self, at: &ShadingPoint, random: &mut Stream) -> Option<ResampledDirection> {
        let (first, second) = (self.first.prepare(at), self.second.prepare(at));
        let of_second = self.candidates / 2;
        let of_first = self.candidates - of_second;
        let (mut total, mut chosen) = (0.0_f32, None);
        for index in 0..self.candidates {
            let u = random.uniform2();
            let drawn =
                if index % 2 == 0 { self.first.sample(&first, at, u) } else { self.second.sample(&second, at, u) };
            let survives = random.uniform();
            let Some(drawn) = drawn else { continue };
            let target = luminance(at.brdf_cosine(drawn.wi) * drawn.radiance);
            if target <= 0.0 {
                continue;
            }
            let other = if index % 2 == 0 {
                self.second.pdf(&second, at, drawn.wi)
            } else {
                self.first.pdf(&first, at, drawn.wi)
            };
            let (pdf_first, pdf_second) = if index % 2 == 0 { (drawn.pdf, other) } else { (other, drawn.pdf) };
            // Balance heuristic over all draws: m_i target / p_i = target / sum_j n_j p_j.
            let weight = target / (of_first as f32 * pdf_first + of_second as f32 * pdf_second);
            total += weight;
            if survives * total < weight {
                chosen = Some((drawn, target));
            }
        }
        chosen.map(|(drawn, target)| ResampledDirection {
            wi: drawn.wi,
            radiance: drawn.radiance,
            contribution_weight: total / target,
        })
    }
}
