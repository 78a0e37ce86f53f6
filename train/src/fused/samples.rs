//! What is computed for every sample of a group of conditions: both spline networks, both splines, and the way back.

use std::f32::consts::TAU;

use headtail_model::{Mode, spline::Topology};
use headtail_render::simd::{LANES, Lanes};

use super::{
    Layout,
    conditions::Conditions,
    matrix::Matrix,
    perceptron::{Layer, dot, leaky_relu, leaky_relu_backward, sum},
    spline::Splines,
};
use crate::{Objective, loss::LossDerivatives, target::Batch};

/// A group of conditions: `count` from `first` on in the batch, from `column` on in the matrices of conditions.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub first: usize,
    pub count: usize,
    pub column: usize,
}

/// Matrices with one column per sample of a group, padded to whole lanes.
#[derive(Default)]
pub(super) struct Samples {
    columns: usize,
    u: Vec<f32>,
    v: Vec<f32>,
    elevation: Network,
    azimuth: Network,
    /// The loss's derivatives by the log-density.
    by_log_q: Vec<f32>,
    log_q: Vec<f32>,
}

/// One spline network and its splines.
#[derive(Default)]
struct Network {
    /// Rows of the other coordinate's features.
    features: Vec<f32>,
    /// Activations of the hidden layers.
    hidden: Vec<Vec<f32>>,
    /// Logits, then the derivatives of the log-slopes by them, then those of the loss.
    logits: Vec<f32>,
    /// Derivatives of the values by the logits.
    of_values: Vec<f32>,
    values: Vec<f32>,
    log_slopes: Vec<f32>,
    exponentials: Vec<Lanes>,
    by_hidden: Vec<f32>,
    scratch: Vec<f32>,
    by_feature: Vec<f32>,
}

impl Samples {
    #[inline(always)]
    pub fn forward(&mut self, layout: &Layout, weights: &[f32], batch: &Batch, conditions: &Conditions, place: Place) {
        self.load(batch, place);
        let (columns, samples) = (self.columns, batch.samples);
        let Self { u, v, elevation, azimuth, .. } = self;
        let coupled = layout.config.mode == Mode::Coupled;
        elevation.features.clear();
        if coupled {
            for &u in &*u {
                elevation.features.push((TAU * u).cos());
            }
            for &u in &*u {
                elevation.features.push((TAU * u).sin());
            }
            let first = First { matrix: &conditions.elevation, stride: conditions.count, place, samples };
            elevation.forward(&layout.elevation, weights, &first, columns, layout.config.leaky_slope);
        } else {
            elevation.logits.clear();
            elevation.logits.resize(layout.config.logits() * columns, 0.0);
            let rows = conditions.elevation_logits.chunks_exact(conditions.count);
            for (row, out) in rows.zip(elevation.logits.chunks_exact_mut(columns)) {
                for (logit, out) in row[place.column..].iter().zip(out.chunks_exact_mut(samples)).take(place.count) {
                    out.fill(*logit);
                }
            }
        }
        elevation.splines(Topology::Interval, layout.config.bins, v, coupled);
        azimuth.features.clear();
        azimuth.features.extend_from_slice(if coupled { &elevation.values } else { v });
        let first = First { matrix: &conditions.azimuth, stride: conditions.count, place, samples };
        azimuth.forward(&layout.azimuth, weights, &first, columns, layout.config.leaky_slope);
        azimuth.splines(Topology::Circle, layout.config.bins, u, false);
    }

    #[inline(always)]
    fn load(&mut self, batch: &Batch, place: Place) {
        let count = place.count * batch.samples;
        self.columns = count.next_multiple_of(LANES);
        for (coordinate, out) in [&mut self.u, &mut self.v].into_iter().enumerate() {
            out.clear();
            let points = &batch.points[2 * place.first * batch.samples..][..2 * count];
            for point in points.chunks_exact(2) {
                out.push(point[coordinate]);
            }
            out.resize(self.columns, 0.5);
        }
    }

    /// The loss of the group times `scale`; keeps its derivatives.
    #[inline(always)]
    pub fn evaluate_loss(
        &mut self,
        objective: Objective,
        batch: &Batch,
        conditions: &mut Conditions,
        place: Place,
        scale: f32,
    ) -> f32 {
        let samples = batch.samples;
        self.log_q.clear();
        for (v, u) in self.elevation.log_slopes.iter().zip(&self.azimuth.log_slopes) {
            self.log_q.push(v + u);
        }
        self.by_log_q.clear();
        self.by_log_q.resize(self.columns, 0.0);
        let mut total = 0.0;
        for index in 0..place.count {
            let range = index * samples..(index + 1) * samples;
            let logit = conditions.selection.get(place.column + index).copied();
            let mut out = LossDerivatives { by_log_q: &mut self.by_log_q[range.clone()], by_selection: 0.0 };
            let points = batch.condition(place.first + index);
            if let Some(loss) = objective.evaluate(&points, &self.log_q[range], logit, &mut out) {
                total += loss;
                if let Some(by_selection) = conditions.by_selection.get_mut(place.column + index) {
                    *by_selection = out.by_selection * scale;
                }
            }
        }
        for derivative in &mut self.by_log_q {
            *derivative *= scale;
        }
        total * scale
    }

    #[inline(always)]
    pub fn backward(
        &mut self,
        layout: &Layout,
        weights: &[f32],
        batch: &Batch,
        conditions: &mut Conditions,
        place: Place,
        gradient: &mut [f32],
    ) {
        let (columns, stride, slope) = (self.columns, conditions.count, layout.config.leaky_slope);
        let Self { elevation, azimuth, by_log_q, .. } = self;
        let coupled = layout.config.mode == Mode::Coupled;
        scale_columns(&mut azimuth.logits, by_log_q);
        let mut first = FirstMut { matrix: &mut conditions.by_azimuth, stride, place, samples: batch.samples };
        azimuth.backward(&layout.azimuth, weights, columns, slope, &mut first, gradient);
        scale_columns(&mut elevation.logits, by_log_q);
        if coupled {
            azimuth.by_first_feature(&layout.azimuth[0], weights, columns);
            for (out, of_value) in
                elevation.logits.chunks_exact_mut(columns).zip(elevation.of_values.chunks_exact(columns))
            {
                for ((out, of_value), by_value) in out.iter_mut().zip(of_value).zip(&azimuth.by_feature) {
                    *out += of_value * by_value;
                }
            }
            let mut first = FirstMut { matrix: &mut conditions.by_elevation, stride, place, samples: batch.samples };
            elevation.backward(&layout.elevation, weights, columns, slope, &mut first, gradient);
        } else {
            let rows = conditions.by_elevation_logits.chunks_exact_mut(stride);
            for (out, row) in rows.zip(elevation.logits.chunks_exact(columns)) {
                for (out, part) in out[place.column..].iter_mut().zip(row.chunks_exact(batch.samples)).take(place.count)
                {
                    *out += sum(part);
                }
            }
        }
    }
}

/// Multiplies every row by `factors`.
#[inline(always)]
fn scale_columns(matrix: &mut [f32], factors: &[f32]) {
    for row in matrix.chunks_exact_mut(factors.len()) {
        for (value, factor) in row.iter_mut().zip(factors) {
            *value *= factor;
        }
    }
}

/// The conditions' part of a first layer.
struct First<'a> {
    matrix: &'a [f32],
    stride: usize,
    place: Place,
    samples: usize,
}

/// Derivatives by it.
struct FirstMut<'a> {
    matrix: &'a mut [f32],
    stride: usize,
    place: Place,
    samples: usize,
}

impl Network {
    #[inline(always)]
    fn forward(&mut self, layers: &[Layer], weights: &[f32], conditions: &First<'_>, columns: usize, slope: f32) {
        let (last, inner) = layers[1..].split_last().expect("a network has at least two layers");
        self.hidden.resize(inner.len() + 1, Vec::new());
        self.first_layer(&layers[0], weights, conditions, columns, slope);
        for (index, layer) in inner.iter().enumerate() {
            let (before, after) = self.hidden.split_at_mut(index + 1);
            layer.forward(weights, Matrix::new(&before[index], layer.inputs, columns), &mut after[0]);
            leaky_relu(&mut after[0], slope);
        }
        last.forward(weights, Matrix::new(&self.hidden[inner.len()], last.inputs, columns), &mut self.logits);
    }

    /// Condition's part plus features, activated.
    #[inline(always)]
    fn first_layer(&mut self, layer: &Layer, weights: &[f32], first: &First<'_>, columns: usize, slope: f32) {
        let features = self.features.len() / columns;
        let out = &mut self.hidden[0];
        out.clear();
        out.resize(layer.outputs * columns, 0.0);
        for (unit, out) in out.chunks_exact_mut(columns).enumerate() {
            let from = unit * first.stride + first.place.column;
            let row = &first.matrix[from..from + first.place.count];
            for (value, out) in row.iter().zip(out.chunks_exact_mut(first.samples)) {
                out.fill(*value);
            }
            for (index, feature) in self.features.chunks_exact(columns).enumerate() {
                let weight = weights[layer.weight_at(unit, layer.inputs - features + index)];
                for (out, feature) in out.iter_mut().zip(feature) {
                    *out += weight * feature;
                }
            }
            leaky_relu(out, slope);
        }
    }

    #[inline(always)]
    fn splines(&mut self, topology: Topology, bins: usize, points: &[f32], with_values: bool) {
        let samples = points.len();
        self.values.resize(samples, 0.0);
        self.log_slopes.resize(samples, 0.0);
        self.of_values.resize(if with_values { self.logits.len() } else { 0 }, 0.0);
        Splines {
            topology,
            bins,
            samples,
            points,
            logits: &mut self.logits,
            of_values: &mut self.of_values,
            values: &mut self.values,
            log_slopes: &mut self.log_slopes,
            scratch: &mut self.exponentials,
        }
        .evaluate();
    }

    /// From the derivatives by the logits to those by the weights and by the conditions' part of the first layer.
    #[inline(always)]
    fn backward(
        &mut self,
        layers: &[Layer],
        weights: &[f32],
        columns: usize,
        slope: f32,
        first: &mut FirstMut<'_>,
        gradient: &mut [f32],
    ) {
        for (index, layer) in layers.iter().enumerate().skip(1).rev() {
            let hidden = &self.hidden[index - 1];
            let by_output = if index + 1 == layers.len() { &self.logits } else { &self.by_hidden };
            let by_output = Matrix::new(by_output, layer.outputs, columns);
            layer.add_gradient(by_output, Matrix::new(hidden, layer.inputs, columns), gradient);
            layer.backward(weights, (0, layer.inputs), by_output, &mut self.scratch);
            leaky_relu_backward(&mut self.scratch, hidden, slope);
            std::mem::swap(&mut self.by_hidden, &mut self.scratch);
        }
        let layer = &layers[0];
        let features = self.features.len() / columns;
        for (unit, row) in self.by_hidden.chunks_exact(columns).enumerate() {
            for (index, feature) in self.features.chunks_exact(columns).enumerate() {
                gradient[layer.weight_at(unit, layer.inputs - features + index)] += dot(row, feature);
            }
            let from = unit * first.stride + first.place.column;
            let out = &mut first.matrix[from..from + first.place.count];
            for (out, part) in out.iter_mut().zip(row.chunks_exact(first.samples)) {
                *out += sum(part);
            }
        }
    }

    /// The loss's derivatives by the first feature.
    #[inline(always)]
    fn by_first_feature(&mut self, layer: &Layer, weights: &[f32], columns: usize) {
        let features = self.features.len() / columns;
        self.by_feature.clear();
        self.by_feature.resize(columns, 0.0);
        for (unit, row) in self.by_hidden.chunks_exact(columns).enumerate() {
            let weight = weights[layer.weight_at(unit, layer.inputs - features)];
            for (out, derivative) in self.by_feature.iter_mut().zip(row) {
                *out += weight * derivative;
            }
        }
    }
}
