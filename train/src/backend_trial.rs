//! The same short training run on several backends: throughput, memory, and agreement.

use std::time::Instant;

use headtail_model::{Head, Mode};
use headtail_render::random::Purpose;
use serde::Serialize;

use crate::{
    Backend, FitConfig, GradientForm, GradientSource, Result, Target,
    integrand::{Batch, BatchShape},
    peak_memory,
    reference::gradient_error,
    state::TrainingState,
};

/// A short training run.
#[derive(Clone, Debug)]
pub struct BackendTrial {
    /// The configuration; its backend and number of steps are ignored.
    pub config: FitConfig,
    /// Steps to run; with more than one, the first is not timed.
    pub steps: usize,
}

/// The result on one backend.
#[derive(Clone, Debug, Serialize)]
pub struct TrialRow {
    /// The backend.
    pub backend: Backend,
    /// The device's name.
    pub device: String,
    /// The coupling mode.
    pub mode: Mode,
    /// The form of the gradient.
    pub gradient: GradientForm,
    /// Points per second through forward pass, backward pass and optimiser.
    pub samples_per_second: f64,
    /// Points per second with the drawing of targets included.
    pub samples_per_second_with_targets: f64,
    /// Peak resident memory of the process during the trial; `None` where the system does not report it.
    pub peak_memory_bytes: Option<u64>,
    /// The last step's loss.
    pub final_loss: f32,
    /// The loss of every step.
    pub losses: Vec<f32>,
    /// The largest difference at any step from the losses given for comparison.
    pub largest_loss_difference: f32,
    /// The largest difference between the gradient along a few directions and central differences in f64,
    /// relative to the gradient's norm, at weights other than the initial ones.
    pub gradient_error: f64,
}

impl BackendTrial {
    /// Runs the trial on one backend. `others` are losses to compare with, for example another backend's; may
    /// be empty. `watch` is called after every step with the number of steps done.
    ///
    /// # Errors
    /// If the backend is not in this build, the configuration is out of range, or the target is not a
    /// density.
    pub fn run(
        &self,
        backend: Backend,
        target: &dyn Target,
        others: &[f32],
        watch: &dyn Fn(usize),
    ) -> Result<TrialRow> {
        let config = FitConfig { backend, steps: self.steps, ..self.config.clone() };
        config.validate()?;
        let device = backend.device()?;
        peak_memory::reset();
        let head = Head::new(config.head, config.seed, &device)?;
        let mut source = config.gradient.source(&head, backend, &device)?;
        let mut state = TrainingState::new(&config, head.flat_weights());
        let (mut losses, mut drawing, mut stepping, mut timed) = (Vec::new(), 0.0, 0.0, 0_usize);
        for step in 0..self.steps {
            let start = Instant::now();
            let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step as u64)?;
            let drawn = start.elapsed().as_secs_f64();
            let gradient = source.gradient(&state.parameters.weights, config.objective(), &batch)?;
            let outcome = state.move_by(&config, gradient);
            state.end_step(&config, outcome)?;
            if step > 0 || self.steps == 1 {
                drawing += drawn;
                stepping += start.elapsed().as_secs_f64() - drawn;
                timed += batch.densities.len();
            }
            losses.push(state.loss.unwrap_or(f32::NAN));
            watch(step + 1);
        }
        let own = self.seconds_of_own_steps(&config, target, &mut *source, head.flat_weights())?;
        let with_targets = own.unwrap_or(stepping + drawing);
        let peak_memory_bytes = peak_memory::bytes();
        let apart = |(a, b): (&f32, &f32)| (a - b).abs();
        let largest_loss_difference = losses.iter().zip(others).map(apart).fold(0.0, f32::max);
        Ok(TrialRow {
            backend,
            device: source.device(),
            mode: config.head.mode,
            gradient: config.gradient.on(backend),
            samples_per_second: timed as f64 / stepping,
            samples_per_second_with_targets: timed as f64 / with_targets,
            peak_memory_bytes,
            final_loss: losses.last().copied().unwrap_or(f32::NAN),
            losses,
            largest_loss_difference,
            gradient_error: self.parity(&config, target)?,
        })
    }

    /// Returns the seconds of as many timed steps from the start, if `source` takes steps by itself.
    fn seconds_of_own_steps(
        &self,
        config: &FitConfig,
        target: &dyn Target,
        source: &mut dyn GradientSource,
        weights: Vec<f32>,
    ) -> Result<Option<f64>> {
        let mut state = TrainingState::new(config, weights);
        let mut start = Instant::now();
        while state.step < self.steps {
            if state.step == 1 {
                start = Instant::now();
            }
            let most = if state.step == 0 { 1 } else { self.steps - state.step };
            let outcomes = source.take_steps(config, target, &mut state, most)?;
            if outcomes.is_empty() {
                return Ok(None);
            }
            outcomes.into_iter().try_for_each(|outcome| state.end_step(config, outcome))?;
        }
        Ok(Some(start.elapsed().as_secs_f64()))
    }

    /// Returns [`TrialRow::gradient_error`] on a small batch.
    fn parity(&self, config: &FitConfig, target: &dyn Target) -> Result<f64> {
        let device = config.backend.device()?;
        let shape = BatchShape { conditions: 4, strata: 6, brdf_samples: config.brdf_samples.min(8) };
        let batch = Batch::draw(target, shape, config.seed, Purpose::Validation, 1)?;
        let head = Head::new(config.head, config.seed, &device)?;
        // The last layers start at zero, which hides the other weights: perturb all.
        let moved = |(k, weight): (usize, f32)| weight + 0.05 * ((k * 7919 % 101) as f32 / 50.0 - 1.0);
        let weights: Vec<f32> = head.flat_weights().into_iter().enumerate().map(moved).collect();
        let objective = crate::Loss::LogChiSquare.into();
        let mut source = config.gradient.source(&head, config.backend, &device)?;
        let gradient = source.gradient(&weights, objective, &batch)?;
        Ok(gradient.map_or(f64::NAN, |found| gradient_error(&config.head, &weights, &batch, &found.d_weight)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CosineTarget, Error, test_support::studio};

    #[test]
    fn all_backends_and_forms_agree_with_the_reference_gradient_and_on_losses() {
        let tail = studio();
        let target = CosineTarget::new(&tail);
        for mode in [Mode::Coupled, Mode::Autoregressive] {
            let mut first: Option<TrialRow> = None;
            for (backend, gradient) in
                Backend::ALL.into_iter().flat_map(|backend| GradientForm::FORMS.map(|gradient| (backend, gradient)))
            {
                // The paper's rate: Adam's first moves have the gradient's sign at any size, so high rates
                // amplify rounding.
                let shape = FitConfig { conditions: 8, strata: 4, learning_rate: 1e-3, ..FitConfig::default() };
                let mut config = FitConfig { gradient, ..shape };
                config.head.mode = mode;
                let others = first.as_ref().map_or(&[][..], |row| &row.losses);
                let row = match (BackendTrial { config, steps: 3 }).run(backend, &target, others, &|_| {}) {
                    Ok(row) => row,
                    Err(Error::BackendNotCompiled { .. } | Error::DeviceNotCompiled) => continue,
                    Err(error) => panic!("{error}"),
                };
                // f32 rounding of sums of a few thousand terms; the required accuracy is 1e-4.
                assert!(row.gradient_error < 1e-4, "{row:?}");
                assert!(row.largest_loss_difference < 1e-3 && row.final_loss.is_finite(), "{row:?}");
                first.get_or_insert(row);
            }
        }
    }
}
