//! All weights of a head, and their gradients, as one list.
//!
//! The order is that of [`Head::weights`]: layer by layer a row-major `[out, in]` weight, then a bias.

use burn::{nn::Linear, optim::GradientsParams, prelude::Device};

use super::Head;
use crate::linear;

impl Head {
    fn linears(&self) -> impl Iterator<Item = &Linear> {
        self.parts().flat_map(|(_, layers)| layers)
    }

    /// Returns the number of weights.
    pub fn weight_count(&self) -> usize {
        linear::count(self.linears())
    }

    /// Returns all weights in one list.
    pub fn flat_weights(&self) -> Vec<f32> {
        linear::flat_weights(self.linears())
    }

    /// Returns a head of the same shape with other weights, on `device` (with autodiff for training).
    ///
    /// # Panics
    /// If `flat` does not have [`weight_count`](Self::weight_count) numbers.
    #[must_use]
    pub fn with_flat_weights(mut self, flat: &[f32], device: &Device) -> Self {
        linear::set_flat(self.parts_mut().flat_map(|(_, layers)| layers), flat, device);
        self
    }

    /// Returns the gradients in the order of [`flat_weights`](Self::flat_weights); 0 where the loss does not
    /// depend on a weight.
    pub fn flat_gradients(&self, gradients: &GradientsParams) -> Vec<f32> {
        linear::flat_gradients(self.linears(), gradients)
    }
}
