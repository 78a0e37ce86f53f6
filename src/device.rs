//! `--device`: pictures by the CPU or by a graphics device.

use anyhow::Result;
use headtail_eval::{OpenedView, Renderer};
use headtail_render::spec::SamplerSpec;

/// What renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// All threads of the CPU.
    #[default]
    Cpu,
    /// The fastest graphics adapter.
    Gpu,
}

/// The values of `--device`.
pub const DEVICES: [(Device, &str, &str); 2] =
    [(Device::Cpu, "cpu", "All threads of the CPU"), (Device::Gpu, "gpu", "The fastest Vulkan, Metal or DX12 adapter")];

/// Chooses the graphics adapter of this process by its number, see [`headtail_gpu::Gpu::use_adapter`].
#[cfg(feature = "gpu")]
pub fn use_adapter(number: usize) -> Result<()> {
    Ok(headtail_gpu::Gpu::use_adapter(number)?)
}

#[cfg(not(feature = "gpu"))]
pub fn use_adapter(_number: usize) -> Result<()> {
    anyhow::bail!("this program was built without graphics devices; build it with --features gpu")
}

/// An open graphics device, and a view's scene and map for it.
#[cfg(feature = "gpu")]
pub struct GraphicsDevice {
    gpu: std::sync::Arc<headtail_gpu::Gpu>,
    view: OpenedView,
    scene: headtail_gpu::LitScene,
}

#[cfg(feature = "gpu")]
impl GraphicsDevice {
    /// Opens the fastest adapter for a view.
    ///
    /// # Errors
    /// If there is none, or the shaders do not cover the scene.
    pub fn open(view: &OpenedView) -> Result<Self> {
        let scene = headtail_gpu::LitScene::new(view.scene(), view.environment.clone())?;
        let gpu = headtail_gpu::Gpu::open()?;
        if gpu.is_software() {
            crate::terminal::note!("{gpu} computes in software; --device cpu is faster");
        }
        Ok(Self { gpu: std::sync::Arc::new(gpu), view: view.clone(), scene })
    }

    /// Prepares a sampler.
    ///
    /// # Errors
    /// If the shaders do not have it, or the device fails.
    pub fn renderer(&self, spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        let program = headtail_gpu::Program::new(&self.scene, spec)?;
        let renderer = headtail_gpu::Renderer::new(self.gpu.clone(), &self.scene, &program)?;
        Ok(Box::new(OnDevice(match program.has_visibility {
            true => renderer.with_visibility(self.view.learned_visibility(spec)?),
            false => renderer,
        })))
    }

    /// Returns the names of adapter and driver.
    pub fn name(&self) -> String {
        self.gpu.to_string()
    }
}

#[cfg(feature = "gpu")]
struct OnDevice(headtail_gpu::Renderer);

#[cfg(feature = "gpu")]
impl Renderer for OnDevice {
    fn render_part(
        &self,
        (view, part): (headtail_render::integrator::View<'_>, headtail_render::integrator::Part),
        budget: headtail_eval::Budget,
        points: headtail_render::points::Points,
        stop: &std::sync::atomic::AtomicBool,
        progress: &dyn Fn(f64),
    ) -> headtail_eval::Result<headtail_render::integrator::Rendering> {
        let rendered = self.0.render(&view, part, budget.into(), points, stop, progress);
        rendered.map_err(|error| headtail_eval::Error::Device(error.to_string()))
    }
}

/// A graphics device of a build without one.
#[cfg(not(feature = "gpu"))]
pub enum GraphicsDevice {}

#[cfg(not(feature = "gpu"))]
impl GraphicsDevice {
    /// Fails.
    pub fn open(_view: &OpenedView) -> Result<Self> {
        anyhow::bail!("--device gpu: this program was built without graphics devices; build it with --features gpu")
    }

    pub fn renderer(&self, _spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        match *self {}
    }

    pub fn name(&self) -> String {
        match *self {}
    }
}
