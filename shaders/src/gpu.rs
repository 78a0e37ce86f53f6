//! Graphics devices through `wgpu`: opening one, compute pipelines, buffers, reading back.

use std::{
    borrow::Cow,
    fmt,
    sync::{Arc, OnceLock},
};

use parking_lot::Mutex;
use wgpu::{BufferUsages, DeviceType};

use crate::training::Kernel;

/// Why work on a device failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter, or none that can be opened.
    #[error("no graphics adapter: install a Vulkan, Metal or DX12 driver (mesa-vulkan-drivers has one in software)")]
    NoAdapter,
    /// The adapter that was asked for is not there.
    #[error("there is no graphics adapter {number}: {count} are found")]
    NoSuchAdapter {
        /// Its number, from 0.
        number: usize,
        /// Adapters of the best interface.
        count: usize,
    },
    /// More memory is needed than the adapter gives.
    #[error("{what} needs {needed} bytes in one buffer, and the adapter allows {allowed}")]
    TooLarge {
        /// What needs the memory.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed.
        allowed: u64,
    },
    /// The driver refused work, or the device was lost.
    #[error("the graphics device failed: {0}")]
    Failed(String),
}

/// The number of the adapter that this process uses, if one was chosen.
static ADAPTER: OnceLock<usize> = OnceLock::new();

/// A device and its queue. Nothing is rendered: only compute shaders run on it.
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the fastest adapter, a software adapter where there is no other; the one of
    /// [`use_adapter`](Self::use_adapter), if that was called.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] if there is none; [`GpuError::Failed`] if it cannot be opened.
    pub fn open() -> Result<Self, GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapter = match ADAPTER.get() {
            Some(&number) => numbered(&instance, number)?,
            None => {
                let power_preference = wgpu::PowerPreference::HighPerformance;
                let options = wgpu::RequestAdapterOptions { power_preference, ..Default::default() };
                pollster::block_on(instance.request_adapter(&options)).map_err(|_| GpuError::NoAdapter)?
            }
        };
        // All that the adapter has: large buffers, above all.
        let required_limits = adapter.limits();
        let required_features = adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
        let descriptor = wgpu::DeviceDescriptor { required_features, required_limits, ..Default::default() };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = opened.map_err(|error| GpuError::Failed(error.to_string()))?;
        let failure = Arc::new(Mutex::new(None));
        // By default an error ends the process.
        let first = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&first, error.to_string())));
        let first = failure.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&first, format!("it was lost: {message}"));
            }
        });
        Ok(Self { device, queue, info: adapter.get_info(), failure })
    }

    /// Names all adapters, graphics cards first and software last, in the order in which [`open`](Self::open) prefers
    /// them.
    pub fn adapters() -> Vec<String> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        sorted(&instance).iter().map(|adapter| name_of(&adapter.get_info())).collect()
    }

    /// Makes [`open`](Self::open) open this adapter in the rest of the process: its number, from 0, among those of the
    /// interface (Vulkan, Metal, DX12) that the first of [`adapters`](Self::adapters) has. Later calls have no effect.
    ///
    /// # Errors
    /// [`GpuError::NoSuchAdapter`], or [`GpuError::NoAdapter`] if there is none at all.
    pub fn use_adapter(number: usize) -> Result<(), GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        numbered(&instance, number)?;
        ADAPTER.get_or_init(|| number);
        Ok(())
    }

    /// Opens a graphics card, with memory of its own; `None` if the fastest adapter is none.
    ///
    /// # Errors
    /// [`GpuError::Failed`] if it cannot be opened.
    pub fn open_card() -> Result<Option<Self>, GpuError> {
        match Self::open() {
            Ok(gpu) => Ok(gpu.is_card().then_some(gpu)),
            Err(GpuError::NoAdapter) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns whether the adapter is a graphics card, with memory of its own.
    pub fn is_card(&self) -> bool {
        self.info.device_type == DeviceType::DiscreteGpu
    }

    /// Returns whether the adapter computes in software.
    pub fn is_software(&self) -> bool {
        self.info.device_type == DeviceType::Cpu
    }

    /// Returns the largest size of a storage buffer in bytes.
    pub fn largest_buffer(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Returns an error if a driver refused work, or the device was lost, since the device was opened.
    ///
    /// # Errors
    /// [`GpuError::Failed`] with the first reason.
    pub fn check(&self) -> Result<(), GpuError> {
        match &*self.failure.lock() {
            Some(reason) => Err(GpuError::Failed(reason.clone())),
            None => Ok(()),
        }
    }

    /// Creates a storage buffer of `bytes` bytes, filled with zeros.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if the adapter has no buffers of this size.
    pub fn buffer(&self, what: &'static str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        let allowed = self.largest_buffer();
        if bytes > allowed {
            return Err(GpuError::TooLarge { what, needed: bytes, allowed });
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size: bytes, usage, mapped_at_creation: false };
        Ok(self.device.create_buffer(&descriptor))
    }

    /// Returns whether the device can time its work.
    pub fn has_timestamps(&self) -> bool {
        self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// Compiles a compute pipeline. `layout` of `None` is that of the shader's own bindings.
    pub fn pipeline(&self, layout: Option<&wgpu::PipelineLayout>, source: &str, entry: &str) -> wgpu::ComputePipeline {
        let mut checks = wgpu::ShaderRuntimeChecks::checked();
        // Counting a second time, as devices of untrusted shaders do, would keep drivers from unrolling loops.
        checks.force_loop_bounding = false;
        // SAFETY: all loops of our shaders end: they count up to numbers that do not change meanwhile.
        unsafe { self.compile(layout, source, entry, checks) }
    }

    /// Compiles a shader of training as [`Self::pipeline`] does; matrix products, without checks of places in memory.
    pub fn pipeline_of_kernel(&self, layout: &wgpu::PipelineLayout, kernel: Kernel) -> wgpu::ComputePipeline {
        let (source, entry) = (kernel.source(), kernel.entry());
        match kernel {
            // SAFETY: their places depend on the sizes of matrices alone, which are allocated in whole tiles, and on no number in
            // a buffer, and their loops end. Each check would be an instruction for every 16 products.
            Kernel::Affine { .. } | Kernel::WeightGradient { .. } => unsafe {
                self.compile(Some(layout), &source, entry, wgpu::ShaderRuntimeChecks::unchecked())
            },
            _ => self.pipeline(Some(layout), &source, entry),
        }
    }

    /// Compiles a pipeline.
    ///
    /// # Safety
    /// The shader must not need the checks that are missing.
    unsafe fn compile(
        &self,
        layout: Option<&wgpu::PipelineLayout>,
        source: &str,
        entry: &str,
        checks: wgpu::ShaderRuntimeChecks,
    ) -> wgpu::ComputePipeline {
        let source = wgpu::ShaderSource::Wgsl(Cow::Borrowed(source));
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(entry), source };
        // SAFETY: the caller has seen that no check is needed that is missing.
        let module = unsafe { self.device.create_shader_module_trusted(descriptor, checks) };
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout,
            module: &module,
            entry_point: Some(entry),
            // All of it is written before it is read.
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    }

    /// Binds whole buffers to a pipeline of the shader's own bindings, in order.
    pub fn bind(&self, pipeline: &wgpu::ComputePipeline, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
        let numbered: Vec<_> = (0..).zip(buffers.iter().copied()).collect();
        self.bind_at(pipeline, &numbered)
    }

    /// Binds whole buffers by their numbers: all that the pipeline's entry point uses.
    pub fn bind_at(&self, pipeline: &wgpu::ComputePipeline, buffers: &[(u32, &wgpu::Buffer)]) -> wgpu::BindGroup {
        let resources = buffers.iter().map(|(binding, buffer)| (*binding, buffer.as_entire_binding()));
        let entries: Vec<_> = resources.map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        let layout = pipeline.get_bind_group_layout(0);
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries };
        self.device.create_bind_group(&descriptor)
    }

    /// Submits one dispatch of `groups` workgroups.
    pub fn submit(
        &self,
        pipeline: &wgpu::ComputePipeline,
        bound: &wgpu::BindGroup,
        [x, y]: [u32; 2],
    ) -> wgpu::SubmissionIndex {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, bound, &[]);
            pass.dispatch_workgroups(x, y, 1);
        }
        self.queue.submit([encoder.finish()])
    }

    /// Waits for submitted work.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn wait(&self, work: wgpu::SubmissionIndex) -> Result<(), GpuError> {
        let waited = self.device.poll(wgpu::PollType::Wait { submission_index: Some(work), timeout: None });
        self.check()?;
        waited.map(|_| ()).map_err(|error| GpuError::Failed(error.to_string()))
    }

    /// Waits for all work, and returns `count` numbers of a buffer from number `first` on.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, first: u64, count: usize) -> Result<Vec<T>, GpuError> {
        let (start, size) = (first * size_of::<T>() as u64, (count * size_of::<T>()) as u64);
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let descriptor = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
        let copy = self.device.create_buffer(&descriptor);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, start, &copy, 0, size);
        self.queue.submit([encoder.finish()]);
        let failure = self.failure.clone();
        copy.slice(..).map_async(wgpu::MapMode::Read, move |mapped| {
            if let Err(error) = mapped {
                note(&failure, error.to_string());
            }
        });
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|error| GpuError::Failed(error.to_string()))?;
        let view = copy.slice(..).get_mapped_range().map_err(|error| GpuError::Failed(error.to_string()))?;
        Ok(bytemuck::pod_collect_to_vec(&view))
    }
}

/// Returns all adapters, graphics cards first and software last.
fn sorted(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let order = [DeviceType::DiscreteGpu, DeviceType::IntegratedGpu, DeviceType::VirtualGpu, DeviceType::Other];
    let place = |adapter: &wgpu::Adapter| order.iter().position(|kind| *kind == adapter.get_info().device_type);
    found.sort_by_key(|adapter| place(adapter).unwrap_or(order.len()));
    found
}

/// Returns an adapter by its number, see [`Gpu::use_adapter`].
fn numbered(instance: &wgpu::Instance, number: usize) -> Result<wgpu::Adapter, GpuError> {
    let mut found = sorted(instance);
    let interface = found.first().ok_or(GpuError::NoAdapter)?.get_info().backend;
    found.retain(|adapter| adapter.get_info().backend == interface);
    let count = found.len();
    if number < count { Ok(found.swap_remove(number)) } else { Err(GpuError::NoSuchAdapter { number, count }) }
}

/// Names the adapter, its driver and its interface.
impl fmt::Display for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name_of(&self.info))
    }
}

fn name_of(wgpu::AdapterInfo { name, driver_info, backend, .. }: &wgpu::AdapterInfo) -> String {
    format!("{name} ({backend}, {driver_info})")
}

/// Keeps the first of several reasons: what follows is often its consequence.
fn note(failure: &Mutex<Option<String>>, reason: String) {
    failure.lock().get_or_insert(reason);
}
