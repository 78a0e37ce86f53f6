//! The next jobs of a sweep, from its plan and journals.

use super::{
    Sweep,
    halving::{Scores, promotions},
    journal::Ledger,
    plan::{Configuration, Plan},
    space::{Assignment, Space},
};

/// A trial that is to run to some step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    /// Index into the plan.
    pub trial: usize,
    /// The rung to pause at; `None` for the end.
    pub until: Option<usize>,
}

/// Returns the trials that can be worked on now, in order of priority.
pub fn jobs(space: &Space, plan: &Plan, ledger: &Ledger) -> Vec<Job> {
    let Some(halving) = &space.halving else {
        let open = |trial: &usize| !is_over(plan, ledger, *trial);
        return (0..plan.trials.len()).filter(open).map(|trial| Job { trial, until: None }).collect();
    };
    let scores: Vec<Scores> = plan.configurations.iter().map(|own| scores(space, plan, ledger, own)).collect();
    let promoted = promotions(&scores, halving.rungs.len(), halving.keep);
    let begun = scores.iter().enumerate().filter(|(_, scores)| scores.is_empty()).map(|(index, _)| (index, 0));
    let mut jobs = Vec::new();
    for (configuration, rung) in promoted.into_iter().chain(begun) {
        let step = halving.rungs[rung];
        let until = (step < halving.last()).then_some(step);
        let waits =
            |trial: &&usize| !is_over(plan, ledger, **trial) && figure(space, plan, ledger, **trial, step).is_none();
        let trials = plan.configurations[configuration].trials.iter().filter(waits);
        jobs.extend(trials.map(|&trial| Job { trial, until }));
    }
    jobs
}

/// Whether a trial is complete or has failed.
pub fn is_over(plan: &Plan, ledger: &Ledger, trial: usize) -> bool {
    let record = ledger.record(&plan.trials[trial].id);
    record.is_some_and(|record| record.done.is_some() || record.failure().is_some())
}

/// Returns the scores of a configuration at the rungs that all of its trials have reached.
fn scores(space: &Space, plan: &Plan, ledger: &Ledger, configuration: &Configuration) -> Scores {
    let rungs = space.halving.as_ref().map_or(&[][..], |halving| &halving.rungs);
    let at = |step: &usize| {
        let figures = configuration.trials.iter().map(|&trial| figure(space, plan, ledger, trial, *step));
        figures.collect::<Option<Vec<f64>>>().map(|figures| space.aggregate.by.of(&figures))
    };
    rungs.iter().map_while(at).map(|score| if score.is_nan() { f64::INFINITY } else { score }).collect()
}

/// Returns the first objective of a trial at a rung; infinite if it failed.
fn figure(space: &Space, plan: &Plan, ledger: &Ledger, trial: usize, step: usize) -> Option<f64> {
    let record = ledger.record(&plan.trials[trial].id)?;
    let is_last = space.halving.as_ref().is_some_and(|halving| step == halving.last());
    let measures = if is_last { record.done.as_ref() } else { record.rungs.get(&step) };
    match measures {
        Some(measures) => Some(measures.get(space.objectives[0].name()).copied().unwrap_or(f64::INFINITY)),
        None => record.failure().map(|_| f64::INFINITY),
    }
}

/// Returns the configurations for adaptive search, with their scores: those at the highest rung that has
/// enough of them, since scores of different rungs are not comparable (Falkner et al. 2018).
pub fn history(space: &Space, plan: &Plan, ledger: &Ledger) -> Vec<(Assignment, f64)> {
    const ENOUGH: usize = 8;
    let all: Vec<(&Configuration, Scores)> = plan
        .configurations
        .iter()
        .map(|own| {
            (
                own,
                if space.halving.is_some() {
                    scores(space, plan, ledger, own)
                } else {
                    whole(space, plan, ledger, own)
                },
            )
        })
        .collect();
    let rungs = all.iter().map(|(_, scores)| scores.len()).max().unwrap_or(0);
    let of = |rung: usize| -> Vec<(Assignment, f64)> {
        let known = all.iter().filter_map(|(own, scores)| Some((own.assignment.clone(), *scores.get(rung)?)));
        known.collect()
    };
    (0..rungs).rev().map(of).find(|known| known.len() >= ENOUGH).unwrap_or_else(|| of(0))
}

/// Returns the score of a configuration whose trials are all over.
fn whole(space: &Space, plan: &Plan, ledger: &Ledger, configuration: &Configuration) -> Scores {
    let figure = |trial: &usize| {
        let record = ledger.record(&plan.trials[*trial].id)?;
        match &record.done {
            Some(measures) => measures.get(space.objectives[0].name()).copied(),
            None => record.failure().map(|_| f64::INFINITY),
        }
    };
    let figures: Option<Vec<f64>> = configuration.trials.iter().map(figure).collect();
    figures.map(|figures| space.aggregate.by.of(&figures)).into_iter().collect()
}

impl Sweep {
    /// Whether adaptive search should make further configurations.
    pub fn wants_suggestions(&self) -> bool {
        self.space.search.method == super::space::Method::Tpe && self.suggested < self.space.search.n
    }
}
