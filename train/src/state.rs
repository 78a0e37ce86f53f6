//! The state of a training run between two steps: all that the next step depends on, besides the configuration.

use headtail_render::random::Purpose;

use crate::{
    Error, FitConfig, GradientSource, Result, StepGradient, Target,
    integrand::Batch,
    optimizer::{Optimizer, OptimizerState},
};

/// Weights, optimiser and counters. Batches are not part of it: they are functions of (seed, step).
#[derive(Clone, Debug)]
pub struct TrainingState {
    /// Steps done.
    pub step: usize,
    /// Steps left out because loss or gradient was not finite.
    pub skipped: usize,
    /// The last step's loss.
    pub loss: f32,
    weights: Vec<f32>,
    /// The moving average of the weights; empty where it is off.
    average: Vec<f32>,
    optimizer: Optimizer,
}

/// A [`TrainingState`] as plain numbers, for a checkpoint.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedState {
    /// Steps done.
    pub step: usize,
    /// Steps left out.
    pub skipped: usize,
    /// The last step's loss.
    pub loss: f32,
    /// The weights, in the order of [`headtail_model::Head::flat_weights`].
    pub weights: Vec<f32>,
    /// Their moving average, or empty.
    pub average: Vec<f32>,
    /// The optimiser's moments.
    pub optimizer: OptimizerState,
}

impl TrainingState {
    /// Before the first step.
    pub fn new(config: &FitConfig, weights: Vec<f32>) -> Self {
        let average = if config.ema_decay > 0.0 { weights.clone() } else { Vec::new() };
        Self { step: 0, skipped: 0, loss: f32::NAN, optimizer: Optimizer::new(config, weights.len()), weights, average }
    }

    /// The state in numbers.
    pub fn save(&self) -> SavedState {
        SavedState {
            step: self.step,
            skipped: self.skipped,
            loss: self.loss,
            weights: self.weights.clone(),
            average: self.average.clone(),
            optimizer: self.optimizer.state().clone(),
        }
    }

    /// The state that was saved under the same configuration.
    pub fn restore(config: &FitConfig, saved: SavedState) -> Self {
        let mut optimizer = Optimizer::new(config, saved.weights.len());
        optimizer.restore(saved.optimizer);
        Self {
            step: saved.step,
            skipped: saved.skipped,
            loss: saved.loss,
            weights: saved.weights,
            average: saved.average,
            optimizer,
        }
    }

    /// The weights for use: the moving average where there is one.
    pub fn best_weights(&self) -> &[f32] {
        if self.average.is_empty() { &self.weights } else { &self.average }
    }

    /// The learning rate of the step that was done last.
    pub fn last_rate(&self) -> f64 {
        self.optimizer.rate(self.step.saturating_sub(1))
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

    /// The weights.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Ends a step with its gradient, or with none.
    ///
    /// # Errors
    /// [`Error::Diverged`] after too many steps that were not finite.
    pub fn apply(&mut self, config: &FitConfig, gradient: Option<StepGradient>) -> Result<()> {
        if let Some(gradient) = gradient {
            self.loss = gradient.loss;
            let moved =
                gradient.loss.is_finite() && self.optimizer.step(self.step, &mut self.weights, &gradient.d_weight);
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
        let moves = self.optimizer.state().moves as f32;
        let decay = decay.min((1.0 + moves) / (10.0 + moves));
        for (average, weight) in self.average.iter_mut().zip(&self.weights) {
            *average = decay * *average + (1.0 - decay) * weight;
        }
    }
}
