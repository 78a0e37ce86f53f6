//! What is computed once per condition: encoder, the condition's part of the first layers, selection, and in autoregressive
//! mode the elevation's network.

use std::ops::Range;

use headtail_model::Mode;

use super::{
    Layout,
    matrix::{Form, Matrix, multiply},
    perceptron::{Layer, leaky_relu, leaky_relu_backward},
};
use crate::target::Batch;

/// Matrices with one column per condition; `by_` are derivatives of the loss.
#[derive(Default)]
pub(super) struct Conditions {
    pub count: usize,
    /// The condition and below it the encoder's output: what every network sees.
    seen: Vec<f32>,
    encoder_hidden: Vec<f32>,
    /// First hidden layers before activation, without the samples' part.
    pub elevation: Vec<f32>,
    pub azimuth: Vec<f32>,
    pub by_elevation: Vec<f32>,
    pub by_azimuth: Vec<f32>,
    selection_hidden: Vec<f32>,
    /// Empty without selection.
    pub selection: Vec<f32>,
    pub by_selection: Vec<f32>,
    /// Autoregressive mode: activations of the elevation's hidden layers, and its logits.
    elevation_hidden: Vec<Vec<f32>>,
    pub elevation_logits: Vec<f32>,
    pub by_elevation_logits: Vec<f32>,
    by_seen: Vec<f32>,
    scratch: Vec<f32>,
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
        if let [first, second] = &layout.encoder[..] {
            first.forward(weights, Matrix::new(&self.seen, length, count), &mut self.encoder_hidden);
            leaky_relu(&mut self.encoder_hidden, slope);
            let hidden = Matrix::new(&self.encoder_hidden, first.outputs, count);
            second.forward(weights, hidden, &mut self.scratch);
            leaky_relu(&mut self.scratch, slope);
            self.seen.extend_from_slice(&self.scratch);
        }
        let seen = Matrix::new(&self.seen, layout.config.network_condition(), count);
        layout.elevation[0].forward(weights, seen, &mut self.elevation);
        layout.azimuth[0].forward(weights, seen, &mut self.azimuth);
        for (derivatives, values) in [(&mut self.by_elevation, &self.elevation), (&mut self.by_azimuth, &self.azimuth)]
        {
            derivatives.clear();
            derivatives.resize(values.len(), 0.0);
        }
        if let [first, second] = &layout.selection[..] {
            first.forward(weights, seen, &mut self.selection_hidden);
            leaky_relu(&mut self.selection_hidden, slope);
            second.forward(weights, Matrix::new(&self.selection_hidden, first.outputs, count), &mut self.selection);
            self.by_selection.clear();
            self.by_selection.resize(count, 0.0);
        }
        if layout.config.mode == Mode::Autoregressive {
            self.elevation_forward(layout, weights);
        }
    }

    #[inline(always)]
    fn elevation_forward(&mut self, layout: &Layout, weights: &[f32]) {
        let (count, slope) = (self.count, layout.config.leaky_slope);
        let (last, inner) = layout.elevation[1..].split_last().expect("a network has at least two layers");
        self.elevation_hidden.resize(inner.len() + 1, Vec::new());
        self.elevation_hidden[0].clone_from(&self.elevation);
        leaky_relu(&mut self.elevation_hidden[0], slope);
        for (index, layer) in inner.iter().enumerate() {
            let (before, after) = self.elevation_hidden.split_at_mut(index + 1);
            layer.forward(weights, Matrix::new(&before[index], layer.inputs, count), &mut after[0]);
            leaky_relu(&mut after[0], slope);
        }
        let hidden = Matrix::new(&self.elevation_hidden[inner.len()], last.inputs, count);
        last.forward(weights, hidden, &mut self.elevation_logits);
        self.by_elevation_logits.clear();
        self.by_elevation_logits.resize(self.elevation_logits.len(), 0.0);
    }

    /// From the derivatives by first layers, selection and elevation logits to those by the weights.
    #[inline(always)]
    pub fn backward(&mut self, layout: &Layout, weights: &[f32], gradient: &mut [f32]) {
        let (count, slope) = (self.count, layout.config.leaky_slope);
        if layout.config.mode == Mode::Autoregressive {
            self.elevation_backward(layout, weights, gradient);
        }
        let rows = layout.config.network_condition();
        self.by_seen.clear();
        self.by_seen.resize(rows * count, 0.0);
        let seen = Matrix::new(&self.seen, rows, count);
        if let [first, second] = &layout.selection[..] {
            let by_logits = Matrix::new(&self.by_selection, 1, count);
            second.add_gradient(by_logits, Matrix::new(&self.selection_hidden, second.inputs, count), gradient);
            second.backward(weights, (0, second.inputs), by_logits, &mut self.scratch);
            leaky_relu_backward(&mut self.scratch, &self.selection_hidden, slope);
            first_layer_backward(first, weights, &self.scratch, seen, gradient, &mut self.by_seen);
        }
        for (layer, derivatives) in [(&layout.elevation[0], &self.by_elevation), (&layout.azimuth[0], &self.by_azimuth)]
        {
            first_layer_backward(layer, weights, derivatives, seen, gradient, &mut self.by_seen);
        }
        if let [first, second] = &layout.encoder[..] {
            let length = first.inputs;
            let by_output = &mut self.by_seen[length * count..];
            leaky_relu_backward(by_output, &self.seen[length * count..], slope);
            let by_output = Matrix::new(by_output, second.outputs, count);
            second.add_gradient(by_output, Matrix::new(&self.encoder_hidden, second.inputs, count), gradient);
            second.backward(weights, (0, second.inputs), by_output, &mut self.scratch);
            leaky_relu_backward(&mut self.scratch, &self.encoder_hidden, slope);
            let by_hidden = Matrix::new(&self.scratch, first.outputs, count);
            first.add_gradient(by_hidden, Matrix::new(&self.seen[..length * count], length, count), gradient);
        }
    }

    #[inline(always)]
    fn elevation_backward(&mut self, layout: &Layout, weights: &[f32], gradient: &mut [f32]) {
        let count = self.count;
        let mut by_output = self.by_elevation_logits.clone();
        for (index, layer) in layout.elevation.iter().enumerate().skip(1).rev() {
            let hidden = &self.elevation_hidden[index - 1];
            let derivatives = Matrix::new(&by_output, layer.outputs, count);
            layer.add_gradient(derivatives, Matrix::new(hidden, layer.inputs, count), gradient);
            layer.backward(weights, (0, layer.inputs), derivatives, &mut self.scratch);
            leaky_relu_backward(&mut self.scratch, hidden, layout.config.leaky_slope);
            std::mem::swap(&mut by_output, &mut self.scratch);
        }
        self.by_elevation = by_output;
    }
}

/// The condition's part of a first layer: its gradient, and what it adds to the derivatives by what the networks see.
#[inline(always)]
fn first_layer_backward(
    layer: &Layer,
    weights: &[f32],
    by_output: &[f32],
    seen: Matrix<'_>,
    gradient: &mut [f32],
    by_seen: &mut [f32],
) {
    let by_output = Matrix::new(by_output, layer.outputs, seen.columns);
    layer.add_gradient(by_output, seen, gradient);
    let weight = layer.weight(weights).columns(0, seen.rows);
    multiply(Form::LeftTransposed, weight, by_output, by_seen, seen.columns, true);
}
