//! The implementations of a step's gradient.

use std::fmt;

use burn::prelude::Device;
use headtail_model::Head;
use serde::{Deserialize, Serialize};

use crate::{
    Backend, GradientSource, Objective, StepGradient, config::name_of, fused::FusedGradient, in_graph::in_graph,
    integrand::Batch,
};

/// How a step's gradient is computed. All forms agree to rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GradientForm {
    /// The fastest form for the backend: fused on the host, in the graph elsewhere.
    #[default]
    Auto,
    /// Networks, splines and their derivatives in one pass over SIMD lanes, see [`crate::fused`]. Host only.
    Fused,
    /// In the tensor library's graph, see [`crate::in_graph`]: the reference, and the form for GPUs.
    InGraph,
}

impl GradientForm {
    /// All forms except `Auto`.
    pub const FORMS: [Self; 2] = [Self::Fused, Self::InGraph];

    /// Returns the form for a backend.
    pub const fn on(self, backend: Backend) -> Self {
        match self {
            Self::Auto if backend.is_host() => Self::Fused,
            Self::Auto => Self::InGraph,
            form => form,
        }
    }

    /// Returns the gradient source for heads of the shape of `head`, which lives on `device`.
    pub fn source(self, head: &Head, backend: Backend, device: &Device) -> Box<dyn GradientSource> {
        match self.on(backend) {
            Self::Fused | Self::Auto => Box::new(FusedGradient::new(head)),
            Self::InGraph => Box::new(BurnGradient { head: head.clone(), device: device.clone().autodiff() }),
        }
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
}

impl GradientSource for BurnGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Option<StepGradient> {
        let head = self.head.clone().with_flat_weights(weights, &self.device);
        in_graph(&head, objective, batch, &self.device)
    }
}
