//! Drawing the points of a batch and the target there on the device.

use headtail_render::{flat::FlatArray, random::Purpose};
use headtail_shaders::{Shader, gpu::Gpu};

use super::dispatch::{Matrix, spread};
use crate::{
    Result,
    integrand::{BatchShape, ShaderSurface, ShaderTarget},
};

/// Returns the largest number of bytes of tables that are held at a time: enough to keep a device busy, and few enough
/// that none is busy for long.
fn bytes_of_tables(gpu: &Gpu) -> usize {
    if gpu.is_card() { 1 << 28 } else { 1 << 25 }
}

/// A shader with its buffers.
struct Pass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

/// How points are drawn.
enum Points {
    Strata(Pass),
    /// From tables of `rows` rows: what fills the tables of some conditions, sums their rows, and draws.
    Tabulated {
        rows: usize,
        passes: [Pass; 3],
    },
}

/// The shaders of a target for batches of one shape.
pub struct Targets {
    points: Points,
    /// The key of the batch's random stream, the first condition to draw points of, and where in the stream the numbers
    /// of each condition begin.
    stream: wgpu::Buffer,
    shape: BatchShape,
    /// Conditions whose points are drawn together.
    together: usize,
}

impl Targets {
    /// Uploads the tail. `seen` are the conditions, `batch` and `arena` the buffers of a step.
    pub fn new(
        gpu: &Gpu,
        target: ShaderTarget,
        shape: BatchShape,
        seen: Matrix,
        [batch, arena]: [&wgpu::Buffer; 2],
    ) -> Result<Self> {
        let ShaderTarget { mut arrays, surface, is_in_x } = target;
        let is_glossy = surface != ShaderSurface::Lambert;
        let has_alpha = surface == ShaderSurface::GgxOfCondition;
        let (mut alpha, mut of_neural) = (0.0, false);
        match surface {
            ShaderSurface::Lambert | ShaderSurface::GgxOfCondition => {}
            ShaderSurface::Ggx { alpha: own } => alpha = own,
            ShaderSurface::Fitted { numbers, is_neural } => {
                arrays.push(FlatArray::floats("material.numbers", vec![numbers.len()], numbers));
                of_neural = is_neural;
            }
        }
        // In the order of `TARGET_SIZES`.
        let sizes = [
            shape.conditions * shape.samples(),
            shape.samples(),
            shape.strata,
            shape.brdf_samples,
            seen.start,
            seen.stride,
            is_glossy.into(),
            has_alpha.into(),
            of_neural.into(),
            is_in_x.into(),
        ];
        let shader = Shader::of_targets(&arrays, sizes, alpha)?;
        let floats = gpu.buffer("tail and material", 4 * shader.floats.len() as u64)?;
        let integers = gpu.buffer("the tail", 4 * shader.integers.len() as u64)?;
        gpu.queue.write_buffer(&floats, 0, bytemuck::cast_slice(&shader.floats));
        gpu.queue.write_buffer(&integers, 0, bytemuck::cast_slice(&shader.integers));
        let stream = gpu.buffer("places of random numbers", 4 * (6 + shape.conditions) as u64)?;
        let pass = |entry, bound: &[(u32, &wgpu::Buffer)]| {
            let pipeline = gpu.pipeline(None, &shader.source, entry);
            Pass { group: gpu.bind_at(&pipeline, bound), pipeline }
        };
        let [floats, integers, stream_at] = [(0, &floats), (1, &integers), (4, &stream)];
        let [batch, arena] = [(2, batch), (3, arena)];
        // Flow tails have no integers: an empty buffer cannot be bound.
        let integers = (!shader.integers.is_empty()).then_some(integers);
        let all: Vec<_> = [floats, batch, arena, stream_at].into_iter().chain(integers).collect();
        let (points, together) = match arrays.iter().find(|array| array.name == "light.cells") {
            None => (Points::Strata(pass("place_strata", &all)), shape.conditions),
            Some(FlatArray { shape: cells, .. }) => {
                let (rows, bytes) = (cells[0], 4 * (cells[0] * cells[1] + cells[0]));
                let most = bytes_of_tables(gpu).min(usize::try_from(gpu.largest_buffer()).unwrap_or(usize::MAX));
                let together = (most / bytes).clamp(1, shape.conditions);
                let table = gpu.buffer("tables of the product", (together * bytes) as u64)?;
                let table = (5, &table);
                let passes = [
                    pass("tabulate", &[floats, arena, stream_at, table]),
                    pass("sum_rows", &[table]),
                    pass("place_tabulated", &[&all[..], &[table]].concat()),
                ];
                (Points::Tabulated { rows, passes }, together)
            }
        };
        gpu.check()?;
        Ok(Self { points, stream, shape, together })
    }

    /// Draws the points of a batch, whose conditions are in the arena.
    pub fn run(&self, gpu: &Gpu, seed: u64, index: u64, positions: &[u64]) {
        let halves = |number: u64| [number as u32, (number >> 32) as u32];
        let ([seed_low, seed_high], [low, high]) = (halves(seed), halves(index));
        let key = [seed_low, seed_high, Purpose::Batch as u32, low, high, 0];
        // Below 2^32: a batch has fewer numbers than the arena.
        let words: Vec<u32> = key.into_iter().chain(positions.iter().map(|&position| position as u32)).collect();
        gpu.queue.write_buffer(&self.stream, 0, bytemuck::cast_slice(&words));
        for first in (0..self.shape.conditions).step_by(self.together) {
            let count = self.together.min(self.shape.conditions - first);
            gpu.queue.write_buffer(&self.stream, 20, bytemuck::bytes_of(&(first as u32)));
            let submit = |Pass { pipeline, group }: &Pass, groups| {
                gpu.submit(pipeline, group, groups);
            };
            let points = spread(count * self.shape.samples());
            match &self.points {
                Points::Strata(strata) => submit(strata, points),
                Points::Tabulated { rows, passes: [tabulate, sum_rows, place] } => {
                    submit(tabulate, [*rows as u32, count as u32]);
                    submit(sum_rows, [count as u32, 1]);
                    submit(place, points);
                }
            }
        }
    }
}
