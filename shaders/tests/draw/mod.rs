//! Sampling by the example shader on a device, for tests and benchmarks.

use glam::Vec3;
use headtail_sampling::{
    brdf::{Ggx, Kernel, Lambert},
    random::{Purpose, Stream},
};
use headtail_shaders::{
    Shader,
    gpu::{Gpu, GpuError},
};

/// A point to sample at, and a direction whose pdf is evaluated.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Query {
    pub n: [f32; 3],
    pub u: f32,
    pub wo: [f32; 3],
    pub v: f32,
    pub lobes: [f32; 4],
    pub wi: [f32; 4],
}

/// A direction, its pdf, the pdf of the given direction, and the mixture weight.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Answer {
    pub wi: [f32; 3],
    pub pdf: f32,
    pub pdf_of_given: f32,
    pub mixture_weight: f32,
    padding: [f32; 2],
}

/// Returns random points, and the widths of their lobes; normals and directions include the poles and
/// directions along the seam of the map.
pub fn queries(count: usize, glossy: bool) -> (Vec<Query>, Vec<f32>) {
    let mut random = Stream::new(11, Purpose::Test, u64::from(glossy));
    let special =
        [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [-1e-7, 0.0, -1.0], [1e-4, 1.0, -1e-4], [1.0, 0.0, 0.0]];
    let mut alphas = Vec::with_capacity(count);
    let queries = (0..count).map(|k| {
        let mut direction = |every: usize| -> [f32; 3] {
            let own = random.direction().to_array();
            if k % every == 0 {
                Vec3::from_array(special[k / every % special.len()]).normalize().to_array()
            } else {
                own
            }
        };
        let (n, wo, wi) = (direction(997), direction(1009), direction(101));
        let wo = if Vec3::from_array(n).dot(Vec3::from_array(wo)) < 0.0 { wo.map(|x| -x) } else { wo };
        let (u, v, alpha) = (random.uniform(), random.uniform(), 0.1 + 0.9 * random.uniform());
        alphas.push(alpha);
        let cos_o = Vec3::from_array(n).dot(Vec3::from_array(wo));
        let lobes =
            if glossy { Ggx::new(alpha, Vec3::ONE).lobes(cos_o) } else { Lambert { albedo: Vec3::ONE }.lobes(cos_o) };
        let lobes = [lobes.diffuse, lobes.specular, lobes.f0, lobes.alpha];
        Query { n, u, wo, v, lobes, wi: [wi[0], wi[1], wi[2], 0.0] }
    });
    (queries.collect(), alphas)
}

/// A shader with its buffers and a list of queries on a device.
pub struct Program {
    gpu: Gpu,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    answers: wgpu::Buffer,
    queries: usize,
}

impl Program {
    /// Uploads everything to the fastest adapter.
    pub fn new(shader: &Shader, queries: &[Query]) -> Result<Self, GpuError> {
        let gpu = Gpu::open()?;
        // The example returns everything but the mixture weight, and leaves positions to callers: here two metres along `wi`.
        let source = shader.source.replace("pdf_of_given: f32 }", "pdf_of_given: f32, mixture_weight: f32 }");
        let source = source.replace("drawn.w, given)", "drawn.w, given, headtail_share(q.n, q.wo, q.lobes))");
        let source = source.replace(
            "let drawn = headtail_sample(",
            "headtail_position = 2.0 * q.wi.xyz;\n    let drawn = headtail_sample(",
        );
        let pipeline = gpu.pipeline(None, &source, "headtail_draw");
        let inputs: [&[u8]; 3] = [
            bytemuck::cast_slice(&shader.floats),
            bytemuck::cast_slice(&shader.integers),
            bytemuck::cast_slice(queries),
        ];
        let mut buffers = Vec::new();
        for contents in inputs {
            let buffer = gpu.buffer("what a sampler reads", contents.len() as u64)?;
            gpu.queue.write_buffer(&buffer, 0, contents);
            buffers.push(buffer);
        }
        let answers = gpu.buffer("answers", (queries.len() * size_of::<Answer>()) as u64)?;
        let bound: Vec<_> = buffers.iter().chain([&answers]).collect();
        let group = gpu.bind(&pipeline, &bound);
        gpu.check()?;
        Ok(Self { gpu, pipeline, group, answers, queries: queries.len() })
    }

    /// Answers all queries, and waits.
    pub fn run(&self) {
        self.gpu.submit(&self.pipeline, &self.group, [self.queries.div_ceil(64) as u32, 1]);
        self.gpu.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    }

    /// Returns the answers of the last [`Program::run`].
    pub fn answers(&self) -> Vec<Answer> {
        self.gpu.read(&self.answers, 0, self.queries).unwrap()
    }
}
