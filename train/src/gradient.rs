//! Where a step's gradient comes from: the seam between the training loop and whatever computes it.

use headtail_model::{Head, burn::prelude::Device};

use crate::{Backend, Objective, injection, target::Batch};

/// Loss and gradient of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepGradient {
    /// The mean loss over the conditions whose target is not zero everywhere.
    pub loss: f32,
    /// Its gradient, in the order of [`Head::flat_weights`].
    pub by_weight: Vec<f32>,
}

/// Computes [`StepGradient`]s. The training loop keeps the weights as one list and knows nothing of how this is done.
pub trait GradientSource: Send {
    /// The gradient at `weights` (in the order of [`Head::flat_weights`]); `None` if the target is zero under every
    /// condition of the batch. A result that is not finite is the caller's to leave out.
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Option<StepGradient>;
}

/// Gradients by burn, on any backend.
pub struct BurnGradient {
    head: Head,
    /// With autodiff.
    device: Device,
    /// Whether splines and loss stay out of the graph.
    injected: bool,
}

impl BurnGradient {
    /// For heads of the shape of `head`. Reading logits back is cheap on the host and a synchronisation elsewhere, so the
    /// splines leave the graph on the host's backends only.
    pub fn new(head: Head, backend: Backend, device: &Device) -> Self {
        Self { head, device: device.clone().autodiff(), injected: backend.is_host() }
    }
}

impl GradientSource for BurnGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Option<StepGradient> {
        let head = self.head.clone().with_flat_weights(weights, &self.device);
        let form = if self.injected { injection::injected } else { injection::in_graph };
        form(&head, objective, batch, &self.device)
    }
}
