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
        let stretched = stretched(u, share);
        if u.x < share {
            let mut sample = self.first.sample(first, at, stretched)?;
            sample.pdf = share * sample.pdf + (1.0 - share) * self.second.pdf(second, at, sample.wi);
            Some(sample)
        } else {
            let mut sample = self.second.sample(second, at, stretched)?;
            sample.pdf = share * self.first.pdf(first, at, sample.wi) + (1.0 - share) * sample.pdf;
            Some(sample)
        }
    }

    fn sample_batch(&self, at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        // Where there is nothing to prepare, references to the points will do.
        if size_of::<Self::Prepared>() == 0 {
            let prepared = self.prepare_batch(at);
            let (prepared, at): (Vec<_>, Vec<_>) = prepared.iter().zip(at).unzip();
            self.sample_prepared(&prepared, &at, u, out);
            return;
        }
        let mut shares = vec![0.0; at.len()];
        self.first.share_batch(at, &mut shares);
        // Each point is prepared in the part of the batch in which it is needed, so that nothing is kept or moved in between.
        let (of_first, of_second): (Vec<usize>, Vec<usize>) = (0..at.len()).partition(|&k| u[k].x < shares[k]);
        for (which, is_first) in [(of_first, true), (of_second, false)] {
            let points: Vec<ShadingPoint> = which.iter().map(|&k| at[k]).collect();
            let u: Vec<Vec2> = which.iter().map(|&k| stretched(u[k], shares[k])).collect();
            let mut samples = vec![None; which.len()];
            let mut others = vec![0.0; which.len()];
            if is_first {
                self.first.sample_batch(&points, &u, &mut samples);
                self.second.pdf_batch(&points, &directions(&samples), &mut others);
            } else {
                self.second.sample_batch(&points, &u, &mut samples);
                self.first.pdf_batch(&points, &directions(&samples), &mut others);
            }
            for ((k, sample), other) in which.into_iter().zip(samples).zip(others) {
                out[k] = sample.map(|sample| {
                    let (first, second) = if is_first { (sample.pdf, other) } else { (other, sample.pdf) };
                    DirectionSample { pdf: shares[k] * first + (1.0 - shares[k]) * second, ..sample }
                });
            }
        }
    }

    fn pdf_batch(&self, at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        let (mut shares, mut of_second) = (vec![0.0; at.len()], vec![0.0; at.len()]);
        self.first.share_batch(at, &mut shares);
        self.first.pdf_batch(at, wi, out);
        self.second.pdf_batch(at, wi, &mut of_second);
        for ((out, second), share) in out.iter_mut().zip(of_second).zip(shares) {
            *out = share * *out + (1.0 - share) * second;
        }
    }

    fn prepare_batch(&self, at: &[ShadingPoint]) -> Vec<Self::Prepared> {
        self.first.prepare_batch(at).into_iter().zip(self.second.prepare_batch(at)).collect()
    }

    fn sample_prepared(
        &self,
        prepared: &[&Self::Prepared],
        at: &[&ShadingPoint],
        u: &[Vec2],
        out: &mut [Option<DirectionSample>],
    ) {
        let shares: Vec<f32> = prepared.iter().map(|(first, _)| self.first.share_beside_brdf(first)).collect();
        let (of_first, of_second): (Vec<usize>, Vec<usize>) = (0..u.len()).partition(|&k| u[k].x < shares[k]);
        let stretch = |k: usize| stretched(u[k], shares[k]);
        let (firsts, seconds): (Vec<_>, Vec<_>) = prepared.iter().map(|(first, second)| (first, second)).unzip();
        let mixed = |k: usize, first: f32, second: f32| shares[k] * first + (1.0 - shares[k]) * second;
        draw(&self.first, &firsts, at, &of_first, &stretch, out);
        let pdfs = pdfs_of(&self.second, &seconds, at, &of_first, out);
        for (&k, second) in of_first.iter().zip(pdfs) {
            if let Some(sample) = &mut out[k] {
                sample.pdf = mixed(k, sample.pdf, second);
            }
        }
        draw(&self.second, &seconds, at, &of_second, &stretch, out);
        let pdfs = pdfs_of(&self.first, &firsts, at, &of_second, out);
        for (&k, first) in of_second.iter().zip(pdfs) {
            if let Some(sample) = &mut out[k] {
                sample.pdf = mixed(k, first, sample.pdf);
            }
        }
    }

    fn pdf_prepared(&self, prepared: &[&Self::Prepared], at: &[&ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        let (firsts, seconds): (Vec<_>, Vec<_>) = prepared.iter().map(|(first, second)| (first, second)).unzip();
        let mut of_second = vec![0.0; out.len()];
        self.first.pdf_prepared(&firsts, at, wi, out);
        self.second.pdf_prepared(&seconds, at, wi, &mut of_second);
        for ((out, second), first) in out.iter_mut().zip(of_second).zip(firsts) {
            let share = self.first.share_beside_brdf(first);
            *out = share * *out + (1.0 - share) * second;
        }
    }

    fn pdf(&self, (first, second): &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32 {
        let share = self.first.share_beside_brdf(first);
        share * self.first.pdf(first, at, wi) + (1.0 - share) * self.second.pdf(second, at, wi)
    }
}

/// The point that the chosen half of a mixture draws from. For a share of 1/2 this doubles and subtracts exactly.
fn stretched(u: Vec2, share: f32) -> Vec2 {
    let x = if u.x < share { u.x / share } else { (u.x - share) / (1.0 - share) };
    Vec2::new(x.min(BELOW_ONE), u.y)
}

/// The directions of samples; where there is no sample, any direction.
pub(crate) fn directions(samples: &[Option<DirectionSample>]) -> Vec<Vec3A> {
    samples.iter().map(|sample| sample.map_or(Vec3A::Z, |sample| sample.wi)).collect()
}

/// Draws for the points of a batch whose indices are in `which`.
fn draw<S: DirectionSampler>(
    sampler: &S,
    prepared: &[&S::Prepared],
    at: &[&ShadingPoint],
    which: &[usize],
    u: &dyn Fn(usize) -> Vec2,
    out: &mut [Option<DirectionSample>],
) {
    let (prepared, at): (Vec<_>, Vec<_>) = which.iter().map(|&k| (prepared[k], at[k])).unzip();
    let u: Vec<Vec2> = which.iter().map(|&k| u(k)).collect();
    let mut samples = vec![None; which.len()];
    sampler.sample_prepared(&prepared, &at, &u, &mut samples);
    for (&k, sample) in which.iter().zip(samples) {
        out[k] = sample;
    }
}

/// The pdfs with which a sampler draws the directions of the samples of `which`; where there is no sample, any number.
fn pdfs_of<S: DirectionSampler>(
    sampler: &S,
    prepared: &[&S::Prepared],
    at: &[&ShadingPoint],
    which: &[usize],
    samples: &[Option<DirectionSample>],
) -> Vec<f32> {
    let (prepared, at): (Vec<_>, Vec<_>) = which.iter().map(|&k| (prepared[k], at[k])).unzip();
    let wi: Vec<Vec3A> = which.iter().map(|&k| samples[k].map_or(Vec3A::Z, |sample| sample.wi)).collect();
    let mut pdfs = vec![0.0; which.len()];
    sampler.pdf_prepared(&prepared, &at, &wi, &mut pdfs);
    pdfs
}

impl<A: DirectionSampler, B: CoversIntegrand> CoversIntegrand for OneSampleMis<A, B> {}
