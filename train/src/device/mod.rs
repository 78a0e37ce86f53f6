//! A step's gradient on a graphics device, by shaders of ours and without a tensor library.
//!
//! Matrices are `[features, columns]` as in [`crate::fused`], with one column per point or per condition, in
//! one buffer, the arena. Whole conditions pass through the networks together, as many as memory allows; each
//! matrix product is one dispatch. Gradients are sums over slices of columns, which are added up in order: the
//! same seed on the same device gives the same bytes. The result equals that of [`crate::in_graph`] to
//! rounding.
//!
//! | file | concept |
//! | --- | --- |
//! | `dispatch.rs` | matrices in the arena; dispatches of the shaders |
//! | `engine.rs`, `plan.rs` | buffers and pipelines; all dispatches of a step |
//! | `memory.rs` | the networks of a head and their matrices |
//! | `conditions.rs`, `piece.rs` | what is computed per condition; per point, for some conditions |
//! | `targets.rs` | drawing targets |
//! | `flow.rs`, `coupling.rs` | the likelihood of a flow tail; its coupling layers |
//! | `optimizer.rs`, `steps.rs` | moving the weights; steps of a run without waiting for each |
//! | `profile.rs` | the time of each shader |
//! | `mod.rs` | a head on a device |

mod conditions;
mod coupling;
mod dispatch;
mod engine;
mod flow;
mod memory;
mod optimizer;
mod piece;
mod plan;
mod profile;
mod steps;
mod targets;

use headtail_model::Head;
pub use headtail_shaders::gpu::Gpu;
use headtail_shaders::gpu::GpuError;

use crate::{
    Error, FitConfig, GradientSource, Objective, Result, StepGradient, Target, TrainingState, fused::Layout,
    integrand::Batch, state::Outcome,
};

use dispatch::Matrix;
use engine::{Engine, Prepared};
pub use flow::DeviceFlow;
use memory::Shape;
use plan::Plan;
pub use profile::KernelTime;
use targets::Targets;

/// Points that pass through the networks together: many more than a device has threads. A card takes as many as the
/// paper's batch has, since the dispatches of a piece wait for one another.
fn points_together(gpu: &Gpu) -> usize {
    if gpu.is_card() { 1 << 18 } else { 1 << 16 }
}

/// Computes gradients of heads of one shape on a graphics device.
pub struct DeviceGradient {
    engine: Engine,
    layout: Layout,
    points: usize,
    prepared: Option<PreparedHead>,
}

/// What a shape of batches and an objective need.
struct PreparedHead {
    shape: Shape,
    objective: Objective,
    step: Prepared,
    /// The conditions, a matrix with one column each.
    seen: Matrix,
    /// What draws the targets, if the device does.
    targets: Option<Targets>,
}

impl From<GpuError> for Error {
    fn from(error: GpuError) -> Self {
        let reason = match error {
            GpuError::Failed(_) => {
                format!("{error}; a run with checkpoints can be resumed, also with gradient = \"fused\"")
            }
            error => error.to_string(),
        };
        Self::Device { reason }
    }
}

impl DeviceGradient {
    /// Prepares gradients of heads of the shape of `head`.
    ///
    /// # Errors
    /// If the device has too little memory.
    pub fn new(gpu: Gpu, head: &Head) -> Result<Self> {
        let layout = Layout::new(*head.config());
        assert_eq!(layout.length, head.weight_count(), "the layout is that of the head's flat weights");
        Ok(Self { points: points_together(&gpu), engine: Engine::new(gpu, layout.length)?, layout, prepared: None })
    }

    /// Sets how many points pass through the networks together, at least those of one condition: more keep a
    /// device busy, fewer need less memory. The gradient changes by rounding.
    #[must_use]
    pub fn in_pieces_of(mut self, points: usize) -> Self {
        self.points = points;
        self.prepared = None;
        self
    }

    /// Prepares buffers and pipelines, unless the last batch had the same shape.
    fn prepare(&mut self, shape: Shape, objective: Objective) -> Result<()> {
        if self.prepared.as_ref().is_some_and(|prepared| (prepared.shape, prepared.objective) == (shape, objective)) {
            return Ok(());
        }
        self.prepared = None;
        let largest = self.engine.gpu.largest_buffer();
        let (plan, seen) = Plan::of_head(&self.layout, shape, objective, self.points, largest)?;
        let what = "a batch: conditions, strata and brdf_samples";
        let step = self.engine.prepare(plan, shape.batch_length(), what)?;
        self.prepared = Some(PreparedHead { shape, objective, step, seen, targets: None });
        Ok(())
    }

    /// Uploads conditions of `length` numbers, one column each.
    fn upload_conditions(&self, prepared: &PreparedHead, conditions: &[f32], length: usize) {
        let Matrix { start, stride, .. } = prepared.seen;
        let mut rows = vec![0.0_f32; length * stride];
        for (column, condition) in conditions.chunks_exact(length).enumerate() {
            for (row, &value) in condition.iter().enumerate() {
                rows[row * stride + column] = value;
            }
        }
        self.engine.gpu.queue.write_buffer(&prepared.step.arena, 4 * start as u64, bytemuck::cast_slice(&rows));
    }

    fn upload(&self, prepared: &PreparedHead, batch: &Batch) {
        let lists =
            [&batch.points, &batch.densities, &batch.weights, &batch.brdf, &batch.tails, &batch.mixture_weight_logits];
        let mut start = 0;
        for numbers in lists {
            let bytes = bytemuck::cast_slice(numbers);
            self.engine.gpu.queue.write_buffer(&prepared.step.batch, 4 * start as u64, bytes);
            start += numbers.len();
        }
        self.upload_conditions(prepared, &batch.conditions, batch.condition_length);
    }
}

impl GradientSource for DeviceGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Result<Option<StepGradient>> {
        let shape = Shape { conditions: batch.condition_count(), samples: batch.samples };
        self.prepare(shape, objective)?;
        let Some(prepared) = &self.prepared else { return Ok(None) };
        self.upload(prepared, batch);
        self.engine.gradient(&prepared.step, weights)
    }

    fn take_steps(
        &mut self,
        config: &FitConfig,
        target: &dyn Target,
        state: &mut TrainingState,
        most: usize,
    ) -> Result<Vec<Outcome>> {
        self.prepare_steps(config, target)?;
        let Some(prepared) = &self.prepared else { return Ok(Vec::new()) };
        self.engine
            .take_steps(&prepared.step, config, state, most, |step| self.place_batch(prepared, config, target, step))
    }

    fn device(&self) -> String {
        self.engine.gpu.to_string()
    }
}
