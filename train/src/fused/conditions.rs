//! Computations per condition: encoder, the condition's part of the first layers, mixture weight, and in
//! autoregressive mode the elevation's network.

use std::ops::Range;

use headtail_model::Mode;

use super::{
    layout::Layout,
    matrix::{Form, Matrix, multiply},
    perceptron::{BackwardScratch, Hidden, Layer, leaky_relu, leaky_relu_backward},
};
use crate::integrand::Batch;

/// Matrices with one column per condition; `d_` marks derivatives of the loss.
#[derive(Default)]
pub(super) struct Conditions {
    pub count: usize,
    /// The condition, followed by the encoder's output: the input of every network.
    seen: Vec<f32>,
    encoder: Hidden,
    /// First hidden layers before activation, without the samples' part.
    pub elevation: Vec<f32>,
    pub azimuth: Vec<f32>,
    pub d_elevation: Vec<f32>,
    pub d_azimuth: Vec<f32>,
    mixture_weight_hidden: Hidden,
    /// Logits of the mixture weights; empty without learned mixture weight.
    mixture_weight_logits: Vec<f32>,
    d_mixture_weight_logits: Vec<f32>,
    /// Autoregressive mode: the elevation's hidden layers, and its logits.
    elevation_hidden: Hidden,
    pub elevation_logits: Vec<f32>,
    pub d_elevation_logits: Vec<f32>,
    d_seen: Vec<f32>,
    d_latent: Vec<f32>,
    latent: Vec<f32>,
    scratch: BackwardScratch,
}

impl Conditions {
    #[inline(always)]
    pub fn forward(&mut self, layout: &Layout, weights: &[f32], batch: &Batch, range: Range<usize>) {
        let (length, count, slope) = (batch.condition_length, range.len(), layout.config.leaky_slope);
        self.count = count;
        self.seen.clear();
        self.seen.resize(length * count, 0.0);
        for (column, condition) in batch.conditions.chunks_exact(length).skip(range.start).take(count).enumerate() {
            for (row, &value) in condition.iter().enumerate() {
                self.seen[row * count + column] = value;
            }
        }
        if let [first, ..] = &layout.encoder[..] {
            let condition = Matrix::new(&self.seen, length, count);
            first.forward(weights, condition, self.encoder.first(&layout.encoder));
            self.encoder.forward(&layout.encoder, weights, slope, count, &mut self.latent);
            leaky_relu(&mut self.latent, slope);
            self.seen.extend_from_slice(&self.latent);
        }
        let seen = Matrix::new(&self.seen, layout.config.network_condition(), count);
        layout.elevation[0].forward(weights, seen, &mut self.elevation);
        layout.azimuth[0].forward(weights, seen, &mut self.azimuth);
        clear(&mut self.d_elevation, self.elevation.len());
        clear(&mut self.d_azimuth, self.azimuth.len());
        if let [first, ..] = &layout.mixture_weight[..] {
            first.forward(weights, seen, self.mixture_weight_hidden.first(&layout.mixture_weight));
            self.mixture_weight_hidden.forward(
                &layout.mixture_weight,
                weights,
                slope,
                count,
                &mut self.mixture_weight_logits,
            );
            clear(&mut self.d_mixture_weight_logits, count);
        }
        if layout.config.mode == Mode::Autoregressive {
            self.elevation_hidden.first(&layout.elevation).clone_from(&self.elevation);
            self.elevation_hidden.forward(&layout.elevation, weights, slope, count, &mut self.elevation_logits);
            clear(&mut self.d_elevation_logits, self.elevation_logits.len());
        }
    }

    /// Returns the mixture weight logits of some columns and their derivatives; empty without learned mixture
    /// weight.
    pub fn mixture_weight_logits_of(&mut self, columns: Range<usize>) -> (&[f32], &mut [f32]) {
        match self.mixture_weight_logits.get(columns.clone()) {
            Some(logits) => (logits, &mut self.d_mixture_weight_logits[columns]),
            None => (&[], &mut []),
        }
    }

    /// Propagates derivatives with respect to first layers, mixture weights and elevation logits to the
    /// weights.
    #[inline(always)]
    pub fn backward(&mut self, layout: &Layout, weights: &[f32], gradient: &mut [f32]) {
        let (count, slope) = (self.count, layout.config.leaky_slope);
        let scratch = &mut self.scratch;
        if layout.config.mode == Mode::Autoregressive {
            let d_logits = Matrix::new(&self.d_elevation_logits, layout.config.logits(), count);
            self.elevation_hidden.backward(&layout.elevation, weights, slope, d_logits, scratch, gradient);
            self.d_elevation.clone_from(&scratch.d_hidden);
        }
        let rows = layout.config.network_condition();
        clear(&mut self.d_seen, rows * count);
        let seen = Matrix::new(&self.seen, rows, count);
        if let [first, ..] = &layout.mixture_weight[..] {
            let d_logits = Matrix::new(&self.d_mixture_weight_logits, 1, count);
            self.mixture_weight_hidden.backward(&layout.mixture_weight, weights, slope, d_logits, scratch, gradient);
            first_layer_backward(first, weights, &scratch.d_hidden, seen, gradient, &mut self.d_seen);
        }
        for (layer, derivatives) in [(&layout.elevation[0], &self.d_elevation), (&layout.azimuth[0], &self.d_azimuth)] {
            first_layer_backward(layer, weights, derivatives, seen, gradient, &mut self.d_seen);
        }
        if let [first, second] = &layout.encoder[..] {
            let (condition, latent) = self.seen.split_at(first.inputs * count);
            leaky_relu_backward(&self.d_seen[condition.len()..], latent, slope, &mut self.d_latent);
            let d_latent = Matrix::new(&self.d_latent, second.outputs, count);
            self.encoder.backward(&layout.encoder, weights, slope, d_latent, scratch, gradient);
            let d_hidden = Matrix::new(&scratch.d_hidden, first.outputs, count);
            first.add_gradient(d_hidden, Matrix::new(condition, first.inputs, count), gradient);
        }
    }
}

#[inline(always)]
fn clear(values: &mut Vec<f32>, length: usize) {
    values.clear();
    values.resize(length, 0.0);
}

/// Adds the gradient of the condition's part of a first layer, and its contribution to the derivatives with
/// respect to the network inputs.
#[inline(always)]
fn first_layer_backward(
    layer: &Layer,
    weights: &[f32],
    d_output: &[f32],
    seen: Matrix<'_>,
    gradient: &mut [f32],
    d_seen: &mut [f32],
) {
    let d_output = Matrix::new(d_output, layer.outputs, seen.columns);
    layer.add_gradient(d_output, seen, gradient);
    let weight = layer.weight(weights).columns(0, seen.rows);
    multiply(Form::LeftTransposed, weight, d_output, d_seen, seen.columns, true);
}
