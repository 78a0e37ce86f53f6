//! The shape of a flow tail.

use serde::{Deserialize, Serialize};

use crate::{Result, coupling::Coordinate, error::within, spline::logit_count};

/// Inputs of the layers that transform the elevation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlowForm {
    /// The azimuth; the azimuth's layers depend on the elevation likewise (the paper's form).
    Coupled,
    /// None: `p(v) p(u | v)`. Rows of the square stay rows, so all cells of a table have convex images for
    /// any weights.
    Triangular,
}

/// The shape of a flow tail.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowConfig {
    /// Inputs of the elevation's layers: `coupled`, the azimuth as in the paper, or `triangular`, none.
    pub form: FlowForm,
    /// Bins K per spline.
    pub bins: usize,
    /// Number of coupling layers, which transform elevation and azimuth in turn.
    pub couplings: usize,
    /// Width of the residual networks.
    pub hidden: usize,
    /// Residual blocks per network, of two layers each.
    pub residual_blocks: usize,
    /// Octaves of the other coordinate's features: 1 is (cos, sin) of the azimuth, or the elevation
    /// unchanged.
    pub octaves: usize,
    /// Slope of the leaky ReLU for negative arguments.
    pub leaky_slope: f32,
}

impl Default for FlowConfig {
    /// Returns [`FlowConfig::SMALL`].
    fn default() -> Self {
        Self::SMALL
    }
}

impl FlowConfig {
    /// A flow that trains on a CPU in minutes.
    pub const SMALL: Self = Self {
        form: FlowForm::Triangular,
        bins: 64,
        couplings: 2,
        hidden: 64,
        residual_blocks: 1,
        octaves: 5,
        leaky_slope: 0.01,
    };
    /// The paper's flow: 128 bins, 16 coupling layers, 256 hidden units, two residual blocks.
    pub const PAPER: Self = Self {
        form: FlowForm::Coupled,
        bins: 128,
        couplings: 16,
        hidden: 256,
        residual_blocks: 2,
        octaves: 1,
        leaky_slope: 0.01,
    };

    /// Returns the number of logits per spline.
    pub const fn logits(&self) -> usize {
        logit_count(self.bins)
    }

    /// Returns the coordinate that a coupling layer transforms, counted in the density direction.
    pub const fn target(&self, coupling: usize) -> Coordinate {
        if coupling.is_multiple_of(2) { Coordinate::Elevation } else { Coordinate::Azimuth }
    }

    /// Returns whether the network of a layer that transforms `target` uses the other coordinate; otherwise
    /// its input is 0.
    pub fn sees_other(&self, target: Coordinate) -> bool {
        self.form == FlowForm::Coupled || target == Coordinate::Azimuth
    }

    /// Returns the number of features of the coordinate that is not `target`.
    pub const fn features(&self, target: Coordinate) -> usize {
        match target {
            Coordinate::Elevation => 2 * self.octaves,
            Coordinate::Azimuth => self.octaves,
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        within("flow.shape.bins", self.bins, 2..=128, "in 2..=128")?;
        within("flow.shape.couplings", self.couplings, 2..=64, "in 2..=64")?;
        within("flow.shape.hidden", self.hidden, 1..=4096, "in 1..=4096")?;
        within("flow.shape.residual_blocks", self.residual_blocks, 0..=16, "in 0..=16")?;
        within("flow.shape.octaves", self.octaves, 1..=12, "in 1..=12")?;
        within("flow.shape.leaky_slope", self.leaky_slope, 0.0..=1.0, "in [0, 1]")
    }
}
