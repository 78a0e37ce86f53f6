//! The likelihood of a flow tail and its gradient, in one pass over SIMD lanes: as the rest of this module does it for heads, but
//! with residual networks, without conditions, and with the way back through the coordinates of all earlier layers.

use std::f32::consts::{PI, TAU};

use headtail_model::{Flow, FlowConfig, coupling::Coordinate};
use headtail_render::simd::{self, LANES, Lanes, Simd, Vectorized};
use rayon::prelude::*;

use super::{
    PARTS,
    matrix::Matrix,
    perceptron::{Layer, leaky_relu, leaky_relu_backward},
    spline::Splines,
};
use crate::StepGradient;

/// Samples that go through all layers together.
const BLOCK: usize = 128;

/// Likelihood and gradient of flows of one shape.
pub struct FusedFlow {
    layout: Layout,
    parts: Vec<Part>,
}

/// Where the layers are in the flat list of weights, see [`Flow::flat_weights`].
#[derive(Clone, Debug)]
struct Layout {
    config: FlowConfig,
    networks: Vec<Vec<Layer>>,
    length: usize,
}

#[derive(Default)]
struct Part {
    loss: f32,
    gradient: Vec<f32>,
    scratch: Scratch,
    couplings: Vec<Coupling>,
}

/// What a coupling keeps of a block for the way back. Matrices are `[rows, columns]` with one column per sample.
#[derive(Default)]
struct Coupling {
    other: Vec<f32>,
    features: Vec<f32>,
    /// Activated: the inputs of all layers after the first.
    activated: Vec<Vec<f32>>,
    /// Logits, then the derivatives of the log-slopes by them, then those of the loss.
    logits: Vec<f32>,
    of_values: Vec<f32>,
    values: Vec<f32>,
    log_slopes: Vec<f32>,
    by_points: [Vec<f32>; 2],
}

#[derive(Default)]
struct Scratch {
    spline: Vec<Lanes>,
    hidden: Vec<f32>,
    inner: Vec<f32>,
    by_hidden: Vec<f32>,
    by_inner: Vec<f32>,
    by_activation: Vec<f32>,
    by_features: Vec<f32>,
}

impl FusedFlow {
    /// For flows of the shape of `flow`.
    pub fn new(flow: &Flow) -> Self {
        let config = *flow.config();
        let mut length = 0;
        let mut layer = |inputs: usize, outputs: usize| {
            let layer = Layer { inputs, outputs, start: length };
            length += layer.length();
            layer
        };
        let networks: Vec<Vec<Layer>> = (0..config.couplings)
            .map(|coupling| {
                let mut layers = vec![layer(config.features(config.target(coupling)), config.hidden)];
                layers.extend((0..2 * config.residual_blocks).map(|_| layer(config.hidden, config.hidden)));
                layers.push(layer(config.hidden, config.logits()));
                layers
            })
            .collect();
        assert_eq!(length, flow.weight_count(), "the layout is that of the flow's flat weights");
        Self { layout: Layout { config, networks, length }, parts: (0..PARTS).map(|_| Part::default()).collect() }
    }

    /// `-mean ln q(x)` over points of X, `[samples, 2]`, and its gradient.
    pub fn gradient(&mut self, weights: &[f32], points: &[f32]) -> StepGradient {
        assert_eq!(weights.len(), self.layout.length, "one number for each weight");
        let count = points.len() / 2;
        let layout = &self.layout;
        self.parts.par_iter_mut().enumerate().for_each(|(index, part)| {
            let range = index * count / PARTS..(index + 1) * count / PARTS;
            let points = &points[2 * range.start..2 * range.end];
            simd::dispatch(Work { part, layout, weights, points, scale: 1.0 / count as f32 });
        });
        let mut sum = StepGradient { loss: 0.0, by_weight: vec![0.0; layout.length] };
        for part in &self.parts {
            sum.loss += part.loss;
            for (sum, term) in sum.by_weight.iter_mut().zip(&part.gradient) {
                *sum += term;
            }
        }
        sum
    }

    /// The logits of one coupling's splines for values of the coordinate that it does not transform: `[samples, 3 K + 1]`.
    pub fn logits(&self, weights: &[f32], coupling: usize, other: &[f32]) -> Vec<f32> {
        struct Forward<'a> {
            layout: &'a Layout,
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
                for (k, row) in state.logits.chunks_exact(columns).enumerate() {
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

struct Work<'a> {
    part: &'a mut Part,
    layout: &'a Layout,
    weights: &'a [f32],
    points: &'a [f32],
    scale: f32,
}

impl Vectorized for Work<'_> {
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
    /// One block forward and back.
    #[inline(always)]
    fn block(&mut self, layout: &Layout, weights: &[f32], points: &[f32], scale: f32) {
        let Self { loss, gradient, scratch, couplings } = self;
        let count = points.len() / 2;
        let columns = count.next_multiple_of(LANES);
        let mut coordinates = [vec![0.5; columns], vec![0.5; columns]];
        for (k, point) in points.chunks_exact(2).enumerate() {
            (coordinates[0][k], coordinates[1][k]) = (point[0], point[1]);
        }
        for (index, coupling) in couplings.iter_mut().enumerate() {
            let own = own_coordinate(layout, index);
            coupling.other.clear();
            coupling.other.extend_from_slice(&coordinates[1 - own]);
            if !layout.config.sees_other(layout.config.target(index)) {
                coupling.other.fill(0.0);
            }
            coupling.network(layout, weights, index, columns, scratch);
            coupling.splines(layout, index, &coordinates[own], scratch);
            coordinates[own].copy_from_slice(&coupling.values);
            for log_slope in &coupling.log_slopes[..count] {
                *loss -= log_slope * scale;
            }
        }
        // The uniform density of the base does not depend on where a point ends.
        let mut by_coordinates = [vec![0.0; columns], vec![0.0; columns]];
        let mut by_log = vec![0.0; columns];
        by_log[..count].fill(-scale);
        for (index, coupling) in couplings.iter_mut().enumerate().rev() {
            let own = own_coordinate(layout, index);
            let [by_u, by_v] = &mut by_coordinates;
            let (by_own, by_other) = if own == 0 { (by_u, by_v) } else { (by_v, by_u) };
            coupling.backward(layout, weights, index, &by_log, (by_own, by_other), scratch, gradient);
        }
    }
}

fn own_coordinate(layout: &Layout, coupling: usize) -> usize {
    match layout.config.target(coupling) {
        Coordinate::Azimuth => 0,
        Coordinate::Elevation => 1,
    }
}

impl Coupling {
    /// Features of the other coordinate, and the network's logits.
    #[inline(always)]
    fn network(&mut self, layout: &Layout, weights: &[f32], index: usize, columns: usize, scratch: &mut Scratch) {
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
        layers[last].forward(weights, input, &mut self.logits);
    }

    /// As [`Flow`]'s: see there for their order.
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

    #[inline(always)]
    fn splines(&mut self, layout: &Layout, index: usize, points: &[f32], scratch: &mut Scratch) {
        let samples = points.len();
        self.values.resize(samples, 0.0);
        self.log_slopes.resize(samples, 0.0);
        self.of_values.resize(self.logits.len(), 0.0);
        let [by_value, by_log_slope] = &mut self.by_points;
        by_value.resize(samples, 0.0);
        by_log_slope.resize(samples, 0.0);
        Splines {
            topology: layout.config.target(index).topology(),
            bins: layout.config.bins,
            samples,
            points,
            logits: &mut self.logits,
            of_values: &mut self.of_values,
            values: &mut self.values,
            log_slopes: &mut self.log_slopes,
            by_points: [by_value, by_log_slope],
            scratch: &mut scratch.spline,
        }
        .evaluate();
    }

    /// From the loss's derivatives by what comes out (both coordinates, the log-slope) to those by what goes in, and by the weights.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the state of one step of backpropagation")]
    fn backward(
        &mut self,
        layout: &Layout,
        weights: &[f32],
        index: usize,
        by_log: &[f32],
        (by_own, by_other): (&mut [f32], &mut [f32]),
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        let columns = by_log.len();
        for (out, of_value) in self.logits.chunks_exact_mut(columns).zip(self.of_values.chunks_exact(columns)) {
            for k in 0..columns {
                out[k] = out[k] * by_log[k] + of_value[k] * by_own[k];
            }
        }
        for k in 0..columns {
            by_own[k] = by_own[k] * self.by_points[0][k] + by_log[k] * self.by_points[1][k];
        }
        self.network_backward(layout, weights, index, columns, scratch, gradient);
        let target = layout.config.target(index);
        if layout.config.sees_other(target) {
            self.features_backward(target, layout.config.octaves, &scratch.by_features, by_other);
        }
    }

    #[inline(always)]
    fn network_backward(
        &mut self,
        layout: &Layout,
        weights: &[f32],
        index: usize,
        columns: usize,
        scratch: &mut Scratch,
        gradient: &mut [f32],
    ) {
        let layers = &layout.networks[index];
        let (slope, last) = (layout.config.leaky_slope, layers.len() - 1);
        let Scratch { by_hidden, by_inner, by_activation, by_features, .. } = scratch;
        let mut back = |layer: &Layer, by_output: &[f32], input: &[f32], out: &mut Vec<f32>| {
            let by_output = Matrix::new(by_output, layer.outputs, columns);
            layer.add_gradient(by_output, Matrix::new(input, layer.inputs, columns), gradient);
            layer.backward(weights, (0, layer.inputs), by_output, out);
        };
        back(&layers[last], &self.logits, &self.activated[last - 1], by_activation);
        leaky_relu_backward(by_activation, &self.activated[last - 1], slope, by_hidden);
        for block in (0..layout.config.residual_blocks).rev() {
            let (outer, inner) = (&self.activated[2 * block], &self.activated[2 * block + 1]);
            back(&layers[2 * block + 2], by_hidden, inner, by_activation);
            leaky_relu_backward(by_activation, inner, slope, by_inner);
            back(&layers[2 * block + 1], by_inner, outer, by_activation);
            leaky_relu_backward(by_activation, outer, slope, by_inner);
            add(by_hidden, by_inner);
        }
        back(&layers[0], by_hidden, &self.features, by_features);
    }

    #[inline(always)]
    fn features_backward(&self, target: Coordinate, octaves: usize, by_features: &[f32], by_other: &mut [f32]) {
        let columns = by_other.len();
        let row = |matrix: &[f32], k: usize, at: usize| matrix[k * columns + at];
        for k in 0..octaves {
            for (at, by_other) in by_other.iter_mut().enumerate() {
                *by_other += match target {
                    Coordinate::Elevation => {
                        let (cos, sin) = (row(&self.features, k, at), row(&self.features, octaves + k, at));
                        let by_angle = row(by_features, octaves + k, at) * cos - row(by_features, k, at) * sin;
                        TAU * (1_u32 << k) as f32 * by_angle
                    }
                    Coordinate::Azimuth if k == 0 => 2.0 * row(by_features, 0, at),
                    Coordinate::Azimuth => {
                        let frequency = PI * (1_u32 << k) as f32;
                        -frequency * (frequency * self.other[at]).sin() * row(by_features, k, at)
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
