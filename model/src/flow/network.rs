//! The residual network that predicts a spline's logits.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
};

use super::config::FlowConfig;
use crate::linear::{self, Initializer};

/// A residual network: `h = W x + b`, then blocks `h += W2 a(W1 a(h) + b1) + b2` with the leaky ReLU `a` (He
/// et al. 2016, pre-activation), then `W a(h) + b`, which starts at zero.
#[derive(Module, Debug)]
pub struct ResidualNetwork {
    linears: Vec<Linear>,
    leaky_slope: f64,
}

impl ResidualNetwork {
    /// Draws initial weights.
    pub fn new(inputs: usize, config: &FlowConfig, initializer: &mut Initializer, device: &Device) -> Self {
        let mut linears = vec![initializer.linear(inputs, config.hidden, device)];
        for _ in 0..2 * config.residual_blocks {
            linears.push(initializer.linear(config.hidden, config.hidden, device));
        }
        linears.push(linear::zeros(config.hidden, config.logits(), device));
        Self { linears, leaky_slope: f64::from(config.leaky_slope) }
    }

    /// Returns logits `[samples, logits]` for features `[samples, inputs]`.
    pub fn forward(&self, features: Tensor<2>) -> Tensor<2> {
        let activate = |x: Tensor<2>| linear::leaky_relu(x, self.leaky_slope);
        let (first, rest) = self.linears.split_first().expect("a network has a first layer");
        let (last, blocks) = rest.split_last().expect("a network has a last layer");
        let mut hidden = first.forward(features);
        for block in blocks.chunks_exact(2) {
            let inner = block[0].forward(activate(hidden.clone()));
            hidden = hidden + block[1].forward(activate(inner));
        }
        last.forward(activate(hidden))
    }

    pub(super) fn linears(&self) -> &[Linear] {
        &self.linears
    }

    pub(super) fn linears_mut(&mut self) -> &mut [Linear] {
        &mut self.linears
    }
}
