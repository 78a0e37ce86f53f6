//! Target densities in the intermediate square Y, and batches of them.
//!
//! An exact tail takes uniform points of Y to directions in proportion to radiance, so the ideal intermediate density
//! `q*(y|c)` is BRDF x cosine at the tail's direction: it is evaluated at stratified points, and nothing is tabulated.

use headtail_model::Condition;
use headtail_render::random::{Purpose, Stream};
use rayon::prelude::*;

use crate::{Error, Result};

/// What a head is trained for: a distribution of conditions, and an unnormalised density in Y for each.
pub trait Target: Sync {
    /// The layout of a condition.
    fn condition(&self) -> Condition;

    /// Draws a condition.
    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]);

    /// The unnormalised density at `y` per unit area of Y: finite, at least 0. It may be zero everywhere (no light above the
    /// horizon); such conditions are left out of losses and figures.
    fn density(&self, condition: &[f32], y: [f32; 2]) -> f32;
}

/// Lambert: `max(0, n . w(t(y)))` for normals `n` uniform over the sphere.
pub struct CosineTarget<'a> {
    tail_direction: &'a (dyn Fn([f32; 2]) -> [f32; 3] + Sync),
}

impl<'a> CosineTarget<'a> {
    /// `tail_direction` is the exact tail's `forward` followed by the lat-long map: Y to unit directions, world space.
    pub fn new(tail_direction: &'a (dyn Fn([f32; 2]) -> [f32; 3] + Sync)) -> Self {
        Self { tail_direction }
    }
}

impl Target for CosineTarget<'_> {
    fn condition(&self) -> Condition {
        Condition::Normal
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        condition.copy_from_slice(&stream.direction().to_array());
    }

    fn density(&self, condition: &[f32], y: [f32; 2]) -> f32 {
        let direction = (self.tail_direction)(y);
        let cosine: f32 = condition.iter().zip(direction).map(|(n, w)| n * w).sum();
        // Not `max`: it would turn NaN into 0.
        if cosine < 0.0 { 0.0 } else { cosine }
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
    /// `[conditions, samples, 2]`, one point in each stratum.
    pub points: Vec<f32>,
    /// `[conditions, samples]`, unnormalised.
    pub densities: Vec<f32>,
}

impl Batch {
    /// `conditions` conditions with `strata^2` jittered points each: a function of (target, seed, purpose, index) alone.
    ///
    /// # Errors
    /// [`Error::BadTarget`] if the target gives a density that is not finite or is negative.
    pub fn draw(
        target: &dyn Target,
        (conditions, strata): (usize, usize),
        seed: u64,
        purpose: Purpose,
        index: u64,
    ) -> Result<Self> {
        let condition_length = target.condition().length();
        let samples = strata * strata;
        let mut stream = Stream::new(seed, purpose, index);
        let mut batch = Self {
            condition_length,
            samples,
            conditions: vec![0.0; conditions * condition_length],
            points: Vec::with_capacity(conditions * samples * 2),
            densities: vec![0.0; conditions * samples],
        };
        for condition in batch.conditions.chunks_exact_mut(condition_length) {
            target.draw_condition(&mut stream, condition);
            for stratum in 0..samples {
                for cell in [stratum % strata, stratum / strata] {
                    batch.points.push((cell as f32 + stream.uniform()) / strata as f32);
                }
            }
        }
        batch.evaluate(target)?;
        Ok(batch)
    }

    fn evaluate(&mut self, target: &dyn Target) -> Result<()> {
        let points = self.points.par_chunks_exact(2 * self.samples);
        let conditions = self.conditions.par_chunks_exact(self.condition_length);
        self.densities.par_chunks_exact_mut(self.samples).zip(points).zip(conditions).try_for_each(
            |((densities, points), condition)| {
                for (density, y) in densities.iter_mut().zip(points.chunks_exact(2)) {
                    let y = [y[0], y[1]];
                    *density = target.density(condition, y);
                    if !(density.is_finite() && *density >= 0.0) {
                        return Err(Error::BadTarget { density: *density, y, condition: condition.to_vec() });
                    }
                }
                Ok(())
            },
        )
    }

    /// Parts of `conditions` conditions each (the last may have fewer), in order.
    pub fn split(&self, conditions: usize) -> Vec<Self> {
        let points = self.points.chunks(conditions * self.samples * 2);
        let densities = self.densities.chunks(conditions * self.samples);
        let part = |((c, points), densities): ((&[f32], &[f32]), &[f32])| Self {
            conditions: c.to_vec(),
            points: points.to_vec(),
            densities: densities.to_vec(),
            ..*self
        };
        self.conditions.chunks(conditions * self.condition_length).zip(points).zip(densities).map(part).collect()
    }

    /// Number of conditions.
    pub fn condition_count(&self) -> usize {
        self.densities.len() / self.samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tail without an environment: elevation and azimuth of a uniform sphere.
    fn uniform_tail(y: [f32; 2]) -> [f32; 3] {
        let cos = 1.0 - 2.0 * y[1];
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let phi = std::f32::consts::TAU * y[0];
        [sin * phi.sin(), cos, -sin * phi.cos()]
    }

    fn draw(seed: u64, step: u64) -> Batch {
        Batch::draw(&CosineTarget::new(&uniform_tail), (5, 4), seed, Purpose::Batch, step).unwrap()
    }

    #[test]
    fn a_batch_is_a_function_of_seed_and_step() {
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }

    #[test]
    fn the_parts_of_a_batch_make_the_batch() {
        let batch = draw(4, 0);
        let parts = batch.split(2);
        assert_eq!(parts.iter().map(Batch::condition_count).collect::<Vec<_>>(), [2, 2, 1]);
        let joined =
            |field: fn(&Batch) -> &Vec<f32>| parts.iter().flat_map(|part| field(part).clone()).collect::<Vec<_>>();
        assert_eq!(joined(|part| &part.conditions), batch.conditions);
        assert_eq!(joined(|part| &part.points), batch.points);
        assert_eq!(joined(|part| &part.densities), batch.densities);
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
        assert!((target.density(&[0.0, 1.0, 0.0], [0.3, 0.25]) - 0.5).abs() < 1e-6);
        assert_eq!(target.density(&[0.0, 1.0, 0.0], [0.3, 0.75]), 0.0);
        // The mean of the clamped cosine over the sphere is 1/4.
        let batch = Batch::draw(&target, (8, 64), 0, Purpose::Test, 0).unwrap();
        for densities in batch.densities.chunks_exact(64 * 64) {
            assert!((densities.iter().sum::<f32>() / 4096.0 - 0.25).abs() < 2e-3);
        }
    }

    #[test]
    fn a_target_that_is_not_a_number_is_an_error() {
        let broken = |_: [f32; 2]| [f32::NAN; 3];
        let tail = |y: [f32; 2]| if y[0] < 0.5 { uniform_tail(y) } else { [f32::INFINITY; 3] };
        for tail in [&broken as &(dyn Fn([f32; 2]) -> [f32; 3] + Sync), &tail] {
            let batch = Batch::draw(&CosineTarget::new(tail), (4, 4), 0, Purpose::Test, 0);
            if let Ok(batch) = batch {
                panic!("{:?}", batch.densities);
            }
        }
    }
}
