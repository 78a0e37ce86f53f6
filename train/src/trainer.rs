//! The training loop of heads, flow tails, neural materials and rivals.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use serde::Serialize;
use serde_json::Value;

use crate::{
    Divergence, Error, FitConfig, Result, StepGradient,
    state::{Outcome, TrainingState, as_json},
};

/// Statistics after a step.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Progress {
    /// Steps done.
    pub step: usize,
    /// Total steps.
    #[serde(skip)]
    pub steps: usize,
    /// The step's loss on its batch.
    pub loss: f32,
    /// Decaying mean of the losses, over about 50 steps.
    #[serde(skip)]
    pub mean_loss: Option<f32>,
    /// Validation, if this step had one.
    #[serde(flatten)]
    pub divergence: Option<Divergence>,
    /// The step's learning rate.
    pub learning_rate: f64,
    /// Training points per second since the process started, validation included.
    pub samples_per_second: f64,
    /// Wall-clock seconds of training, over all processes of a resumed run.
    pub seconds: f64,
    /// Steps skipped because loss or gradient was not finite.
    pub skipped: usize,
}

/// The environment of a training run: callbacks and checkpoints.
pub struct Run<'a> {
    /// Called after every step, at the end, and, except for flow tails, at the start; its error ends the run.
    pub progress: &'a mut dyn FnMut(&Progress) -> Result<()>,
    /// Ends the run after the current step.
    pub interrupt: &'a AtomicBool,
    /// Where to save and resume the run: a [`crate::CheckpointFolder`] or a [`crate::StateFile`].
    pub checkpoints: Option<&'a dyn Checkpoints>,
    /// Called with checkpoints that cannot be used.
    pub warn: &'a mut dyn FnMut(&Error),
}

/// Saved states of a run.
pub trait Checkpoints {
    /// Returns the number of steps between two saves; 0 saves only at the end and on interruption.
    fn every(&self) -> usize;

    /// Returns the state to resume from: `None` if nothing is saved yet. `settings` are those of the run,
    /// `blank` is its state before the first step; `warn` is called for damaged checkpoints.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if a checkpoint belongs to another run or version, or cannot be read.
    fn open(
        &self,
        settings: &Value,
        blank: &TrainingState,
        warn: &mut dyn FnMut(&Error),
    ) -> Result<Option<TrainingState>>;

    /// Saves a state.
    ///
    /// # Errors
    /// If the file cannot be written.
    fn save(&self, settings: &Value, state: &TrainingState) -> Result<()>;
}

/// A model that a [`Trainer`] trains.
pub(crate) trait Trainable {
    /// Returns loss and gradient of `step`, a function of the settings and the arguments; `None` if the batch
    /// has no light. The caller skips results that are not finite.
    fn gradient(&mut self, weights: &[f32], step: usize) -> Result<Option<StepGradient>>;

    /// Takes steps of `state` by itself, at most `most`, and returns what became of each; nothing if the trainer takes
    /// them, by [`Self::gradient`]. The parameters of `state` move, all else is left to the caller, who needs
    /// none of the parameters in between.
    fn take_steps(&mut self, _state: &mut TrainingState, _most: usize) -> Result<Vec<Outcome>> {
        Ok(Vec::new())
    }

    /// Returns whether training ends before all steps are done.
    fn is_done(&mut self, _state: &TrainingState) -> Result<bool> {
        Ok(false)
    }

    /// Returns the divergence of the state after a step, if it is measured.
    fn divergence(&mut self, _state: &TrainingState) -> Option<Divergence> {
        None
    }
}

impl<F: FnMut(&[f32], usize) -> Result<Option<StepGradient>>> Trainable for F {
    fn gradient(&mut self, weights: &[f32], step: usize) -> Result<Option<StepGradient>> {
        self(weights, step)
    }
}

/// A run in progress.
pub(crate) struct Trainer<'a> {
    pub state: TrainingState,
    config: FitConfig,
    settings: Value,
    samples_per_step: usize,
    run: Run<'a>,
    first_step: usize,
    earlier_seconds: f64,
    start: Instant,
}

impl<'a> Trainer<'a> {
    /// Starts a run from `blank`, its state before the first step, or from its checkpoint. `config` sets the
    /// optimiser and the number of steps; a checkpoint must agree on `settings`.
    pub fn new(
        config: &FitConfig,
        settings: &impl Serialize,
        blank: TrainingState,
        samples_per_step: usize,
        run: Run<'a>,
    ) -> Result<Self> {
        let settings = as_json(settings);
        let saved = match run.checkpoints {
            Some(checkpoints) => checkpoints.open(&settings, &blank, run.warn)?,
            None => None,
        };
        let state = saved.unwrap_or(blank);
        let (config, first_step, earlier_seconds) = (config.clone(), state.step, state.seconds);
        let start = Instant::now();
        Ok(Self { state, config, settings, samples_per_step, run, first_step, earlier_seconds, start })
    }

    /// Runs to the end without validation and returns the last state.
    pub fn run(mut self, training: &mut dyn Trainable) -> Result<TrainingState> {
        self.report(None)?;
        self.train(training)?;
        self.finish(None)?;
        Ok(self.state)
    }

    /// Takes steps until all are done or [`Trainable::is_done`], and returns whether an
    /// interruption came first. The last step is neither reported nor saved: see [`Self::finish`].
    pub fn train(&mut self, training: &mut dyn Trainable) -> Result<bool> {
        while self.state.step < self.config.steps && !training.is_done(&self.state)? {
            if self.run.interrupt.load(Ordering::Relaxed) {
                return Ok(true);
            }
            let most = self.steps_to_the_next_save();
            let mut outcomes = training.take_steps(&mut self.state, most)?;
            if outcomes.is_empty() {
                let gradient = training.gradient(&self.state.parameters.weights, self.state.step)?;
                outcomes.push(self.state.move_by(&self.config, gradient));
            }
            for outcome in outcomes {
                self.state.end_step(&self.config, outcome)?;
                if self.state.step < self.config.steps {
                    self.follow(training)?;
                }
            }
        }
        Ok(false)
    }

    /// Returns the number of steps up to the next checkpoint or the end.
    fn steps_to_the_next_save(&self) -> usize {
        let every = self.run.checkpoints.map_or(0, Checkpoints::every);
        let left = self.config.steps - self.state.step;
        self.state.step.checked_rem(every).map_or(left, |since| left.min(every - since))
    }

    /// Reports, validates and saves what is due after a step that is not the last.
    fn follow(&mut self, training: &mut dyn Trainable) -> Result<()> {
        let divergence = training.divergence(&self.state);
        // Before the checkpoint, so that a resumed run has reported everything up to it.
        self.report(divergence)?;
        if let Some(divergence) = divergence {
            self.state.judge(&self.config, divergence);
        }
        if self.run.checkpoints.is_some_and(|checkpoints| self.state.step.is_multiple_of(checkpoints.every())) {
            self.save()?;
        }
        Ok(())
    }

    /// Reports the end of the run and saves it.
    pub fn finish(&mut self, divergence: Option<Divergence>) -> Result<()> {
        self.report(divergence)?;
        // A resumed run that takes no step is saved already.
        if self.first_step == 0 || self.state.step > self.first_step { self.save() } else { Ok(()) }
    }

    /// Reports the state.
    pub fn report(&mut self, divergence: Option<Divergence>) -> Result<()> {
        let (state, taken) = (&self.state, self.state.step - self.first_step);
        let progress = Progress {
            step: state.step,
            steps: self.config.steps,
            loss: state.loss.unwrap_or(f32::NAN),
            mean_loss: state.mean_loss,
            divergence,
            learning_rate: state.learning_rate(&self.config, state.step.saturating_sub(1)),
            samples_per_second: (taken * self.samples_per_step) as f64 / self.start.elapsed().as_secs_f64(),
            seconds: self.seconds(),
            skipped: state.skipped,
        };
        (self.run.progress)(&progress)
    }

    /// Returns the wall-clock seconds of the run, over all its processes.
    pub fn seconds(&self) -> f64 {
        self.earlier_seconds + self.start.elapsed().as_secs_f64()
    }

    fn save(&mut self) -> Result<()> {
        self.state.seconds = self.seconds();
        self.run.checkpoints.map_or(Ok(()), |checkpoints| checkpoints.save(&self.settings, &self.state))
    }
}
