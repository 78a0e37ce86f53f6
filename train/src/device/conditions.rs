//! The networks of conditions, and gradients that are sums over conditions.

use headtail_shaders::training::Kernel;

use super::{
    dispatch::{Columns, Dispatch, Form, Matrix, Packed, backward, forward, weight_gradient},
    memory::{Memory, Network, OfConditions},
};

/// The networks of conditions, before and after all pieces of the batch.
pub struct Conditions<'a> {
    pub memory: &'a Memory<'a>,
}

impl Conditions<'_> {
    /// Packs all weights, and runs the networks.
    pub fn before(&self) -> Vec<Dispatch> {
        let mut list: Vec<Dispatch> = self.packed().map(Packed::pack).collect();
        let condition = Matrix { rows: self.memory.layout.config.condition.length(), ..self.memory.seen };
        if let Some(encoder) = &self.memory.encoder {
            self.forward_of_conditions(encoder, condition, Form::Activated, &mut list);
        }
        if let Some(network) = &self.memory.mixture_weight {
            self.forward_of_conditions(network, self.memory.seen, Form::WithBias, &mut list);
        }
        if let Some(network) = &self.memory.elevation_of_condition {
            self.forward_of_conditions(network, self.memory.seen, Form::WithBias, &mut list);
        }
        for Network { layers, of_condition, .. } in [&self.memory.elevation, &self.memory.azimuth] {
            if let Some(first) = layers.first() {
                let (columns, slope) = (self.memory.shape.conditions, self.memory.slope());
                list.push(forward(first, self.memory.seen, *of_condition, columns, Form::WithBias, slope));
            }
        }
        list
    }

    fn packed(&self) -> impl Iterator<Item = &Packed> {
        let of_conditions = [&self.memory.encoder, &self.memory.mixture_weight, &self.memory.elevation_of_condition]
            .into_iter()
            .flatten();
        let of_points = [&self.memory.elevation, &self.memory.azimuth].into_iter().flat_map(|network| &network.layers);
        of_conditions.flat_map(|network| &network.layers).chain(of_points)
    }

    fn forward_of_conditions(&self, network: &OfConditions, input: Matrix, last: Form, list: &mut Vec<Dispatch>) {
        let mut input = input;
        for (index, layer) in network.layers.iter().enumerate() {
            let hidden = network.hidden.get(index).copied();
            let (output, form) = hidden.map_or((network.output, last), |hidden| (hidden, Form::Activated));
            list.push(forward(layer, input, output, self.memory.shape.conditions, form, self.memory.slope()));
            input = output;
        }
    }

    /// Gradients of what depends on conditions, and the sum of the slices.
    pub fn after(&self) -> Vec<Dispatch> {
        let mut list = Vec::new();
        for network in [&self.memory.azimuth, &self.memory.elevation] {
            self.feature_gradient(network, &mut list);
        }
        let mut form = Form::Plain;
        if let Some(network) = &self.memory.elevation_of_condition {
            self.backward_of_conditions(network, network.d_output, &mut list);
            self.first_layer_backward(&network.layers[0], network.hidden[0], &mut form, &mut list);
        }
        if let Some(network) = &self.memory.mixture_weight {
            self.backward_of_conditions(network, network.d_output, &mut list);
            self.first_layer_backward(&network.layers[0], network.hidden[0], &mut form, &mut list);
        }
        for Network { layers, d_condition, .. } in [&self.memory.elevation, &self.memory.azimuth] {
            if let Some(first) = layers.first() {
                let derivative = Matrix { rows: first.layer.outputs, ..*d_condition };
                self.first_layer_backward(first, derivative, &mut form, &mut list);
            }
        }
        if let Some(encoder) = &self.memory.encoder {
            let count = encoder.output.rows * encoder.output.stride;
            let through = Columns {
                source: encoder.output.start,
                output: encoder.d_output.start,
                count,
                slope: self.memory.slope(),
                ..Columns::default()
            };
            list.push(through.each(Kernel::ThroughActivation, count));
            self.backward_of_conditions(encoder, encoder.d_output, &mut list);
            let condition = Matrix { rows: self.memory.layout.config.condition.length(), ..self.memory.seen };
            list.push(self.gradient_of_conditions(&encoder.layers[0], encoder.hidden[0], condition));
        }
        list.push(self.memory.slices.add(self.memory.results));
        list
    }

    /// The weights of a first layer's features.
    fn feature_gradient(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let (Some(first), features) = (network.layers.first(), network.features.rows) else { return };
        let sums = Columns {
            source: network.d_condition.start,
            source_stride: network.d_condition.stride,
            output: first.layer.weight_at(0, first.layer.inputs - features),
            stride: first.layer.inputs,
            rows: first.layer.outputs,
            count: self.memory.shape.conditions,
            ..Columns::default()
        };
        list.push(sums.run(Kernel::FeatureGradient, [first.layer.outputs, features]));
    }

    /// From the output of a network of conditions to its first hidden layer.
    fn backward_of_conditions(&self, network: &OfConditions, d_output: Matrix, list: &mut Vec<Dispatch>) {
        let mut derivative = d_output;
        for (layer, hidden) in network.layers[1..].iter().zip(&network.hidden).rev() {
            list.push(self.gradient_of_conditions(layer, derivative, *hidden));
            let columns = self.memory.shape.conditions;
            list.push(backward(layer, derivative, *hidden, columns, Form::ThroughActivation, self.memory.slope()));
            derivative = *hidden;
        }
    }

    fn first_layer_backward(&self, first: &Packed, derivative: Matrix, form: &mut Form, list: &mut Vec<Dispatch>) {
        list.push(self.gradient_of_conditions(first, derivative, self.memory.seen));
        list.push(backward(
            first,
            derivative,
            self.memory.d_seen,
            self.memory.shape.conditions,
            *form,
            self.memory.slope(),
        ));
        *form = Form::Added;
    }

    fn gradient_of_conditions(&self, layer: &Packed, derivative: Matrix, input: Matrix) -> Dispatch {
        weight_gradient(layer.layer, derivative, input, self.memory.shape.conditions, self.memory.slices, false)
    }
}
