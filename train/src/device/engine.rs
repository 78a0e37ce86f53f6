//! Buffers and pipelines of a step, and running its dispatches.

use std::collections::HashMap;

use headtail_shaders::{gpu::Gpu, training::Kernel};
use wgpu::{BufferBindingType, BufferUsages, ShaderStages};

use super::{dispatch::Dispatch, optimizer::Optimizer, plan::Plan};
use crate::{FitConfig, Result, StepGradient};

/// Distance of the parameters of dispatches in their buffer, in bytes: the largest alignment that adapters
/// require.
const PARAMETERS: u64 = 256;

/// A device with the weights of a model, and the shaders that its steps need.
pub struct Engine {
    pub gpu: Gpu,
    pub weights: wgpu::Buffer,
    bindings: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    pipelines: HashMap<Kernel, wgpu::ComputePipeline>,
}

/// A plan with its buffers.
pub struct Prepared {
    pub plan: Plan,
    pub batch: wgpu::Buffer,
    pub arena: wgpu::Buffer,
    group: wgpu::BindGroup,
    /// What moves the weights, if the device does.
    pub optimizer: Option<Optimizer>,
}

impl Engine {
    pub fn new(gpu: Gpu, weight_count: usize) -> Result<Self> {
        let bindings = bindings(&gpu.device);
        let descriptor =
            wgpu::PipelineLayoutDescriptor { label: None, bind_group_layouts: &[Some(&bindings)], immediate_size: 0 };
        let pipeline_layout = gpu.device.create_pipeline_layout(&descriptor);
        let weights = gpu.buffer("the model's weights", 4 * weight_count as u64)?;
        Ok(Self { gpu, weights, bindings, pipeline_layout, pipelines: HashMap::new() })
    }

    /// Returns the number of weights.
    pub fn weight_count(&self) -> usize {
        (self.weights.size() / 4) as usize
    }

    /// Creates the buffers of a plan for batches of `batch_length` numbers. `what` names the settings that they grow
    /// with.
    pub fn prepare(&mut self, plan: Plan, batch_length: usize, what: &'static str) -> Result<Prepared> {
        for Dispatch { kernel, .. } in plan.dispatches() {
            let pipeline = || self.gpu.pipeline_of_kernel(&self.pipeline_layout, *kernel);
            self.pipelines.entry(*kernel).or_insert_with(pipeline);
        }
        let gpu = &self.gpu;
        let batch = gpu.buffer(what, 4 * batch_length as u64)?;
        let arena = gpu.buffer(what, 4 * plan.arena as u64)?;
        let partials = gpu.buffer("slices of the gradient", 4 * plan.partials as u64)?;
        let parameters = self.parameters(&plan);
        let buffers = [&self.weights, &batch, &arena, &partials].into_iter().map(wgpu::Buffer::as_entire_binding);
        let uniform = wgpu::BufferBinding { buffer: &parameters, offset: 0, size: PARAMETERS.try_into().ok() };
        let resources = buffers.chain([wgpu::BindingResource::Buffer(uniform)]).zip(0..);
        let entries: Vec<_> = resources.map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource }).collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &self.bindings, entries: &entries };
        let group = gpu.device.create_bind_group(&descriptor);
        gpu.check()?;
        Ok(Prepared { plan, batch, arena, group, optimizer: None })
    }

    /// Prepares what moves the weights, unless that is done.
    pub fn prepare_optimizer(&self, prepared: &mut Prepared, config: &FitConfig) -> Result<()> {
        if prepared.optimizer.is_none() {
            let Plan { conditions, results, .. } = prepared.plan;
            let buffers = [&self.weights, &prepared.arena];
            prepared.optimizer = Some(Optimizer::new(&self.gpu, config, conditions, results, buffers)?);
        }
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

    pub fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, prepared: &Prepared, dispatch: &Dispatch, index: u32) {
        let [x, y, z] = dispatch.groups;
        pass.set_pipeline(&self.pipelines[&dispatch.kernel]);
        pass.set_bind_group(0, &prepared.group, &[index * PARAMETERS as u32]);
        pass.dispatch_workgroups(x, y, z);
    }

    /// Runs all dispatches; each piece of the batch is submitted alone, so that none runs for long.
    pub fn run(&self, prepared: &Prepared) {
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

    /// Computes loss and gradient at `weights` for the batch in the buffer, means over the lit conditions.
    pub fn gradient(&self, prepared: &Prepared, weights: &[f32]) -> Result<Option<StepGradient>> {
        assert_eq!(weights.len(), self.weight_count(), "one number for each weight");
        self.gpu.queue.write_buffer(&self.weights, 0, bytemuck::cast_slice(weights));
        self.run(prepared);
        let Plan { conditions, results, .. } = prepared.plan;
        let mut found: Vec<f32> = self.gpu.read(&prepared.arena, results as u64, weights.len() + 2 * conditions)?;
        let of_conditions = found.split_off(weights.len());
        let (losses, lit) = of_conditions.split_at(conditions);
        let lit: f32 = lit.iter().sum();
        if lit == 0.0 {
            return Ok(None);
        }
        found.iter_mut().for_each(|derivative| *derivative /= lit);
        Ok(Some(StepGradient { loss: losses.iter().sum::<f32>() / lit, d_weight: found }))
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
