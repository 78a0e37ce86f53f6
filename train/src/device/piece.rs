//! Some conditions of a batch: their points forward, losses, and backward.

use headtail_model::Mode;
use headtail_shaders::training::Kernel;

use super::{
    dispatch::{Columns, Cost, Dispatch, Form, Splines, backward, forward, weight_gradient},
    memory::{Memory, Network},
};
use crate::Loss;

/// Some conditions of a batch.
pub struct Piece<'a> {
    pub memory: &'a Memory<'a>,
    pub first: usize,
    pub count: usize,
}

impl Piece<'_> {
    /// Returns all dispatches.
    pub fn dispatches(&self) -> Vec<Dispatch> {
        let mut list = Vec::new();
        self.forward(&mut list);
        list.push(self.loss());
        self.backward(&mut list);
        list
    }

    fn columns(&self) -> usize {
        self.count * self.memory.shape.samples
    }

    fn coupled(&self) -> bool {
        self.memory.layout.config.mode == Mode::Coupled
    }

    fn forward(&self, list: &mut Vec<Dispatch>) {
        let Memory { elevation, azimuth, .. } = self.memory;
        let features = if self.coupled() { elevation.features } else { azimuth.features };
        let place = Columns {
            output: features.start,
            stride: features.stride,
            feature_count: features.rows,
            count: self.columns(),
            point: 2 * self.first * self.memory.shape.samples,
            ..Columns::default()
        };
        list.push(place.over(Kernel::Place, self.columns(), 1));
        for (network, splines) in [elevation, azimuth].into_iter().zip(self.splines()) {
            self.network(network, list);
            list.push(splines.run(Kernel::SplineForward));
        }
    }

    fn network(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let slope = self.memory.slope();
        let features = network.features.rows;
        // Without layers, the logits are the condition's.
        let (output, factors, slope_of_first) = match network.layers.first() {
            Some(first) => (network.hidden[0], first.forward.after_rows(first.layer.inputs - features), slope),
            None => (network.logits, network.logits, 1.0),
        };
        let first_layer = Columns {
            source: network.of_condition.start,
            source_stride: network.of_condition.stride,
            features: network.features.start,
            factors: factors.start,
            factor_stride: factors.stride,
            output: output.start,
            stride: output.stride,
            rows: output.rows,
            feature_count: features,
            samples: self.memory.shape.samples,
            first: self.first,
            count: self.memory.shape.conditions,
            slope: slope_of_first,
            ..Columns::default()
        };
        // A thread computes eight rows.
        list.push(first_layer.over(Kernel::FirstLayer, self.columns(), output.rows.div_ceil(8)));
        let mut input = output;
        for (index, layer) in network.layers.iter().enumerate().skip(1) {
            let hidden = network.hidden.get(index).copied();
            let (output, form) = hidden.map_or((network.logits, Form::WithBias), |hidden| (hidden, Form::Activated));
            list.push(forward(layer, input, output, self.columns(), form, slope));
            input = output;
        }
    }

    /// The splines of the elevation and of the azimuth.
    fn splines(&self) -> [Splines; 2] {
        let memory = self.memory;
        [(&memory.elevation, false), (&memory.azimuth, true)].map(|(network, is_circle)| Splines {
            logits: network.logits,
            bins: memory.layout.config.bins,
            is_circle,
            point: 2 * self.first * memory.shape.samples + usize::from(!is_circle),
            is_of_chain: false,
            count: self.columns(),
            log_slope: network.log_slope,
            value: (!is_circle && self.coupled()).then_some([memory.azimuth.features.start, memory.d_value]),
            d_log_slope: memory.d_log,
        })
    }

    fn loss(&self) -> Dispatch {
        let memory = self.memory;
        let [logit, d_logit] =
            memory.mixture_weight.as_ref().map_or([0; 2], |network| [network.output.start, network.d_output.start]);
        let losses = memory.results + memory.layout.length;
        let form = match memory.objective.loss {
            Loss::ForwardKl => 0,
            Loss::LogChiSquare => 1,
            Loss::ChiSquare => 2,
            Loss::ReverseKl => 3,
        };
        let numbers = [
            memory.shape.points(),
            memory.shape.samples,
            self.first,
            memory.elevation.log_slope,
            memory.azimuth.log_slope,
            memory.d_log,
            losses,
            losses + memory.shape.conditions,
            memory.mixture_weight.is_some().into(),
            logit,
            d_logit,
            form,
        ];
        let mut parameters: Vec<u32> = numbers.iter().map(|&number| number as u32).collect();
        parameters.push(memory.objective.entropic.to_bits());
        Dispatch { kernel: Kernel::Loss, parameters, groups: [self.count as u32, 1, 1], cost: Cost::default() }
    }

    fn backward(&self, list: &mut Vec<Dispatch>) {
        let Memory { elevation, azimuth, .. } = self.memory;
        let [of_elevation, of_azimuth] = self.splines();
        list.push(of_azimuth.run(Kernel::SplineBackward));
        self.network_backward(azimuth, list);
        if let (true, Some(first)) = (self.coupled(), azimuth.layers.first()) {
            let derivative = Columns {
                source: azimuth.hidden[0].start,
                source_stride: azimuth.hidden[0].stride,
                factors: first.forward.after_rows(first.layer.inputs - 1).start,
                output: self.memory.d_value,
                rows: first.layer.outputs,
                ..Columns::default()
            };
            list.push(derivative.over(Kernel::FeatureDerivative, self.columns(), 1));
        }
        list.push(of_elevation.run(Kernel::SplineBackward));
        self.network_backward(elevation, list);
    }

    /// From the derivatives by logits to those by the weights, and the sums of those by what the first layer
    /// makes of a condition.
    fn network_backward(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let memory = self.memory;
        let mut derivative = network.logits;
        for (layer, hidden) in network.layers.iter().skip(1).zip(&network.hidden).rev() {
            let is_added = self.first > 0;
            list.push(weight_gradient(layer.layer, derivative, *hidden, self.columns(), memory.slices, is_added));
            list.push(backward(layer, derivative, *hidden, self.columns(), Form::ThroughActivation, memory.slope()));
            derivative = *hidden;
        }
        let sums = Columns {
            source: derivative.start,
            source_stride: derivative.stride,
            features: network.features.start,
            output: network.d_condition.start,
            stride: network.d_condition.stride,
            rows: derivative.rows,
            feature_count: network.features.rows,
            samples: memory.shape.samples,
            first: self.first,
            ..Columns::default()
        };
        list.push(sums.sums(self.count));
    }
}
