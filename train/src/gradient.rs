//! The implementations of a step's gradient.

use std::fmt;

use burn::prelude::Device;
use headtail_model::Head;
use serde::{Deserialize, Serialize};

use crate::{
    Backend, GradientSource, Objective, Result, StepGradient,
    config::name_of,
    device::{DeviceGradient, Gpu},
    fused::FusedGradient,
    in_graph::in_graph,
    integrand::Batch,
};

/// How a step's gradient is computed. All forms agree to rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GradientForm {
    /// The fastest form: on the device where this build and the machine have a graphics card, else fused for a
    /// backend on the host, and in the graph for others.
    #[default]
    Auto,
    /// Networks, splines and their derivatives in one pass over SIMD lanes, see [`crate::fused`]. Host only.
    Fused,
    /// In the tensor library's graph, see [`crate::in_graph`]: the reference on every backend.
    InGraph,
    /// By shaders on a graphics device, see `device`; needs the feature `gpu`.
    Device,
}

impl GradientForm {
    /// All forms except `Auto`.
    pub const FORMS: [Self; 3] = [Self::Fused, Self::InGraph, Self::Device];

    /// Returns the form for a backend of a machine without a graphics card.
    pub const fn on(self, backend: Backend) -> Self {
        match self {
            Self::Auto if backend.is_host() => Self::Fused,
            Self::Auto => Self::InGraph,
            form => form,
        }
    }

    /// Names the graphics device that the form computes on; `None` for one in a backend.
    ///
    /// # Errors
    /// As [`source`](Self::source).
    pub fn graphics_device(self) -> Result<Option<String>> {
        Ok(self.open_device()?.map(|gpu| gpu.to_string()))
    }

    /// Opens the graphics device that the form computes on: for `Auto`, a graphics card, if there is one.
    pub(crate) fn open_device(self) -> Result<Option<Gpu>> {
        Ok(match self {
            Self::Auto => Gpu::open_card()?,
            Self::Device => Some(Gpu::open()?),
            Self::Fused | Self::InGraph => None,
        })
    }

    /// Returns the gradient source for heads of the shape of `head`, which lives on `device`.
    ///
    /// # Errors
    /// If the form needs a graphics device, and this build or the machine has none.
    pub fn source(self, head: &Head, backend: Backend, device: &Device) -> Result<Box<dyn GradientSource>> {
        if let Some(gpu) = self.open_device()? {
            return Ok(Box::new(DeviceGradient::new(gpu, head)?));
        }
        Ok(match self.on(backend) {
            Self::InGraph => {
                let name = if backend.is_host() { "CPU".into() } else { format!("{device:?}") };
                Box::new(BurnGradient { head: head.clone(), device: device.clone().autodiff(), name })
            }
            _ => Box::new(FusedGradient::new(head)),
        })
    }
}

impl fmt::Display for GradientForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name_of(self))
    }
}

/// Gradients by burn, on any backend.
struct BurnGradient {
    head: Head,
    /// With autodiff.
    device: Device,
    name: String,
}

impl GradientSource for BurnGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Result<Option<StepGradient>> {
        let head = self.head.clone().with_flat_weights(weights, &self.device);
        Ok(in_graph(&head, objective, batch, &self.device))
    }

    fn device(&self) -> String {
        self.name.clone()
    }
}
