//! The state of a training run between two steps: everything that the next step depends on, besides the
//! settings.

use serde::{Deserialize, Serialize};

use crate::{
    Divergence, Error, FitConfig, Result, StepGradient,
    optimizer::{OptimizerState, learning_rate},
};

/// Weight of a step's loss in [`TrainingState::mean_loss`].
const LOSS_WEIGHT: f32 = 0.02;

/// Weights, moments and counters. Batches are not part of it: they are functions of (seed, step). The lists
/// are not part of its JSON form, see [`crate::state_file`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingState {
    /// Steps done.
    pub step: usize,
    /// Steps skipped because loss or gradient was not finite.
    pub skipped: usize,
    /// The last step's loss.
    pub loss: Option<f32>,
    /// Decaying mean of the losses, over about 50 steps.
    pub mean_loss: Option<f32>,
    /// Wall-clock seconds up to the last save.
    pub seconds: f64,
    /// Factor of the learning rates: 1, halved after each setback (see [`crate::setback`]).
    pub rate_factor: f64,
    /// The weights and the optimiser's state.
    pub parameters: Parameters,
    /// Length and peak learning rate of each group of weights, in order; determined by the settings.
    #[serde(skip)]
    pub groups: Vec<(usize, f64)>,
    /// The best validation so far, if setbacks are enabled.
    pub best: Option<BestValidation>,
}

/// Weights and moments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// The weights, in one list.
    #[serde(skip)]
    pub weights: Vec<f32>,
    /// Their moving average; empty if disabled.
    #[serde(skip)]
    pub average: Vec<f32>,
    /// The optimiser's state.
    pub optimizer: OptimizerState,
}

/// A validation and the parameters that it measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BestValidation {
    /// The divergence.
    #[serde(with = "bits")]
    pub divergence: Divergence,
    /// The parameters.
    pub parameters: Parameters,
}

/// Returns the factor by which the moving average decays after `m` moves: at most `(1 + m) / (10 + m)`, which
/// discounts the start.
pub(crate) fn average_decay(decay: f32, moves: u64) -> f32 {
    let moves = moves as f32;
    decay.min((1.0 + moves) / (10.0 + moves))
}

/// Stores a divergence as bits of f64: JSON decimals are read to within 1 ULP.
mod bits {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::Divergence;

    pub fn serialize<S: Serializer>(divergence: &Divergence, serializer: S) -> Result<S::Ok, S::Error> {
        let Divergence { kl, log_chi_square, relative_variance } = divergence;
        [kl, log_chi_square, relative_variance].map(|value| value.to_bits()).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Divergence, D::Error> {
        let [kl, log_chi_square, relative_variance] = <[u64; 3]>::deserialize(deserializer)?.map(f64::from_bits);
        Ok(Divergence { kl, log_chi_square, relative_variance })
    }
}

/// What became of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The weights moved; with the step's loss.
    Moved(f32),
    /// The loss, which is given, or the gradient was not finite: nothing moved.
    Skipped(f32),
    /// The batch had no light.
    Dark,
}

impl Parameters {
    /// Returns the lists, with their names in files.
    pub(crate) fn lists(&self) -> [(&'static str, &Vec<f32>); 4] {
        let OptimizerState { first_moments, second_moments, .. } = &self.optimizer;
        let [weights, average] = [("weights", &self.weights), ("average", &self.average)];
        [weights, average, ("first_moments", first_moments), ("second_moments", second_moments)]
    }

    /// Returns the lists, in the same order.
    pub(crate) fn lists_mut(&mut self) -> [&mut Vec<f32>; 4] {
        let Self { weights, average, optimizer: OptimizerState { first_moments, second_moments, .. } } = self;
        [weights, average, first_moments, second_moments]
    }

    /// Returns the weights for inference: the moving average if there is one.
    pub fn inference_weights(&self) -> &[f32] {
        if self.average.is_empty() { &self.weights } else { &self.average }
    }

    /// Updates the moving average.
    fn average_weights(&mut self, decay: f32) {
        let decay = average_decay(decay, self.optimizer.moves);
        for (average, weight) in self.average.iter_mut().zip(&self.weights) {
            *average = decay * *average + (1.0 - decay) * weight;
        }
    }
}

impl TrainingState {
    /// Returns the state before the first step, with all weights in one group.
    pub fn new(config: &FitConfig, weights: Vec<f32>) -> Self {
        let groups = vec![(weights.len(), config.learning_rate)];
        let average = if config.ema_decay > 0.0 { weights.clone() } else { Vec::new() };
        let optimizer = OptimizerState::new(weights.len());
        let parameters = Parameters { weights, average, optimizer };
        let (loss, mean_loss, best) = (None, None, None);
        Self { step: 0, skipped: 0, loss, mean_loss, seconds: 0.0, rate_factor: 1.0, parameters, groups, best }
    }

    /// Returns the learning rate of the first group at `step`.
    pub fn learning_rate(&self, config: &FitConfig, step: usize) -> f64 {
        self.rate_factor * learning_rate(config, self.groups[0].1, step)
    }

    /// Moves the parameters by the gradient of a step, if there is one that is finite. [`Self::end_step`] follows.
    pub fn move_by(&mut self, config: &FitConfig, gradient: Option<StepGradient>) -> Outcome {
        let Some(StepGradient { loss, d_weight }) = gradient else { return Outcome::Dark };
        let rate = |peak| self.rate_factor * learning_rate(config, peak, self.step);
        let rates: Vec<_> = self.groups.iter().map(|&(length, peak)| (length, rate(peak))).collect();
        let Parameters { weights, optimizer, .. } = &mut self.parameters;
        if !(loss.is_finite() && optimizer.step(config, &rates, weights, &d_weight)) {
            return Outcome::Skipped(loss);
        }
        self.parameters.average_weights(config.ema_decay);
        Outcome::Moved(loss)
    }

    /// Counts a step, whose parameters have moved already.
    ///
    /// # Errors
    /// [`Error::Diverged`] after more than `max_skipped` steps that were not finite.
    pub fn end_step(&mut self, config: &FitConfig, outcome: Outcome) -> Result<()> {
        match outcome {
            Outcome::Moved(loss) => {
                self.loss = Some(loss);
                self.mean_loss = Some(self.mean_loss.map_or(loss, |mean| mean + LOSS_WEIGHT * (loss - mean)));
            }
            Outcome::Skipped(loss) => {
                self.loss = Some(loss);
                self.skipped += 1;
            }
            Outcome::Dark => {}
        }
        self.step += 1;
        if self.skipped > config.max_skipped {
            return Err(Error::Diverged { step: self.step, skipped: self.skipped });
        }
        Ok(())
    }
}

/// Returns settings as JSON, for comparison with those of a file; files named in them are not opened.
pub(crate) fn as_json(settings: &impl Serialize) -> serde_json::Value {
    let text = serde_json::to_string(settings).expect("settings can be written as JSON");
    serde_json::from_str(&text).expect("what was written as JSON is JSON")
}
