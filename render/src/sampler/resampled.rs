//! Resampled importance sampling: a few candidates, one of which survives in proportion to the unshadowed integrand.

use glam::Vec3A;

use super::{CoversIntegrand, DirectionSample, ShadingPoint};
use crate::{
    color::luminance,
    random::{Stream, Streams},
};

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

    /// [`Self::sample`] for many shading points, each with its stream.
    fn sample_batch(&self, at: &[ShadingPoint], random: &mut Streams<'_>) -> Vec<Option<ResampledDirection>> {
        at.iter().enumerate().map(|(k, at)| self.sample(at, random.of(k))).collect()
    }
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

/// What is kept of the candidates so far.
#[derive(Clone, Copy, Default)]
struct Reservoir {
    total: f32,
    /// The survivor and its target.
    chosen: Option<(DirectionSample, f32)>,
}

impl Reservoir {
    /// Shows it a candidate whose balance-heuristic weight is its target over `density`, the sum of all techniques'
    /// draws times pdfs.
    fn add(&mut self, drawn: DirectionSample, target: f32, density: f32, survives: f32) {
        let weight = target / density;
        self.total += weight;
        if survives * self.total < weight {
            self.chosen = Some((drawn, target));
        }
    }

    fn direction(self) -> Option<ResampledDirection> {
        self.chosen.map(|(drawn, target)| ResampledDirection {
            wi: drawn.wi,
            radiance: drawn.radiance,
            contribution_weight: self.total / target,
        })
    }
}

impl<A: CoversIntegrand, B: CoversIntegrand> ResampledSampler for Resampled<A, B> {
    fn sample(&self, at: &ShadingPoint, random: &mut Stream) -> Option<ResampledDirection> {
        let (first, second) = (self.first.prepare(at), self.second.prepare(at));
        let mut reservoir = Reservoir::default();
        for index in 0..self.candidates {
            let u = random.uniform2();
            let drawn =
                if index % 2 == 0 { self.first.sample(&first, at, u) } else { self.second.sample(&second, at, u) };
            let survives = random.uniform();
            let Some(drawn) = drawn else { continue };
            let target = target(at, &drawn);
            if target > 0.0 {
                let density = if index % 2 == 0 {
                    self.density(drawn.pdf, self.second.pdf(&second, at, drawn.wi))
                } else {
                    self.density(self.first.pdf(&first, at, drawn.wi), drawn.pdf)
                };
                reservoir.add(drawn, target, density, survives);
            }
        }
        reservoir.direction()
    }

    fn sample_batch(&self, at: &[ShadingPoint], random: &mut Streams<'_>) -> Vec<Option<ResampledDirection>> {
        let (first, second) = (self.first.prepare_batch(at), self.second.prepare_batch(at));
        let at: Vec<&ShadingPoint> = at.iter().collect();
        let (first, second): (Vec<_>, Vec<_>) = (first.iter().collect(), second.iter().collect());
        let mut reservoirs = vec![Reservoir::default(); at.len()];
        let (mut samples, mut others) = (vec![None; at.len()], vec![0.0; at.len()]);
        for index in 0..self.candidates {
            let (mut u, mut survives) = (Vec::with_capacity(at.len()), Vec::with_capacity(at.len()));
            for k in 0..at.len() {
                u.push(random.of(k).uniform2());
                survives.push(random.of(k).uniform());
            }
            let of_first = index % 2 == 0;
            if of_first {
                self.first.sample_prepared(&first, &at, &u, &mut samples);
            } else {
                self.second.sample_prepared(&second, &at, &u, &mut samples);
            }
            // The other technique's pdf of a direction that does not count is not used.
            let wi: Vec<Vec3A> = samples.iter().map(|sample| sample.map_or(Vec3A::Z, |sample| sample.wi)).collect();
            if of_first {
                self.second.pdf_prepared(&second, &at, &wi, &mut others);
            } else {
                self.first.pdf_prepared(&first, &at, &wi, &mut others);
            }
            for (k, sample) in samples.iter().enumerate() {
                let Some(drawn) = *sample else { continue };
                let target = target(at[k], &drawn);
                if target > 0.0 {
                    let (a, b) = if of_first { (drawn.pdf, others[k]) } else { (others[k], drawn.pdf) };
                    reservoirs[k].add(drawn, target, self.density(a, b), survives[k]);
                }
            }
        }
        reservoirs.into_iter().map(Reservoir::direction).collect()
    }
}

impl<A, B> Resampled<A, B> {
    /// The sum of both techniques' draws times their pdfs: the denominator of the balance heuristic.
    fn density(&self, first: f32, second: f32) -> f32 {
        let of_second = self.candidates / 2;
        (self.candidates - of_second) as f32 * first + of_second as f32 * second
    }
}

/// What candidates are weighed by: the luminance of light x BRDF x cosine.
fn target(at: &ShadingPoint, drawn: &DirectionSample) -> f32 {
    luminance(at.brdf_cosine(drawn.wi) * drawn.radiance)
}
