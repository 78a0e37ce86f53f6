//! Estimates the completed and the remaining work of a sweep, including early stopping.

use std::collections::HashMap;

use anyhow::Result;

use super::{Sweep, jobs, plan, space::Method};
use crate::cost;

/// Work, in any unit common to all trials.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkAmount {
    /// Completed work of all workers.
    pub done: f64,
    /// Estimated remaining work.
    pub left: f64,
}

/// Work of a trial.
#[derive(Clone, Copy, Debug)]
struct TrialWork {
    /// Work of its whole run.
    whole: f64,
    /// Number of rungs that it has passed; the last one is its end.
    passed: usize,
    /// Whether it is complete or has failed.
    is_over: bool,
    /// Fraction of its steps that are done.
    fraction: f64,
}

/// Expected reduction of the number of trials.
struct Ladder {
    /// Rungs as fractions of a whole run, the last one 1.
    rungs: Vec<f64>,
    /// One of this many configurations advances from each rung.
    keep: usize,
    /// Number of trials of a configuration.
    replicates: usize,
    /// Number of configurations that adaptive search has yet to make.
    unplanned: usize,
}

impl Ladder {
    /// Returns the work of these trials, and of those not planned yet.
    fn work(&self, trials: &[TrialWork]) -> WorkAmount {
        let count = trials.len().max(1) as f64;
        let mean = trials.iter().map(|trial| trial.whole).sum::<f64>() / count;
        let begins = |rung: usize| if rung == 0 { 0.0 } else { self.rungs[rung - 1] };
        let mut work = WorkAmount::default();
        for trial in trials {
            let fraction = if trial.passed == 0 { 0.0 } else { self.rungs[trial.passed - 1] };
            let fraction = if trial.is_over { fraction } else { fraction.max(trial.fraction) };
            work.done += trial.whole * fraction;
            // Below the first rung, the remaining work is certain.
            if trial.passed == 0 && !trial.is_over {
                work.left += trial.whole * (self.rungs[0] - fraction).max(0.0);
            }
        }
        work.left += (self.unplanned * self.replicates) as f64 * mean * self.rungs[0];
        let mut configurations = trials.len() / self.replicates + self.unplanned;
        for rung in 1..self.rungs.len() {
            // Promotion is asynchronous, so more may have advanced.
            let passed = trials.iter().filter(|trial| trial.passed > rung).count();
            configurations = (configurations / self.keep).max(passed / self.replicates);
            // The part of a run between two rungs, as a number of trials.
            let length = self.rungs[rung] - begins(rung);
            let part = |trial: &TrialWork| ((trial.fraction - begins(rung)) / length).clamp(0.0, 1.0);
            let running = |trial: &&TrialWork| trial.passed == rung && !trial.is_over;
            let done = passed as f64 + trials.iter().filter(running).map(part).sum::<f64>();
            work.left += mean * length * ((configurations * self.replicates) as f64 - done).max(0.0);
        }
        work
    }
}

/// Estimates the work of a sweep; caches the work of each trial.
#[derive(Default)]
pub struct Estimate {
    whole: HashMap<String, f64>,
}

impl Estimate {
    /// Returns the work of a sweep; `steps` are the reported steps of the running trials.
    ///
    /// # Errors
    /// If the settings of a trial are wrong.
    pub fn of(&mut self, sweep: &Sweep, steps: &HashMap<String, (usize, usize)>) -> Result<WorkAmount> {
        let (space, rungs) = (&sweep.space, sweep.space.halving.as_ref().map(|halving| &halving.rungs));
        let mut trials = Vec::with_capacity(sweep.plan.trials.len());
        for (index, trial) in sweep.plan.trials.iter().enumerate() {
            if !self.whole.contains_key(&trial.id) {
                let seconds = cost::fit(&plan::resolve(space, &trial.assignment)?.fit);
                self.whole.insert(trial.id.clone(), seconds);
            }
            let record = sweep.ledger.record(&trial.id);
            let is_done = record.is_some_and(|record| record.done.is_some());
            let passed = record.map_or(0, |record| {
                rungs.map_or(0, |rungs| rungs.iter().take_while(|step| record.rungs.contains_key(step)).count())
            });
            let fraction = steps.get(&trial.id).map_or(0.0, |&(step, all)| step as f64 / all.max(1) as f64);
            trials.push(TrialWork {
                whole: self.whole[&trial.id],
                passed: if is_done { rungs.map_or(1, Vec::len) } else { passed },
                is_over: jobs::is_over(&sweep.plan, &sweep.ledger, index),
                fraction,
            });
        }
        let replicates = trials.len().checked_div(sweep.plan.configurations.len()).unwrap_or(1);
        let ladder = Ladder {
            rungs: rungs.map_or(vec![1.0], |rungs| {
                let last = rungs[rungs.len() - 1] as f64;
                rungs.iter().map(|&step| step as f64 / last).collect()
            }),
            keep: space.halving.as_ref().map_or(1, |halving| halving.keep),
            replicates: replicates.max(1),
            unplanned: match space.search.method {
                Method::Tpe => space.search.n.saturating_sub(sweep.suggested),
                Method::Product | Method::Zip | Method::Random => 0,
            },
        };
        Ok(ladder.work(&trials))
    }

    /// Returns the work of a trial that [`Self::of`] has processed.
    pub fn whole(&self, trial: &str) -> f64 {
        self.whole.get(trial).copied().unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: TrialWork = TrialWork { whole: 900.0, passed: 0, is_over: false, fraction: 0.0 };

    fn halving(unplanned: usize) -> Ladder {
        Ladder { rungs: vec![1.0 / 9.0, 1.0 / 3.0, 1.0], keep: 3, replicates: 1, unplanned }
    }

    /// Returns completed and remaining work, for trials whose unit is a step.
    fn work(ladder: &Ladder, trials: &[TrialWork]) -> (f64, f64) {
        let WorkAmount { done, left } = ladder.work(trials);
        ((1e6 * done).round() / 1e6, (1e6 * left).round() / 1e6)
    }

    #[test]
    fn without_halving_every_trial_runs_to_its_end() {
        let ladder = Ladder { rungs: vec![1.0], keep: 1, replicates: 1, unplanned: 0 };
        let (short, done) = (TrialWork { whole: 100.0, ..OPEN }, TrialWork { passed: 1, is_over: true, ..OPEN });
        let failed = TrialWork { is_over: true, ..OPEN };
        let running = TrialWork { fraction: 0.25, ..OPEN };
        assert_eq!(work(&ladder, &[OPEN, short]), (0.0, 1000.0));
        assert_eq!(work(&ladder, &[running, short, done, failed]), (225.0 + 900.0, 675.0 + 100.0));
    }

    #[test]
    fn with_halving_most_trials_end_at_the_first_rung() {
        // 27 of 100 steps, of which 9 advance to 300 and 3 to 900; all trials to the end would be 24,300.
        let mut trials = [OPEN; 27];
        assert_eq!(work(&halving(0), &trials), (0.0, 2700.0 + 1800.0 + 1800.0));
        // All have reached the first rung and five the second; one is halfway from there to the end.
        trials.iter_mut().for_each(|trial| trial.passed = 1);
        trials[..5].iter_mut().for_each(|trial| trial.passed = 2);
        trials[0].fraction = 2.0 / 3.0;
        assert_eq!(work(&halving(0), &trials), (2700.0 + 1000.0 + 300.0, 800.0 + 1500.0));
        // More than 1/3 advanced, so more will again.
        trials[..18].iter_mut().for_each(|trial| trial.passed = 2);
        assert_eq!(work(&halving(0), &trials).1, 3600.0 - 300.0);
        trials.iter_mut().for_each(|trial| trial.passed = 3);
        assert_eq!(work(&halving(0), &trials).1, 0.0);
    }

    #[test]
    fn unplanned_configurations_are_counted() {
        let tpe = Ladder { rungs: vec![1.0], keep: 1, replicates: 2, unplanned: 8 };
        let trials = [[OPEN; 2], [TrialWork { passed: 1, is_over: true, ..OPEN }; 2]].concat();
        assert_eq!(work(&tpe, &trials), (1800.0, 1800.0 + 16.0 * 900.0));
        assert_eq!(work(&halving(18), &[OPEN; 9]), work(&halving(0), &[OPEN; 27]));
    }
}
