//! Drawing the points of a batch and the target there on the device, from uniform numbers.

use headtail_shaders::{Shader, gpu::Gpu};

use super::{dispatch::spread, plan::Plan};
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
        let group = gpu.bind(&pipeline, &[&floats, &integers, batch, arena]);
        gpu.check()?;
        Ok(Self { pipeline, group, points })
    }

    /// Replaces the uniform numbers of the batch.
    pub fn run(&self, gpu: &Gpu) {
        gpu.submit(&self.pipeline, &self.group, spread(self.points));
    }
}
