//! A step's gradient: the interface between the training loop and its implementations.

use headtail_render::random::Purpose;

use crate::{FitConfig, Objective, Result, Target, integrand::Batch};

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

    /// Returns the gradient of a step of a run, whose batch is a function of the configuration, the target and the
    /// step; implementations that draw it themselves draw the same one, to rounding. All calls are for one target.
    ///
    /// # Errors
    /// As [`gradient`](Self::gradient), and [`Error::BadTarget`](crate::Error::BadTarget).
    fn gradient_of_step(
        &mut self,
        weights: &[f32],
        config: &FitConfig,
        target: &dyn Target,
        step: u64,
    ) -> Result<Option<StepGradient>> {
        let batch = Batch::draw(target, config.batch_shape(), config.seed, Purpose::Batch, step)?;
        self.gradient(weights, config.objective(), &batch)
    }

    /// Returns whether [`gradient_of_step`](Self::gradient_of_step) draws this target faster than
    /// [`Batch::draw`].
    fn draws(&self, _target: &dyn Target) -> bool {
        false
    }

    /// Names what computes.
    fn device(&self) -> String {
        "CPU".into()
    }
}
