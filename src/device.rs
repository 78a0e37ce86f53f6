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

/// An open graphics device.
#[cfg(feature = "gpu")]
pub struct GraphicsDevice(std::sync::Arc<headtail_gpu::Gpu>);

#[cfg(feature = "gpu")]
impl GraphicsDevice {
    /// Opens the fastest adapter.
    ///
    /// # Errors
    /// If there is none.
    pub fn open() -> Result<Self> {
        Ok(Self(std::sync::Arc::new(headtail_gpu::Gpu::open()?)))
    }

    /// Prepares a sampler for a view.
    ///
    /// # Errors
    /// If the shaders do not cover the scene or the sampler, or the device fails.
    pub fn renderer(&self, view: &OpenedView, spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        let program = headtail_gpu::Program::new(view.scene(), &view.environment, spec)?;
        Ok(Box::new(OnDevice(headtail_gpu::Renderer::new(self.0.clone(), &program)?)))
    }

    /// Returns the names of adapter and driver.
    pub fn name(&self) -> String {
        self.0.to_string()
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
    pub fn open() -> Result<Self> {
        anyhow::bail!("--device gpu: this program was built without graphics devices; build it with --features gpu")
    }

    pub fn renderer(&self, _view: &OpenedView, _spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        match *self {}
    }

    pub fn name(&self) -> String {
        match *self {}
    }
}
