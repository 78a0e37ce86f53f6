//! What one sampler does in one regime, in figures.

use std::time::Instant;

use glam::{Vec2, Vec3A};
use headtail_render::{
    color::luminance,
    random::{Purpose, Stream},
    sampler::{DirectionSampler, EnvironmentLight, ShadingPoint},
    statistics::{Quadrature, QuadratureShape, Term},
};
use rayon::prelude::*;

use super::regime::Regime;

/// Where the pdf is below this share of the target's density, the target counts as uncovered.
const UNCOVERED: f64 = 1e-3;
/// Strata along a side of the square of random numbers, for the share of draws that give no direction.
const LOST_STRATA: usize = 48;

/// How much is computed.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Shading points.
    pub conditions: u64,
    /// Strata along a side of Y, and of BRDF samples.
    pub strata: (usize, usize),
    /// Draws for each shading point.
    pub draws: usize,
}

/// Means over shading points that see light, for one sampler.
#[derive(Clone, Debug)]
pub struct Figures {
    /// KL(target || sampler) in nats.
    pub kl: f64,
    /// Chi-square divergence: the relative variance of one sample.
    pub chi_square: f64,
    /// `|1 - integral of the pdf|`, of the mean over shading points; draws that give no direction count as probability.
    pub integral_error: f64,
    /// Largest and 99.99th percentile of the weight f / p over its mean, among draws.
    pub largest_weight: f64,
    /// The percentile.
    pub weight_9999: f64,
    /// Effective share of the draws, `(sum w)^2 / (n sum w^2)`.
    pub effective: f64,
    /// Share of the target where the pdf is below a thousandth of it.
    pub uncovered: f64,
    /// Mean of the draws over the integral, minus 1, and half its 95 % interval.
    pub bias: (f64, f64),
    /// Relative variance at each shading point.
    pub variances: Vec<f64>,
    /// Nanoseconds per sample on one thread, with what depends on the shading point.
    pub nanoseconds: f64,
}

/// Shading points of a regime with their quadrature, shared by its samplers.
pub struct Bench {
    points: Vec<(ShadingPoint, Vec<Term>, f64)>,
    effort: Effort,
    /// Of the draws: regimes must not share their luck, or the table would show one error many times.
    seed: u64,
}

/// Figures of one shading point.
struct One {
    kl: f64,
    chi_square: f64,
    integral: f64,
    uncovered: f64,
    weights: Vec<f64>,
}

impl Bench {
    /// Shading points that see light. `light` has an exact tail of the whole map.
    pub fn new(regime: &Regime, light: &EnvironmentLight, effort: Effort) -> Self {
        let shape = QuadratureShape { strata: effort.strata.0, brdf_strata: effort.strata.1, seed: Some(0) };
        let quadrature = Quadrature::new(light, shape);
        let point = |index| {
            let at = regime.shading_point(index);
            let terms = quadrature.terms(&at, index);
            let total: f64 = terms.iter().map(|term| term.weight * term.f).sum();
            (total > 0.0).then_some((at, terms, total))
        };
        // FNV-1a.
        let seed = regime
            .name
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
        Self { points: (0..effort.conditions).into_par_iter().filter_map(point).collect(), effort, seed }
    }

    /// How many shading points see light.
    pub fn lit(&self) -> usize {
        self.points.len()
    }

    /// The shading point that reflects the most light.
    pub fn brightest(&self) -> ShadingPoint {
        let brightest = self.points.iter().max_by(|a, b| a.2.total_cmp(&b.2));
        brightest.expect("there are shading points that see light").0
    }

    /// Measures a sampler.
    pub fn measure<S: DirectionSampler>(&self, sampler: &S) -> Figures {
        let ones: Vec<One> =
            self.points.par_iter().enumerate().map(|(index, point)| self.one(sampler, point, index as u64)).collect();
        let count = ones.len() as f64;
        let mean = |figure: &dyn Fn(&One) -> f64| ones.iter().map(figure).sum::<f64>() / count;
        let mut weights: Vec<f64> = ones.iter().flat_map(|one| &one.weights).copied().collect();
        weights.sort_by(f64::total_cmp);
        let draws = self.effort.draws as f64;
        let of_one = |one: &One| one.weights.iter().sum::<f64>() / draws - 1.0;
        let variance = |one: &One| {
            let mean = one.weights.iter().sum::<f64>() / draws;
            (one.weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / draws / draws).max(0.0)
        };
        let effective = |one: &One| {
            let (sum, squares) = one.weights.iter().fold((0.0, 0.0), |(a, b), w| (a + w, b + w * w));
            if squares > 0.0 { sum * sum / (draws * squares) } else { 0.0 }
        };
        Figures {
            kl: mean(&|one| one.kl),
            chi_square: mean(&|one| one.chi_square),
            integral_error: (mean(&|one| one.integral) - 1.0).abs(),
            largest_weight: weights.last().copied().unwrap_or(f64::NAN),
            weight_9999: weights.get(weights.len() * 9999 / 10_000).copied().unwrap_or(f64::NAN),
            effective: mean(&effective),
            uncovered: mean(&|one| one.uncovered),
            bias: (mean(&of_one), 1.96 * (ones.iter().map(variance).sum::<f64>()).sqrt() / count),
            variances: ones.iter().map(|one| one.chi_square).collect(),
            nanoseconds: self.time(sampler),
        }
    }

    fn one<S: DirectionSampler>(
        &self,
        sampler: &S,
        (at, terms, total): &(ShadingPoint, Vec<Term>, f64),
        index: u64,
    ) -> One {
        let prepared = sampler.prepare(at);
        let (mut kl, mut second, mut integral, mut uncovered) = (0.0, 0.0, 0.0, 0.0);
        for &Term { wi, f, weight } in terms {
            let pdf = f64::from(sampler.pdf(&prepared, at, wi));
            integral += weight * pdf;
            if f > 0.0 {
                let share = weight * f / total;
                kl += share * (f / total / pdf).ln();
                second += share * (f / total / pdf);
                uncovered += if pdf < UNCOVERED * f / total { share } else { 0.0 };
            }
        }
        // A draw that gives no direction has its share of the probability: lobes reach below the horizon.
        let stratum =
            |k: usize| Vec2::new((k % LOST_STRATA) as f32 + 0.5, (k / LOST_STRATA) as f32 + 0.5) / LOST_STRATA as f32;
        let lost =
            (0..LOST_STRATA * LOST_STRATA).filter(|&k| sampler.sample(&prepared, at, stratum(k)).is_none()).count();
        integral += lost as f64 / (LOST_STRATA * LOST_STRATA) as f64;
        let mut random = Stream::new(self.seed, Purpose::Test, index);
        let draw = |_| {
            let sample = sampler.sample(&prepared, at, random.uniform2());
            sample.map_or(0.0, |s| f64::from(luminance(at.brdf_cosine(s.wi) * s.radiance / s.pdf)) / total)
        };
        One { kl, chi_square: second - 1.0, integral, uncovered, weights: (0..self.effort.draws).map(draw).collect() }
    }

    fn time<S: DirectionSampler>(&self, sampler: &S) -> f64 {
        const SAMPLES: usize = 4000;
        let mut random = Stream::new(19, Purpose::Test, 0);
        let mut sum = Vec3A::ZERO;
        let start = Instant::now();
        for k in 0..SAMPLES {
            let at = &self.points[k % self.points.len()].0;
            if let Some(sample) = sampler.sample(&sampler.prepare(at), at, random.uniform2()) {
                sum += sample.wi;
            }
        }
        std::hint::black_box(sum);
        start.elapsed().as_nanos() as f64 / SAMPLES as f64
    }
}

/// The ratio of mean relative variances of a sampler and a baseline at the same shading points, and its 95 % interval over the choice of
/// shading points (jackknife of its logarithm): `(ratio, low, high)`. The points of the integrals are the same for both.
pub fn variance_ratio(sampler: &[f64], baseline: &[f64]) -> (f64, f64, f64) {
    let sums = |skip: usize| {
        let sum = |values: &[f64]| values.iter().enumerate().filter(|(k, _)| *k != skip).map(|(_, v)| v).sum::<f64>();
        sum(sampler) / sum(baseline)
    };
    let ratio = sums(usize::MAX);
    let n = sampler.len() as f64;
    let leave_out: Vec<f64> = (0..sampler.len()).map(sums).collect();
    let logs: Vec<f64> = leave_out.iter().map(|r| r.ln()).collect();
    let mean = logs.iter().sum::<f64>() / n;
    let error = ((n - 1.0) / n * logs.iter().map(|r| (r - mean).powi(2)).sum::<f64>()).sqrt();
    (ratio, ratio * (-1.96 * error).exp(), ratio * (1.96 * error).exp())
}

#[cfg(test)]
mod tests {
    use super::variance_ratio;

    #[test]
    fn ratio_of_equal_variances_is_one() {
        let (ratio, low, high) = variance_ratio(&[1.0, 2.0, 5.0], &[1.0, 2.0, 5.0]);
        assert!((ratio - 1.0).abs() < 1e-12 && (low - 1.0).abs() < 1e-9 && (high - 1.0).abs() < 1e-9);
    }

    #[test]
    fn interval_of_a_ratio_is_that_of_the_linear_approximation() {
        let sampler: Vec<f64> = (0..200).map(|k| 0.5 + f64::from(k * 37 % 101) / 101.0).collect();
        let (ratio, low, high) = variance_ratio(&sampler, &[2.0; 200]);
        let mean = sampler.iter().sum::<f64>() / 200.0;
        let deviation = (sampler.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 199.0).sqrt();
        assert!((ratio - mean / 2.0).abs() < 1e-12);
        let expected = 2.0 * 1.96 * deviation / 2.0 / 200.0_f64.sqrt();
        assert!(((high - low) / expected - 1.0).abs() < 0.01);
    }
}
