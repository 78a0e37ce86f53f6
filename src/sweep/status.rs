//! Status of a sweep, from its folder, and from Slurm if it was submitted there.

use std::{collections::BTreeMap, fmt};

use anyhow::Result;
use serde::{Serialize, Serializer};

use super::{
    Sweep,
    plan::{self, Trial},
    queue::Queue,
    record::Record,
    space::Assignment,
};
use crate::report::number::duration;
use crate::terminal::out;

/// State of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Complete.
    Done,
    /// A worker holds it.
    Running,
    /// At a rung, and may be promoted.
    Paused,
    /// Stopped or killed; it resumes from its last checkpoint.
    Stopped,
    /// Ended with an error.
    Failed,
    /// Not started.
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

impl Serialize for State {
    /// Serializes the displayed word.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl State {
    /// Returns the state of a trial.
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

/// Returns the number of trials per state.
pub fn counts(sweep: &Sweep) -> BTreeMap<State, usize> {
    let mut counts = BTreeMap::new();
    let states = sweep.plan.trials.iter().map(|trial| State::of(sweep, &trial.id));
    states.for_each(|state| *counts.entry(state).or_default() += 1);
    counts
}

/// Formats [`counts`].
pub fn words(counts: &BTreeMap<State, usize>) -> String {
    let words: Vec<String> = counts.iter().map(|(state, count)| format!("{count} {state}")).collect();
    words.join(", ")
}

/// Status of a sweep.
#[derive(Debug, Serialize)]
pub struct Status {
    /// Number of trials planned so far.
    trials: usize,
    /// Number of trials by state.
    states: BTreeMap<State, usize>,
    /// Seconds of work that ended regularly.
    work_seconds: f64,
    /// Trials that failed.
    failures: Vec<Failure>,
    /// Slurm's answers, if the sweep was submitted there.
    slurm: Option<Queue>,
}

/// A trial that failed.
#[derive(Debug, Serialize)]
struct Failure {
    trial: String,
    assignment: Assignment,
    reason: String,
}

impl Status {
    /// Reads the status from the folder and from Slurm.
    ///
    /// # Errors
    /// As [`Queue::ask`].
    pub fn of(sweep: &Sweep) -> Result<Self> {
        let record = |trial: &Trial| sweep.ledger.record(&trial.id);
        let trials = &sweep.plan.trials;
        let mut failures = Vec::new();
        for trial in trials {
            if State::of(sweep, &trial.id) == State::Failed {
                let reason = record(trial).and_then(Record::failure).unwrap_or_default();
                failures.push(Failure { trial: trial.id.clone(), assignment: trial.assignment.clone(), reason });
            }
        }
        let work_seconds = trials.iter().filter_map(record).map(|record| record.seconds).sum();
        Ok(Self {
            trials: trials.len(),
            states: counts(sweep),
            work_seconds,
            failures,
            slurm: Queue::ask(sweep.folder.path())?,
        })
    }

    /// Prints counts, then failures, then Slurm's answers.
    pub fn print(&self) {
        let Self { trials, states, work_seconds, failures, slurm } = self;
        out!("{trials} trials: {}; {} of work", words(states), duration(*work_seconds));
        const SHOWN: usize = 20;
        for Failure { trial, assignment, reason } in failures.iter().take(SHOWN) {
            out!("failed: {trial}  {}: {reason}", plan::text(assignment));
        }
        if failures.len() > SHOWN {
            out!("... and {} more that failed", failures.len() - SHOWN);
        }
        slurm.iter().flat_map(Queue::lines).for_each(|line| out!("{line}"));
    }
}
