//! Conditions, points of Y and target densities: the input of a training step or a validation.

use headtail_render::random::{Purpose, Stream};
use rayon::prelude::*;

use super::target::{BatchShape, PlacedPoints, Target};
use crate::Result;

/// The conditions of a batch, and the places of its points' uniform numbers in the batch's [`Stream`].
pub struct BatchConditions {
    /// Length of one condition.
    pub condition_length: usize,
    /// `[conditions, condition_length]`.
    pub conditions: Vec<f32>,
    /// `[conditions]`: [position](Stream::position) of the first of `2 samples` numbers.
    pub positions: Vec<u64>,
    /// See [`Batch::mixture_weight_logits`].
    pub mixture_weight_logits: Vec<f32>,
}

impl BatchConditions {
    /// Draws the conditions of a batch, see [`Batch::draw`].
    pub fn draw(target: &dyn Target, shape: BatchShape, seed: u64, purpose: Purpose, index: u64) -> Self {
        let condition_length = target.condition().length();
        let mut stream = Stream::new(seed, purpose, index);
        let mut conditions = vec![0.0; shape.conditions * condition_length];
        let mut place = |condition: &mut [f32]| {
            target.draw_condition(&mut stream, condition);
            let position = stream.position();
            stream.seek(position + 2 * shape.samples() as u64);
            position
        };
        let positions = conditions.chunks_exact_mut(condition_length).map(&mut place).collect();
        let each = conditions.par_chunks_exact(condition_length);
        let mixture_weight_logits = each.map(|condition| target.mixture_weight_logit(condition)).collect();
        Self { condition_length, conditions, positions, mixture_weight_logits }
    }
}

/// Conditions, points and the target's values there.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Length of one condition.
    pub condition_length: usize,
    /// Points per condition.
    pub samples: usize,
    /// `[conditions, condition_length]`.
    pub conditions: Vec<f32>,
    /// `[conditions, samples, 2]`.
    pub points: Vec<f32>,
    /// `[conditions, samples]`: the target, unnormalised.
    pub densities: Vec<f32>,
    /// `[conditions, samples]`: one over the density of the points; the mean of weight times function
    /// estimates the function's integral over Y. 1 for points that are uniform in Y, 0 for excluded points.
    pub weights: Vec<f32>,
    /// `[conditions, samples]`: the density of BRDF sampling over Y.
    pub brdf: Vec<f32>,
    /// `[conditions, samples]`: the density over X of the tail's image of uniform points.
    pub tails: Vec<f32>,
    /// `[conditions]`: offset of the logits of learned mixture weights.
    pub mixture_weight_logits: Vec<f32>,
}

/// The points of one condition, `[samples]` each; see [`Batch`].
#[derive(Clone, Copy, Debug)]
pub struct ConditionPoints<'a> {
    /// The target, unnormalised.
    pub densities: &'a [f32],
    /// One over the density of the points.
    pub weights: &'a [f32],
    /// The density of BRDF sampling.
    pub brdf: &'a [f32],
    /// The tail's density over X.
    pub tails: &'a [f32],
    /// Offset of the logit of a learned mixture weight.
    pub mixture_weight_logit: f32,
}

impl Batch {
    /// Draws a batch: a function of (target, shape, seed, purpose, index) alone, on any number of threads.
    ///
    /// # Errors
    /// [`Error::BadTarget`](crate::Error::BadTarget) if the target returns a density that is negative or not finite.
    pub fn draw(target: &dyn Target, shape: BatchShape, seed: u64, purpose: Purpose, index: u64) -> Result<Self> {
        let BatchConditions { condition_length, conditions, positions, mixture_weight_logits } =
            BatchConditions::draw(target, shape, seed, purpose, index);
        let samples = shape.samples();
        let count = shape.conditions * samples;
        let mut batch = Self {
            condition_length,
            samples,
            conditions,
            points: vec![0.0; 2 * count],
            densities: vec![0.0; count],
            weights: vec![1.0; count],
            brdf: vec![0.0; count],
            tails: vec![1.0; count],
            mixture_weight_logits,
        };
        batch
            .conditions
            .par_chunks_exact(condition_length)
            .zip(&positions)
            .zip(batch.points.par_chunks_exact_mut(2 * samples))
            .zip(batch.densities.par_chunks_exact_mut(samples))
            .zip(batch.weights.par_chunks_exact_mut(samples))
            .zip(batch.brdf.par_chunks_exact_mut(samples))
            .zip(batch.tails.par_chunks_exact_mut(samples))
            .try_for_each(|((((((condition, &position), points), densities), weights), brdf), tails)| {
                let mut stream = Stream::new(seed, purpose, index);
                stream.seek(position);
                points.fill_with(|| stream.uniform());
                let place = PlacedPoints { points, densities, weights, brdf, tails };
                match purpose {
                    Purpose::Validation => target.place_for_validation(condition, shape, place),
                    _ => target.place(condition, shape, place),
                }
            })?;
        Ok(batch)
    }

    /// Splits into parts of `conditions` conditions each (the last may have fewer), in order.
    pub fn split(&self, conditions: usize) -> Vec<Self> {
        let part = |first: usize| {
            let range = first..(first + conditions).min(self.condition_count());
            let cut = |values: &[f32], length: usize| values[range.start * length..range.end * length].to_vec();
            Self {
                conditions: cut(&self.conditions, self.condition_length),
                points: cut(&self.points, 2 * self.samples),
                densities: cut(&self.densities, self.samples),
                weights: cut(&self.weights, self.samples),
                brdf: cut(&self.brdf, self.samples),
                tails: cut(&self.tails, self.samples),
                mixture_weight_logits: cut(&self.mixture_weight_logits, 1),
                ..*self
            }
        };
        (0..self.condition_count()).step_by(conditions).map(part).collect()
    }

    /// Returns the number of conditions.
    pub fn condition_count(&self) -> usize {
        self.densities.len() / self.samples
    }

    /// Returns the points of a condition.
    pub fn condition(&self, index: usize) -> ConditionPoints<'_> {
        let range = index * self.samples..(index + 1) * self.samples;
        ConditionPoints {
            densities: &self.densities[range.clone()],
            weights: &self.weights[range.clone()],
            brdf: &self.brdf[range.clone()],
            tails: &self.tails[range],
            mixture_weight_logit: self.mixture_weight_logits[index],
        }
    }

    /// Iterates over the points of every condition, in order.
    pub fn by_condition(&self) -> impl Iterator<Item = ConditionPoints<'_>> {
        (0..self.condition_count()).map(|index| self.condition(index))
    }

    /// Returns the number of conditions under which the target is not zero everywhere.
    pub fn lit_count(&self) -> usize {
        self.by_condition().filter(ConditionPoints::is_lit).count()
    }
}

impl ConditionPoints<'_> {
    /// Returns whether the target is nonzero at a point that is not excluded.
    pub fn is_lit(&self) -> bool {
        self.densities.iter().zip(self.weights).any(|(&g, &v)| g > 0.0 && v > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CosineTarget, integrand::TailMap, test_support::studio};

    const SHAPE: BatchShape = BatchShape { conditions: 5, strata: 4, brdf_samples: 0 };

    /// Maps Y as a tail without an environment: elevation and azimuth of a uniform sphere.
    fn uniform_tail(y: [f32; 2]) -> [f32; 3] {
        let cos = 1.0 - 2.0 * y[1];
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let phi = std::f32::consts::TAU * y[0];
        [sin * phi.sin(), cos, -sin * phi.cos()]
    }

    fn draw(seed: u64, step: u64) -> Batch {
        Batch::draw(&CosineTarget::new(&uniform_tail), SHAPE, seed, Purpose::Batch, step).unwrap()
    }

    #[test]
    fn a_batch_is_a_function_of_seed_and_step() {
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }

    #[test]
    fn the_parts_of_a_batch_concatenate_to_the_batch() {
        let batch = draw(4, 0);
        let parts = batch.split(2);
        assert_eq!(parts.iter().map(Batch::condition_count).collect::<Vec<_>>(), [2, 2, 1]);
        let joined =
            |field: fn(&Batch) -> &Vec<f32>| parts.iter().flat_map(|part| field(part).clone()).collect::<Vec<_>>();
        assert_eq!(joined(|part| &part.conditions), batch.conditions);
        assert_eq!(joined(|part| &part.points), batch.points);
        assert_eq!(joined(|part| &part.densities), batch.densities);
        assert_eq!(joined(|part| &part.weights), batch.weights);
        assert_eq!(joined(|part| &part.brdf), batch.brdf);
        assert_eq!(joined(|part| &part.tails), batch.tails);
        assert_eq!(joined(|part| &part.mixture_weight_logits), batch.mixture_weight_logits);
    }

    #[test]
    fn there_is_one_point_in_each_stratum() {
        for points in draw(3, 0).points.chunks_exact(32) {
            let mut counts = [0; 16];
            for y in points.chunks_exact(2) {
                counts[(y[0] * 4.0) as usize + 4 * (y[1] * 4.0) as usize] += 1;
            }
            assert_eq!(counts, [1; 16]);
        }
    }

    #[test]
    fn the_cosine_target_is_the_clamped_cosine_to_the_tails_direction() {
        let target = CosineTarget::new(&uniform_tail);
        assert!((target.at(&[0.0, 1.0, 0.0], [0.3, 0.25]).target - 0.5).abs() < 1e-6);
        assert_eq!(target.at(&[0.0, 1.0, 0.0], [0.3, 0.75]).target, 0.0);
        // The mean of the clamped cosine over the sphere is 1/4.
        let shape = BatchShape { conditions: 8, strata: 64, brdf_samples: 0 };
        let batch = Batch::draw(&target, shape, 0, Purpose::Test, 0).unwrap();
        for densities in batch.densities.chunks_exact(64 * 64) {
            assert!((densities.iter().sum::<f32>() / 4096.0 - 0.25).abs() < 2e-3);
        }
    }

    #[test]
    fn a_nan_target_is_an_error() {
        let broken = |_: [f32; 2]| [f32::NAN; 3];
        let tail = |y: [f32; 2]| if y[0] < 0.5 { uniform_tail(y) } else { [f32::INFINITY; 3] };
        for tail in [&broken as &dyn TailMap, &tail] {
            let batch = Batch::draw(&CosineTarget::new(tail), SHAPE, 0, Purpose::Test, 0);
            if let Ok(batch) = batch {
                panic!("{:?}", batch.densities);
            }
        }
    }

    /// Integrals over Y do not depend on the sampling strategy.
    #[test]
    fn brdf_samples_do_not_change_integrals() {
        let tail = studio();
        let target = CosineTarget::new(&tail);
        let integrals = |strata, brdf_samples| -> Vec<(f64, f64, f64)> {
            let shape = BatchShape { conditions: 12, strata, brdf_samples };
            // The same conditions: each has its own stream.
            (0..12)
                .map(|index| {
                    let shape = BatchShape { conditions: 1, ..shape };
                    let batch = Batch::draw(&target, shape, 0, Purpose::Test, index).unwrap();
                    let at = batch.condition(0);
                    let mean = |f: &dyn Fn(usize) -> f32| {
                        let terms: Vec<f64> = (0..batch.samples).map(|i| f64::from(at.weights[i] * f(i))).collect();
                        let mean = terms.iter().sum::<f64>() / terms.len() as f64;
                        let variance = terms.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / terms.len() as f64;
                        (mean, (variance / terms.len() as f64).sqrt())
                    };
                    let ((one, _), (light, error)) = (mean(&|_| 1.0), mean(&|i| at.densities[i]));
                    (one, light, error)
                })
                .collect()
        };
        for ((one, light, error), (exact_one, exact, _)) in integrals(16, 256).into_iter().zip(integrals(256, 0)) {
            assert!((exact_one - 1.0).abs() < 1e-6);
            // Stratification makes the error smaller than that of independent points; 4 standard errors of
            // those for 24 estimates.
            assert!((light - exact).abs() < 4.0 * error + 1e-3 * exact, "{light} {exact} +- {error}");
            assert!((one - 1.0).abs() < 0.2, "{one}");
        }
    }

    #[test]
    fn brdf_samples_concentrate_where_their_density_is_high() {
        let tail = studio();
        let shape = BatchShape { conditions: 20, strata: 8, brdf_samples: 64 };
        let batch = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, 0).unwrap();
        let mean = |range: std::ops::Range<usize>| {
            let logs = batch.by_condition().flat_map(|at| at.brdf[range.clone()].iter().filter(|b| **b > 0.0));
            let logs: Vec<f64> = logs.map(|&b| f64::from(b).ln()).collect();
            logs.iter().sum::<f64>() / logs.len() as f64
        };
        assert!(mean(64..128) > mean(0..64) + 0.5);
        assert!(batch.points.iter().all(|y| (0.0..1.0).contains(y)));
    }
}
