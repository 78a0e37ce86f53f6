//! Sampling by the example shader on a device, for tests and benchmarks.

use std::borrow::Cow;

use glam::Vec3;
use headtail_sampling::{
    brdf::{Ggx, Kernel, Lambert},
    random::{Purpose, Stream},
};
use headtail_shaders::Shader;
use wgpu::util::DeviceExt;

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

/// Returns the fastest adapter; `None` if there is none.
pub fn adapter() -> Option<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let power_preference = wgpu::PowerPreference::HighPerformance;
    let options = wgpu::RequestAdapterOptions { power_preference, ..Default::default() };
    pollster::block_on(instance.request_adapter(&options)).ok()
}

/// A shader with its buffers and a list of queries on a device.
pub struct Program {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    answers: wgpu::Buffer,
    queries: usize,
}

impl Program {
    /// Uploads everything to the [`adapter`]; `None` if there is none.
    pub fn new(shader: &Shader, queries: &[Query]) -> Option<Self> {
        let adapter = adapter()?;
        let descriptor = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
        // The example returns everything but the mixture weight.
        let source = shader.source.replace("pdf_of_given: f32 }", "pdf_of_given: f32, mixture_weight: f32 }");
        let source = source.replace("drawn.w, given)", "drawn.w, given, headtail_share(q.n, q.wo, q.lobes))");
        let source = wgpu::ShaderSource::Wgsl(Cow::Owned(source));
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some("headtail_draw"),
            compilation_options: Default::default(),
            cache: None,
        });
        let storage = wgpu::BufferUsages::STORAGE;
        let inputs = [
            bytemuck::cast_slice(&shader.floats),
            bytemuck::cast_slice(&shader.integers),
            bytemuck::cast_slice(queries),
        ];
        let inputs = inputs.map(|contents| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage: storage })
        });
        let size = (queries.len() * size_of::<Answer>()) as u64;
        let usage = storage | wgpu::BufferUsages::COPY_SRC;
        let answers =
            device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
        let entries: Vec<_> = inputs
            .iter()
            .chain([&answers])
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let group =
            device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries });
        Some(Self { device, queue, pipeline, group, answers, queries: queries.len() })
    }

    /// Answers all queries, and waits.
    pub fn run(&self) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.dispatch_workgroups(self.queries.div_ceil(64) as u32, 1, 1);
        }
        self.queue.submit([encoder.finish()]);
        self.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    }

    /// Returns the answers of the last [`Program::run`].
    pub fn answers(&self) -> Vec<Answer> {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let size = self.answers.size();
        let copy =
            self.device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&self.answers, 0, &copy, 0, size);
        self.queue.submit([encoder.finish()]);
        copy.slice(..).map_async(wgpu::MapMode::Read, |result| result.unwrap());
        self.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
        let view = copy.slice(..).get_mapped_range().unwrap();
        bytemuck::cast_slice(&view).to_vec()
    }
}
