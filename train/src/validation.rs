//! Divergence of a head from its target, on a fixed set of conditions and points.

use burn::prelude::Device;
use headtail_model::Head;
use headtail_render::{random::Purpose, statistics::relative_variance_of_log_moment};
use serde::{Deserialize, Serialize};

use crate::{
    Error, Loss, Objective, Result, Target,
    in_graph::tensors,
    integrand::{Batch, BatchShape},
    loss::LossDerivatives,
};

/// Means over the conditions under which the target is not zero everywhere. With a learned mixture weight
/// they are those of the mixture with BRDF sampling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Divergence {
    /// `KL(q* || q)` in nats.
    pub kl: f64,
    /// `ln(1 + chi^2(q* || q))` in nats: the Renyi divergence of order 2.
    pub log_chi_square: f64,
    /// Relative variance of the weight `q* / q`, i.e. the chi-square divergence itself: the variance of a
    /// one-sample estimate over the square of its mean, without shadows.
    pub relative_variance: f64,
}

/// A fixed validation set.
pub struct Validation {
    batch: Batch,
}

/// Conditions evaluated together.
const CHUNK: usize = 16;

impl Validation {
    /// Draws conditions and points.
    ///
    /// # Errors
    /// [`Error::EmptyTarget`] if the target is zero under all conditions, [`Error::BadTarget`] if it is not a
    /// density.
    pub fn new(target: &dyn Target, shape: BatchShape, seed: u64) -> Result<Self> {
        let batch = Batch::draw(target, shape, seed, Purpose::Validation, 0)?;
        if batch.lit_count() == 0 {
            return Err(Error::EmptyTarget { conditions: shape.conditions });
        }
        Ok(Self { batch })
    }

    /// Returns the divergence of `head`, which lives on `device` (without autodiff).
    pub fn divergence(&self, head: &Head, device: &Device) -> Divergence {
        let mut sum = Divergence { kl: 0.0, log_chi_square: 0.0, relative_variance: 0.0 };
        let count = self.batch.lit_count() as f64;
        for batch in self.batch.split(CHUNK) {
            let read = "densities are readable and convert to f32";
            let (y, c) = tensors(&batch, device);
            let log_q = head.log_density(&y, c.clone()).try_into_vec_as::<f32>().expect(read);
            let logits = head.mixture_weight_logits(c).map(|logits| logits.try_into_vec_as::<f32>().expect(read));
            let mut unused = vec![0.0; batch.samples];
            for (index, log_q) in log_q.chunks_exact(batch.samples).enumerate() {
                let mut evaluate = |loss: Loss| {
                    let mut out = LossDerivatives { d_log_q: &mut unused, d_mixture_weight_logit: 0.0 };
                    let logit = logits.as_ref().map(|logits| logits[index]);
                    Objective::from(loss).evaluate(&batch.condition(index), log_q, logit, &mut out).map(f64::from)
                };
                let Some((kl, chi)) = evaluate(Loss::ForwardKl).zip(evaluate(Loss::LogChiSquare)) else { continue };
                sum.kl += kl / count;
                sum.log_chi_square += chi / count;
                sum.relative_variance += relative_variance_of_log_moment(chi) / count;
            }
        }
        sum
    }
}
