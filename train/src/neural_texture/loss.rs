//! The losses of a fit: weighted squared errors, and the negative likelihood of the lobes.
//!
//! The error of a prediction `p` (the mean of its channels) is weighted by `1 / (p + floor)`. This lies
//! between absolute errors, which a few highlights would dominate, and relative errors, which nearly ignore
//! highlights although they are visible. The prediction in the weight is held fixed, so that the gradient has
//! the same mean for any noise of the samples.

use glam::Vec3;
use headtail_render::color::luminance;

use super::samples::Samples;

/// Added to a prediction in the weight of its error, relative to the mean of the batch.
const ERROR_FLOOR: f32 = 0.05;
/// Added if the batch is black.
const LEAST_FLOOR: f32 = 1e-4;

/// Weights of a batch's samples.
#[derive(Clone, Debug)]
pub(super) struct Weighting {
    floor: f32,
    /// Errors are relative to the mean of the batch, so that they have no unit.
    mean: f32,
    scale: f32,
    /// Weight of the lobes' log-density at each sample, in proportion to its reflectance; the sum is 1.
    pub likelihood: Vec<f32>,
}

impl Weighting {
    /// Returns the weights for a batch.
    pub fn new(samples: &Samples) -> Self {
        let mean = samples.luminances().sum::<f32>() / samples.len() as f32;
        let weight = |(value, density): (&Vec3, &f32)| luminance((*value).into()) / density;
        let weights: Vec<f32> = samples.values.iter().zip(&samples.densities).map(weight).collect();
        let sum = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        Self {
            floor: ERROR_FLOOR * mean + LEAST_FLOOR,
            mean: mean.max(LEAST_FLOOR),
            scale: 1.0 / (3 * samples.len()) as f32,
            likelihood: weights.iter().map(|weight| weight / sum).collect(),
        }
    }

    /// Returns the weight of the squared error of a prediction.
    #[inline(always)]
    pub fn of(&self, value: Vec3) -> f32 {
        self.scale / (value.element_sum() / 3.0 + self.floor) / self.mean
    }
}
