//! Drawing the points of a batch and the target there on the device.

use headtail_render::random::Purpose;
use headtail_shaders::{Shader, gpu::Gpu};

use super::dispatch::{Matrix, spread};
use crate::{
    Result,
    integrand::{BatchShape, ShaderSurface, ShaderTarget},
};

/// The shader of a target for batches of one shape.
pub struct Targets {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    /// The key of the batch's random stream, and where in it the numbers of each condition begin.
    stream: wgpu::Buffer,
    points: usize,
}

impl Targets {
    /// Uploads the tail. `seen` are the conditions, `batch` and `arena` the buffers of a step.
    pub fn new(
        gpu: &Gpu,
        target: ShaderTarget<'_>,
        shape: BatchShape,
        seen: Matrix,
        [batch, arena]: [&wgpu::Buffer; 2],
    ) -> Result<Self> {
        let points = shape.conditions * shape.samples();
        let (is_glossy, alpha) = match target.surface {
            ShaderSurface::Lambert => (false, 0.0),
            ShaderSurface::Ggx { alpha } => (true, alpha),
            ShaderSurface::GgxOfCondition => (true, 0.0),
        };
        let has_alpha = target.surface == ShaderSurface::GgxOfCondition;
        // In the order of `TARGET_SIZES`.
        let sizes = [
            points,
            shape.samples(),
            shape.strata,
            shape.brdf_samples,
            seen.start,
            seen.stride,
            is_glossy.into(),
            has_alpha.into(),
        ];
        let shader = Shader::of_targets(target.tail, sizes, alpha)?;
        let pipeline = gpu.pipeline(None, &shader.source, "place_targets");
        let floats = gpu.buffer("the tail", 4 * shader.floats.len() as u64)?;
        let integers = gpu.buffer("the tail", 4 * shader.integers.len() as u64)?;
        gpu.queue.write_buffer(&floats, 0, bytemuck::cast_slice(&shader.floats));
        gpu.queue.write_buffer(&integers, 0, bytemuck::cast_slice(&shader.integers));
        let stream = gpu.buffer("places of random numbers", 4 * (5 + shape.conditions) as u64)?;
        let group = gpu.bind(&pipeline, &[&floats, &integers, batch, arena, &stream]);
        gpu.check()?;
        Ok(Self { pipeline, group, stream, points })
    }

    /// Draws the points of a batch, whose conditions are in the arena.
    pub fn run(&self, gpu: &Gpu, seed: u64, index: u64, positions: &[u64]) {
        let halves = |number: u64| [number as u32, (number >> 32) as u32];
        let ([seed_low, seed_high], [low, high]) = (halves(seed), halves(index));
        let key = [seed_low, seed_high, Purpose::Batch as u32, low, high];
        // Below 2^32: a batch has fewer numbers than the arena.
        let words: Vec<u32> = key.into_iter().chain(positions.iter().map(|&position| position as u32)).collect();
        gpu.queue.write_buffer(&self.stream, 0, bytemuck::cast_slice(&words));
        gpu.submit(&self.pipeline, &self.group, spread(self.points));
    }
}
