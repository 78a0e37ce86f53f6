//! The training loop.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use headtail_model::{Head, burn::prelude::Module};
use headtail_render::random::Purpose;
use serde::{Deserialize, Serialize};

use crate::{
    Divergence, Error, FitConfig, Result, Target, injection, optimizer::Optimizer, target::Batch,
    validation::Validation,
};

/// What is known after a step.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Steps done.
    pub step: usize,
    /// Steps in all.
    pub steps: usize,
    /// The step's loss on its batch.
    pub loss: f32,
    /// Validation, if this step had one.
    pub divergence: Option<Divergence>,
    /// Training points per second since the start, validation included.
    pub samples_per_second: f64,
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
/// weights, bit for bit. `progress` is called after every step. `interrupt` ends the run after the current step; what was learned so far is
/// returned (at a learning rate that has not come down yet).
///
/// # Errors
/// If the configuration is out of range, the backend is not in this build, the target is no density or zero everywhere, or
/// more than `max_skipped` steps were not finite.
pub fn fit(
    config: &FitConfig,
    target: &dyn Target,
    progress: &mut dyn FnMut(&Progress),
    interrupt: &AtomicBool,
) -> Result<Fitted> {
    config.validate()?;
    if config.head.condition != target.condition_length() {
        let value = config.head.condition.to_string();
        return Err(Error::Config {
            field: "head.condition",
            value,
            requirement: "the length of the target's condition",
        });
    }
    let device = config.backend.device()?;
    let trained = device.clone().autodiff();
    let start = Instant::now();
    let validation = Validation::new(target, config.validation_conditions, config.validation_strata, config.seed)?;
    let mut head = Head::new(config.head, config.seed, &trained)?;
    let mut optimizer = Optimizer::new(config);
    let initial = validation.divergence(&head.valid(), &device);
    let mut summary = Summary {
        steps: 0,
        interrupted: false,
        loss: f32::NAN,
        initial,
        divergence: initial,
        seconds: 0.0,
        skipped: 0,
    };

    // Reading logits back is cheap on the host and a synchronisation elsewhere.
    let gradients = if config.backend.is_host() { injection::injected } else { injection::in_graph };
    for step in 0..config.steps {
        if interrupt.load(Ordering::Relaxed) {
            summary.interrupted = true;
            break;
        }
        let shape = (config.conditions, config.strata);
        let batch = Batch::draw(target, shape, config.seed, Purpose::Batch, step as u64)?;
        if let Some((loss, gradients)) = gradients(&head, config.loss, &batch, &trained) {
            let moved;
            (head, moved) = if loss.is_finite() { optimizer.step(step, head, gradients) } else { (head, false) };
            if !moved {
                summary.skipped += 1;
                if summary.skipped > config.max_skipped {
                    return Err(Error::Diverged { step: step + 1, skipped: summary.skipped });
                }
            }
            summary.loss = loss;
        }
        summary.steps = step + 1;
        let due =
            config.validate_every > 0 && summary.steps % config.validate_every == 0 && summary.steps < config.steps;
        progress(&Progress {
            step: summary.steps,
            steps: config.steps,
            loss: summary.loss,
            divergence: due.then(|| validation.divergence(&head.valid(), &device)),
            samples_per_second: (summary.steps * config.conditions * config.samples()) as f64
                / start.elapsed().as_secs_f64(),
        });
    }

    let head = head.valid();
    summary.divergence = validation.divergence(&head, &device);
    summary.seconds = start.elapsed().as_secs_f64();
    Ok(Fitted { head, summary })
}
