//! Choice of sample points.

use std::str::FromStr;

use headtail_render::points::PointSet;

use crate::Budget;

/// A set of points, or `zsobol` in sets that the budget fits into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointChoice {
    /// A set by its name.
    Named(PointSet),
    /// One sequence along a curve through the pixels, in sets that the budget fits into.
    Zsobol,
}

impl PointChoice {
    /// Set size of `zsobol` if the budget does not determine it.
    const SET: u32 = 16;

    /// Returns the points for a budget.
    pub fn for_budget(self, budget: Budget) -> PointSet {
        match (self, budget) {
            (Self::Named(set), _) => set,
            (Self::Zsobol, Budget::Samples(samples)) => PointSet::zsobol(samples),
            (Self::Zsobol, Budget::Seconds(_)) => PointSet::zsobol(Self::SET),
        }
    }
}

impl Default for PointChoice {
    fn default() -> Self {
        Self::Named(PointSet::Sobol)
    }
}

impl FromStr for PointChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("zsobol", _) => Ok(Self::Zsobol),
            (_, Ok(set)) => Ok(Self::Named(set)),
            _ => Err("choose sobol, zsobol, zsobol:N with a power of two up to 1048576, or independent".into()),
        }
    }
}
