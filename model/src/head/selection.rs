//! The learned share of samples that the head gives; BRDF sampling gives the others.

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
    tensor::activation::sigmoid,
};

use crate::{
    NamedTensor, Result,
    linear::{self, Initializer},
};

/// Width of the hidden layer.
pub const SELECTION_HIDDEN: usize = 16;

/// The least probability of either strategy: neither can be given up, so a weight of the mixture is at most 50 times that of
/// the strategy that fits.
pub const SELECTION_FLOOR: f64 = 0.02;

/// The probability of drawing from the head for a logit of the selection network: `0.02 + 0.96 sigmoid(logit)`.
pub fn selection_probability(logit: f32) -> f32 {
    (SELECTION_FLOOR + (1.0 - 2.0 * SELECTION_FLOOR) / (1.0 + (-f64::from(logit)).exp())) as f32
}

/// The same in the tensor library's graph.
pub fn selection_probability_in_graph(logit: Tensor<2>) -> Tensor<2> {
    sigmoid(logit).mul_scalar(1.0 - 2.0 * SELECTION_FLOOR).add_scalar(SELECTION_FLOOR)
}

/// `(c, latent) -> 16 -> 1`, leaky ReLU between. The last layer starts at zero: both strategies start with 1/2.
#[derive(Module, Debug)]
pub struct SelectionNetwork {
    linears: Vec<Linear>,
    leaky_slope: f64,
}

impl SelectionNetwork {
    pub(super) fn new(inputs: usize, leaky_slope: f64, initializer: &mut Initializer, device: &Device) -> Self {
        let linears =
            vec![initializer.linear(inputs, SELECTION_HIDDEN, device), linear::zeros(SELECTION_HIDDEN, 1, device)];
        Self { linears, leaky_slope }
    }

    /// Logits `[conditions, 1]`.
    pub(super) fn logits(&self, condition: Tensor<2>) -> Tensor<2> {
        self.linears[1].forward(linear::leaky_relu(self.linears[0].forward(condition), self.leaky_slope))
    }

    pub(super) fn linears(&self) -> &[Linear] {
        &self.linears
    }

    pub(super) fn linears_mut(&mut self) -> &mut [Linear] {
        &mut self.linears
    }

    pub(super) fn export(&self, weights: &mut Vec<NamedTensor>) {
        for (index, layer) in self.linears.iter().enumerate() {
            linear::export(layer, &format!("selection.linear{index}"), weights);
        }
    }

    pub(super) fn import(&self, weights: &mut Vec<NamedTensor>, device: &Device) -> Result<Self> {
        let load = |(index, layer)| linear::import(layer, &format!("selection.linear{index}"), weights, device);
        let linears = self.linears.iter().enumerate().map(load).collect::<Result<_>>()?;
        Ok(Self { linears, leaky_slope: self.leaky_slope })
    }
}
