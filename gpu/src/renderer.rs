//! Rendering through `wgpu`.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use bytemuck::Pod;
use headtail_render::{
    estimator::LearnedVisibility,
    image::Image,
    integrator::{Budget, Part, Rendering, View, learn_weights},
    points::{Dimension, PointSet, Points},
};
use headtail_shaders::gpu::{Gpu, GpuError};
use wgpu::{BufferBindingType, ShaderStages};

use crate::{
    error::Result,
    points::ViewWords,
    program::{BINDINGS, Binding, ENTRY_POINT, FILM_VECTORS, LitScene, Program, WORKGROUP_SIDE},
    visibility::visibility_words,
};

/// Seconds of a dispatch that drivers and desktops tolerate.
const SECONDS: f64 = 0.1;
/// Most samples per dispatch, whose numbers come from the host.
const SAMPLES: u32 = 64;
/// What visibility is called in errors.
const VISIBILITY: &str = "learned visibility";
/// Pixels of the first dispatch, before any is timed.
const FIRST_PIXELS: usize = 1 << 14;

/// A program on a device.
pub struct Renderer {
    gpu: Arc<Gpu>,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    buffers: Vec<(Binding, wgpu::Buffer)>,
    groups: Vec<Dimension>,
    visibility: Option<LearnedVisibility>,
}

impl Renderer {
    /// Compiles a program and moves the buffers to a device.
    ///
    /// # Errors
    /// If a buffer is larger than the device allows, or its driver refuses the shader.
    pub fn new(gpu: Arc<Gpu>, scene: &LitScene, program: &Program) -> Result<Self> {
        let layout = layout(&gpu.device);
        let descriptor = wgpu::PipelineLayoutDescriptor { bind_group_layouts: &[Some(&layout)], ..Default::default() };
        let pipeline_layout = gpu.device.create_pipeline_layout(&descriptor);
        let pipeline = gpu.pipeline(Some(&pipeline_layout), &program.source, ENTRY_POINT);
        let buffers = vec![
            (Binding::Floats, filled(&gpu, "the sampler", &program.floats)?),
            (Binding::Integers, filled(&gpu, "the sampler", &program.integers)?),
            (Binding::Geometry, filled(&gpu, "the scene's triangles", scene.geometry())?),
            (Binding::Surfaces, filled(&gpu, "the scene's surfaces", scene.surfaces())?),
            (Binding::Texels, filled(&gpu, "the map", scene.texels())?),
        ];
        gpu.check()?;
        let renderer = Self { gpu, pipeline, layout, buffers, groups: program.groups.clone(), visibility: None };
        renderer.compile()?;
        Ok(renderer)
    }

    /// Returns the renderer with visibility that is learned on the CPU before each picture, in a small fraction of its budget.
    /// Programs without visibility do not read it.
    #[must_use]
    pub fn with_visibility(self, visibility: LearnedVisibility) -> Self {
        Self { visibility: Some(visibility), ..self }
    }

    /// Dispatches no pixels: some drivers compile a shader when it is first used, which is preparation.
    fn compile(&self) -> Result<()> {
        let film = self.gpu.buffer("the picture", 16)?;
        let view = self.gpu.buffer("the numbers of samples", 4 * ViewWords::LEAST as u64)?;
        let visibility = filled(&self.gpu, VISIBILITY, &visibility_words(None))?;
        self.gpu.submit(&self.pipeline, &self.bind([&film, &view, &visibility]), [1, 1]);
        wait(&self.gpu)
    }

    fn bind(&self, [film, view, visibility]: [&wgpu::Buffer; 3]) -> wgpu::BindGroup {
        let kept = |binding| &self.buffers.iter().find(|(own, _)| *own == binding).expect("all others are kept").1;
        let buffer = |binding: Binding| match binding {
            Binding::Film => film,
            Binding::View => view,
            Binding::Visibility => visibility,
            _ => kept(binding),
        };
        let entry = |(binding, own)| wgpu::BindGroupEntry { binding, resource: buffer(own).as_entire_binding() };
        let entries: Vec<_> = (0..).zip(BINDINGS).map(entry).collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &self.layout, entries: &entries };
        self.gpu.device.create_bind_group(&descriptor)
    }

    /// Renders a part of a view until the budget is spent or `stop` is set, as
    /// `headtail_render::integrator::render_part` does.
    ///
    /// # Errors
    /// If the film is too large, or the device fails.
    pub fn render(
        &self,
        view: &View<'_>,
        part: Part,
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Rendering> {
        let start = Instant::now();
        let film = self.gpu.buffer("the picture", (16 * FILM_VECTORS * part.width * part.height) as u64)?;
        let learn = |estimator| learn_weights((*view, part), estimator, budget, points.seed(), stop);
        let (weights, learned) = self.visibility.as_ref().map(learn).unzip();
        let visibility = filled(&self.gpu, VISIBILITY, &visibility_words(weights.flatten().as_ref()))?;
        let kept = [&film, &visibility];
        let mut work = Accumulation { renderer: self, view, part, kept, points, seconds_per_sample: None };
        let mut spp = 0;
        if let Budget::Spp(total) = budget {
            work.points = points.planned(total.max(1));
        }
        loop {
            let seconds = start.elapsed().as_secs_f64();
            let left = match budget {
                Budget::Spp(total) => total.max(1) - spp,
                Budget::Time(limit) => work.affordable(limit.as_secs_f64() - seconds),
            };
            let count = if spp == 0 { 1 } else { left.clamp(1, work.samples_at_once()) };
            work.add((spp, spp + count))?;
            spp += count;
            if let (1, Budget::Time(limit)) = (spp, budget) {
                // The first sample is the same for any number of samples.
                let rest = work.affordable(limit.as_secs_f64() - start.elapsed().as_secs_f64());
                work.points = points.planned(1 + rest);
            }
            let spent = match budget {
                Budget::Spp(total) => f64::from(spp) / f64::from(total.max(1)),
                Budget::Time(limit) => {
                    let half = 0.5 * work.seconds_per_sample.unwrap_or(0.0);
                    (start.elapsed().as_secs_f64() + half) / limit.as_secs_f64()
                }
            };
            progress(spent.min(1.0));
            if spent >= 1.0 || stop.load(Ordering::Relaxed) {
                break;
            }
        }
        let pixels = self.gpu.read::<[[f32; 4]; FILM_VECTORS]>(&film, 0, part.width * part.height)?;
        let rendering = resolve(&pixels, part, work.points.set(), spp, start.elapsed().as_secs_f64());
        Ok(Rendering { learned, ..rendering })
    }
}

/// A picture in progress.
struct Accumulation<'a> {
    renderer: &'a Renderer,
    view: &'a View<'a>,
    part: Part,
    /// The film, and the weights of visibility.
    kept: [&'a wgpu::Buffer; 2],
    points: Points,
    /// Seconds of a sample of every pixel, of the latest dispatches.
    seconds_per_sample: Option<f64>,
}

impl Accumulation<'_> {
    /// Adds samples to every pixel, in pieces that are short enough.
    fn add(&mut self, samples: (u32, u32)) -> Result<()> {
        let Self { renderer, view, part, kept: [film, visibility], points, .. } = *self;
        let Renderer { gpu, pipeline, groups, .. } = renderer;
        let mut words = ViewWords::new(view, part, points, samples, groups);
        let view_buffer = gpu.buffer("the numbers of samples", size_of_val(words.words()) as u64)?;
        let bound = renderer.bind([film, &view_buffer, visibility]);
        let mut row = 0;
        let start = Instant::now();
        while row < part.height {
            let rows = self.rows_at_once(samples.1 - samples.0).min(part.height - row);
            words.set_first_row(row as u32);
            gpu.queue.write_buffer(&view_buffer, 0, bytemuck::cast_slice(words.words()));
            let groups = [part.width as u32, rows as u32].map(|pixels| pixels.div_ceil(WORKGROUP_SIDE));
            let begun = Instant::now();
            gpu.submit(pipeline, &bound, groups);
            wait(gpu)?;
            let fraction = rows as f64 / part.height as f64;
            self.seconds_per_sample = Some(begun.elapsed().as_secs_f64() / f64::from(samples.1 - samples.0) / fraction);
            row += rows;
        }
        self.seconds_per_sample = Some(start.elapsed().as_secs_f64() / f64::from(samples.1 - samples.0));
        Ok(())
    }

    /// Returns the number of samples that take so many seconds.
    fn affordable(&self, seconds: f64) -> u32 {
        self.seconds_per_sample.map_or(1, |own| (seconds / own.max(1e-9)).round() as u32)
    }

    fn samples_at_once(&self) -> u32 {
        self.affordable(SECONDS).clamp(1, SAMPLES)
    }

    /// Returns the number of rows of a dispatch, in whole workgroups.
    fn rows_at_once(&self, samples: u32) -> usize {
        let pixels = (self.part.width * self.part.height) as f64;
        let at_once = match self.seconds_per_sample {
            Some(own) => SECONDS / (own * f64::from(samples)) * pixels,
            None => FIRST_PIXELS as f64,
        };
        let rows = (at_once / self.part.width as f64) as usize;
        (rows / WORKGROUP_SIDE as usize).max(1) * WORKGROUP_SIDE as usize
    }
}

/// Waits until the device is done.
fn wait(gpu: &Gpu) -> Result<()> {
    let waited = gpu.device.poll(wgpu::PollType::wait_indefinitely());
    gpu.check()?;
    waited.map_err(|error| GpuError::Failed(error.to_string()))?;
    Ok(())
}

fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |(binding, own): (u32, Binding)| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: BufferBindingType::Storage { read_only: own != Binding::Film },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    let entries: Vec<_> = (0..).zip(BINDINGS).map(entry).collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries })
}

/// Creates a buffer with this content.
fn filled<T: Pod>(gpu: &Gpu, what: &'static str, content: &[T]) -> Result<wgpu::Buffer> {
    let buffer = gpu.buffer(what, size_of_val(content) as u64)?;
    gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(content));
    Ok(buffer)
}

/// Divides the film by the number of samples.
fn resolve(pixels: &[[[f32; 4]; FILM_VECTORS]], part: Part, points: PointSet, spp: u32, seconds: f64) -> Rendering {
    let Part { width, height, .. } = part;
    let image = |of: usize| Image {
        width,
        height,
        pixels: pixels.iter().map(|pixel| [0, 1, 2].map(|c| pixel[of][c] / spp as f32)).collect(),
    };
    let (rays, estimates) =
        pixels.iter().fold((0.0, 0.0), |(r, e), pixel| (r + f64::from(pixel[0][3]), e + f64::from(pixel[1][3])));
    Rendering {
        surfaces: image(0),
        background: image(1),
        coverage: pixels.iter().map(|pixel| pixel[1][3] / spp as f32).collect(),
        spp,
        points,
        seconds,
        rays_per_sample: rays / f64::max(estimates, 1.0),
        max_weight: pixels.iter().map(|pixel| pixel[2][0]).fold(0.0, f32::max),
        learned: None,
    }
}
