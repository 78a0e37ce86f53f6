//! The state of a training run between two steps: all that the next step depends on, besides the configuration.

use headtail_render::random::Purpose;

use crate::{
    Divergence, Error, FitConfig, GradientSource, Result, StepGradient, Target,
    integrand::Batch,
    optimizer::{OptimizerState, Schedule},
};

/// Weights, moments and counters, as they are saved. Batches are not part of it: they are functions of (seed, step).
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingState {
    /// Steps done.
    pub step: usize,
    /// Steps left out because loss or gradient was not finite.
    pub skipped: usize,
    /// The last step's loss.
    pub loss: f32,
    /// The weights, in the order of [`headtail_model::Head::flat_weights`].
    pub weights: Vec<f32>,
    /// Their moving average; empty where it is off.
    pub average: Vec<f32>,
    /// The optimiser's memory.
    pub optimizer: OptimizerState,
    /// What the learning rate is multiplied by: 1, and half as much after each fall (see [`crate::setback`]).
    pub rate_factor: f64,
    /// The state at the best validation so far, where it is kept.
    pub kept: Option<Kept>,
}

/// What to go back to.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// What validation said.
    pub divergence: Divergence,
    /// The weights.
    pub weights: Vec<f32>,
    /// Their moving average; empty where it is off.
    pub average: Vec<f32>,
    /// The optimiser's memory.
    pub optimizer: OptimizerState,
}

impl Kept {
    /// The weights for use: the moving average where there is one.
    pub fn best_weights(&self) -> &[f32] {
        if self.average.is_empty() { &self.weights } else { &self.average }
    }
}

impl TrainingState {
    /// Before the first step.
    pub fn new(config: &FitConfig, weights: Vec<f32>) -> Self {
        let average = if config.ema_decay > 0.0 { weights.clone() } else { Vec::new() };
        let optimizer = OptimizerState::new(weights.len());
        Self { step: 0, skipped: 0, loss: f32::NAN, optimizer, weights, average, rate_factor: 1.0, kept: None }
    }

    /// The weights for use: the moving average where there is one.
    pub fn best_weights(&self) -> &[f32] {
        if self.average.is_empty() { &self.weights } else { &self.average }
    }

    /// The learning rate of the step that was done last.
    pub fn last_rate(&self, config: &FitConfig) -> f64 {
        self.rate_factor * Schedule::new(config).rate(self.step.saturating_sub(1))
    }

    /// One step; it changes nothing but the count if no condition of its batch sees any light.
    ///
    /// # Errors
    /// [`Error::BadTarget`] for a target that is no density, [`Error::Diverged`] after too many steps that were not finite.
    pub fn advance(&mut self, config: &FitConfig, target: &dyn Target, source: &mut dyn GradientSource) -> Result<()> {
        let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, self.step as u64)?;
        self.advance_on(config, &batch, source)
    }

    /// [`Self::advance`] on a batch that has been drawn.
    ///
    /// # Errors
    /// [`Error::Diverged`] after too many steps that were not finite.
    pub fn advance_on(&mut self, config: &FitConfig, batch: &Batch, source: &mut dyn GradientSource) -> Result<()> {
        let gradient = source.gradient(&self.weights, config.objective(), batch);
        self.apply(config, gradient)
    }

    /// Ends a step with its gradient, or with none.
    ///
    /// # Errors
    /// [`Error::Diverged`] after too many steps that were not finite.
    pub fn apply(&mut self, config: &FitConfig, gradient: Option<StepGradient>) -> Result<()> {
        if let Some(gradient) = gradient {
            self.loss = gradient.loss;
            let rate = self.rate_factor * Schedule::new(config).rate(self.step);
            let moved =
                gradient.loss.is_finite() && self.optimizer.step(config, rate, &mut self.weights, &gradient.d_weight);
            if moved {
                self.average_weights(config.ema_decay);
            } else {
                self.skipped += 1;
            }
        }
        self.step += 1;
        if self.skipped > config.max_skipped {
            return Err(Error::Diverged { step: self.step, skipped: self.skipped });
        }
        Ok(())
    }

    /// The average forgets its start: after `m` moves it decays by at most `(1 + m) / (10 + m)`.
    fn average_weights(&mut self, decay: f32) {
        let moves = self.optimizer.moves as f32;
        let decay = decay.min((1.0 + moves) / (10.0 + moves));
        for (average, weight) in self.average.iter_mut().zip(&self.weights) {
            *average = decay * *average + (1.0 - decay) * weight;
        }
    }
}
