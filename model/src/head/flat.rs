//! All weights of a head, and their gradients, as one list of numbers.
//!
//! The order is that of [`Head::weights`]: row-major `[out, in]` weight, then bias, layer by layer.

use burn::{module::Param, nn::Linear, optim::GradientsParams, prelude::Device};

use super::{Head, SelectionNetwork};
use crate::linear;

impl Head {
    /// The layers in the order of [`weights`](Self::weights).
    fn linears(&self) -> impl Iterator<Item = &Linear> {
        let layers = self.layers.iter().flat_map(|layer| layer.network().linears());
        self.encoder.iter().chain(layers).chain(self.selection.iter().flat_map(SelectionNetwork::linears))
    }

    fn linears_mut(&mut self) -> impl Iterator<Item = &mut Linear> {
        let layers = self.layers.iter_mut().flat_map(|layer| layer.network_mut().linears_mut());
        let selection = self.selection.iter_mut().flat_map(SelectionNetwork::linears_mut);
        self.encoder.iter_mut().chain(layers).chain(selection)
    }

    /// Number of weights.
    pub fn weight_count(&self) -> usize {
        self.linears().map(linear::value_count).sum()
    }

    /// Every weight in one list.
    pub fn flat_weights(&self) -> Vec<f32> {
        let mut flat = Vec::with_capacity(self.weight_count());
        for layer in self.linears() {
            linear::flatten(layer.weight.val(), layer.bias.as_ref().map(Param::val), &mut flat);
        }
        flat
    }

    /// A head of the same shape with other weights, on `device` (with autodiff where it is to be trained).
    ///
    /// # Panics
    /// If `flat` does not have [`weight_count`](Self::weight_count) numbers.
    #[must_use]
    pub fn with_flat_weights(mut self, flat: &[f32], device: &Device) -> Self {
        assert_eq!(flat.len(), self.weight_count(), "one number for each weight");
        let mut rest = flat;
        for layer in self.linears_mut() {
            let (values, after) = rest.split_at(linear::value_count(layer));
            *layer = linear::unflatten(layer, values, device);
            rest = after;
        }
        self
    }

    /// Gradients in the order of [`flat_weights`](Self::flat_weights); 0 where the loss does not depend on a weight.
    pub fn flat_gradients(&self, gradients: &GradientsParams) -> Vec<f32> {
        let mut flat = Vec::with_capacity(self.weight_count());
        for layer in self.linears() {
            let weight = gradients.get::<2>(layer.weight.id).unwrap_or_else(|| layer.weight.val().inner().zeros_like());
            let bias = layer.bias.as_ref().and_then(|bias| gradients.get::<1>(bias.id));
            linear::flatten(weight, bias, &mut flat);
        }
        flat
    }
}
