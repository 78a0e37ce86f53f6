//! The learned mixture weight: the probability of drawing from the head rather than by BRDF sampling.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
    tensor::activation::sigmoid,
};

pub use headtail_render::head::SHARE_FLOOR;

use crate::linear::{self, Initializer};

/// Width of the hidden layer.
pub const SHARE_HIDDEN: usize = 16;

/// Returns the probability of drawing from the head: `0.02 + 0.96 sigmoid(logit)`.
pub fn share_of_logit(logit: f32) -> f32 {
    SHARE_FLOOR + (1.0 - 2.0 * SHARE_FLOOR) / (1.0 + (-logit).exp())
}

/// Returns [`share_of_logit`] in the tensor library's graph.
pub fn share_of_logits(logit: Tensor<2>) -> Tensor<2> {
    sigmoid(logit).mul_scalar(1.0 - 2.0 * SHARE_FLOOR).add_scalar(SHARE_FLOOR)
}

/// A network `(c, latent) -> 16 -> 1` with leaky ReLU between. The last layer starts at zero: the initial
/// probability is 1/2.
#[derive(Module, Debug)]
pub struct ShareNetwork {
    linears: Vec<Linear>,
    leaky_slope: f64,
}

impl ShareNetwork {
    pub(super) fn new(inputs: usize, leaky_slope: f64, initializer: &mut Initializer, device: &Device) -> Self {
        let linears = vec![initializer.linear(inputs, SHARE_HIDDEN, device), linear::zeros(SHARE_HIDDEN, 1, device)];
        Self { linears, leaky_slope }
    }

    /// Returns logits `[conditions, 1]`.
    pub(super) fn logits(&self, condition: Tensor<2>) -> Tensor<2> {
        self.linears[1].forward(linear::leaky_relu(self.linears[0].forward(condition), self.leaky_slope))
    }

    pub(super) fn linears(&self) -> &[Linear] {
        &self.linears
    }

    pub(super) fn linears_mut(&mut self) -> &mut Vec<Linear> {
        &mut self.linears
    }
}
