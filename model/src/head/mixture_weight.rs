//! The learned mixture weight: the probability of drawing from the head rather than by BRDF sampling.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
    tensor::activation::sigmoid,
};

pub use headtail_render::head::MIXTURE_WEIGHT_FLOOR;

use crate::linear::{self, Initializer};

/// Width of the hidden layer.
pub const MIXTURE_WEIGHT_HIDDEN: usize = 16;

/// Returns the probability of drawing from the head: `0.02 + 0.96 sigmoid(logit)`.
pub fn mixture_weight_of_logit(logit: f32) -> f32 {
    MIXTURE_WEIGHT_FLOOR + (1.0 - 2.0 * MIXTURE_WEIGHT_FLOOR) / (1.0 + (-logit).exp())
}

/// Returns [`mixture_weight_of_logit`] in the tensor library's graph.
pub fn mixture_weight_of_logits(logit: Tensor<2>) -> Tensor<2> {
    sigmoid(logit).mul_scalar(1.0 - 2.0 * MIXTURE_WEIGHT_FLOOR).add_scalar(MIXTURE_WEIGHT_FLOOR)
}

/// A network `(c, latent) -> 16 -> 1` with leaky ReLU between. The last layer starts at zero: the initial
/// probability is 1/2.
#[derive(Module, Debug)]
pub struct MixtureWeightNetwork {
    linears: Vec<Linear>,
    leaky_slope: f64,
}

impl MixtureWeightNetwork {
    pub(super) fn new(inputs: usize, leaky_slope: f64, initializer: &mut Initializer, device: &Device) -> Self {
        let linears = vec![
            initializer.linear(inputs, MIXTURE_WEIGHT_HIDDEN, device),
            linear::zeros(MIXTURE_WEIGHT_HIDDEN, 1, device),
        ];
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
