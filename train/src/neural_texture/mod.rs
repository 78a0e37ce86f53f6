//! Fitting a neural material to samples of a bidirectional texture.
//!
//! Each step asks the source for new samples, so that nothing is learned by heart. One light path per sample is enough: the loss is a
//! squared error with weights of its own (`loss.rs`), whose gradient has the same mean whatever the noise of the samples (Lehtinen et al. 2018).
//! Lobes for sampling are fitted in the same steps, by maximum likelihood under the samples, and do not act back on the features.

mod fused;
#[cfg(test)]
mod graph;
mod layout;
mod loss;
mod picture;
mod samples;
mod state;

pub use layout::Layout;
pub use picture::{DISTANCES, QUERIES, side_by_side};
pub use samples::{Decibels, Samples, error_over};
pub use state::State;

use headtail_render::{
    brdf::neural_texture::{Description, FEATURES, NeuralTexture},
    fabric::Source,
};
use serde::{Deserialize, Serialize};

use crate::{Error, FitConfig, Result};
use fused::FusedGradient;

/// Slope of the leaky ReLU of the networks.
pub const LEAKY_SLOPE: f32 = 0.01;

/// What a fit is set by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Texels along an axis of the finest level: a power of two.
    pub side: usize,
    /// Training steps.
    pub steps: usize,
    /// Samples of a step.
    pub batch: usize,
    /// Light paths of a sample.
    pub paths: u32,
    /// Seed of weights and samples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { side: 64, steps: 4000, batch: 8192, paths: 1, seed: 0 }
    }
}

impl Settings {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Config`] that names the field.
    pub fn check(&self) -> Result<()> {
        let wrong =
            |field, value: usize, requirement| Err(Error::Config { field, value: value.to_string(), requirement });
        match self {
            Self { side, .. } if !(side.is_power_of_two() && *side <= 512) => {
                wrong("side", *side, "a power of two up to 512")
            }
            Self { steps, .. } if !(1..=10_000_000).contains(steps) => wrong("steps", *steps, "in 1..=10000000"),
            Self { batch, .. } if !(16..=1 << 20).contains(batch) => wrong("batch", *batch, "in 16..=1048576"),
            Self { paths, .. } if !(1..=4096).contains(paths) => wrong("paths", *paths as usize, "in 1..=4096"),
            _ => Ok(()),
        }
    }

    /// The optimiser's settings, for texels and networks.
    fn optimizers(&self) -> [FitConfig; 2] {
        [1e-2, 4e-3].map(|learning_rate| FitConfig {
            steps: self.steps,
            learning_rate,
            warmup: 0.01,
            weight_decay: 0.0,
            clip_norm: f64::MAX,
            beta_1: 0.9,
            beta_2: 0.99,
            ..FitConfig::default()
        })
    }
}

/// A fit on its way.
pub struct Fit<'a> {
    settings: Settings,
    source: &'a dyn Source,
    gradient: FusedGradient,
    layout: Layout,
    /// What the next step depends on.
    pub state: State,
}

impl<'a> Fit<'a> {
    /// A fit before its first step, or where `state` was left.
    ///
    /// # Errors
    /// When a setting is out of range, or the state is of another layout.
    pub fn new(settings: Settings, source: &'a dyn Source, state: Option<State>) -> Result<Self> {
        settings.check()?;
        let layout = Layout::new(settings.side);
        let state = state.unwrap_or_else(|| State::new(layout.initial_weights(settings.seed), layout.texels()));
        state.check(&layout)?;
        Ok(Self { settings, source, gradient: FusedGradient::new(layout.clone()), layout, state })
    }

    /// Steps that are done.
    pub fn step(&self) -> usize {
        self.state.step
    }

    /// Takes the next step and gives its loss: the mean of weighted squared errors.
    pub fn advance(&mut self) -> f32 {
        let samples = Samples::draw(self.source, &self.settings, self.state.step);
        let (loss, gradient) = self.gradient.gradient(&self.state.weights, &samples);
        self.state.advance(&self.settings.optimizers(), FEATURES * self.layout.texels(), &gradient);
        loss
    }

    /// The material as it is now, as a file would hold it.
    ///
    /// # Errors
    /// When the weights have diverged.
    pub fn material(&self, name: &str) -> Result<NeuralTexture> {
        let mut description = Description::new(name, LEAKY_SLOPE);
        description.steps = self.state.step as u64;
        let material = self.layout.material(&self.state.weights, description)?;
        material.rounded().map_err(|error| Error::Render(error.into()))
    }
}

#[cfg(test)]
mod tests;
