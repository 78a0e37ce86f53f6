//! The record of a trial: its merged events, ordered by the numbers of attempts.

use std::collections::BTreeMap;

use crate::run::Measures;

/// Merged events of a trial.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Figures at rungs, by steps.
    pub rungs: BTreeMap<usize, Measures>,
    /// Final figures.
    pub done: Option<Measures>,
    /// Attempt and reason of the last failure.
    failure: Option<(u64, String)>,
    /// Last attempt that was retried.
    retry: Option<u64>,
    /// Attempt and step of each start.
    starts: Vec<(u64, usize)>,
    /// Last attempt that ended regularly.
    stop: Option<u64>,
    /// Seconds of work that ended regularly.
    pub seconds: f64,
}

/// Starts at the same step without a later event after which a trial counts as failed.
const MOST_STARTS: usize = 5;

impl Record {
    /// Returns the reason of its failure, unless it may run again.
    pub fn failure(&self) -> Option<String> {
        if self.done.is_some() {
            return None;
        }
        if let Some((_, reason)) = self.failure.as_ref().filter(|(attempt, _)| Some(*attempt) > self.retry) {
            return Some(reason.clone());
        }
        let after = self.retry.max(self.stop);
        let mut starts: Vec<usize> =
            self.starts.iter().filter(|(attempt, _)| Some(*attempt) > after).map(|(_, step)| *step).collect();
        starts.sort_unstable();
        let lost = starts.windows(MOST_STARTS + 1).find(|window| window.first() == window.last());
        lost.map(|window| format!("ended {MOST_STARTS} times after step {} without a word", window[0]))
    }

    /// Whether work was started and has neither ended regularly nor failed since.
    pub fn is_open(&self) -> bool {
        let last = self.starts.iter().map(|(attempt, _)| *attempt).max();
        self.done.is_none() && last > self.stop.max(self.failure.as_ref().map(|(attempt, _)| *attempt))
    }

    /// Returns the number of the last attempt; 0 before the first, and in journals without such numbers.
    pub fn attempt(&self) -> u64 {
        let started = self.starts.iter().map(|(attempt, _)| *attempt).max();
        started.max(self.failure.as_ref().map(|(attempt, _)| *attempt)).max(self.retry).max(self.stop).unwrap_or(0)
    }

    /// Returns the number of starts.
    pub fn starts(&self) -> usize {
        self.starts.len()
    }

    /// Adds the start of an attempt after this step.
    pub fn start(&mut self, attempt: u64, step: usize) {
        self.starts.push((attempt, step));
    }

    /// Adds the regular end of an attempt.
    pub fn end(&mut self, attempt: u64, seconds: f64) {
        self.seconds += seconds;
        self.stop = self.stop.max(Some(attempt));
    }

    /// Adds the failure of an attempt.
    pub fn fail(&mut self, attempt: u64, reason: String) {
        self.failure = self.failure.take().max(Some((attempt, reason)));
    }

    /// Allows the trial to run again after failures up to an attempt.
    pub fn retry(&mut self, attempt: u64) {
        self.retry = self.retry.max(Some(attempt));
    }
}
