//! The optimiser on the device: several steps of a run, without waiting for any.

use headtail_shaders::{gpu::Gpu, training};

use super::dispatch::spread;
use crate::{
    FitConfig, Result, TrainingState,
    state::{Outcome, average_decay},
};

/// Steps between two looks at what became of them, at most.
pub const MOST_STEPS: usize = 256;

/// What became of a step, as the shader says it.
const MOVED: f32 = 0.0;
const SKIPPED: f32 = 1.0;

/// AdamW and its state.
pub struct Optimizer {
    judge: wgpu::ComputePipeline,
    move_weights: wgpu::ComputePipeline,
    judge_group: wgpu::BindGroup,
    group: wgpu::BindGroup,
    /// First and second moments, and the moving average.
    state: wgpu::Buffer,
    /// Numbers of the shader, see there.
    steps: wgpu::Buffer,
    weights: usize,
}

impl Optimizer {
    /// `gradient` is its place in the arena. All calls are for the same settings.
    pub fn new(
        gpu: &Gpu,
        config: &FitConfig,
        conditions: usize,
        gradient: usize,
        [weights, arena]: [&wgpu::Buffer; 2],
    ) -> Result<Self> {
        let count = (weights.size() / 4) as usize;
        let sizes = [count, conditions, gradient, MOST_STEPS, (config.ema_decay > 0.0).into()];
        let source =
            training::optimizer(sizes, [config.beta_1, config.beta_2, config.epsilon, config.clip_norm as f32]);
        let [judge, move_weights] = ["judge", "move_weights"].map(|entry| gpu.pipeline(None, &source, entry));
        let state = gpu.buffer("the optimiser's state", 12 * count as u64)?;
        let steps = gpu.buffer("the optimiser's steps", 16 * (1 + 2 * MOST_STEPS) as u64)?;
        let judge_group = gpu.bind(&judge, &[arena, &steps]);
        let group = gpu.bind(&move_weights, &[arena, &steps, weights, &state]);
        gpu.check()?;
        Ok(Self { judge, move_weights, judge_group, group, state, steps, weights: count })
    }

    /// Uploads the parameters of `state`, and what depends on the numbers of the next steps and moves.
    pub fn begin(&self, gpu: &Gpu, config: &FitConfig, state: &TrainingState, weights: &wgpu::Buffer) {
        let [given, average, first, second] = state.parameters.lists().map(|(_, list)| list);
        gpu.queue.write_buffer(weights, 0, bytemuck::cast_slice(given));
        for (place, list) in [first, second, average].into_iter().enumerate() {
            gpu.queue.write_buffer(&self.state, (4 * place * self.weights) as u64, bytemuck::cast_slice(list));
        }
        let step = |k: usize| {
            let rate = state.learning_rate(config, state.step + k);
            [rate as f32, (1.0 - rate * f64::from(config.weight_decay)) as f32, 0.0, 0.0]
        };
        let after = |moves: u64| {
            let correction = |beta: f32| 1.0 - f64::from(beta).powf(moves as f64);
            let [first, root] = [1.0 / correction(config.beta_1), 1.0 / correction(config.beta_2).sqrt()];
            [first as f32, root as f32, average_decay(config.ema_decay, moves), 0.0]
        };
        let moves = (1..=MOST_STEPS as u64).map(|number| after(state.parameters.optimizer.moves + number));
        let numbers: Vec<[f32; 4]> = [[0.0; 4]].into_iter().chain((0..MOST_STEPS).map(step)).chain(moves).collect();
        gpu.queue.write_buffer(&self.steps, 0, bytemuck::cast_slice(&numbers));
    }

    /// Takes a step by the gradient in the arena.
    pub fn run(&self, gpu: &Gpu) -> wgpu::SubmissionIndex {
        gpu.submit(&self.judge, &self.judge_group, [1, 1]);
        gpu.submit(&self.move_weights, &self.group, spread(self.weights))
    }

    /// Waits for `count` steps, and returns what became of each; `state` has the parameters after the last one.
    pub fn end(
        &self,
        gpu: &Gpu,
        count: usize,
        state: &mut TrainingState,
        weights: &wgpu::Buffer,
    ) -> Result<Vec<Outcome>> {
        let steps: Vec<[f32; 4]> = gpu.read(&self.steps, 0, 1 + count)?;
        let outcome = |&[_, _, loss, kind]: &[f32; 4]| match kind {
            MOVED => Outcome::Moved(loss),
            SKIPPED => Outcome::Skipped(loss),
            _ => Outcome::Dark,
        };
        let outcomes: Vec<Outcome> = steps[1..].iter().map(outcome).collect();
        let moved = outcomes.iter().filter(|outcome| matches!(outcome, Outcome::Moved(_))).count();
        let parameters = &mut state.parameters;
        parameters.optimizer.moves += moved as u64;
        let [own, average, first, second] = parameters.lists_mut();
        *own = gpu.read(weights, 0, self.weights)?;
        for (place, list) in [first, second, average].into_iter().enumerate().filter(|(_, list)| !list.is_empty()) {
            *list = gpu.read(&self.state, (place * self.weights) as u64, self.weights)?;
        }
        Ok(outcomes)
    }
}
