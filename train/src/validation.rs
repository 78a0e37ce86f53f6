//! How far a head is from its target, on a fixed set of conditions and points.

use headtail_model::{Head, burn::prelude::Device};
use headtail_render::random::Purpose;
use serde::{Deserialize, Serialize};

use crate::{Error, Loss, Result, Target, injection::tensors, loss::log_weights, target::Batch};

/// Means over the conditions under which the target is not zero everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Divergence {
    /// `KL(q* || q)` in nats.
    pub kl: f64,
    /// Relative variance of the weight `q* / q`, i.e. the chi-square divergence: the variance of a one-sample estimate over
    /// the square of its mean, without shadows.
    pub relative_variance: f64,
}

/// A fixed validation set.
pub struct Validation {
    batch: Batch,
}

impl Validation {
    /// Draws `conditions` conditions with `strata^2` points each.
    ///
    /// # Errors
    /// [`Error::EmptyTarget`] if the target is zero under all of them, [`Error::BadTarget`] if it is not a density.
    pub fn new(target: &dyn Target, conditions: usize, strata: usize, seed: u64) -> Result<Self> {
        let batch = Batch::draw(target, (conditions, strata), seed, Purpose::Validation, 0)?;
        if batch.densities.iter().all(|&density| density == 0.0) {
            return Err(Error::EmptyTarget { conditions });
        }
        Ok(Self { batch })
    }

    /// The divergence of `head`, which lives on `device` (without autodiff).
    pub fn divergence(&self, head: &Head, device: &Device) -> Divergence {
        let (y, c) = tensors(&self.batch, device);
        let samples = self.batch.samples;
        let log_q =
            head.log_density(&y, c).try_into_vec_as::<f32>().expect("densities are readable and convert to f32");
        let mut unused = vec![0.0; samples];
        let (mut kl, mut variance, mut count) = (0.0, 0.0, 0.0);
        for (densities, log_q) in self.batch.densities.chunks_exact(samples).zip(log_q.chunks_exact(samples)) {
            let Some(log_weights) = log_weights(densities) else { continue };
            kl += f64::from(Loss::ForwardKl.evaluate(&log_weights, log_q, &mut unused));
            variance += f64::from(Loss::LogChiSquare.evaluate(&log_weights, log_q, &mut unused)).exp_m1();
            count += 1.0;
        }
        Divergence { kl: kl / count, relative_variance: variance / count }
    }
}
