//! A step's gradient: the seam between the training loop and whatever computes it.

use crate::{Objective, integrand::Batch};

/// Loss and gradient of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepGradient {
    /// The loss; of heads, the mean over the conditions whose target is not zero everywhere.
    pub loss: f32,
    /// Its gradient, in the order of the weights.
    pub d_weight: Vec<f32>,
}

impl StepGradient {
    /// The sum of losses and gradients over parts of a batch, in their order.
    pub fn sum<'a>(weights: usize, parts: impl Iterator<Item = (f32, &'a [f32])>) -> Self {
        let mut sum = Self { loss: 0.0, d_weight: vec![0.0; weights] };
        for (loss, gradient) in parts {
            sum.loss += loss;
            sum.d_weight.iter_mut().zip(gradient).for_each(|(sum, term)| *sum += term);
        }
        sum
    }
}

/// Computes [`StepGradient`]s. The training loop keeps the weights as one list and knows nothing of how this is done.
pub trait GradientSource: Send {
    /// The gradient at `weights` (in the order of [`headtail_model::Head::flat_weights`]); `None` if the target is zero under every
    /// condition of the batch. A result that is not finite is the caller's to leave out.
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Option<StepGradient>;
}
