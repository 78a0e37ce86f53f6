//! Pictures by a graphics device.

#[cfg(feature = "gpu")]
use std::sync::{Arc, OnceLock, atomic::AtomicBool};

use headtail_render::spec::SamplerSpec;
#[cfg(feature = "gpu")]
use headtail_render::{
    integrator::{Part, Rendering, View},
    points::Points,
};

#[cfg(feature = "gpu")]
use crate::Budget;
use crate::{Error, OpenedView, Renderer, Result};

/// An open graphics device, and a view's scene and map for it.
#[cfg(feature = "gpu")]
pub struct GraphicsDevice {
    gpu: Arc<headtail_gpu::Gpu>,
    view: OpenedView,
    scene: headtail_gpu::LitScene,
}

#[cfg(feature = "gpu")]
impl From<headtail_gpu::Error> for Error {
    fn from(error: headtail_gpu::Error) -> Self {
        match error {
            headtail_gpu::Error::Render(error) => error.into(),
            headtail_gpu::Error::Device(error) => Self::Device(error.to_string()),
            other => Self::NotOnDevice(other.to_string()),
        }
    }
}

#[cfg(feature = "gpu")]
impl GraphicsDevice {
    /// Prepares a view on the fastest adapter, which is opened once in a process.
    ///
    /// # Errors
    /// If there is none, or the shaders do not cover the scene.
    pub fn open(view: &OpenedView) -> Result<Self> {
        static GPU: OnceLock<Arc<headtail_gpu::Gpu>> = OnceLock::new();
        let scene = headtail_gpu::LitScene::new(view.scene(), view.environment.clone())?;
        let gpu = match GPU.get() {
            Some(gpu) => gpu.clone(),
            None => {
                let gpu = headtail_gpu::Gpu::open().map_err(|error| Error::Device(error.to_string()))?;
                GPU.get_or_init(|| Arc::new(gpu)).clone()
            }
        };
        Ok(Self { gpu, view: view.clone(), scene })
    }

    /// Prepares a sampler.
    ///
    /// # Errors
    /// If the shaders do not have it, or the device fails.
    pub fn renderer(&self, spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        let program =
            self.view.with_context(spec, |context| headtail_gpu::Program::new(&self.scene, spec, context))??;
        let renderer = headtail_gpu::Renderer::new(self.gpu.clone(), &self.scene, &program)?;
        Ok(Box::new(match program.has_visibility {
            true => renderer.with_visibility(self.view.learned_visibility(spec)?),
            false => renderer,
        }))
    }

    /// Returns the names of adapter and driver.
    pub fn name(&self) -> String {
        self.gpu.to_string()
    }

    /// Returns whether the adapter computes in software: slower than the integrator on the CPU.
    pub fn is_software(&self) -> bool {
        self.gpu.is_software()
    }
}

#[cfg(feature = "gpu")]
impl Renderer for headtail_gpu::Renderer {
    fn render_part(
        &self,
        (view, part): (View<'_>, Part),
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Rendering> {
        Ok(self.render(&view, part, budget.into(), points, stop, progress)?)
    }
}

/// What stands for a graphics device in a build without them.
#[cfg(not(feature = "gpu"))]
pub enum GraphicsDevice {}

#[cfg(not(feature = "gpu"))]
impl GraphicsDevice {
    /// Fails.
    pub fn open(_view: &OpenedView) -> Result<Self> {
        Err(Error::Device("this program was built without graphics devices; build it with --features gpu".into()))
    }

    /// There is none.
    pub fn renderer(&self, _spec: &SamplerSpec) -> Result<Box<dyn Renderer>> {
        match *self {}
    }

    /// There is none.
    pub fn name(&self) -> String {
        match *self {}
    }

    /// There is none.
    pub fn is_software(&self) -> bool {
        match *self {}
    }
}
