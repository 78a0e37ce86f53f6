//! Steps of a run that stay on the device.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use headtail_render::random::Purpose;

use super::{
    DeviceGradient, Prepared,
    memory::Shape,
    optimizer::{MOST_STEPS, Optimizer},
    targets::Targets,
};
use crate::{
    FitConfig, Result, Target, TrainingState,
    integrand::{Batch, BatchConditions},
    state::Outcome,
};

/// Steps that are submitted before the first of them has ended: enough to keep a device busy.
const AHEAD: usize = 4;

/// How long steps are taken without a look at what became of them, about: progress and interruptions wait as long.
const UNSEEN: Duration = Duration::from_millis(250);

impl DeviceGradient {
    /// Returns the batch of a step as the device draws it; `None` for a target that shaders do not know.
    ///
    /// # Errors
    /// If the device fails or has too little memory.
    pub fn batch(&mut self, config: &FitConfig, target: &dyn Target, step: u64) -> Result<Option<Batch>> {
        self.prepare_steps(config, target)?;
        let Some((prepared, targets)) = self.prepared.as_ref().and_then(|own| Some((own, own.targets.as_ref()?)))
        else {
            return Ok(None);
        };
        let drawn = self.draw(prepared, targets, config, target, step);
        let BatchConditions { condition_length, conditions, mixture_weight_logits, .. } = drawn;
        let (samples, points) = (prepared.shape.samples, prepared.shape.points());
        let numbers: Vec<f32> = self.gpu.read(&prepared.batch, 0, 6 * points)?;
        let list = |first: usize, length: usize| numbers[first * points..][..length * points].to_vec();
        Ok(Some(Batch {
            condition_length,
            samples,
            conditions,
            points: list(0, 2),
            densities: list(2, 1),
            weights: list(3, 1),
            brdf: list(4, 1),
            tails: list(5, 1),
            mixture_weight_logits,
        }))
    }

    /// See [`crate::GradientSource::take_steps`].
    pub(super) fn steps(
        &mut self,
        config: &FitConfig,
        target: &dyn Target,
        state: &mut TrainingState,
        most: usize,
    ) -> Result<Vec<Outcome>> {
        self.prepare_steps(config, target)?;
        let Some((prepared, optimizer)) = self.prepared.as_ref().and_then(|own| Some((own, own.optimizer.as_ref()?)))
        else {
            return Ok(Vec::new());
        };
        optimizer.begin(&self.gpu, config, state, &self.weights);
        let (start, mut submitted, mut count) = (Instant::now(), VecDeque::new(), 0);
        while count < most.min(MOST_STEPS) && (count == 0 || start.elapsed() < UNSEEN) {
            let step = (state.step + count) as u64;
            match &prepared.targets {
                Some(targets) => drop(self.draw(prepared, targets, config, target, step)),
                None => {
                    let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step)?;
                    self.upload(prepared, &batch);
                }
            }
            self.run(prepared);
            submitted.push_back(optimizer.run(&self.gpu));
            count += 1;
            if let Some(work) = (submitted.len() > AHEAD).then(|| submitted.pop_front()).flatten() {
                self.gpu.wait(work)?;
            }
        }
        optimizer.end(&self.gpu, count, state, &self.weights)
    }

    /// Prepares what draws targets and moves weights, unless that is done.
    fn prepare_steps(&mut self, config: &FitConfig, target: &dyn Target) -> Result<()> {
        let shape = config.batch_shape();
        self.prepare(Shape { conditions: shape.conditions, samples: shape.samples() }, config.objective())?;
        let Some(prepared) = &mut self.prepared else { return Ok(()) };
        if prepared.optimizer.is_none() {
            let buffers = [&self.weights, &prepared.arena];
            prepared.optimizer =
                Some(Optimizer::new(&self.gpu, config, prepared.shape, prepared.plan.results, buffers)?);
        }
        if let (None, Some(known)) = (&prepared.targets, target.shader_target()) {
            let buffers = [&prepared.batch, &prepared.arena];
            prepared.targets = Some(Targets::new(&self.gpu, known, shape, &prepared.plan, buffers)?);
        }
        Ok(())
    }

    /// Draws the batch of a step: its conditions here, and the points on the device.
    fn draw(
        &self,
        prepared: &Prepared,
        targets: &Targets,
        config: &FitConfig,
        target: &dyn Target,
        step: u64,
    ) -> BatchConditions {
        let drawn = BatchConditions::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step);
        let logits = 4 * (prepared.shape.batch_length() - prepared.shape.conditions) as u64;
        self.gpu.queue.write_buffer(&prepared.batch, logits, bytemuck::cast_slice(&drawn.mixture_weight_logits));
        self.upload_conditions(prepared, &drawn.conditions, drawn.condition_length);
        targets.run(&self.gpu, config.seed, step, &drawn.positions);
        drawn
    }
}
