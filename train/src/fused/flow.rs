//! The likelihood of a flow tail and its gradient, in one pass over SIMD lanes. Unlike heads, flows have
//! residual networks, no conditions, and a backward pass through the coordinates of all earlier layers.

use std::f32::consts::{PI, TAU};

use headtail_model::{Flow, coupling::Coordinate};
use headtail_render::simd::{self, LANES, Simd, Vectorized};
use rayon::prelude::*;

use super::{
    FlowLayout,
    matrix::Matrix,
    parts,
    perceptron::{Layer, leaky_relu, leaky_relu_backward},
    splines::Splines,
};
use crate::StepGradient;

/// Number of samples that pass through all layers together.
const BLOCK: usize = 128;

/// Likelihood and gradient of flows of one shape.
pub struct FusedFlow {
    layout: FlowLayout,
    parts: Vec<Part>,
}

#[derive(Default)]
struct Part {
    loss: f32,
    gradient: Vec<f32>,
    scratch: Scratch,
    couplings: Vec<Coupling>,
}

/// State of a coupling for the backward pass of a block. Matrices are `[rows, columns]` with one column per
/// sample.
#[derive(Default)]
struct Coupling {
    other: Vec<f32>,
    features: Vec<f32>,
    /// Activations: the inputs of all layers after the first.
    activated: Vec<Vec<f32>>,
    splines: Splines,
}

#[derive(Default)]
struct Scratch {
    hidden: Vec<f32>,
    inner: Vec<f32>,
    d_hidden: Vec<f32>,
    d_inner: Vec<f32>,
    d_activation: Vec<f32>,
    d_features: Vec<f32>,
}

impl FusedFlow {
    /// Creates buffers for flows of the shape of `flow`.
    pub fn new(flow: &Flow) -> Self {
        let layout = FlowLayout::new(*flow.config());
        assert_eq!(layout.length, flow.weight_count(), "the layout is that of the flow's flat weights");
        Self { layout, parts: Vec::new() }
    }

    /// Returns `-mean ln q(x)` over points of X, `[samples, 2]`, and its gradient.
    pub fn gradient(&mut self, weights: &[f32], points: &[f32]) -> StepGradient {
        assert_eq!(weights.len(), self.layout.length, "one number for each weight");
        let count = points.len() / 2;
        let layout = &self.layout;
        let parts = parts(count / BLOCK);
        self.parts.resize_with(parts, Part::default);
        self.parts.par_iter_mut().enumerate().for_each(|(index, part)| {
            let range = index * count / parts..(index + 1) * count / parts;
            let points = &points[2 * range.start..2 * range.end];
            simd::dispatch(PointsPart { part, layout, weights, points, scale: 1.0 / count as f32 });
        });
        StepGradient::sum(layout.length, self.parts.iter().map(|part| (part.loss, &part.gradient[..])))
    }

    /// Returns the logits of one coupling's splines, `[samples, 3 K + 1]`, for values of the coordinate that
    /// it does not transform.
    pub fn logits(&self, weights: &[f32], coupling: usize, other: &[f32]) -> Vec<f32> {
        struct Forward<'a> {
            layout: &'a FlowLayout,
            weights: &'a [f32],
            coupling: usize,
            other: &'a [f32],
            out: &'a mut [f32],
        }
        impl Vectorized for Forward<'_> {
            #[inline(always)]
            fn run<S: Simd>(self, _simd: S) {
                let columns = self.other.len().next_multiple_of(LANES);
                let mut state = Coupling::default();
                state.other.extend_from_slice(self.other);
                state.other.resize(columns, 0.5);
                state.network(self.layout, self.weights, self.coupling, columns, &mut Scratch::default());
                let count = self.layout.config.logits();
                for (k, row) in state.splines.logits.chunks_exact(columns).enumerate() {
                    for (out, logit) in self.out.chunks_exact_mut(count).zip(row) {
                        out[k] = *logit;
                    }
                }
            }
        }
        let count = self.layout.config.logits();
        let mut out = vec![0.0; count * other.len()];
        out.par_chunks_mut(count * BLOCK).zip(other.par_chunks(BLOCK)).for_each(|(out, other)| {
            simd::dispatch(Forward { layout: &self.layout, weights, coupling, other, out });
        });
        out
    }
}

/// One part of the points.
struct PointsPart<'a> {
    part: &'a mut Part,
    layout: &'a FlowLayout,
    weights: &'a [f32],
    points: &'a [f32],
    scale: f32,
}

impl Vectorized for PointsPart<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { part, layout, weights, points, scale } = self;
        part.loss = 0.0;
        part.gradient.clear();
        part.gradient.resize(layout.length, 0.0);
        part.couplings.resize_with(layout.config.couplings, Coupling::default);
        for block in points.chunks(2 * BLOCK) {
            part.block(layout, weights, block, scale);
        }
    }
}

impl Part {
    /// Runs one block forward and backward.
    #[inline(always)]
    fn block(&mut self, layout: &FlowLayout, weights: &[f32], points: &[f32], scale: f32) {
        let Self { loss, gradient, scratch, couplings } = self;
        let count = points.len() / 2;
        let columns = count.next_multiple_of(LANES);
        let mut coordinates = [vec![0.5; columns], vec![0.5; columns]];
        for (k, point) in points.chunks_exact(2).enumerate() {
            (coordinates[0][k], coordinates[1][k]) = (point[0], point[1]);
        }
        for (index, coupling) in couplings.iter_mut().enumerate() {
            let own = layout.own_coordinate(index);
            coupling.other.clear();
            coupling.other.extend_from_slice(&coordinates[1 - own]);
            if !layout.config.sees_other(layout.config.target(index)) {
                coupling.other.fill(0.0);
            }
            coupling.network(layout, weights, index, columns, scratch);
            let topology = layout.config.target(index).topology();
            coupling.splines.evaluate(topology, layout.config.bins, &coordinates[own], true);
            coordinates[own].copy_from_slice(&coupling.splines.values);
            for log_slope in &coupling.splines.log_slopes[..count] {
                *loss -= log_slope * scale;
            }
        }
        // The base density is uniform, so it does not depend on the final position of a point.
        let mut d_coordinates = [vec![0.0; columns], vec![0.0; columns]];
        let mut d_log = vec![0.0; columns];
        d_log[..count].fill(-scale);
        for (index, coupling) in couplings.iter_mut().enumerate().rev() {
            let own = layout.own_coordinate(index);
            let [d_u, d_v] = &mut d_coordinates;
            let (d_own, d_other) = if own == 0 { (d_u, d_v) } else { (d_v, d_u) };
            coupling.backward(layout, weights, index, &d_log, (d_own, d_other), scratch, gradient);
        }
    }
}

impl Coupling {
    /// Computes the features of the other coordinate and the network's logits.
    #[inline(always)]
    fn network(&mut self, layout: &FlowLayout, weights: &[f32], index: usize, columns: usize, scratch: &mut Scratch) {
        self.place_features(layout.config.target(index), layout.config.octaves);
        let layers = &layout.networks[index];
        let (slope, last) = (layout.config.leaky_slope, layers.len() - 1);
        self.activated.resize(last, Vec::new());
        layers[0].forward(weights, Matrix::new(&self.features, layers[0].inputs, columns), &mut scratch.hidden);
        for block in 0..layout.config.residual_blocks {
            activate(&scratch.hidden, slope, &mut self.activated[2 * block]);
            let (first, second) = (&layers[2 * block + 1], &layers[2 * block + 2]);
            let input = Matrix::new(&self.activated[2 * block], first.inputs, columns);
            first.forward(weights, input, &mut scratch.inner);
            activate(&scratch.inner, slope, &mut self.activated[2 * block + 1]);
            let input = Matrix::new(&self.activated[2 * block + 1], second.inputs, columns);
            second.forward(weights, input, &mut scratch.inner);
            add(&mut scratch.hidden, &scratch.inner);
        }
        activate(&scratch.hidden, slope, &mut self.activated[last - 1]);
        let input = Matrix::new(&self.activated[last - 1], layers[last].inputs, columns);
        layers[last].forward(weights, input, &mut self.splines.logits);
    }

    /// Computes the features as in [`Flow`], in the same order.
    #[inline(always)]
    fn place_features(&mut self, target: Coordinate, octaves: usize) {
        self.features.clear();
        match target {
            Coordinate::Elevation => {
                for k in 0..octaves {
                    let frequency = TAU * (1_u32 << k) as f32;
                    self.features.extend(self.other.iter().map(|u| (frequency * u).cos()));
                }
                for k in 0..octaves {
                    let frequency = TAU * (1_u32 << k) as f32;
                    self.features.extend(self.other.iter().map(|u| (frequency * u).sin()));
                }
            }
            Coordinate::Azimuth => {
                self.features.extend(self.other.iter().map(|v| 2.0 * v - 1.0));
                for k in 1..octaves {
                    let frequency = PI * (1_u32 << k) as f32;
                    self.features.extend(self.other.iter().map(|v| (frequency * v).cos()));
                }
            }
        }
    }

    /// Propagates derivatives of the loss with respect to the outputs (both coordinates, the log-slope) to
    /// the inputs and the weights.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the state of one step of backpropagation")]
    fn backward(
        &mut self,
        layout: &FlowLayout,
        weights: &[f32],
        index: usize,
        d_log: &[f32],
        (d_own, d_other): (&mut [f32], &mut [f32]),
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        let columns = d_log.len();
        self.splines.backward(d_log, Some(d_own));
        for k in 0..columns {
            d_own[k] = d_own[k] * self.splines.d_points[0][k] + d_log[k] * self.splines.d_points[1][k];
        }
        self.network_backward(layout, weights, index, columns, scratch, gradient);
        let target = layout.config.target(index);
        if layout.config.sees_other(target) {
            self.features_backward(target, layout.config.octaves, &scratch.d_features, d_other);
        }
    }

    #[inline(always)]
    fn network_backward(
        &mut self,
        layout: &FlowLayout,
        weights: &[f32],
        index: usize,
        columns: usize,
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        let layers = &layout.networks[index];
        let (slope, last) = (layout.config.leaky_slope, layers.len() - 1);
        let Scratch { d_hidden, d_inner, d_activation, d_features, .. } = scratch;
        let mut back = |layer: &Layer, d_output: &[f32], input: &[f32], out: &mut Vec<f32>| {
            let d_output = Matrix::new(d_output, layer.outputs, columns);
            layer.add_gradient(d_output, Matrix::new(input, layer.inputs, columns), gradient);
            layer.backward(weights, d_output, out);
        };
        back(&layers[last], &self.splines.logits, &self.activated[last - 1], d_activation);
        leaky_relu_backward(d_activation, &self.activated[last - 1], slope, d_hidden);
        for block in (0..layout.config.residual_blocks).rev() {
            let (outer, inner) = (&self.activated[2 * block], &self.activated[2 * block + 1]);
            back(&layers[2 * block + 2], d_hidden, inner, d_activation);
            leaky_relu_backward(d_activation, inner, slope, d_inner);
            back(&layers[2 * block + 1], d_inner, outer, d_activation);
            leaky_relu_backward(d_activation, outer, slope, d_inner);
            add(d_hidden, d_inner);
        }
        back(&layers[0], d_hidden, &self.features, d_features);
    }

    #[inline(always)]
    fn features_backward(&self, target: Coordinate, octaves: usize, d_features: &[f32], d_other: &mut [f32]) {
        let columns = d_other.len();
        let row = |matrix: &[f32], k: usize, at: usize| matrix[k * columns + at];
        for k in 0..octaves {
            for (at, d_other) in d_other.iter_mut().enumerate() {
                *d_other += match target {
                    Coordinate::Elevation => {
                        let (cos, sin) = (row(&self.features, k, at), row(&self.features, octaves + k, at));
                        let d_angle = row(d_features, octaves + k, at) * cos - row(d_features, k, at) * sin;
                        TAU * (1_u32 << k) as f32 * d_angle
                    }
                    Coordinate::Azimuth if k == 0 => 2.0 * row(d_features, 0, at),
                    Coordinate::Azimuth => {
                        let frequency = PI * (1_u32 << k) as f32;
                        -frequency * (frequency * self.other[at]).sin() * row(d_features, k, at)
                    }
                };
            }
        }
    }
}

#[inline(always)]
fn activate(values: &[f32], slope: f32, out: &mut Vec<f32>) {
    out.clear();
    out.extend_from_slice(values);
    leaky_relu(out, slope);
}

#[inline(always)]
fn add(sum: &mut [f32], term: &[f32]) {
    for (sum, term) in sum.iter_mut().zip(term) {
        *sum += term;
    }
}
