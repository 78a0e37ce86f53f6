//! AdamW with warm-up, cosine decay and clipping by the global norm.

use headtail_model::{
    Head,
    burn::{
        module::{ModuleVisitor, Param},
        optim::{AdamWConfig, GradientsParams, ModuleOptimizer},
        prelude::{Module, Tensor},
    },
};

use crate::FitConfig;

/// The optimiser of a head.
pub struct Optimizer {
    adam: ModuleOptimizer,
    schedule: Schedule,
    clip_norm: f64,
}

/// Learning rate by step.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    peak: f64,
    warmup: usize,
    steps: usize,
}

impl Schedule {
    /// Linear rise over the first `warmup` steps, then half a cosine that would reach zero at step `steps`.
    pub fn new(config: &FitConfig) -> Self {
        let warmup = (config.warmup * config.steps as f64).round() as usize;
        Self { peak: config.learning_rate, warmup, steps: config.steps }
    }

    /// The learning rate of `step`, counted from 0.
    pub fn rate(&self, step: usize) -> f64 {
        if step < self.warmup {
            return self.peak * (step + 1) as f64 / (self.warmup + 1) as f64;
        }
        let done = (step - self.warmup) as f64 / (self.steps - self.warmup).max(1) as f64;
        0.5 * self.peak * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos())
    }
}

impl Optimizer {
    /// A fresh optimiser. Every field of AdamW is set here: the library's defaults differ from PyTorch's.
    pub fn new(config: &FitConfig) -> Self {
        let adam = AdamWConfig::new()
            .with_beta_1(config.beta_1)
            .with_beta_2(config.beta_2)
            .with_epsilon(config.epsilon)
            .with_weight_decay(config.weight_decay)
            .with_cautious_weight_decay(false)
            .with_amsgrad(false)
            .with_grad_clipping(None)
            .init();
        Self { adam, schedule: Schedule::new(config), clip_norm: config.clip_norm }
    }

    /// Moves the head's weights against `gradients`. The head comes back as it was, with `false`, if they are not finite.
    pub fn step(&mut self, step: usize, head: Head, mut gradients: GradientsParams) -> (Head, bool) {
        let norm = global_norm(&head, &gradients);
        if !norm.is_finite() {
            return (head, false);
        }
        if norm > self.clip_norm {
            head.visit(&mut Scale { gradients: &mut gradients, factor: self.clip_norm / norm });
        }
        (self.adam.step(self.schedule.rate(step), head, gradients), true)
    }
}

/// The norm of all gradients together.
fn global_norm(head: &Head, gradients: &GradientsParams) -> f64 {
    struct Squares<'a> {
        gradients: &'a GradientsParams,
        sums: Vec<Tensor<1>>,
    }
    impl ModuleVisitor for Squares<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.sums.extend(self.gradients.get::<D>(param.id).map(|gradient| gradient.square().sum()));
        }
    }
    let mut squares = Squares { gradients, sums: Vec::new() };
    head.visit(&mut squares);
    if squares.sums.is_empty() {
        return 0.0;
    }
    f64::from(Tensor::cat(squares.sums, 0).sum().into_scalar::<f32>()).sqrt()
}

struct Scale<'a> {
    gradients: &'a mut GradientsParams,
    factor: f64,
}

impl ModuleVisitor for Scale<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            self.gradients.register(param.id, gradient.mul_scalar(self.factor));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_to_its_peak_and_falls_to_nothing() {
        let config = FitConfig { steps: 1000, warmup: 0.1, learning_rate: 4e-3, ..FitConfig::default() };
        let schedule = Schedule::new(&config);
        let rates: Vec<f64> = (0..1000).map(|step| schedule.rate(step)).collect();
        assert!(rates[..101].windows(2).all(|pair| pair[0] < pair[1]));
        assert!(rates[100..].windows(2).all(|pair| pair[0] > pair[1]));
        assert!((rates[100] - 4e-3).abs() < 1e-12 && rates[0] > 0.0 && rates[999] < 1e-7 && rates[999] > 0.0);
    }
}
