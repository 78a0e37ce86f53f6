//! Computations per sample of a group of conditions: both spline networks, both splines, and the backward
//! pass.

use std::{f32::consts::TAU, ops::Range};

use headtail_model::{Mode, spline::Topology};
use headtail_render::simd::LANES;

use super::{
    conditions::Conditions,
    layout::Layout,
    matrix::Matrix,
    perceptron::{BackwardScratch, Hidden, Layer, dot, sum},
    splines::Splines,
};
use crate::{Objective, integrand::Batch};

/// Number of samples in a block: with 36 k weights, a block takes about 0.33 MB.
const BLOCK: usize = 128;

/// A group of `count` whole conditions, from `first` on in the batch, from `column` on in the matrices of
/// conditions.
#[derive(Clone, Copy)]
pub(super) struct ConditionGroup {
    pub first: usize,
    pub count: usize,
    pub column: usize,
}

/// The samples of a group, in blocks. A block passes through all layers while it is in the second-level
/// cache; its backward pass follows the loss, which needs all samples of a condition.
#[derive(Default)]
pub(super) struct Samples {
    blocks: Vec<Block>,
    /// Number of blocks in use by the group.
    used: usize,
    /// Log-densities of the group's samples; below, the derivatives of the loss with respect to them.
    log_q: Vec<f32>,
    d_log_q: Vec<f32>,
}

/// Matrices with one column per sample, padded to whole lanes.
#[derive(Default)]
struct Block {
    /// Range of the block in the group's samples.
    samples: Range<usize>,
    columns: usize,
    segments: Vec<Segment>,
    u: Vec<f32>,
    v: Vec<f32>,
    elevation: Network,
    azimuth: Network,
    d_log_q: Vec<f32>,
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
    hidden: Hidden,
    splines: Splines,
}

/// Buffers shared by blocks.
#[derive(Default)]
pub(super) struct Scratch {
    backward: BackwardScratch,
    d_feature: Vec<f32>,
}

/// Weights and their layout.
#[derive(Clone, Copy)]
pub(super) struct Weights<'a> {
    pub layout: &'a Layout,
    pub values: &'a [f32],
}

impl Samples {
    #[inline(always)]
    pub fn forward(&mut self, weights: Weights<'_>, batch: &Batch, conditions: &Conditions, group: ConditionGroup) {
        let count = group.count * batch.samples;
        self.used = count.div_ceil(BLOCK);
        if self.blocks.len() < self.used {
            self.blocks.resize_with(self.used, Block::default);
        }
        self.log_q.clear();
        for (index, block) in self.blocks[..self.used].iter_mut().enumerate() {
            block.samples = index * BLOCK..((index + 1) * BLOCK).min(count);
            block.load(batch, group);
            block.forward(weights, conditions);
            let [v, u] = [&block.elevation, &block.azimuth].map(|network| &network.splines.log_slopes);
            for (v, u) in v.iter().zip(u).take(block.samples.len()) {
                self.log_q.push(v + u);
            }
        }
    }

    /// Returns the loss of the group times `scale`; stores its derivatives.
    #[inline(always)]
    pub fn evaluate_loss(
        &mut self,
        objective: Objective,
        batch: &Batch,
        conditions: &mut Conditions,
        group: ConditionGroup,
        scale: f32,
    ) -> f32 {
        self.d_log_q.resize(self.log_q.len(), 0.0);
        let (mixture_weight_logits, d_mixture_weight_logits) =
            conditions.mixture_weight_logits_of(group.column..group.column + group.count);
        let total = objective.evaluate_conditions(
            batch,
            group.first,
            &self.log_q,
            mixture_weight_logits,
            &mut self.d_log_q,
            d_mixture_weight_logits,
        );
        for derivative in self.d_log_q.iter_mut().chain(d_mixture_weight_logits) {
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
            block.d_log_q.clear();
            block.d_log_q.extend_from_slice(&self.d_log_q[block.samples.clone()]);
            block.d_log_q.resize(block.columns, 0.0);
            block.backward(weights, conditions, scratch, gradient);
        }
    }
}

impl Block {
    #[inline(always)]
    fn load(&mut self, batch: &Batch, group: ConditionGroup) {
        let range = self.samples.clone();
        self.columns = range.len().next_multiple_of(LANES);
        for (coordinate, out) in [&mut self.u, &mut self.v].into_iter().enumerate() {
            out.clear();
            let points = &batch.points[2 * (group.first * batch.samples + range.start)..][..2 * range.len()];
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
            self.segments.push(Segment { condition: group.column + condition, columns });
            at = end;
        }
    }

    #[inline(always)]
    fn forward(&mut self, weights: Weights<'_>, conditions: &Conditions) {
        let Self { columns, segments, u, v, elevation, azimuth, .. } = self;
        let Weights { layout, .. } = weights;
        let (coupled, bins) = (layout.config.mode == Mode::Coupled, layout.config.bins);
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
            let logits = &mut elevation.splines.logits;
            logits.clear();
            logits.resize(layout.config.logits() * *columns, 0.0);
            let rows = conditions.elevation_logits.chunks_exact(conditions.count);
            for (row, out) in rows.zip(logits.chunks_exact_mut(*columns)) {
                for segment in &*segments {
                    out[segment.columns.clone()].fill(row[segment.condition]);
                }
            }
        }
        elevation.splines.evaluate(Topology::Interval, bins, v, coupled);
        azimuth.features.clear();
        azimuth.features.extend_from_slice(if coupled { &elevation.splines.values } else { v });
        let first = First { matrix: &conditions.azimuth, stride: conditions.count, segments };
        azimuth.forward(&layout.azimuth, weights, &first, *columns);
        azimuth.splines.evaluate(Topology::Circle, bins, u, false);
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
        let Self { columns, segments, elevation, azimuth, d_log_q, .. } = self;
        azimuth.splines.backward(d_log_q, None);
        let mut first = FirstMut { matrix: &mut conditions.d_azimuth, stride, segments };
        azimuth.backward(&layout.azimuth, weights, *columns, &mut first, scratch, gradient);
        if layout.config.mode == Mode::Coupled {
            azimuth.d_first_feature(&layout.azimuth[0], weights.values, *columns, scratch);
            elevation.splines.backward(d_log_q, Some(&scratch.d_feature));
            let mut first = FirstMut { matrix: &mut conditions.d_elevation, stride, segments };
            elevation.backward(&layout.elevation, weights, *columns, &mut first, scratch, gradient);
        } else {
            let rows = conditions.d_elevation_logits.chunks_exact_mut(stride);
            for (out, row) in rows.zip(elevation.splines.logits.chunks_exact(*columns)) {
                for segment in &*segments {
                    out[segment.condition] += dot(&row[segment.columns.clone()], &d_log_q[segment.columns.clone()]);
                }
            }
        }
    }
}

/// The conditions' part of a first layer.
struct First<'a> {
    matrix: &'a [f32],
    stride: usize,
    segments: &'a [Segment],
}

/// Derivatives with respect to [`First`].
struct FirstMut<'a> {
    matrix: &'a mut [f32],
    stride: usize,
    segments: &'a [Segment],
}

impl Network {
    #[inline(always)]
    fn forward(&mut self, layers: &[Layer], weights: Weights<'_>, conditions: &First<'_>, columns: usize) {
        self.first_layer(layers, weights, conditions, columns);
        let slope = weights.layout.config.leaky_slope;
        self.hidden.forward(layers, weights.values, slope, columns, &mut self.splines.logits);
    }

    /// Adds the condition's part and the features' part.
    #[inline(always)]
    fn first_layer(&mut self, layers: &[Layer], weights: Weights<'_>, first: &First<'_>, columns: usize) {
        let (layer, features) = (&layers[0], self.features.len() / columns);
        let out = self.hidden.first(layers);
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
        }
    }

    /// Propagates derivatives from the logits to the weights and the conditions' part of the first layer.
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
        let d_logits = Matrix::new(&self.splines.logits, weights.layout.config.logits(), columns);
        let slope = weights.layout.config.leaky_slope;
        self.hidden.backward(layers, weights.values, slope, d_logits, &mut scratch.backward, gradient);
        let layer = &layers[0];
        let features = self.features.len() / columns;
        for (unit, row) in scratch.backward.d_hidden.chunks_exact(columns).enumerate() {
            for (index, feature) in self.features.chunks_exact(columns).enumerate() {
                gradient[layer.weight_at(unit, layer.inputs - features + index)] += dot(row, feature);
            }
            let out = &mut first.matrix[unit * first.stride..][..first.stride];
            for segment in first.segments {
                out[segment.condition] += sum(&row[segment.columns.clone()]);
            }
        }
    }

    /// Computes derivatives with respect to the first feature from those with respect to the first hidden
    /// layer.
    #[inline(always)]
    fn d_first_feature(&self, layer: &Layer, weights: &[f32], columns: usize, scratch: &mut Scratch) {
        let features = self.features.len() / columns;
        scratch.d_feature.clear();
        scratch.d_feature.resize(columns, 0.0);
        for (unit, row) in scratch.backward.d_hidden.chunks_exact(columns).enumerate() {
            let weight = weights[layer.weight_at(unit, layer.inputs - features)];
            for (out, derivative) in scratch.d_feature.iter_mut().zip(row) {
                *out += weight * derivative;
            }
        }
    }
}
