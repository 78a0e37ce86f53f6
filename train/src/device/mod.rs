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
//! | `memory.rs` | the networks of a head and their matrices |
//! | `conditions.rs`, `piece.rs` | what is computed per condition; per point, for some conditions |
//! | `plan.rs` | all dispatches of a step |
//! | `targets.rs` | drawing targets |
//! | `optimizer.rs`, `steps.rs` | moving the weights; steps of a run without waiting for each |
//! | `profile.rs` | the time of each shader |
//! | `mod.rs` | buffers, pipelines, and a step |

mod conditions;
mod dispatch;
mod memory;
mod optimizer;
mod piece;
mod plan;
mod profile;
mod steps;
mod targets;

use std::collections::HashMap;

use headtail_model::Head;
use headtail_shaders::{
    gpu::{Gpu, GpuError},
    training::Kernel,
};
use wgpu::{BufferBindingType, BufferUsages, ShaderStages};

use crate::{
    Error, FitConfig, GradientSource, Objective, Result, StepGradient, Target, TrainingState, fused::Layout,
    integrand::Batch, state::Outcome,
};

use dispatch::Dispatch;
use memory::Shape;
use optimizer::Optimizer;
use plan::Plan;
pub use profile::KernelTime;
use targets::Targets;

/// Distance of the parameters of dispatches in their buffer, in bytes: the largest alignment that adapters
/// require.
const PARAMETERS: u64 = 256;

/// Points that pass through the networks together: many more than a device has threads. A card takes as many as the
/// paper's batch has, since the dispatches of a piece wait for one another.
const POINTS: usize = 1 << 16;
const POINTS_OF_CARD: usize = 1 << 18;

/// Computes gradients of heads of one shape on a graphics device.
pub struct DeviceGradient {
    gpu: Gpu,
    layout: Layout,
    bindings: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    pipelines: HashMap<Kernel, wgpu::ComputePipeline>,
    weights: wgpu::Buffer,
    points: usize,
    prepared: Option<Prepared>,
}

/// What a shape of batches and an objective need.
struct Prepared {
    shape: Shape,
    objective: Objective,
    plan: Plan,
    batch: wgpu::Buffer,
    arena: wgpu::Buffer,
    group: wgpu::BindGroup,
    /// What draws the targets, if the device does.
    targets: Option<Targets>,
    /// What moves the weights, if the device does.
    optimizer: Option<Optimizer>,
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
    /// Opens the fastest adapter for heads of the shape of `head`, a software adapter where there is no other.
    ///
    /// # Errors
    /// If there is no adapter, or it cannot be opened.
    pub fn new(head: &Head) -> Result<Self> {
        Self::on(Gpu::open()?, head)
    }

    /// Returns gradients on a graphics card; `None` without one.
    ///
    /// # Errors
    /// If there is one that cannot be opened.
    pub fn on_graphics_card(head: &Head) -> Result<Option<Self>> {
        Gpu::open_card()?.map(|gpu| Self::on(gpu, head)).transpose()
    }

    fn on(gpu: Gpu, head: &Head) -> Result<Self> {
        let points = if gpu.is_card() { POINTS_OF_CARD } else { POINTS };
        let layout = Layout::new(*head.config());
        assert_eq!(layout.length, head.weight_count(), "the layout is that of the head's flat weights");
        let bindings = bindings(&gpu.device);
        let descriptor =
            wgpu::PipelineLayoutDescriptor { label: None, bind_group_layouts: &[Some(&bindings)], immediate_size: 0 };
        let pipeline_layout = gpu.device.create_pipeline_layout(&descriptor);
        let weights = gpu.buffer("the head's weights", 4 * layout.length as u64)?;
        Ok(Self { gpu, layout, bindings, pipeline_layout, pipelines: HashMap::new(), weights, points, prepared: None })
    }

    /// Sets how many points pass through the networks together, at least those of one condition: more keep a
    /// device busy, fewer need less memory. The gradient changes by rounding.
    #[must_use]
    pub fn in_pieces_of(mut self, points: usize) -> Self {
        self.points = points;
        self.prepared = None;
        self
    }

    fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, prepared: &Prepared, dispatch: &Dispatch, index: u32) {
        let [x, y, z] = dispatch.groups;
        pass.set_pipeline(&self.pipelines[&dispatch.kernel]);
        pass.set_bind_group(0, &prepared.group, &[index * PARAMETERS as u32]);
        pass.dispatch_workgroups(x, y, z);
    }

    /// Prepares buffers and pipelines, unless the last batch had the same shape.
    fn prepare(&mut self, shape: Shape, objective: Objective) -> Result<()> {
        if self.prepared.as_ref().is_some_and(|prepared| (prepared.shape, prepared.objective) == (shape, objective)) {
            return Ok(());
        }
        self.prepared = None;
        let (gpu, plan) =
            (&self.gpu, Plan::new(&self.layout, shape, objective, self.points, self.gpu.largest_buffer())?);
        for Dispatch { kernel, .. } in plan.dispatches() {
            let pipeline = || gpu.pipeline(Some(&self.pipeline_layout), &kernel.source(), kernel.entry());
            self.pipelines.entry(*kernel).or_insert_with(pipeline);
        }
        let batch = gpu.buffer("a batch: conditions, strata and brdf_samples", 4 * shape.batch_length() as u64)?;
        let arena = gpu.buffer("a batch: conditions, strata and brdf_samples", 4 * plan.arena as u64)?;
        let partials = gpu.buffer("slices of the gradient", 4 * plan.partials as u64)?;
        let parameters = self.parameters(&plan);
        let buffers = [&self.weights, &batch, &arena, &partials].into_iter().map(wgpu::Buffer::as_entire_binding);
        let uniform = wgpu::BufferBinding { buffer: &parameters, offset: 0, size: PARAMETERS.try_into().ok() };
        let resources = buffers.chain([wgpu::BindingResource::Buffer(uniform)]).zip(0..);
        let entries: Vec<_> = resources.map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource }).collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &self.bindings, entries: &entries };
        let group = gpu.device.create_bind_group(&descriptor);
        gpu.check()?;
        self.prepared = Some(Prepared { shape, objective, plan, batch, arena, group, targets: None, optimizer: None });
        Ok(())
    }

    /// Returns a buffer of the parameters of all dispatches.
    fn parameters(&self, plan: &Plan) -> wgpu::Buffer {
        let mut bytes = Vec::new();
        for Dispatch { parameters, .. } in plan.dispatches() {
            bytes.extend(parameters.iter().flat_map(|number| number.to_ne_bytes()));
            bytes.resize(bytes.len().next_multiple_of(PARAMETERS as usize), 0);
        }
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let size = bytes.len() as u64;
        let descriptor = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
        let buffer = self.gpu.device.create_buffer(&descriptor);
        self.gpu.queue.write_buffer(&buffer, 0, &bytes);
        buffer
    }

    fn upload_conditions(&self, prepared: &Prepared, conditions: &[f32], length: usize) {
        let rows = prepared.plan.condition_rows(conditions, length);
        self.gpu.queue.write_buffer(&prepared.arena, 4 * prepared.plan.seen as u64, bytemuck::cast_slice(&rows));
    }

    fn upload(&self, prepared: &Prepared, batch: &Batch) {
        let lists =
            [&batch.points, &batch.densities, &batch.weights, &batch.brdf, &batch.tails, &batch.mixture_weight_logits];
        let mut start = 0;
        for numbers in lists {
            self.gpu.queue.write_buffer(&prepared.batch, 4 * start as u64, bytemuck::cast_slice(numbers));
            start += numbers.len();
        }
        self.upload_conditions(prepared, &batch.conditions, batch.condition_length);
    }

    /// Waits for the device and returns loss and gradient, means over the lit conditions.
    fn results(&self, Prepared { shape, plan, arena, .. }: &Prepared) -> Result<Option<StepGradient>> {
        let count = self.layout.length + 2 * shape.conditions;
        let mut found: Vec<f32> = self.gpu.read(arena, plan.results as u64, count)?;
        let of_conditions = found.split_off(self.layout.length);
        let (losses, lit) = of_conditions.split_at(shape.conditions);
        let lit: f32 = lit.iter().sum();
        if lit == 0.0 {
            return Ok(None);
        }
        found.iter_mut().for_each(|derivative| *derivative /= lit);
        Ok(Some(StepGradient { loss: losses.iter().sum::<f32>() / lit, d_weight: found }))
    }

    /// Runs all dispatches; each piece of the batch is submitted alone, so that none runs for long.
    fn run(&self, prepared: &Prepared) {
        let mut index = 0;
        for piece in &prepared.plan.pieces {
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                for dispatch in piece {
                    self.dispatch(&mut pass, prepared, dispatch, index);
                    index += 1;
                }
            }
            self.gpu.queue.submit([encoder.finish()]);
        }
    }
}

impl GradientSource for DeviceGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Result<Option<StepGradient>> {
        assert_eq!(weights.len(), self.layout.length, "one number for each weight");
        let shape = Shape { conditions: batch.condition_count(), samples: batch.samples };
        self.prepare(shape, objective)?;
        let Some(prepared) = &self.prepared else { return Ok(None) };
        self.upload(prepared, batch);
        self.gpu.queue.write_buffer(&self.weights, 0, bytemuck::cast_slice(weights));
        self.run(prepared);
        self.results(prepared)
    }

    fn take_steps(
        &mut self,
        config: &FitConfig,
        target: &dyn Target,
        state: &mut TrainingState,
        most: usize,
    ) -> Result<Vec<Outcome>> {
        self.steps(config, target, state, most)
    }

    fn device(&self) -> String {
        self.gpu.to_string()
    }
}

/// Returns the bindings that all shaders of training share.
fn bindings(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let storage = |read_only| BufferBindingType::Storage { read_only };
    let kinds = [storage(true), storage(true), storage(false), storage(false), BufferBindingType::Uniform];
    let entry = |(ty, binding)| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: ty == BufferBindingType::Uniform,
            min_binding_size: None,
        },
        count: None,
    };
    let entries: Vec<_> = kinds.into_iter().zip(0..).map(entry).collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries })
}
