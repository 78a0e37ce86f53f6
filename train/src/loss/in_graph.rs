//! The losses in the tensor library's graph: the reference for the derivatives in closed form.

use burn::prelude::{Tensor, TensorData};
use headtail_model::head::mixture_weight_of_logits;

use super::{ENTROPIC_RANGE, LARGEST_LOG_CHI_SQUARE, Loss, NormalizedTarget, Objective, REVERSE_TARGET_FLOOR};
use crate::integrand::Batch;

/// Stands for `ln 0`: its exponential is 0, and multiplied by 0 it is 0.
const LOG_ZERO: f32 = -1e4;

/// Constants of the losses for a batch, `[conditions, samples]` each.
struct Constants {
    log_weights: Tensor<2>,
    log_densities: Tensor<2>,
    log_point_weights: Tensor<2>,
    log_brdf: Tensor<2>,
    log_tails: Tensor<2>,
    /// `[conditions]`: one over the number of lit conditions, 0 for the others.
    lit: Tensor<1>,
}

impl Objective {
    /// Returns the mean loss of a batch. `log_q` is `[conditions, samples]`, `mixture_weight_logits` is
    /// `[conditions, 1]`.
    ///
    /// `None` if the target is zero under every condition.
    pub fn of_batch(
        &self,
        batch: &Batch,
        log_q: Tensor<2>,
        mixture_weight_logits: Option<Tensor<2>>,
    ) -> Option<Tensor<1>> {
        let constants = Constants::new(batch, &log_q)?;
        let log_q = match mixture_weight_logits {
            Some(logits) => {
                let prior = TensorData::new(batch.mixture_weight_logits.clone(), logits.dims());
                let logits = logits.clone() + Tensor::from_data(prior, &logits.device());
                mix(log_q, logits, constants.log_brdf.clone())
            }
            None => log_q,
        };
        let mut per_condition = constants.loss(self.loss, &log_q, batch.samples);
        if self.entropic > 0.0 {
            let log_x = (log_q + constants.log_tails).clamp(-ENTROPIC_RANGE, ENTROPIC_RANGE);
            let term = constants.log_weights.exp() * log_x.clone().exp() * log_x;
            per_condition = per_condition + term.sum_dim(1).squeeze_dim(1).mul_scalar(self.entropic);
        }
        Some((per_condition * constants.lit).sum())
    }
}

impl Constants {
    fn new(batch: &Batch, like: &Tensor<2>) -> Option<Self> {
        let mut lit = Vec::new();
        let (mut log_weights, mut log_densities) = (Vec::new(), Vec::new());
        for points in batch.by_condition() {
            let target = NormalizedTarget::new(&points);
            lit.push(if target.is_some() { 1.0 } else { 0.0 });
            let zeros = || vec![0.0; batch.samples];
            let target = target.unwrap_or_else(|| NormalizedTarget { log_weights: zeros(), log_densities: zeros() });
            log_weights.extend(target.log_weights);
            log_densities.extend(target.log_densities);
        }
        let count: f32 = lit.iter().sum();
        if count == 0.0 {
            return None;
        }
        let device = like.device();
        let tensor = |values: Vec<f32>| {
            let values: Vec<f32> = values.into_iter().map(|value| value.max(LOG_ZERO)).collect();
            Tensor::<2>::from_data(TensorData::new(values, [batch.condition_count(), batch.samples]), &device)
        };
        let logs = |values: &[f32]| tensor(values.iter().map(|value| value.ln()).collect());
        let conditions = lit.len();
        lit.iter_mut().for_each(|lit| *lit /= count);
        Some(Self {
            log_weights: tensor(log_weights),
            log_densities: tensor(log_densities),
            log_point_weights: logs(&batch.weights),
            log_brdf: logs(&batch.brdf),
            log_tails: logs(&batch.tails),
            lit: Tensor::from_data(TensorData::new(lit, [conditions]), &device),
        })
    }

    /// Returns the losses, `[conditions]`.
    fn loss(&self, loss: Loss, log_q: &Tensor<2>, samples: usize) -> Tensor<1> {
        match loss {
            Loss::ForwardKl => {
                let ratio = self.log_densities.clone() - log_q.clone();
                (self.log_weights.clone().exp() * ratio).sum_dim(1).squeeze_dim(1)
            }
            Loss::LogChiSquare => {
                log_sum_exp(self.log_weights.clone() + self.log_densities.clone() - log_q.clone()).squeeze_dim(1)
            }
            Loss::ChiSquare => {
                self.loss(Loss::LogChiSquare, log_q, samples).clamp_max(LARGEST_LOG_CHI_SQUARE).exp().sub_scalar(1.0)
            }
            Loss::ReverseKl => {
                let log_u = self.log_point_weights.clone() + log_q.clone();
                let log_u = log_u.clone() - log_sum_exp(log_u);
                let held = self.log_densities.clone().clamp_min(REVERSE_TARGET_FLOOR.ln());
                let log_w = (held + self.log_point_weights.clone()).sub_scalar((samples as f64).ln());
                (log_u.clone().exp() * (log_u - log_w)).sum_dim(1).squeeze_dim(1)
            }
        }
    }
}

/// Returns `ln(p q + (1 - p) b)`.
fn mix(log_q: Tensor<2>, logits: Tensor<2>, log_brdf: Tensor<2>) -> Tensor<2> {
    let p = mixture_weight_of_logits(logits);
    let head = log_q + p.clone().log();
    let brdf = log_brdf + p.neg().add_scalar(1.0).log();
    let largest = head.clone().max_pair(brdf.clone()).detach();
    let sum = (head - largest.clone()).exp() + (brdf - largest.clone()).exp();
    sum.log() + largest
}

/// Reduces dimension 1, which keeps length 1.
fn log_sum_exp(terms: Tensor<2>) -> Tensor<2> {
    let largest = terms.clone().detach().max_dim(1);
    (terms - largest.clone()).exp().sum_dim(1).log() + largest
}
