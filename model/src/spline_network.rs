//! The network that gives a spline its logits.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
};

use crate::linear::{self, Initializer};

/// Sizes of a spline network.
#[derive(Clone, Copy, Debug)]
pub struct SplineNetworkShape {
    /// Length of the condition (with the encoder's output, where there is one).
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

/// A perceptron with leaky ReLU after every layer but the last; inputs in the order (condition, coordinate features).
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

    /// Logits `[conditions, samples, outputs]` of conditions `[conditions, length]` and features
    /// `[conditions, samples, features]`; without features `[conditions, 1, outputs]`.
    ///
    /// The condition's part of the first layer is computed once per condition. Samples stay in a matrix for each condition:
    /// the gradient of a weight is then a sum over the conditions of products of matrices, which a GPU computes side by
    /// side. As one product over all samples it is a single group of threads that adds up a quarter of a million terms.
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
