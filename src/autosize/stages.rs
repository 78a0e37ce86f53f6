//! How far a contest is: its stages, each with about the share of the time that it takes.

use crate::progress::{Bar, SHARES, bar};

/// A part of the contest.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    /// First pictures of samplers without a file.
    Plain,
    /// What an exact product would have.
    Product,
    /// Tables.
    Tables,
    /// More pictures of all that are left.
    Beside,
    /// Heads.
    Heads,
    /// The last pictures.
    Last,
}

/// Each stage with the part of the whole time at which it ends. How long a contest takes depends on who stays in it, so that these are rough.
const ENDS: [(Stage, f64); 6] = [
    (Stage::Plain, 0.2),
    (Stage::Product, 0.35),
    (Stage::Tables, 0.55),
    (Stage::Beside, 0.6),
    (Stage::Heads, 0.9),
    (Stage::Last, 1.0),
];

/// A bar over the stages.
pub struct Stages {
    bar: Bar,
    stage: Stage,
}

impl Stages {
    /// Before the first one.
    pub fn new() -> Self {
        Self { bar: bar(SHARES, "autosize"), stage: Stage::Plain }
    }

    /// A stage begins, with so many candidates in the contest.
    pub fn begin(&mut self, stage: Stage, candidates: usize) {
        self.stage = stage;
        self.bar.set_message(format!("{}; candidates left: {candidates}", self.stage.name()));
        self.within(0.0);
    }

    /// So much of the stage is done, between 0 and 1.
    pub fn within(&self, share: f64) {
        self.bar.shares()(self.stage.part(share));
    }
}

impl Drop for Stages {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl Stage {
    /// In words.
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

    /// The part of the whole time that is over when so much of this stage is.
    fn part(self, share: f64) -> f64 {
        let mut begin = 0.0;
        for (stage, end) in ENDS {
            if stage == self {
                return begin + share.clamp(0.0, 1.0) * (end - begin);
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
    fn stages_follow_each_other_and_fill_the_whole() {
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
