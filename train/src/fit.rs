//! Training heads.

use std::{cmp, sync::atomic::AtomicBool};

use burn::prelude::Device;
use headtail_model::Head;
use headtail_render::random::Purpose;
use serde::{Deserialize, Serialize};

use crate::{
    Divergence, Error, FitConfig, GradientSource, Progress, Result, Run, StepGradient, Target, TrainingState,
    config::name_of,
    integrand::Batch,
    state::Outcome,
    trainer::{Trainable, Trainer},
    validation::Validation,
};

/// Statistics of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Steps done: fewer than configured if the run was interrupted.
    pub steps: usize,
    /// Whether the run was interrupted.
    pub interrupted: bool,
    /// The last step's loss.
    pub loss: f32,
    /// The untrained head's divergence: that of the tail alone.
    pub initial: Divergence,
    /// The trained head's divergence.
    pub divergence: Divergence,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Steps skipped because loss or gradient was not finite.
    pub skipped: usize,
    /// Whether training did not reduce the variance and the untrained head was kept (see
    /// [`FitConfig::fall_back`]).
    pub fell_back: bool,
}

/// A trained head, without autodiff, and the run's statistics.
pub struct Fitted {
    /// The head.
    pub head: Head,
    /// The statistics.
    pub summary: Summary,
}

/// Trains a head for `target`.
///
/// Weights and batches depend only on the configuration, which includes the seed; on one backend, the same
/// configuration gives bit-identical weights. `progress` is called before the first step, after every step
/// and at the end. `interrupt` ends the run after the current step and returns the weights so far (at a
/// learning rate that has not decayed yet).
///
/// # Errors
/// If the configuration is out of range or does not match the target, the backend is not in this build, the
/// target is not a density or zero everywhere, or more than `max_skipped` steps were not finite.
pub fn fit(
    config: &FitConfig,
    target: &dyn Target,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Fitted> {
    let mut report = |now: &Progress| {
        progress(now);
        Ok(())
    };
    fit_with(config, target, Run { progress: &mut report, interrupt, checkpoints: None, warn: &mut |_| {} })
}

/// Runs [`fit()`] with checkpoints. A run that is killed and resumed, at any moment and any number of times,
/// ends with bit-identical weights (on one backend).
///
/// # Errors
/// As [`fit()`], and errors of `run.checkpoints` and `run.progress`.
pub fn fit_with(config: &FitConfig, target: &dyn Target, run: Run<'_>) -> Result<Fitted> {
    config.validate()?;
    check_target(config, target)?;
    config.check_memory()?;
    let device = config.backend.device()?;
    let blank = Head::new(config.head, config.seed, &device)?;
    let points_per_step = config.conditions * config.batch_shape().samples();
    let state = TrainingState::new(config, blank.flat_weights());
    let mut trainer = Trainer::new(config, config, state, points_per_step, run)?;
    let validation = Validation::new(target, config.validation_shape(), config.seed)?;
    let source = config.gradient.source(&blank, config.backend, &device)?;
    let mut training = HeadTraining { config, target, source, validation, blank: &blank, device: &device };
    let initial = training.measure(&blank.flat_weights());
    trainer.report((trainer.state.step == 0).then_some(initial))?;
    let interrupted = trainer.train(&mut training)?;

    let mut weights = trainer.state.parameters.inference_weights();
    let mut divergence = training.measure(weights);
    let found = divergence.relative_variance;
    let best = trainer.state.best.as_ref();
    if let Some(best) = best.filter(|best| found.is_nan() || found > best.divergence.relative_variance) {
        divergence = best.divergence;
        weights = best.parameters.inference_weights();
    }
    let fell_back = config.fall_back
        && divergence.relative_variance.partial_cmp(&initial.relative_variance) != Some(cmp::Ordering::Less);
    if fell_back {
        divergence = initial;
    }
    let head = if fell_back { blank.clone() } else { blank.clone().with_flat_weights(weights, &device) };
    trainer.finish(Some(divergence))?;

    let (seconds, TrainingState { step: steps, loss, skipped, .. }) = (trainer.seconds(), trainer.state);
    let loss = loss.unwrap_or(f32::NAN);
    let summary = Summary { steps, interrupted, loss, initial, divergence, seconds, skipped, fell_back };
    Ok(Fitted { head, summary })
}

/// Training of a head.
struct HeadTraining<'a> {
    config: &'a FitConfig,
    target: &'a dyn Target,
    source: Box<dyn GradientSource>,
    validation: Validation,
    blank: &'a Head,
    device: &'a Device,
}

impl HeadTraining<'_> {
    fn measure(&self, weights: &[f32]) -> Divergence {
        self.validation.divergence(&self.blank.clone().with_flat_weights(weights, self.device), self.device)
    }
}

impl Trainable for HeadTraining<'_> {
    fn gradient(&mut self, weights: &[f32], step: usize) -> Result<Option<StepGradient>> {
        let Self { config, target, .. } = *self;
        let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step as u64)?;
        self.source.gradient(weights, config.objective(), &batch)
    }

    fn take_steps(&mut self, state: &mut TrainingState, most: usize) -> Result<Vec<Outcome>> {
        let every = self.config.validate_every;
        let most = state.step.checked_rem(every).map_or(most, |since| most.min(every - since));
        self.source.take_steps(self.config, self.target, state, most)
    }

    fn divergence(&mut self, state: &TrainingState) -> Option<Divergence> {
        // Never due if `validate_every` is 0: no step is a multiple of it.
        let is_due = state.step.is_multiple_of(self.config.validate_every);
        is_due.then(|| self.measure(state.parameters.inference_weights()))
    }
}

/// Checks that the target supports the configuration.
fn check_target(config: &FitConfig, target: &dyn Target) -> Result<()> {
    let refuse = |field, value: String, requirement| Err(Error::Config { field, value, requirement });
    if config.head.condition != target.condition() {
        return refuse("head.condition", name_of(config.head.condition), "that of the target");
    }
    if target.has_brdf_sampling() {
        return Ok(());
    }
    if config.head.share {
        return refuse("head.share", "true".into(), "false for a target without BRDF sampling");
    }
    if config.brdf_samples > 0 {
        return refuse("brdf_samples", config.brdf_samples.to_string(), "0 for a target without BRDF sampling");
    }
    Ok(())
}

#[cfg(test)]
mod tests;
