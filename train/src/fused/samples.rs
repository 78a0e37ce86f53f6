//! What is computed for every sample of a group of conditions: both spline networks, both splines, and the way back.

use std::{f32::consts::TAU, ops::Range};

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

/// Samples of a block: with 36 k weights it takes a third of a megabyte.
const BLOCK: usize = 128;

/// A group of whole conditions: `count` from `first` on in the batch, from `column` on in the matrices of conditions.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub first: usize,
    pub count: usize,
    pub column: usize,
}

/// The samples of a group, in blocks: a block goes through all layers while it is in the second-level cache, and waits for the
/// loss, which needs all samples of a condition, before it goes back.
#[derive(Default)]
pub(super) struct Samples {
    blocks: Vec<Block>,
    /// How many of the blocks the group has.
    used: usize,
    /// Log-densities of the group's samples, and the loss's derivatives by them.
    log_q: Vec<f32>,
    by_log_q: Vec<f32>,
}

/// Matrices with one column per sample, padded to whole lanes.
#[derive(Default)]
struct Block {
    /// Which of the group's samples these are.
    samples: Range<usize>,
    columns: usize,
    segments: Vec<Segment>,
    u: Vec<f32>,
    v: Vec<f32>,
    elevation: Network,
    azimuth: Network,
    by_log_q: Vec<f32>,
}

/// Columns of a block that belong to one condition.
struct Segment {
    /// Its column in the matrices of conditions.
    condition: usize,
    columns: Range<usize>,
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
}

/// Buffers that blocks share.
#[derive(Default)]
pub(super) struct Scratch {
    spline: Vec<Lanes>,
    by_hidden: Vec<f32>,
    by_activation: Vec<f32>,
    by_feature: Vec<f32>,
}

/// Weights and where they are.
#[derive(Clone, Copy)]
pub(super) struct Weights<'a> {
    pub layout: &'a Layout,
    pub values: &'a [f32],
}

impl Samples {
    #[inline(always)]
    pub fn forward(
        &mut self,
        weights: Weights<'_>,
        batch: &Batch,
        conditions: &Conditions,
        place: Place,
        scratch: &mut Scratch,
    ) {
        let count = place.count * batch.samples;
        self.used = count.div_ceil(BLOCK);
        if self.blocks.len() < self.used {
            self.blocks.resize_with(self.used, Block::default);
        }
        self.log_q.clear();
        for (index, block) in self.blocks[..self.used].iter_mut().enumerate() {
            block.samples = index * BLOCK..((index + 1) * BLOCK).min(count);
            block.load(batch, place);
            block.forward(weights, conditions, scratch);
            for (v, u) in block.elevation.log_slopes.iter().zip(&block.azimuth.log_slopes).take(block.samples.len()) {
                self.log_q.push(v + u);
            }
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
        self.by_log_q.clear();
        self.by_log_q.resize(self.log_q.len(), 0.0);
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
        weights: Weights<'_>,
        conditions: &mut Conditions,
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        for block in &mut self.blocks[..self.used] {
            block.by_log_q.clear();
            block.by_log_q.extend_from_slice(&self.by_log_q[block.samples.clone()]);
            block.by_log_q.resize(block.columns, 0.0);
            block.backward(weights, conditions, scratch, gradient);
        }
    }
}

impl Block {
    #[inline(always)]
    fn load(&mut self, batch: &Batch, place: Place) {
        let range = self.samples.clone();
        self.columns = range.len().next_multiple_of(LANES);
        for (coordinate, out) in [&mut self.u, &mut self.v].into_iter().enumerate() {
            out.clear();
            let points = &batch.points[2 * (place.first * batch.samples + range.start)..][..2 * range.len()];
            for point in points.chunks_exact(2) {
                out.push(point[coordinate]);
            }
            out.resize(self.columns, 0.5);
        }
        self.segments.clear();
        let mut at = range.start;
        while at < range.end {
            let condition = at / batch.samples;
            let end = ((condition + 1) * batch.samples).min(range.end);
            let columns = at - range.start..end - range.start;
            self.segments.push(Segment { condition: place.column + condition, columns });
            at = end;
        }
    }

    #[inline(always)]
    fn forward(&mut self, weights: Weights<'_>, conditions: &Conditions, scratch: &mut Scratch) {
        let Self { columns, segments, u, v, elevation, azimuth, .. } = self;
        let Weights { layout, .. } = weights;
        let coupled = layout.config.mode == Mode::Coupled;
        elevation.features.clear();
        if coupled {
            for &u in &*u {
                elevation.features.push((TAU * u).cos());
            }
            for &u in &*u {
                elevation.features.push((TAU * u).sin());
            }
            let first = First { matrix: &conditions.elevation, stride: conditions.count, segments };
            elevation.forward(&layout.elevation, weights, &first, *columns);
        } else {
            elevation.logits.clear();
            elevation.logits.resize(layout.config.logits() * *columns, 0.0);
            let rows = conditions.elevation_logits.chunks_exact(conditions.count);
            for (row, out) in rows.zip(elevation.logits.chunks_exact_mut(*columns)) {
                for segment in &*segments {
                    out[segment.columns.clone()].fill(row[segment.condition]);
                }
            }
        }
        elevation.splines(Topology::Interval, layout.config.bins, v, coupled, scratch);
        azimuth.features.clear();
        azimuth.features.extend_from_slice(if coupled { &elevation.values } else { v });
        let first = First { matrix: &conditions.azimuth, stride: conditions.count, segments };
        azimuth.forward(&layout.azimuth, weights, &first, *columns);
        azimuth.splines(Topology::Circle, layout.config.bins, u, false, scratch);
    }

    #[inline(always)]
    fn backward(
        &mut self,
        weights: Weights<'_>,
        conditions: &mut Conditions,
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        let (stride, layout) = (conditions.count, weights.layout);
        let Self { columns, segments, elevation, azimuth, by_log_q, .. } = self;
        scale_columns(&mut azimuth.logits, by_log_q);
        let mut first = FirstMut { matrix: &mut conditions.by_azimuth, stride, segments };
        azimuth.backward(&layout.azimuth, weights, *columns, &mut first, scratch, gradient);
        if layout.config.mode == Mode::Coupled {
            azimuth.by_first_feature(&layout.azimuth[0], weights.values, *columns, scratch);
            let rows = elevation.logits.chunks_exact_mut(*columns).zip(elevation.of_values.chunks_exact(*columns));
            for (out, of_value) in rows {
                for (((out, of_value), by_value), by_log_q) in
                    out.iter_mut().zip(of_value).zip(&scratch.by_feature).zip(&*by_log_q)
                {
                    *out = *out * by_log_q + of_value * by_value;
                }
            }
            let mut first = FirstMut { matrix: &mut conditions.by_elevation, stride, segments };
            elevation.backward(&layout.elevation, weights, *columns, &mut first, scratch, gradient);
        } else {
            let rows = conditions.by_elevation_logits.chunks_exact_mut(stride);
            for (out, row) in rows.zip(elevation.logits.chunks_exact(*columns)) {
                for segment in &*segments {
                    out[segment.condition] += dot(&row[segment.columns.clone()], &by_log_q[segment.columns.clone()]);
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
    segments: &'a [Segment],
}

/// Derivatives by it.
struct FirstMut<'a> {
    matrix: &'a mut [f32],
    stride: usize,
    segments: &'a [Segment],
}

impl Network {
    #[inline(always)]
    fn forward(&mut self, layers: &[Layer], weights: Weights<'_>, conditions: &First<'_>, columns: usize) {
        let (last, inner) = layers[1..].split_last().expect("a network has at least two layers");
        let slope = weights.layout.config.leaky_slope;
        self.hidden.resize(inner.len() + 1, Vec::new());
        self.first_layer(&layers[0], weights, conditions, columns);
        for (index, layer) in inner.iter().enumerate() {
            let (before, after) = self.hidden.split_at_mut(index + 1);
            layer.forward(weights.values, Matrix::new(&before[index], layer.inputs, columns), &mut after[0]);
            leaky_relu(&mut after[0], slope);
        }
        last.forward(weights.values, Matrix::new(&self.hidden[inner.len()], last.inputs, columns), &mut self.logits);
    }

    /// Condition's part plus features, activated.
    #[inline(always)]
    fn first_layer(&mut self, layer: &Layer, weights: Weights<'_>, first: &First<'_>, columns: usize) {
        let features = self.features.len() / columns;
        let out = &mut self.hidden[0];
        out.resize(layer.outputs * columns, 0.0);
        for (unit, out) in out.chunks_exact_mut(columns).enumerate() {
            let row = &first.matrix[unit * first.stride..][..first.stride];
            for segment in first.segments {
                out[segment.columns.clone()].fill(row[segment.condition]);
            }
            if let Some(last) = first.segments.last() {
                out[last.columns.end..].fill(0.0);
            }
            for (index, feature) in self.features.chunks_exact(columns).enumerate() {
                let weight = weights.values[layer.weight_at(unit, layer.inputs - features + index)];
                for (out, feature) in out.iter_mut().zip(feature) {
                    *out += weight * feature;
                }
            }
            leaky_relu(out, weights.layout.config.leaky_slope);
        }
    }

    #[inline(always)]
    fn splines(&mut self, topology: Topology, bins: usize, points: &[f32], with_values: bool, scratch: &mut Scratch) {
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
            by_points: [&mut [], &mut []],
            scratch: &mut scratch.spline,
        }
        .evaluate();
    }

    /// From the derivatives by the logits to those by the weights and by the conditions' part of the first layer.
    #[inline(always)]
    fn backward(
        &mut self,
        layers: &[Layer],
        weights: Weights<'_>,
        columns: usize,
        first: &mut FirstMut<'_>,
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        for (index, layer) in layers.iter().enumerate().skip(1).rev() {
            let hidden = &self.hidden[index - 1];
            let by_output = if index + 1 == layers.len() { &self.logits } else { &scratch.by_hidden };
            let by_output = Matrix::new(by_output, layer.outputs, columns);
            layer.add_gradient(by_output, Matrix::new(hidden, layer.inputs, columns), gradient);
            layer.backward(weights.values, (0, layer.inputs), by_output, &mut scratch.by_activation);
            let slope = weights.layout.config.leaky_slope;
            leaky_relu_backward(&scratch.by_activation, hidden, slope, &mut scratch.by_hidden);
        }
        let layer = &layers[0];
        let features = self.features.len() / columns;
        for (unit, row) in scratch.by_hidden.chunks_exact(columns).enumerate() {
            for (index, feature) in self.features.chunks_exact(columns).enumerate() {
                gradient[layer.weight_at(unit, layer.inputs - features + index)] += dot(row, feature);
            }
            let out = &mut first.matrix[unit * first.stride..][..first.stride];
            for segment in first.segments {
                out[segment.condition] += sum(&row[segment.columns.clone()]);
            }
        }
    }

    /// The loss's derivatives by the first feature, from those by the first hidden layer.
    #[inline(always)]
    fn by_first_feature(&self, layer: &Layer, weights: &[f32], columns: usize, scratch: &mut Scratch) {
        let features = self.features.len() / columns;
        scratch.by_feature.clear();
        scratch.by_feature.resize(columns, 0.0);
        for (unit, row) in scratch.by_hidden.chunks_exact(columns).enumerate() {
            let weight = weights[layer.weight_at(unit, layer.inputs - features)];
            for (out, derivative) in scratch.by_feature.iter_mut().zip(row) {
                *out += weight * derivative;
            }
        }
    }
}
