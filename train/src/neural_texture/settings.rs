//! Settings of the fit of a neural material.

use crate::{Error, FitConfig, Result, config::within};
use serde::{Deserialize, Serialize};

/// Settings of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Texels along an axis of the finest level: a power of two.
    pub side: usize,
    /// Training steps.
    pub steps: usize,
    /// Samples per step.
    pub batch: usize,
    /// Light paths per sample.
    pub paths: u32,
    /// Seed of weights and samples.
    pub seed: u64,
}

impl Settings {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Config`] naming the field.
    pub fn check(&self) -> Result<()> {
        if !self.side.is_power_of_two() || self.side > 512 {
            let value = self.side.to_string();
            return Err(Error::Config { field: "side", value, requirement: "a power of two up to 512" });
        }
        within("steps", self.steps, 1..=10_000_000, "in 1..=10000000")?;
        within("batch", self.batch, 16..=1 << 20, "in 16..=1048576")?;
        within("paths", self.paths, 1..=4096, "in 1..=4096")
    }

    pub(super) fn optimizer(&self) -> FitConfig {
        FitConfig {
            steps: self.steps,
            learning_rate: 1e-2,
            warmup: 0.01,
            weight_decay: 0.0,
            clip_norm: f64::MAX,
            beta_1: 0.9,
            beta_2: 0.99,
            ..FitConfig::default()
        }
    }
}
