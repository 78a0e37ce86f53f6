//! Progress of a contest: its stages, and the approximate fraction of time that each takes.

use crate::progress::{Bar, FRACTION_UNITS, bar};

/// A part of the contest.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    /// First pictures of samplers without a file.
    Plain,
    /// The exact product, as a bound.
    Product,
    /// Tables.
    Tables,
    /// Further pictures of all remaining candidates.
    Beside,
    /// Heads.
    Heads,
    /// The last pictures.
    Last,
}

/// Stages with the fraction of the whole time at which they end. Approximate: the time depends on which
/// candidates remain.
const ENDS: [(Stage, f64); 6] = [
    (Stage::Plain, 0.2),
    (Stage::Product, 0.35),
    (Stage::Tables, 0.55),
    (Stage::Beside, 0.6),
    (Stage::Heads, 0.9),
    (Stage::Last, 1.0),
];

/// A progress bar over the stages.
pub struct Stages {
    bar: Bar,
    stage: Stage,
}

impl Stages {
    /// Returns a bar before the first stage.
    pub fn new() -> Self {
        Self { bar: bar(FRACTION_UNITS, "autosize"), stage: Stage::Plain }
    }

    /// Begins a stage with the number of remaining candidates.
    pub fn begin(&mut self, stage: Stage, candidates: usize) {
        self.stage = stage;
        self.bar.set_message(format!("{}; candidates left: {candidates}", self.stage.name()));
        self.within(0.0);
    }

    /// Shows the fraction of the stage that is done, in [0, 1].
    pub fn within(&self, fraction: f64) {
        self.bar.fraction_setter()(self.stage.part(fraction));
    }
}

impl Drop for Stages {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl Stage {
    /// Returns the name of the stage.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "samplers without a file",
            Self::Product => "the exact product",
            Self::Tables => "tables",
            Self::Beside => "tables beside them",
            Self::Heads => "heads",
            Self::Last => "the last rounds",
        }
    }

    /// Converts a fraction of this stage to a fraction of the whole time.
    fn part(self, fraction: f64) -> f64 {
        let mut begin = 0.0;
        for (stage, end) in ENDS {
            if stage == self {
                return begin + fraction.clamp(0.0, 1.0) * (end - begin);
            }
            begin = end;
        }
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_contiguous_and_cover_the_whole() {
        let mut before = 0.0;
        for (stage, end) in ENDS {
            assert_eq!(stage.part(0.0), before, "{stage:?}");
            assert!(stage.part(0.5) > before && stage.part(0.5) < end, "{stage:?}");
            assert_eq!(stage.part(1.0), end, "{stage:?}");
            before = end;
        }
        assert_eq!(before, 1.0);
    }
}
