//! AdamW with warm-up, cosine decay and clipping by the norm, over all weights as one list.

use serde::{Deserialize, Serialize};

use crate::FitConfig;

/// The state of AdamW (Loshchilov and Hutter 2019).
///
/// On the host and over one list: a step costs less than launching one operation per tensor, and the state is
/// saved and restored bit-identically.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerState {
    /// Number of steps that changed the weights.
    pub moves: u64,
    /// Decaying mean of the gradients.
    #[serde(skip)]
    pub first_moments: Vec<f32>,
    /// Decaying mean of their squares.
    #[serde(skip)]
    pub second_moments: Vec<f32>,
}

/// Returns the learning rate of `step`, counted from 0: a linear rise to `peak` over the first
/// `warmup` steps, then half a cosine that would reach zero at step `steps`.
pub fn learning_rate(config: &FitConfig, peak: f64, step: usize) -> f64 {
    let warmup = (config.warmup * config.steps as f64).round() as usize;
    if step < warmup {
        return peak * (step + 1) as f64 / (warmup + 1) as f64;
    }
    let done = (step - warmup) as f64 / (config.steps - warmup).max(1) as f64;
    0.5 * peak * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos())
}

impl OptimizerState {
    /// Returns the state before the first step, for `weights` weights.
    pub fn new(weights: usize) -> Self {
        Self { moves: 0, first_moments: vec![0.0; weights], second_moments: vec![0.0; weights] }
    }

    /// Moves `weights` against `gradients`, with the other settings of `config`. `rates` has the length and
    /// learning rate of each group of weights, which is clipped by its own norm. Returns `false` and changes
    /// nothing if a gradient is not finite.
    pub fn step(&mut self, config: &FitConfig, rates: &[(usize, f64)], weights: &mut [f32], gradients: &[f32]) -> bool {
        let mut end = 0;
        let with_norm = |&(length, rate): &(usize, f64)| {
            let range = end..end + length;
            end += length;
            let norm = gradients[range.clone()].iter().map(|&g| f64::from(g) * f64::from(g)).sum::<f64>().sqrt();
            (range, rate, norm)
        };
        let groups: Vec<_> = rates.iter().map(with_norm).collect();
        if groups.iter().any(|(.., norm)| !norm.is_finite()) {
            return false;
        }
        self.moves += 1;
        let moves = self.moves as f64;
        let (beta_1, beta_2, epsilon) = (config.beta_1, config.beta_2, config.epsilon);
        for (range, rate, norm) in groups {
            let clip = if norm > config.clip_norm { (config.clip_norm / norm) as f32 } else { 1.0 };
            // The bias corrections belong to the step, not to the weights.
            let rate_1 = (rate / (1.0 - f64::from(beta_1).powf(moves))) as f32;
            let root_2 = (1.0 / (1.0 - f64::from(beta_2).powf(moves)).sqrt()) as f32;
            let keep = (1.0 - rate * f64::from(config.weight_decay)) as f32;
            let moments = self.first_moments[range.clone()].iter_mut().zip(&mut self.second_moments[range.clone()]);
            let weights = weights[range.clone()].iter_mut().zip(&gradients[range]);
            for ((weight, gradient), (first, second)) in weights.zip(moments) {
                let gradient = gradient * clip;
                *first = beta_1 * *first + (1.0 - beta_1) * gradient;
                *second = beta_2 * *second + (1.0 - beta_2) * gradient * gradient;
                *weight = keep * *weight - rate_1 * *first / (second.sqrt() * root_2 + epsilon);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use burn::optim::{AdamWConfig, GradientsParams};
    use headtail_model::{Head, HeadConfig};
    use headtail_render::random::{Purpose, Stream};

    use super::*;
    use crate::{Backend, in_graph::tensors, integrand::Batch, test_support::batch_of_sky};

    /// Three steps of maximum likelihood, by this optimiser and by burn's.
    #[test]
    fn steps_match_those_of_the_tensor_library() {
        let device = Backend::default().device().unwrap().autodiff();
        let config = FitConfig { steps: 100, warmup: 0.0, clip_norm: 1e9, weight_decay: 0.1, ..FitConfig::default() };
        let mut head = Head::new(HeadConfig::COSINE, 0, &device).unwrap();
        let mut weights = head.flat_weights();
        let mut own = OptimizerState::new(weights.len());
        let mut burns = AdamWConfig::new()
            .with_beta_1(config.beta_1)
            .with_beta_2(config.beta_2)
            .with_epsilon(config.epsilon)
            .with_weight_decay(config.weight_decay)
            .init();
        let batch: Batch = batch_of_sky(8, 4);
        for step in 0..3 {
            let (y, c) = tensors(&batch, &device);
            let loss = head.log_density(&y, c).mean().neg();
            let gradients = GradientsParams::from_grads(loss.backward(), &head);
            let rate = learning_rate(&config, config.learning_rate, step);
            let rates = [(weights.len(), rate)];
            assert!(own.step(&config, &rates, &mut weights, &head.flat_gradients(&gradients)));
            head = burns.step(rate, head, gradients);
            // Steps of 1.6e-2; Adam divides by the gradient's size, and the smallest differ by rounding.
            let apart = head.flat_weights().iter().zip(&weights).filter(|(a, b)| (**a - **b).abs() > 1e-5).count();
            assert!(apart * 1000 <= weights.len(), "step {step}: {apart} of {}", weights.len());
        }
    }

    #[test]
    fn gradients_beyond_the_norm_are_scaled_down_to_it() {
        let mut stream = Stream::new(0, Purpose::Test, 0);
        let gradients: Vec<f32> = (0..50).map(|_| stream.uniform() - 0.5).collect();
        let moved = |clip_norm, factor: f32| {
            let config = FitConfig { clip_norm, ..FitConfig::default() };
            let mut optimizer = OptimizerState::new(50);
            let scaled: Vec<f32> = gradients.iter().map(|g| g * factor).collect();
            assert!(optimizer.step(&config, &[(50, 1e-3)], &mut [0.1; 50], &scaled));
            optimizer.first_moments
        };
        let norm = |moments: &[f32]| moments.iter().map(|m| m * m).sum::<f32>().sqrt();
        assert!((norm(&moved(1.0, 1e6)) - 0.1).abs() < 1e-6);
        assert_eq!(moved(1e3, 1.0), moved(1e6, 1.0));
    }

    #[test]
    fn groups_are_clipped_and_moved_separately() {
        let config = FitConfig { clip_norm: 1.0, ..FitConfig::default() };
        let (mut weights, gradients) = ([0.1; 5], [0.3, -4.0, 0.2, 0.1, 7.0]);
        assert!(OptimizerState::new(5).step(&config, &[(2, 1e-2), (3, 1e-3)], &mut weights, &gradients));
        for (range, rate) in [(0..2, 1e-2), (2..5, 1e-3)] {
            let mut own = vec![0.1; range.len()];
            let mut optimizer = OptimizerState::new(own.len());
            assert!(optimizer.step(&config, &[(own.len(), rate)], &mut own, &gradients[range.clone()]));
            assert_eq!(own, weights[range]);
        }
    }

    #[test]
    fn gradients_that_are_not_finite_move_nothing() {
        let (config, mut optimizer) = (FitConfig::default(), OptimizerState::new(2));
        let (mut weights, before) = ([0.1, 0.2], optimizer.clone());
        for bad in [f32::NAN, f32::INFINITY] {
            // The first group's gradient is finite.
            assert!(!optimizer.step(&config, &[(1, 1e-3), (1, 1e-3)], &mut weights, &[0.1, bad]));
            assert_eq!((weights, &optimizer), ([0.1, 0.2], &before));
        }
    }

    #[test]
    fn the_rate_rises_to_its_peak_and_falls_to_zero() {
        let config = FitConfig { steps: 1000, warmup: 0.1, learning_rate: 4e-3, ..FitConfig::default() };
        let rates: Vec<f64> = (0..1000).map(|step| learning_rate(&config, config.learning_rate, step)).collect();
        assert!(rates[..101].windows(2).all(|pair| pair[0] < pair[1]));
        assert!(rates[100..].windows(2).all(|pair| pair[0] > pair[1]));
        assert!((rates[100] - 4e-3).abs() < 1e-12 && rates[0] > 0.0 && rates[999] < 1e-7 && rates[999] > 0.0);
    }
}
