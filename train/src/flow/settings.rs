//! The settings of a flow tail's fit.

use std::{fmt, str::FromStr};

use headtail_model::FlowConfig;
use serde::{Deserialize, Serialize};

use crate::{Error, FitConfig, Result, config::within};

/// Settings of a flow tail, `[flow]` in files.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowSettings {
    /// Optimiser steps.
    pub steps: usize,
    /// Strata per side of Y; a step has one point in each.
    pub strata: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// The fit ends when `KL(light || flow)`, measured after each twentieth of the run, is at most this many
    /// nats; 0 runs all steps.
    pub kl_target: f64,
    /// Fraction of points that are uniform over X instead of distributed like the light: without them, dark
    /// regions are thinner in Y than a cell of the table. The head learns the remaining factor of the light.
    pub uniform: f32,
    /// Cells along a side of the table: a power of two from 4 to 1024.
    pub cells: usize,
    /// The flow's shape.
    pub shape: FlowConfig,
}

/// Named settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowSize {
    /// Trains in a minute on two cores.
    Small,
    /// Trains in a few minutes on two cores.
    Medium,
    /// The paper's size, for a GPU or a night.
    Paper,
}

impl FlowSize {
    /// All sizes.
    pub const ALL: [Self; 3] = [Self::Small, Self::Medium, Self::Paper];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Medium => "medium",
            Self::Paper => "paper",
        }
    }

    /// Returns the settings.
    pub const fn settings(self) -> FlowSettings {
        const SMALL: FlowSettings = FlowSettings {
            steps: 1500,
            strata: 64,
            learning_rate: 5e-3,
            kl_target: 0.0,
            uniform: 0.05,
            cells: 256,
            shape: FlowConfig::SMALL,
        };
        match self {
            Self::Small => SMALL,
            Self::Medium => {
                let shape = FlowConfig { bins: 128, couplings: 2, hidden: 128, octaves: 6, ..FlowConfig::SMALL };
                FlowSettings { steps: 3000, learning_rate: 3e-3, cells: 512, shape, ..SMALL }
            }
            Self::Paper => {
                // At a rate of 1e-3, steps of 1024 points diverge on lebombo_1k; at this rate, with gradients
                // clipped at 1, they do not.
                FlowSettings { steps: 100_000, learning_rate: 1.5e-4, cells: 1024, shape: FlowConfig::PAPER, ..SMALL }
            }
        }
    }
}

impl fmt::Display for FlowSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for FlowSize {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let known = Self::ALL.into_iter().find(|size| size.name() == text);
        known.ok_or_else(|| format!("'{text}' is not a size of flow tails; choose small, medium or paper"))
    }
}

impl Default for FlowSettings {
    /// Returns [`FlowSize::Small`].
    fn default() -> Self {
        FlowSize::Small.settings()
    }
}

impl FlowSettings {
    /// Returns the number of points of a step.
    pub const fn points(&self) -> usize {
        self.strata * self.strata
    }

    /// Returns `config` with the flow's optimiser settings.
    pub fn optimizer(&self, config: &FitConfig) -> FitConfig {
        FitConfig {
            steps: self.steps,
            learning_rate: self.learning_rate,
            weight_decay: 0.0,
            ema_decay: 0.0,
            ..config.clone()
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Config`] or [`Error::Model`] naming the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        self.shape.validate()?;
        within("flow.steps", self.steps, 1..=100_000_000, "in 1..=1e8")?;
        within("flow.strata", self.strata, 1..=1024, "in 1..=1024")?;
        within("flow.learning_rate", self.learning_rate, f64::MIN_POSITIVE..=1.0, "in (0, 1]")?;
        within("flow.kl_target", self.kl_target, 0.0..=100.0, "in [0, 100]")?;
        within("flow.uniform", self.uniform, 0.0..=0.9, "in [0, 0.9]")?;
        let requirement = "a power of two in 4..=1024";
        within("flow.cells", self.cells, 4..=1024, requirement)?;
        if self.cells.is_power_of_two() {
            return Ok(());
        }
        Err(Error::Config { field: "flow.cells", value: self.cells.to_string(), requirement })
    }
}
