//! Drawing the points of a batch and the target there on the device, from uniform numbers.

use headtail_shaders::{Shader, gpu::Gpu};

use super::plan::Plan;
use crate::{
    Result,
    integrand::{BatchShape, ShaderSurface, ShaderTarget},
};

/// The shader of a target for batches of one shape.
pub struct Targets {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    points: usize,
}

impl Targets {
    /// Uploads the tail. `batch` and `arena` are the buffers of a step.
    pub fn new(
        gpu: &Gpu,
        target: ShaderTarget<'_>,
        shape: BatchShape,
        plan: &Plan,
        [batch, arena]: [&wgpu::Buffer; 2],
    ) -> Result<Self> {
        let points = shape.conditions * shape.samples();
        let (is_glossy, alpha) = match target.surface {
            ShaderSurface::Lambert => (false, 0.0),
            ShaderSurface::Ggx { alpha } => (true, alpha),
            ShaderSurface::GgxOfCondition => (true, 0.0),
        };
        let has_alpha = target.surface == ShaderSurface::GgxOfCondition;
        let sizes = [
            ("POINTS", points),
            ("SAMPLES", shape.samples()),
            ("STRATA", shape.strata),
            ("BRDF_SAMPLES", shape.brdf_samples),
            ("CONDITIONS", plan.seen),
            ("CONDITION_STRIDE", plan.stride),
            ("IS_GLOSSY", is_glossy.into()),
            ("HAS_ALPHA", has_alpha.into()),
        ];
        let shader = Shader::of_targets(target.tail, &sizes, alpha)?;
        let pipeline = gpu.pipeline(None, &shader.source, "place_targets");
        let floats = gpu.buffer("the tail", 4 * shader.floats.len() as u64)?;
        let integers = gpu.buffer("the tail", 4 * shader.integers.len() as u64)?;
        gpu.queue.write_buffer(&floats, 0, bytemuck::cast_slice(&shader.floats));
        gpu.queue.write_buffer(&integers, 0, bytemuck::cast_slice(&shader.integers));
        let entries: Vec<_> = [&floats, &integers, batch, arena]
            .into_iter()
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries };
        let group = gpu.device.create_bind_group(&descriptor);
        gpu.check()?;
        Ok(Self { pipeline, group, points })
    }

    /// Replaces the uniform numbers of the batch.
    pub fn run(&self, gpu: &Gpu) {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.dispatch_workgroups(self.points.div_ceil(64) as u32, 1, 1);
        }
        gpu.queue.submit([encoder.finish()]);
    }
}
