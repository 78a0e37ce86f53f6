//! Statistics of a sampler over many shading points: divergences from the product, weights, bias, time.

use serde::{Deserialize, Serialize};
use std::{sync::Arc, time::Instant};

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use crate::quadrature::{Quadrature, QuadratureShape, Term};
use headtail_render::{
    color::luminance,
    columns::Arena,
    environment::Environment,
    points::{Dimension, PointSet, Points},
    random::{Purpose, Stream},
    sampler::{AtPoint, Direction, Draws, EnvironmentLight, Sampler, prepared},
    tile::{ShadingPoint, Tile},
};

/// The target counts as uncovered where the pdf is below this fraction of its density.
const UNCOVERED: f64 = 1e-3;
/// Strata along a side of the square of random numbers, for the fraction of draws without a direction.
const LOST_STRATA: usize = 48;
/// Independent quadratures per integral: their spread gives the error of the mean.
const REPLICATES: u64 = 4;
/// Shading points that are timed together, like a renderer's tile.
const TIMED: usize = 256;

/// Amount of computation.
#[derive(Clone, Copy, Debug)]
pub struct DirectionEffort {
    /// Shading points.
    pub conditions: u64,
    /// Strata along a side of Y, which is also the number of rows of strata of X; and along a side of BRDF
    /// samples.
    pub strata: (usize, usize),
    /// Draws per shading point.
    pub draws: usize,
}

/// Means over the shading points that see light, for one sampler.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DirectionStatistics {
    /// KL(target || sampler) in nats.
    pub kl: f64,
    /// Chi-square divergence: the relative variance of one sample.
    pub chi_square: f64,
    /// `|1 - integral of the pdf|`, of the mean over shading points; draws without a direction count as
    /// probability.
    pub integral_error: f64,
    /// Largest weight f / p among draws, relative to the mean weight.
    pub largest_weight: f64,
    /// 99.99th percentile of the weights, likewise.
    pub weight_9999: f64,
    /// Effective fraction of the draws, `(sum w)^2 / (n sum w^2)`.
    pub effective: f64,
    /// Fraction of the target where the pdf is below 0.1 % of its density.
    pub uncovered: f64,
    /// Mean of the draws over the integral, minus 1, and half its 95 % interval from the noise of draws and
    /// integral.
    pub bias: (f64, f64),
    /// Relative variance at each shading point.
    pub variances: Vec<f64>,
    /// Nanoseconds per sample on one thread, including the work per shading point, in tiles of 256 different
    /// points.
    pub nanoseconds: f64,
}

/// Shading points with their quadrature, for measuring several samplers.
pub struct DirectionBench {
    points: Vec<Point>,
    environment: Arc<Environment>,
    effort: DirectionEffort,
    /// Seed of the draws.
    seed: u64,
}

/// One shading point.
struct Point {
    at: ShadingPoint,
    terms: Vec<Term>,
    /// Integral of the target, the mean of all replicates.
    total: f64,
    /// Relative variance of `total`.
    error: f64,
}

/// Statistics of one shading point.
struct One {
    kl: f64,
    chi_square: f64,
    integral: f64,
    uncovered: f64,
    weights: Vec<f64>,
}

impl DirectionBench {
    /// Prepares the shading points `point(0..effort.conditions)` that see light. `light` has an exact tail of
    /// the whole map. The seed depends on `name`, so that the errors of different benches are independent.
    pub fn new(
        name: &str,
        light: &EnvironmentLight,
        effort: DirectionEffort,
        point: impl Fn(u64) -> ShadingPoint + Sync,
    ) -> Self {
        let shape = |seed| QuadratureShape {
            strata: effort.strata.0,
            map_rows: effort.strata.0,
            brdf_strata: effort.strata.1,
            seed: Some(seed),
        };
        let quadratures: Vec<Quadrature> = (0..REPLICATES).map(|seed| Quadrature::new(light, shape(seed))).collect();
        let point = |index| {
            let at = point(index);
            let terms: Vec<Vec<Term>> = quadratures.iter().map(|quadrature| quadrature.terms(&at, index)).collect();
            let total = |terms: &Vec<Term>| terms.iter().map(|term| term.weight * term.f).sum::<f64>();
            let totals: Vec<f64> = terms.iter().map(total).collect();
            let count = REPLICATES as f64;
            let mean = totals.iter().sum::<f64>() / count;
            let spread = totals.iter().map(|total| (total / mean - 1.0).powi(2)).sum::<f64>() / (count - 1.0) / count;
            let terms = terms.into_iter().next()?;
            (mean > 0.0 && totals[0] > 0.0).then_some(Point { at, terms, total: mean, error: spread })
        };
        // FNV-1a.
        let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        let seed = name.bytes().fold(0xcbf2_9ce4_8422_2325, mix);
        let points = (0..effort.conditions).into_par_iter().filter_map(point).collect();
        Self { points, environment: light.environment().clone(), effort, seed }
    }

    /// Returns the number of shading points that see light.
    pub fn lit(&self) -> usize {
        self.points.len()
    }

    /// Measures a sampler.
    pub fn measure(&self, sampler: &dyn Sampler) -> DirectionStatistics {
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
        let of_draws = ones.iter().map(variance).sum::<f64>();
        let of_integrals = self.points.iter().map(|point| point.error).sum::<f64>();
        DirectionStatistics {
            kl: mean(&|one| one.kl),
            chi_square: mean(&|one| one.chi_square),
            integral_error: (mean(&|one| one.integral) - 1.0).abs(),
            largest_weight: weights.last().copied().unwrap_or(f64::NAN),
            weight_9999: weights.get(weights.len() * 9999 / 10_000).copied().unwrap_or(f64::NAN),
            effective: mean(&effective),
            uncovered: mean(&|one| one.uncovered),
            bias: (mean(&of_one), 1.96 * (of_draws + of_integrals).sqrt() / count),
            variances: ones.iter().map(|one| one.chi_square).collect(),
            nanoseconds: self.time(sampler),
        }
    }

    fn one(&self, sampler: &dyn Sampler, Point { at, terms, total, .. }: &Point, index: u64) -> One {
        let bound = AtPoint::new(sampler, at);
        let (mut kl, mut second, mut integral, mut uncovered) = (0.0, 0.0, 0.0, 0.0);
        // Normalised by the integral of the same quadrature, so that the target is a density.
        let own: f64 = terms.iter().map(|term| term.weight * term.f).sum();
        let wi: Vec<Vec3A> = terms.iter().map(|term| term.wi).collect();
        for (&Term { f, weight, .. }, pdf) in terms.iter().zip(bound.pdf_many(&wi)) {
            let pdf = f64::from(pdf);
            integral += weight * pdf;
            if f > 0.0 {
                let fraction = weight * f / own;
                kl += fraction * (f / own / pdf).ln();
                second += fraction * (f / own / pdf);
                uncovered += if pdf < UNCOVERED * f / own { fraction } else { 0.0 };
            }
        }
        // Draws without a direction have probability: lobes reach below the horizon.
        let stratum =
            |k: usize| Vec2::new((k % LOST_STRATA) as f32 + 0.5, (k / LOST_STRATA) as f32 + 0.5) / LOST_STRATA as f32;
        let strata: Vec<Vec2> = (0..LOST_STRATA * LOST_STRATA).map(stratum).collect();
        let lost = bound.sample_many(&strata).iter().filter(|drawn| drawn.is_none()).count();
        integral += lost as f64 / strata.len() as f64;
        let mut random = Stream::new(self.seed, Purpose::Test, index);
        let u: Vec<Vec2> = (0..self.effort.draws).map(|_| random.uniform2()).collect();
        let drawn = bound.sample_many(&u);
        One { kl, chi_square: second - 1.0, integral, uncovered, weights: self.weights(&bound, &drawn, *total) }
    }

    /// Returns light x BRDF x cosine / pdf of draws, relative to the integral; 0 for draws without a
    /// direction.
    fn weights(&self, bound: &AtPoint<'_>, drawn: &[Option<Direction>], total: f64) -> Vec<f64> {
        let wi: Vec<Vec3A> = drawn.iter().map(|drawn| drawn.map_or(Vec3A::Z, |drawn| drawn.wi)).collect();
        let values = bound.point().brdf_cosines(&wi).into_iter().zip(&wi).zip(drawn);
        let weight = |((f, &wi), drawn): ((Vec3A, &Vec3A), &Option<Direction>)| {
            drawn.map_or(0.0, |drawn| f64::from(luminance(f * self.environment.radiance(wi) / drawn.pdf)) / total)
        };
        values.map(weight).collect()
    }

    fn time(&self, sampler: &dyn Sampler) -> f64 {
        const REPEATS: u32 = 16;
        let points: Vec<ShadingPoint> = (0..TIMED).map(|k| self.points[k % self.points.len()].at).collect();
        let (tile, arena) = (Tile::of(&points), Arena::default());
        let rows = tile.rows();
        let once = |repeat: u32| {
            let mut columns = arena.columns::<6>(rows.strips());
            let [u, v, x, y, z, pdf] = columns.get_mut();
            Points::new(PointSet::Independent, 19).at_sample(repeat).draw(
                Dimension::Light(0),
                &rows,
                [&mut *u, &mut *v],
            );
            prepared(sampler, &rows, &arena, |state| {
                sampler.sample(&rows, state, [u, v], Draws { wi: [x, y, z], pdf }, &arena);
            });
            std::hint::black_box(columns.get());
        };
        once(0);
        let start = Instant::now();
        (1..=REPEATS).for_each(once);
        start.elapsed().as_nanos() as f64 / f64::from(REPEATS) / TIMED as f64
    }
}

/// Returns the ratio of mean relative variances of a sampler and a baseline at the same shading points, with
/// its 95 % interval over the choice of shading points (jackknife of the logarithm): `(ratio, low, high)`.
/// The points of the integrals are the same for both.
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
