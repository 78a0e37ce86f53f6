//! All weights of a head, and their gradients, as one list of numbers.
//!
//! The order is that of [`Head::weights`]: row-major `[out, in]` weight, then bias, layer by layer.

use burn::{nn::Linear, optim::GradientsParams, prelude::Device};

use super::Head;
use crate::linear;

impl Head {
    fn linears(&self) -> impl Iterator<Item = &Linear> {
        self.parts().flat_map(|(_, layers)| layers)
    }

    /// Number of weights.
    pub fn weight_count(&self) -> usize {
        linear::count(self.linears())
    }

    /// Every weight in one list.
    pub fn flat_weights(&self) -> Vec<f32> {
        linear::flat_weights(self.linears())
    }

    /// A head of the same shape with other weights, on `device` (with autodiff where it is to be trained).
    ///
    /// # Panics
    /// If `flat` does not have [`weight_count`](Self::weight_count) numbers.
    #[must_use]
    pub fn with_flat_weights(mut self, flat: &[f32], device: &Device) -> Self {
        linear::set_flat(self.parts_mut().flat_map(|(_, layers)| layers), flat, device);
        self
    }

    /// Gradients in the order of [`flat_weights`](Self::flat_weights); 0 where the loss does not depend on a weight.
    pub fn flat_gradients(&self, gradients: &GradientsParams) -> Vec<f32> {
        linear::flat_gradients(self.linears(), gradients)
    }
}
