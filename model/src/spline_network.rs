//! The network that predicts a spline's logits.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
};

use crate::linear::{self, Initializer};

/// Sizes of a spline network.
#[derive(Clone, Copy, Debug)]
pub struct SplineNetworkShape {
    /// Length of the condition, including the encoder's output if there is an encoder.
    pub condition: usize,
    /// Features of the other coordinate: 2 for the circle, 1 for the interval, 0 for none.
    pub features: usize,
    /// Width of the hidden layers.
    pub hidden: usize,
    /// Number of hidden layers, at least 1.
    pub hidden_layers: usize,
    /// Number of logits.
    pub outputs: usize,
}

/// A perceptron with leaky ReLU after all layers but the last; inputs: condition, coordinate features.
///
/// The last layer starts at zero, so that the spline starts as the identity.
#[derive(Module, Debug)]
pub struct SplineNetwork {
    linears: Vec<Linear>,
    leaky_slope: f64,
}

impl SplineNetwork {
    /// Draws initial weights.
    pub fn new(shape: SplineNetworkShape, leaky_slope: f64, initializer: &mut Initializer, device: &Device) -> Self {
        let mut inputs = shape.condition + shape.features;
        let mut linears = Vec::with_capacity(shape.hidden_layers + 1);
        for _ in 0..shape.hidden_layers {
            linears.push(initializer.linear(inputs, shape.hidden, device));
            inputs = shape.hidden;
        }
        linears.push(linear::zeros(inputs, shape.outputs, device));
        Self { linears, leaky_slope }
    }

    /// Returns logits `[conditions, samples, outputs]` for conditions `[conditions, length]` and features
    /// `[conditions, samples, features]`; without features `[conditions, 1, outputs]`.
    ///
    /// The condition's part of the first layer is computed once per condition. Samples form one matrix per
    /// condition: the gradient of a weight is then a sum of matrix products over the conditions, which a GPU
    /// computes in parallel. As one product over all samples, a single thread group would sum about 250,000
    /// terms.
    pub fn forward(&self, condition: Tensor<2>, features: Option<Tensor<3>>) -> Tensor<3> {
        let [_, length] = condition.dims();
        let first = &self.linears[0];
        let mut hidden = linear::affine(first, condition.unsqueeze_dim(1));
        if let Some(features) = features {
            hidden = hidden + linear::partial(first, length, features);
        }
        for layer in &self.linears[1..] {
            hidden = linear::affine(layer, linear::leaky_relu(hidden, self.leaky_slope));
        }
        hidden
    }

    pub(crate) fn linears(&self) -> &[Linear] {
        &self.linears
    }

    pub(crate) fn linears_mut(&mut self) -> &mut Vec<Linear> {
        &mut self.linears
    }
}
