//! A step's gradient: the interface between the training loop and its implementations.

use crate::{FitConfig, Objective, Result, Target, TrainingState, integrand::Batch, state::Outcome};

/// Loss and gradient of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepGradient {
    /// The loss; for heads, the mean over the conditions whose target is not zero everywhere.
    pub loss: f32,
    /// Its gradient, in the order of the weights.
    pub d_weight: Vec<f32>,
}

impl StepGradient {
    /// Returns the sum of losses and gradients over parts of a batch, in order.
    pub fn sum<'a>(weights: usize, parts: impl Iterator<Item = (f32, &'a [f32])>) -> Self {
        let mut sum = Self { loss: 0.0, d_weight: vec![0.0; weights] };
        for (loss, gradient) in parts {
            sum.loss += loss;
            sum.d_weight.iter_mut().zip(gradient).for_each(|(sum, term)| *sum += term);
        }
        sum
    }
}

/// Computes [`StepGradient`]s from the weights as one list, independent of the implementation.
pub trait GradientSource: Send {
    /// Returns the gradient at `weights` (in the order of [`headtail_model::Head::flat_weights`]); `None` if
    /// the target is zero under every condition of the batch. The caller skips results that are not finite.
    ///
    /// # Errors
    /// If a graphics device fails or has too little memory.
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Result<Option<StepGradient>>;

    /// Takes steps of a run by itself, at most `most`, and returns what became of each; nothing if the caller takes
    /// them. The parameters of `state` move; the batch of a step is that of [`Batch::draw`], to rounding. All
    /// calls are for one configuration and one target.
    ///
    /// # Errors
    /// As [`gradient`](Self::gradient), and [`Error::BadTarget`](crate::Error::BadTarget).
    fn take_steps(
        &mut self,
        _config: &FitConfig,
        _target: &dyn Target,
        _state: &mut TrainingState,
        _most: usize,
    ) -> Result<Vec<Outcome>> {
        Ok(Vec::new())
    }

    /// Names what computes.
    fn device(&self) -> String {
        "CPU".into()
    }
}
