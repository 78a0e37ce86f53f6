//! A worker: performs one trial after another until none is left, and records the results.

use std::{
    collections::HashMap,
    io::{Read, Write},
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::{Result, bail, ensure};
use headtail_train::Progress;
use serde::{Deserialize, Serialize};

use super::{
    Sweep,
    folder::Lock,
    jobs::{self, Job},
    journal::{Event, Journal},
    plan,
    record::Record,
    search,
};
use crate::{
    output::Claim,
    progress::Interrupted,
    run::{self, Checkpoints, Finished, RunContext},
};

/// A line on a worker's standard output, for the process that shows progress.
#[derive(Debug, Serialize, Deserialize)]
pub struct Tick {
    /// The trial's identity.
    pub trial: String,
    /// Steps done.
    pub step: usize,
    /// Steps of the whole run.
    pub steps: usize,
    /// Relative variance, if it was just measured.
    pub variance: Option<f64>,
}

/// Time between two lines of progress.
const TICK: Duration = Duration::from_millis(200);
/// Time between two checks for work that other workers may leave.
const WAIT: Duration = Duration::from_millis(250);

/// Time that a worker waits for trials that others hold: workers whose parent was killed release theirs
/// within moments.
const GRACE: Duration = Duration::from_secs(10);

/// Attempts of a worker at a trial, whatever other commands allow.
const MOST_ATTEMPTS: usize = 5;

/// Settings of a worker.
#[derive(Clone, Copy, Debug)]
pub struct Manner {
    /// Steps between checkpoints.
    pub every: usize,
    /// Whether progress is written to standard output.
    pub ticks: bool,
    /// Whether the end of standard input means that the parent process is gone.
    pub watch_input: bool,
}

/// Works until no work is left, or until it is told to stop.
///
/// # Errors
/// [`Interrupted`] after a signal; otherwise only errors that prevent all work: the error of a trial is
/// recorded in the journal.
pub fn work(sweep: &mut Sweep, manner: Manner, stop: &Arc<AtomicBool>) -> Result<()> {
    if manner.watch_input {
        stop_at_end_of_input(stop.clone());
    }
    let mut journal = Journal::create(&sweep.folder.journals())?;
    let mut idle = None::<Instant>;
    let mut attempts = HashMap::<(String, Option<usize>), usize>::new();
    while !stop.load(Ordering::Relaxed) {
        sweep.refresh()?;
        let open: Vec<Job> = jobs::jobs(&sweep.space, &sweep.plan, &sweep.ledger);
        if let Some((job, lock)) = take(sweep, &open)? {
            let id = sweep.plan.trials[job.trial].id.clone();
            let attempts = attempts.entry((id.clone(), job.until)).or_default();
            *attempts += 1;
            ensure!(
                *attempts <= MOST_ATTEMPTS,
                "trial {id} was run {MOST_ATTEMPTS} times and is still open; check that {} can be read and written",
                sweep.folder.journals().display()
            );
            perform(sweep, &job, manner, &mut journal, stop)?;
            drop(lock);
            idle = None;
        } else if sweep.wants_suggestions() {
            suggest(sweep, &mut journal)?;
        } else if open.is_empty()
            || sweep.space.halving.is_none() && idle.get_or_insert_with(Instant::now).elapsed() > patience(sweep, &open)
        {
            // Trials held by others are theirs; with halving, their results can make new work.
            break;
        } else {
            std::thread::sleep(WAIT);
        }
    }
    if stop.load(Ordering::Relaxed) {
        bail!(Interrupted::new("checkpoints are written; the same command goes on"));
    }
    Ok(())
}

/// Returns the time to wait for trials that others hold.
fn patience(sweep: &Sweep, open: &[Job]) -> Duration {
    let mut ids = open.iter().map(|job| &sweep.plan.trials[job.trial].id);
    // Whether the holder of a claim is gone shows only after a while.
    if ids.any(|id| sweep.folder.is_claimed(id)) { Claim::DEAD + GRACE } else { GRACE }
}

/// Takes the first job that no other worker holds, and that is still open once it is locked.
fn take(sweep: &mut Sweep, open: &[Job]) -> Result<Option<(Job, Lock)>> {
    for job in open {
        let id = &sweep.plan.trials[job.trial].id;
        let Some(lock) = sweep.folder.lock(id)? else { continue };
        sweep.ledger.refresh()?;
        if jobs::jobs(&sweep.space, &sweep.plan, &sweep.ledger).contains(job) {
            return Ok(Some((job.clone(), lock)));
        }
    }
    Ok(None)
}

/// Makes the next configuration, unless another worker does.
fn suggest(sweep: &mut Sweep, journal: &mut Journal) -> Result<()> {
    let Some(_lock) = sweep.folder.lock_search()? else {
        std::thread::sleep(WAIT);
        return Ok(());
    };
    sweep.refresh()?;
    if sweep.wants_suggestions() {
        let history = jobs::history(&sweep.space, &sweep.plan, &sweep.ledger);
        let number = sweep.suggested as u64;
        let assignment = search::suggest(&sweep.space, &history, number)?;
        journal.add(Event::Suggested { number, assignment })?;
    }
    Ok(())
}

/// Runs a trial up to the end of the job.
fn perform(sweep: &Sweep, job: &Job, manner: Manner, journal: &mut Journal, stop: &Arc<AtomicBool>) -> Result<()> {
    let trial = &sweep.plan.trials[job.trial];
    let start = Instant::now();
    let folder = sweep.folder.trial(&trial.id);
    let checkpoints = folder.join("checkpoints");
    // Recorded before anything that could end the process.
    let begun = last_checkpoint(&checkpoints);
    let attempt = 1 + sweep.ledger.record(&trial.id).map_or(0, Record::attempt);
    journal.add(Event::Started { trial: trial.id.clone(), attempt, step: begun })?;
    let outcome = {
        let mut last = None::<Instant>;
        let mut watch = |progress: &Progress| {
            if manner.ticks && (progress.divergence.is_some() || last.is_none_or(|last| last.elapsed() > TICK)) {
                last = Some(Instant::now());
                tick(&trial.id, progress);
            }
        };
        let context = RunContext {
            references: sweep.folder.references(),
            tensorboard: None,
            pictures: None,
            until: job.until,
            stop,
            watch: &mut watch,
            out: folder,
        };
        let attempt = || -> Result<Finished> {
            let mut run = plan::resolve(&sweep.space, &trial.assignment)?;
            run.checkpoints = Some(Checkpoints { folder: checkpoints, every: manner.every, resume: true });
            run::perform(&run, context)
        };
        catch_unwind(AssertUnwindSafe(attempt))
    };
    let seconds = start.elapsed().as_secs_f64();
    let id = trial.id.clone();
    let event = match outcome {
        Ok(Ok(finished)) => {
            let step = finished.summary.steps;
            match job.until {
                _ if !finished.summary.interrupted => {
                    Event::Done { trial: id, attempt, measures: finished.measures, seconds }
                }
                Some(until) if step >= until => {
                    Event::Rung { trial: id, attempt, step: until, measures: finished.measures, seconds }
                }
                _ => Event::Stopped { trial: id, attempt, step, seconds },
            }
        }
        Ok(Err(error)) if error.is::<Interrupted>() => Event::Stopped { trial: id, attempt, step: begun, seconds },
        Ok(Err(error)) => Event::Failed { trial: id, attempt, reason: format!("{error:#}") },
        Err(_) => {
            Event::Failed { trial: id, attempt, reason: "the program panicked; the worker's log says where".into() }
        }
    };
    journal.add(event)
}

/// Returns the step of the last checkpoint in a folder; 0 without one.
fn last_checkpoint(folder: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter_map(|name| name.strip_prefix("step-")?.parse().ok()).max().unwrap_or(0)
}

/// Reports progress to the parent process, which may be gone.
fn tick(trial: &str, progress: &Progress) {
    let tick = Tick {
        trial: trial.to_owned(),
        step: progress.step,
        steps: progress.steps,
        variance: progress.divergence.map(|divergence| divergence.relative_variance),
    };
    let line = serde_json::to_string(&tick).unwrap_or_default() + "\n";
    let _ = std::io::stdout().write_all(line.as_bytes());
}

/// Sets the stop flag when standard input ends: it is a pipe from the parent process, which the system closes
/// when that process is killed.
fn stop_at_end_of_input(stop: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        let mut input = std::io::stdin();
        let mut byte = [0];
        while input.read(&mut byte).is_ok_and(|count| count > 0) {}
        stop.store(true, Ordering::Relaxed);
    });
}
