//! How far a sweep is, by its folder, and by Slurm where it was sent there.

use std::{collections::BTreeMap, fmt};

use anyhow::Result;

use super::{Sweep, journal::Record, slurm};
use crate::report::number::duration;
use crate::terminal::out;

/// Where a trial is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Complete.
    Done,
    /// A worker is at it.
    Running,
    /// At a rung, and may go on.
    Paused,
    /// Stopped or killed; it goes on from its last checkpoint.
    Stopped,
    /// Ended with an error.
    Failed,
    /// Not begun.
    Waiting,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Done => "done",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Waiting => "waiting",
        })
    }
}

impl State {
    /// The state of a trial of which this is known.
    pub fn of(sweep: &Sweep, id: &str) -> Self {
        let Some(record) = sweep.ledger.record(id) else { return Self::Waiting };
        if record.done.is_some() {
            Self::Done
        } else if record.failure().is_some() {
            Self::Failed
        } else if record.is_open() && sweep.folder.is_locked(id) {
            Self::Running
        } else if sweep.space.halving.is_some() && !record.is_open() && !record.rungs.is_empty() {
            Self::Paused
        } else {
            Self::Stopped
        }
    }
}

/// Prints counts, then failures.
pub fn run(sweep: &Sweep) -> Result<()> {
    let mut counts: BTreeMap<State, usize> = BTreeMap::new();
    let mut failures = Vec::new();
    for trial in &sweep.plan.trials {
        let state = State::of(sweep, &trial.id);
        *counts.entry(state).or_default() += 1;
        if state == State::Failed {
            let reason = sweep.ledger.record(&trial.id).and_then(Record::failure).unwrap_or_default();
            failures.push(format!("{}  {}: {reason}", trial.id, super::plan::text(&trial.assignment)));
        }
    }
    let words: Vec<String> = counts.iter().map(|(state, count)| format!("{count} {state}")).collect();
    let seconds: f64 =
        sweep.plan.trials.iter().filter_map(|trial| sweep.ledger.record(&trial.id)).map(|record| record.seconds).sum();
    out!("{} trials: {}; {} of work", sweep.plan.trials.len(), words.join(", "), duration(seconds));
    const SHOWN: usize = 20;
    failures.iter().take(SHOWN).for_each(|line| out!("failed: {line}"));
    if failures.len() > SHOWN {
        out!("... and {} more that failed", failures.len() - SHOWN);
    }
    slurm::print_status(sweep)
}
