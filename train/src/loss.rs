//! Losses, per condition, over points that are uniform in Y: value, and derivative with respect to each log-density.

use headtail_model::burn::prelude::{Tensor, TensorData};
use serde::{Deserialize, Serialize};

use crate::target::Batch;

/// What training minimises, averaged over the conditions whose target is not zero everywhere.
///
/// With `g_i` the target at `n` points, `w_i = g_i / sum g` and `p_i = n w_i` the target's density: both are 0 for a perfect head
/// up to the noise of the points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// Forward Kullback-Leibler divergence in nats, `sum_i w_i ln(p_i / q_i)`: weighted maximum likelihood.
    ForwardKl,
    /// `ln sum_i w_i p_i / q_i = ln(1 + chi-square) = ln(1 + relative variance)`: what a renderer pays for, with gradients
    /// that the logarithm bounds.
    #[default]
    LogChiSquare,
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::ForwardKl => "forward-kl",
            Self::LogChiSquare => "log-chi-square",
        })
    }
}

/// Log-weights `ln w_i` of one condition's points, `-inf` where the target is zero; `None` if it is zero everywhere.
pub fn log_weights(densities: &[f32]) -> Option<Vec<f32>> {
    let total: f64 = densities.iter().map(|&g| f64::from(g)).sum();
    (total > 0.0).then(|| densities.iter().map(|&g| (f64::from(g) / total).ln() as f32).collect())
}

impl Loss {
    /// The loss of one condition. `derivatives` receives the derivative with respect to each of `log_q`.
    pub fn evaluate(self, log_weights: &[f32], log_q: &[f32], derivatives: &mut [f32]) -> f32 {
        let log_count = (log_weights.len() as f32).ln();
        match self {
            Self::ForwardKl => {
                let mut loss = 0.0;
                for ((&log_w, &log_q), derivative) in log_weights.iter().zip(log_q).zip(derivatives) {
                    let w = log_w.exp();
                    *derivative = -w;
                    if w > 0.0 {
                        loss += w * (log_count + log_w - log_q);
                    }
                }
                loss
            }
            Self::LogChiSquare => {
                let terms = || log_weights.iter().zip(log_q).map(|(log_w, log_q)| 2.0 * log_w - log_q);
                // Finite: at least one weight is positive.
                let largest = terms().fold(f32::NEG_INFINITY, f32::max);
                let sum: f32 = terms().map(|term| (term - largest).exp()).sum();
                for (derivative, term) in derivatives.iter_mut().zip(terms()) {
                    *derivative = -(term - largest).exp() / sum;
                }
                log_count + largest + sum.ln()
            }
        }
    }

    /// The mean loss of a batch in the tensor library's graph: the reference for the injected gradient.
    ///
    /// `log_q` is `[conditions, samples]`. `None` if the target is zero under every condition.
    pub fn of_batch(self, batch: &Batch, log_q: &Tensor<2>) -> Option<Tensor<1>> {
        /// Stands for `ln 0`: its exponential is 0, and multiplied by 0 it is 0.
        const LOG_ZERO: f32 = -1e4;
        let samples = batch.samples;
        let mut log_w = Vec::with_capacity(batch.densities.len());
        let mut share = Vec::new();
        for densities in batch.densities.chunks_exact(samples) {
            let weights = log_weights(densities);
            share.push(if weights.is_some() { 1.0 } else { 0.0 });
            log_w.extend(weights.unwrap_or_else(|| vec![0.0; samples]).iter().map(|w| w.max(LOG_ZERO)));
        }
        let count: f32 = share.iter().sum();
        if count == 0.0 {
            return None;
        }
        let conditions = share.len();
        let device = log_q.device();
        let share: Vec<f32> = share.iter().map(|share| share / count).collect();
        let share = Tensor::<1>::from_data(TensorData::new(share, [conditions]), &device);
        let log_w = Tensor::<2>::from_data(TensorData::new(log_w, [conditions, samples]), &device);
        let log_count = (samples as f64).ln();
        let per_condition: Tensor<1> = match self {
            Self::ForwardKl => {
                let ratio = (log_w.clone() - log_q.clone()).add_scalar(log_count);
                (log_w.exp() * ratio).sum_dim(1).squeeze_dim(1)
            }
            Self::LogChiSquare => {
                let terms = log_w.mul_scalar(2.0) - log_q.clone();
                let largest = terms.clone().detach().max_dim(1);
                let sum = (terms - largest.clone()).exp().sum_dim(1);
                (sum.log() + largest).add_scalar(log_count).squeeze_dim(1)
            }
        };
        Some((per_condition * share).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DENSITIES: [f32; 6] = [0.0, 1.0, 3.0, 0.5, 0.0, 2.0];

    #[test]
    fn both_losses_are_zero_for_the_target_itself() {
        let log_w = log_weights(&DENSITIES).unwrap();
        let log_q: Vec<f32> = log_w.iter().map(|w| (w + 6.0_f32.ln()).max(-20.0)).collect();
        for loss in [Loss::ForwardKl, Loss::LogChiSquare] {
            assert!(loss.evaluate(&log_w, &log_q, &mut [0.0; 6]).abs() < 1e-6);
        }
    }

    #[test]
    fn log_chi_square_of_the_uniform_density_is_the_log_of_the_second_moment() {
        let log_w = log_weights(&DENSITIES).unwrap();
        let (sum, squares): (f32, f32) = (6.5, 1.0 + 9.0 + 0.25 + 4.0);
        let expected = (6.0 * squares / (sum * sum)).ln();
        assert!((Loss::LogChiSquare.evaluate(&log_w, &[0.0; 6], &mut [0.0; 6]) - expected).abs() < 1e-6);
    }

    #[test]
    fn derivatives_are_those_of_central_differences() {
        let log_w = log_weights(&DENSITIES).unwrap();
        let log_q = [0.3, -0.2, 0.8, -1.0, 0.1, 0.4];
        for loss in [Loss::ForwardKl, Loss::LogChiSquare] {
            let mut derivatives = [0.0; 6];
            loss.evaluate(&log_w, &log_q, &mut derivatives);
            for i in 0..6 {
                let at = |step: f32| {
                    let mut moved = log_q;
                    moved[i] += step;
                    loss.evaluate(&log_w, &moved, &mut [0.0; 6])
                };
                // f32 differences over 0.02: rounding 1e-7 / 0.02, truncation 1e-4 / 6.
                let difference = (at(0.01) - at(-0.01)) / 0.02;
                assert!((derivatives[i] - difference).abs() < 5e-5, "{} {difference}", derivatives[i]);
            }
        }
    }

    #[test]
    fn a_condition_without_light_has_no_weights() {
        assert!(log_weights(&[0.0; 4]).is_none());
    }

    #[test]
    fn huge_log_densities_do_not_overflow() {
        let log_w = log_weights(&DENSITIES).unwrap();
        let mut derivatives = [0.0; 6];
        let loss = Loss::LogChiSquare.evaluate(&log_w, &[-300.0, -200.0, 50.0, 3.0, 1.0, 100.0], &mut derivatives);
        assert!(loss.is_finite() && derivatives.iter().all(|d| d.is_finite()));
    }
}
