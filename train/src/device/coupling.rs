//! The coupling layers of a flow: for some points, forward and backward. See [`crate::fused::FusedFlow`], of which
//! this is the same.

use headtail_model::coupling::Coordinate;
use headtail_shaders::training::Kernel;

use super::{
    dispatch::{
        Allocator, Cost, Dispatch, Form, Matrix, Packed, Slices, Splines, TILE, backward, forward, threads,
        weight_gradient, words,
    },
    plan::Plan,
};
use crate::fused::FlowLayout;

/// A coupling layer: its network, and its numbers for the points of a piece.
struct Coupling {
    layers: Vec<Packed>,
    /// The input of each layer: features of the other coordinate, then activations; in the backward pass, derivatives
    /// by the arguments of these.
    inputs: Vec<Matrix>,
    logits: Matrix,
    /// Places of the coordinate that it transforms, before and after, and of the other one.
    own: [usize; 2],
    other: usize,
}

/// Where the numbers of a step of a flow are in the arena.
pub struct FlowMemory<'a> {
    layout: &'a FlowLayout,
    couplings: Vec<Coupling>,
    /// The arguments of activations, which the residual connections need: of one coupling at a time.
    hidden: Matrix,
    d_features: Matrix,
    /// Coordinates of the points, derivatives by both, and by log-slopes.
    points: Matrix,
    d_points: Matrix,
    d_log: Matrix,
    /// A row for each coupling.
    log_slopes: Matrix,
    results: usize,
    slices: Slices,
    length: usize,
}

impl<'a> FlowMemory<'a> {
    /// Places `points` points together.
    pub fn new(layout: &'a FlowLayout, points: usize) -> Self {
        let (config, mut arena, stride) = (&layout.config, Allocator::default(), points.next_multiple_of(TILE));
        let results = arena.length;
        arena.length += (layout.length + 2).next_multiple_of(TILE);
        let [points, d_points] = [(); 2].map(|()| arena.matrix(2, stride));
        let [d_log, log_slopes, hidden, d_features] =
            [1, config.couplings, config.hidden, 2 * config.octaves].map(|rows| arena.matrix(rows, stride));
        let mut now = [points.start, points.after_rows(1).start];
        let coupling = |(index, layers): (usize, &Vec<_>)| {
            let own = layout.own_coordinate(index);
            let layers: Vec<Packed> = layers.iter().map(|layer| Packed::new(*layer, &mut arena)).collect();
            let coupling = Coupling {
                inputs: layers.iter().map(|packed| arena.matrix(packed.layer.inputs, stride)).collect(),
                layers,
                logits: arena.logits(config.logits(), stride),
                own: [now[own], arena.matrix(1, stride).start],
                other: now[1 - own],
            };
            now[own] = coupling.own[1];
            coupling
        };
        let couplings = layout.networks.iter().enumerate().map(coupling).collect();
        let slices = Slices { length: layout.length, most: stride.div_ceil(Slices::LEAST) };
        let length = arena.length;
        Self { layout, couplings, hidden, d_features, points, d_points, d_log, log_slopes, results, slices, length }
    }

    /// Returns the length of the longest buffer.
    pub fn largest(&self) -> usize {
        self.length.max(self.partials())
    }

    fn partials(&self) -> usize {
        self.slices.most * self.layout.length
    }

    /// Returns the plan of a step of `count` points, the memory's at a time.
    pub fn plan(&self, count: usize) -> Plan {
        let packed = self.couplings.iter().flat_map(|coupling| &coupling.layers);
        let mut pieces = vec![packed.map(Packed::pack).collect()];
        for first in (0..count).step_by(self.points.stride) {
            let points = Points { memory: self, first, count: self.points.stride.min(count - first), all: count };
            pieces.push(points.dispatches());
        }
        pieces.push(vec![self.slices.add(self.results)]);
        Plan { pieces, arena: self.length, partials: self.partials(), results: self.results, conditions: 1 }
    }
}

/// Some points of a batch.
struct Points<'a> {
    memory: &'a FlowMemory<'a>,
    first: usize,
    count: usize,
    all: usize,
}

impl Points<'_> {
    fn dispatches(&self) -> Vec<Dispatch> {
        let memory = self.memory;
        let mut list = vec![self.small(Kernel::PlacePoints, None, [threads(memory.points.stride), 4])];
        for (index, coupling) in memory.couplings.iter().enumerate() {
            self.forward(index, coupling, &mut list);
        }
        // One workgroup.
        list.push(self.small(Kernel::Likelihood, None, [1, memory.couplings.len()]));
        for (index, coupling) in memory.couplings.iter().enumerate().rev() {
            self.backward(index, coupling, &mut list);
        }
        list
    }

    /// Runs a shader of `coupling.wgsl` with some workgroups, which reads or writes some rows.
    fn small(&self, kernel: Kernel, of: Option<(usize, &Coupling)>, [groups, rows]: [usize; 2]) -> Dispatch {
        let memory = self.memory;
        let config = &memory.layout.config;
        let [other, features, d_other, sees_other, is_circle] = of.map_or([0; 5], |(index, coupling)| {
            let (target, own) = (config.target(index), memory.layout.own_coordinate(index));
            let d_other = memory.d_points.after_rows(1 - own).start;
            let is_circle = target == Coordinate::Elevation;
            [coupling.other, coupling.inputs[0].start, d_other, config.sees_other(target).into(), is_circle.into()]
        });
        let mut parameters = words([
            memory.points.stride,
            self.first,
            self.count,
            memory.points.start,
            memory.d_points.start,
            memory.d_log.start,
            memory.log_slopes.start,
            memory.couplings.len(),
            memory.results + memory.layout.length,
            other,
            features,
            memory.d_features.start,
            d_other,
            sees_other,
            is_circle,
            config.octaves,
        ]);
        parameters.push((1.0 / self.all as f32).to_bits());
        let cost = Cost::of_rows(rows, self.count);
        Dispatch { kernel, parameters, groups: [groups as u32, 1, 1], cost }
    }

    fn splines(&self, index: usize, coupling: &Coupling) -> Splines {
        let memory = self.memory;
        let d_own = memory.d_points.after_rows(memory.layout.own_coordinate(index)).start;
        Splines {
            logits: coupling.logits,
            bins: memory.layout.config.bins,
            is_circle: memory.layout.config.target(index) == Coordinate::Azimuth,
            point: coupling.own[0],
            is_of_chain: true,
            count: self.count,
            log_slope: memory.log_slopes.after_rows(index).start,
            value: Some([coupling.own[1], d_own]),
            d_log_slope: memory.d_log.start,
        }
    }

    fn forward(&self, index: usize, coupling: &Coupling, list: &mut Vec<Dispatch>) {
        let (memory, Coupling { layers, inputs, logits, .. }) = (self.memory, coupling);
        let groups = threads(memory.points.stride);
        list.push(self.small(Kernel::PlaceFeatures, Some((index, coupling)), [groups, inputs[0].rows]));
        for (number, (layer, input)) in layers.iter().zip(inputs).enumerate() {
            let output = inputs.get(number + 1).unwrap_or(logits);
            let form = match number {
                0 => Form::Kept(memory.hidden),
                last if last + 1 == layers.len() => Form::WithBias,
                inner if inner % 2 == 1 => Form::Activated,
                _ => Form::Residual(memory.hidden),
            };
            list.push(forward(layer, *input, *output, self.count, form, memory.layout.config.leaky_slope));
        }
        list.push(self.splines(index, coupling).run(Kernel::SplineForward));
    }

    fn backward(&self, index: usize, coupling: &Coupling, list: &mut Vec<Dispatch>) {
        let (memory, Coupling { layers, inputs, logits, .. }) = (self.memory, coupling);
        list.push(self.splines(index, coupling).run(Kernel::SplineBackward));
        let mut derivative = *logits;
        for (number, (layer, input)) in layers.iter().zip(inputs).enumerate().rev() {
            list.push(weight_gradient(layer.layer, derivative, *input, self.count, memory.slices, self.first > 0));
            let (output, form) = match number {
                0 => (memory.d_features, Form::Plain),
                // The first layer of a residual block: its input has a part in the block's sum, too.
                first if first % 2 == 1 && first + 1 < layers.len() => {
                    (*input, Form::ThroughActivationAdded(inputs[first + 2]))
                }
                _ => (*input, Form::ThroughActivation),
            };
            list.push(backward(layer, derivative, output, self.count, form, memory.layout.config.leaky_slope));
            derivative = output;
        }
        if memory.layout.config.sees_other(memory.layout.config.target(index)) {
            let groups = threads(memory.points.stride);
            list.push(self.small(Kernel::FeaturesBackward, Some((index, coupling)), [groups, 2 * inputs[0].rows]));
        }
    }
}
