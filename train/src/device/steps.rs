//! Steps of a run that stay on the device.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use headtail_render::random::Purpose;

use super::{
    DeviceGradient, PreparedHead,
    engine::{Engine, Prepared},
    memory::Shape,
    optimizer::MOST_STEPS,
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

impl Engine {
    /// Takes steps of `state`, at most `most`, and returns what became of each; `place` places the batch of a step in
    /// its buffer. Takes none if `prepared` has no optimiser.
    pub fn take_steps(
        &self,
        prepared: &Prepared,
        config: &FitConfig,
        state: &mut TrainingState,
        most: usize,
        mut place: impl FnMut(u64) -> Result<()>,
    ) -> Result<Vec<Outcome>> {
        let Some(optimizer) = &prepared.optimizer else { return Ok(Vec::new()) };
        optimizer.begin(&self.gpu, config, state, &self.weights);
        let (start, mut submitted, mut count) = (Instant::now(), VecDeque::new(), 0);
        while count < most.min(MOST_STEPS) && (count == 0 || start.elapsed() < UNSEEN) {
            place((state.step + count) as u64)?;
            self.run(prepared);
            submitted.push_back(optimizer.run(&self.gpu));
            count += 1;
            if let Some(work) = (submitted.len() > AHEAD).then(|| submitted.pop_front()).flatten() {
                self.gpu.wait(work)?;
            }
        }
        optimizer.end(&self.gpu, count, state, &self.weights)
    }
}

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
        let numbers: Vec<f32> = self.engine.gpu.read(&prepared.step.batch, 0, 6 * points)?;
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

    /// Prepares what draws targets and moves weights, unless that is done.
    pub(super) fn prepare_steps(&mut self, config: &FitConfig, target: &dyn Target) -> Result<()> {
        let shape = config.batch_shape();
        self.prepare(Shape { conditions: shape.conditions, samples: shape.samples() }, config.objective())?;
        let Some(prepared) = &mut self.prepared else { return Ok(()) };
        self.engine.prepare_optimizer(&mut prepared.step, config)?;
        if let (None, Some(known)) = (&prepared.targets, target.shader_target()) {
            let buffers = [&prepared.step.batch, &prepared.step.arena];
            prepared.targets = Some(Targets::new(&self.engine.gpu, known, shape, prepared.seen, buffers)?);
        }
        Ok(())
    }

    /// Places the batch of a step: draws it on the device, or uploads it if shaders do not know the target.
    pub(super) fn place_batch(
        &self,
        prepared: &PreparedHead,
        config: &FitConfig,
        target: &dyn Target,
        step: u64,
    ) -> Result<()> {
        match &prepared.targets {
            Some(targets) => drop(self.draw(prepared, targets, config, target, step)),
            None => {
                let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step)?;
                self.upload(prepared, &batch);
            }
        }
        Ok(())
    }

    /// Draws the batch of a step: its conditions here, and the points on the device.
    fn draw(
        &self,
        prepared: &PreparedHead,
        targets: &Targets,
        config: &FitConfig,
        target: &dyn Target,
        step: u64,
    ) -> BatchConditions {
        let drawn = BatchConditions::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step);
        let logits = 4 * (prepared.shape.batch_length() - prepared.shape.conditions) as u64;
        let gpu = &self.engine.gpu;
        gpu.queue.write_buffer(&prepared.step.batch, logits, bytemuck::cast_slice(&drawn.mixture_weight_logits));
        self.upload_conditions(prepared, &drawn.conditions, drawn.condition_length);
        targets.run(gpu, config.seed, step, &drawn.positions);
        drawn
    }
}
