//! The training loop.

use std::{
    cmp,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use headtail_model::Head;
use serde::{Deserialize, Serialize};

use crate::{
    CheckpointFolder, Divergence, Error, FitConfig, Result, Target, checkpoint::SavedRun, config::name_of,
    state::TrainingState, validation::Validation,
};

/// What is known after a step.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Progress {
    /// Steps done.
    pub step: usize,
    /// Steps in all.
    #[serde(skip)]
    pub steps: usize,
    /// The step's loss on its batch.
    pub loss: f32,
    /// Validation, if this step had one.
    #[serde(flatten)]
    pub divergence: Option<Divergence>,
    /// The step's learning rate.
    pub learning_rate: f64,
    /// Training points per second since the process began, validation included.
    pub samples_per_second: f64,
    /// Wall-clock seconds of training, over all processes of a resumed run.
    pub seconds: f64,
    /// Steps left out because loss or gradient was not finite.
    pub skipped: usize,
}

/// A training run in figures.
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
    /// Steps left out because loss or gradient was not finite.
    pub skipped: usize,
    /// Whether training did not help, and the untrained head was kept (see [`FitConfig::fall_back`]).
    pub fell_back: bool,
}

/// A trained head, without autodiff, and the run's figures.
pub struct Fitted {
    /// The head.
    pub head: Head,
    /// The figures.
    pub summary: Summary,
}

/// Trains a head for `target`.
///
/// Weights and batches depend on the configuration and its seed alone; on one backend the same configuration gives the same
/// weights, bit for bit. `progress` is called before the first step, after every step and at the end. `interrupt` ends the run after the current step; what was learned so far is
/// returned (at a learning rate that has not come down yet).
///
/// # Errors
/// If the configuration is out of range or asks of the target what it does not have, the backend is not in this build, the
/// target is no density or zero everywhere, or more than `max_skipped` steps were not finite.
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

/// What surrounds a training run.
pub struct Run<'a> {
    /// Called at the start, after every step and at the end; an error of its own ends the run.
    pub progress: &'a mut dyn FnMut(&Progress) -> Result<()>,
    /// Ends the run after the current step.
    pub interrupt: &'a AtomicBool,
    /// Where to save checkpoints and to go on from.
    pub checkpoints: Option<&'a CheckpointFolder>,
    /// Told of checkpoints that cannot be used.
    pub warn: &'a mut dyn FnMut(&Error),
}

/// [`fit()`] with checkpoints. A run that is killed and resumed, at any moment and any number of times, ends with the weights of one
/// that was not, bit for bit (on one backend).
///
/// # Errors
/// As [`fit()`], and those of [`CheckpointFolder`] and of `run.progress`.
pub fn fit_with(config: &FitConfig, target: &dyn Target, run: Run<'_>) -> Result<Fitted> {
    let Run { progress, interrupt, checkpoints, warn } = run;
    config.validate()?;
    check_target(config, target)?;
    config.check_memory()?;
    let device = config.backend.device()?;
    let blank = Head::new(config.head, config.seed, &device)?;
    let mut state = TrainingState::new(config, blank.flat_weights());
    let saved = match checkpoints {
        Some(checkpoints) => checkpoints.open(config, blank.weight_count(), warn)?,
        None => None,
    };
    let start = Instant::now();
    let validation = Validation::new(target, config.validation_shape(), config.seed)?;
    let head = |state: &TrainingState| blank.clone().with_flat_weights(state.best_weights(), &device);
    let divergence = |state: &TrainingState| validation.divergence(&head(state), &device);
    let initial = divergence(&state);
    let mut earlier_seconds = 0.0;
    if let Some(saved) = saved {
        earlier_seconds = saved.seconds;
        state = saved.state;
    }
    let first_step = state.step;
    let report = |state: &TrainingState, divergence: Option<Divergence>| Progress {
        step: state.step,
        steps: config.steps,
        loss: state.loss,
        divergence,
        learning_rate: state.last_rate(config),
        samples_per_second: ((state.step - first_step) * config.conditions * config.batch_shape().samples()) as f64
            / start.elapsed().as_secs_f64(),
        seconds: earlier_seconds + start.elapsed().as_secs_f64(),
        skipped: state.skipped,
    };
    let save = |state: &TrainingState| match checkpoints {
        Some(checkpoints) => {
            let seconds = earlier_seconds + start.elapsed().as_secs_f64();
            checkpoints.save(config, &SavedRun { state: state.clone(), seconds })
        }
        None => Ok(()),
    };

    progress(&report(&state, (first_step == 0).then_some(initial)))?;
    let mut source = config.gradient.source(&blank, config.backend, &device);
    let mut interrupted = false;
    while state.step < config.steps {
        interrupted = interrupt.load(Ordering::Relaxed);
        if interrupted {
            break;
        }
        state.advance(config, target, &mut *source)?;
        if state.step == config.steps {
            break;
        }
        // Never due where `validate_every` is 0: no step is a multiple of it.
        let due = state.step.is_multiple_of(config.validate_every);
        let found = due.then(|| divergence(&state));
        // Before the checkpoint: a run that goes on from it has been told of everything up to it.
        progress(&report(&state, found))?;
        if let Some(found) = found {
            state.judge(config, found);
        }
        if checkpoints.is_some_and(|checkpoints| checkpoints.is_due(state.step)) {
            save(&state)?;
        }
    }
    let mut last = divergence(&state);
    let mut weights = state.best_weights().to_vec();
    let least = state
        .kept
        .as_ref()
        .filter(|kept| last.relative_variance.is_nan() || last.relative_variance > kept.divergence.relative_variance);
    if let Some(kept) = least {
        last = kept.divergence;
        weights = kept.best_weights().to_vec();
    }
    let fell_back =
        config.fall_back && last.relative_variance.partial_cmp(&initial.relative_variance) != Some(cmp::Ordering::Less);
    if fell_back {
        last = initial;
    }
    progress(&report(&state, Some(last)))?;
    save(&state)?;

    let summary = Summary {
        steps: state.step,
        interrupted,
        loss: state.loss,
        initial,
        divergence: last,
        seconds: earlier_seconds + start.elapsed().as_secs_f64(),
        skipped: state.skipped,
        fell_back,
    };
    let head = if fell_back { blank.clone() } else { blank.clone().with_flat_weights(&weights, &device) };
    Ok(Fitted { head, summary })
}

/// Checks that the target has what the configuration asks of it.
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
