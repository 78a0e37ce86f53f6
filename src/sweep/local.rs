//! A sweep on this machine: several worker processes and their progress.

use std::{
    collections::HashMap,
    fs::OpenOptions,
    io::{BufRead, BufReader},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{
    Sweep,
    estimate::{Estimate, WorkAmount},
    jobs,
    location::{Checkpoints, SweepLocation},
    record::Record,
    status,
    worker::Tick,
};
use crate::terminal::{self, note, say};
use crate::{device, output::make_folder, progress};

/// Run the missing trials in several processes.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    location: SweepLocation,
    #[command(flatten)]
    checkpoints: Checkpoints,
    /// Worker processes; the cores are divided among them.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: u16,
    /// Threads per worker. Default: an equal part of the cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Graphics cards, on which workers train in turn (needs the feature gpu).
    /// Default: all workers use the fastest one.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    gpus: Option<u16>,
}

/// Message from a worker.
enum Message {
    /// Progress.
    Tick(usize, Tick),
    /// End of its output.
    End(usize),
}

/// Runs workers until no work is left.
pub fn run(arguments: &Arguments) -> Result<()> {
    let stop = progress::stop_flag()?;
    // Workers would only say so in their logs.
    arguments.gpus.map_or(Ok(()), |gpus| device::use_adapter(usize::from(gpus) - 1)).context("--gpus")?;
    let sweep = arguments.location.open()?;
    make_folder(&sweep.folder.logs())?;
    let mut crew = Crew::new(arguments, sweep, stop);
    crew.run()?;
    crew.conclude()
}

/// Workers and their progress bars.
struct Crew<'a> {
    arguments: &'a Arguments,
    sweep: Sweep,
    stop: Arc<AtomicBool>,
    workers: HashMap<usize, Child>,
    /// Workers killed in a row without a new start of a trial, and the starts before them.
    in_vain: (usize, usize),
    bars: HashMap<usize, ProgressBar>,
    all: MultiProgress,
    total: progress::Bar,
    estimate: Estimate,
    /// Completed and total steps of the running trials, by identity.
    steps: HashMap<String, (usize, usize)>,
    /// Work that was done earlier.
    inherited: f64,
    send: Sender<Message>,
    receive: Receiver<Message>,
}

/// Workers in a row that may be killed before they start a trial.
const MOST_IN_VAIN: usize = 10;
/// Time between two reads of the journals.
const LOOK: Duration = Duration::from_millis(500);

impl<'a> Crew<'a> {
    fn new(arguments: &'a Arguments, sweep: Sweep, stop: Arc<AtomicBool>) -> Self {
        let (send, receive) = channel();
        let all = MultiProgress::new();
        if terminal::is_quiet() {
            all.set_draw_target(ProgressDrawTarget::hidden());
        }
        let total = progress::bar(progress::FRACTION_UNITS, "sweep").among(&all);
        let (workers, bars, steps) = (HashMap::new(), HashMap::new(), HashMap::new());
        let (estimate, inherited) = (Estimate::default(), 0.0);
        Self {
            arguments,
            sweep,
            stop,
            workers,
            in_vain: (0, 0),
            bars,
            all,
            total,
            estimate,
            steps,
            inherited,
            send,
            receive,
        }
    }

    /// Starts workers, shows their progress, and replaces those that were killed.
    fn run(&mut self) -> Result<()> {
        self.inherited = self.estimate.of(&self.sweep, &self.steps)?.done;
        for number in 0..self.arguments.jobs.into() {
            self.start(number)?;
        }
        let mut looked = Instant::now();
        while !self.workers.is_empty() {
            match self.receive.recv_timeout(LOOK) {
                Ok(Message::Tick(worker, tick)) => self.show(worker, &tick),
                Ok(Message::End(worker)) => self.end(worker)?,
                Err(_) => {}
            }
            if self.stop.load(Ordering::Relaxed) {
                // Closing their input asks workers to stop.
                self.workers.values_mut().for_each(|worker| drop(worker.stdin.take()));
            }
            if looked.elapsed() > LOOK {
                looked = Instant::now();
                self.sweep.refresh()?;
                self.show_total()?;
            }
        }
        self.sweep.refresh()?;
        self.total.finish_and_clear();
        Ok(())
    }

    /// Starts a worker, or the replacement of one that has ended.
    fn start(&mut self, number: usize) -> Result<()> {
        let log = self.sweep.folder.logs().join(format!("worker-{number}.log"));
        let log = OpenOptions::new().create(true).append(true).open(&log).with_context(|| log.display().to_string())?;
        let mut command = Command::new(std::env::current_exe().context("the program's own file")?);
        command.args(["sweep", "work"]).arg(&self.arguments.location.space).arg("--out").arg(self.sweep.folder.path());
        command.arg("--checkpoint-every").arg(self.arguments.checkpoints.checkpoint_every.to_string());
        if let Some(gpus) = self.arguments.gpus {
            command.arg("--gpu").arg((number % usize::from(gpus)).to_string());
        }
        command.env("RAYON_NUM_THREADS", self.threads().to_string());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log);
        let mut worker = command.spawn().context("a worker cannot be started")?;
        let output = worker.stdout.take().context("a worker's output")?;
        let send = self.send.clone();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines() {
                let Ok(line) = line else { break };
                if let Ok(tick) = serde_json::from_str(&line)
                    && send.send(Message::Tick(number, tick)).is_err()
                {
                    break;
                }
            }
            // The receiver is gone if the program is about to end.
            let _ = send.send(Message::End(number));
        });
        // Above the bar for the total.
        let bar = self.all.insert_from_back(1, ProgressBar::new(1));
        bar.set_style(style("{prefix:>12} [{bar:32}] {percent:>3}%  {eta} left  {msg}"));
        bar.set_prefix(format!("worker {number}"));
        self.bars.insert(number, bar);
        self.workers.insert(number, worker);
        Ok(())
    }

    /// Returns the number of threads per worker.
    fn threads(&self) -> usize {
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        self.arguments.threads.map_or((cores / usize::from(self.arguments.jobs)).max(1), usize::from)
    }

    /// Handles the end of a worker: it is replaced if it was killed.
    fn end(&mut self, number: usize) -> Result<()> {
        if let Some(bar) = self.bars.remove(&number) {
            bar.finish_and_clear();
            self.all.remove(&bar);
        }
        let Some(mut worker) = self.workers.remove(&number) else { return Ok(()) };
        let status = worker.wait().context("a worker")?;
        if status.success() || self.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        // An exit status is a worker's own error, which its replacement would have, too.
        ensure!(
            was_killed(status),
            "a worker ended with {status}; its messages are in {}",
            self.sweep.folder.logs().display()
        );
        // Starts of trials are bounded (see `Record::failure`), and so are workers that come to none.
        self.sweep.refresh()?;
        let starts = self.sweep.ledger.records.values().map(Record::starts).sum();
        self.in_vain = if starts > self.in_vain.1 { (0, starts) } else { (self.in_vain.0 + 1, starts) };
        ensure!(
            self.in_vain.0 < MOST_IN_VAIN,
            "{MOST_IN_VAIN} workers in a row were ended by {status} before they started a trial; their messages are in {}",
            self.sweep.folder.logs().display()
        );
        note!("a worker was ended by {status}; another takes its place");
        self.start(number)
    }

    fn show(&mut self, number: usize, tick: &Tick) {
        let Some(bar) = self.bars.get(&number) else { return };
        if !bar.message().starts_with(&tick.trial) {
            bar.reset();
            bar.set_message(tick.trial.clone());
        }
        bar.set_length(tick.steps as u64);
        bar.set_position(tick.step as u64);
        if let Some(variance) = tick.variance {
            bar.set_message(format!("{}, relative variance {variance:.4}", tick.trial));
        }
        if self.steps.insert(tick.trial.clone(), (tick.step, tick.steps)).is_none() {
            // Work in its checkpoint was done earlier.
            let rung =
                self.sweep.ledger.record(&tick.trial).and_then(|record| record.rungs.keys().next_back().copied());
            let resumed = tick.step.saturating_sub(rung.unwrap_or(0)) as f64 / tick.steps.max(1) as f64;
            self.inherited += resumed * self.estimate.whole(&tick.trial);
        }
    }

    /// Shows the completed fraction of the work that was open at the start or was added since.
    fn show_total(&mut self) -> Result<()> {
        let WorkAmount { done, left } = self.estimate.of(&self.sweep, &self.steps)?;
        let done = done - self.inherited;
        self.total.set_message(status::words(&status::counts(&self.sweep)));
        self.total.fraction_setter()(done / (done + left).max(f64::MIN_POSITIVE));
        Ok(())
    }

    /// Reports the result in a sentence; returns an error if something failed or is left.
    fn conclude(&self) -> Result<()> {
        let (plan, ledger) = (&self.sweep.plan, &self.sweep.ledger);
        let records = || plan.trials.iter().filter_map(|trial| ledger.record(&trial.id));
        let done = records().filter(|record| record.done.is_some()).count();
        let failed = records().filter(|record| record.failure().is_some()).count();
        let all = plan.trials.len();
        if self.stop.load(Ordering::Relaxed) {
            let left = format!("{done} of {all} trials are done; the same command goes on from their checkpoints");
            bail!(progress::Interrupted::new(left));
        }
        ensure!(
            failed == 0,
            "{failed} of {all} trials failed; `headtail sweep status` names them, `retry` lets them be tried again"
        );
        let open = jobs::jobs(&self.sweep.space, plan, ledger).len();
        ensure!(open == 0, "{open} trials are left to another sweep that works in this folder");
        say!("{done} of {all} trials are done in {}", self.sweep.folder.path().display());
        Ok(())
    }
}

impl Drop for Crew<'_> {
    /// After an error, stops workers by closing their input, and waits for them.
    fn drop(&mut self) {
        for worker in self.workers.values_mut() {
            drop(worker.stdin.take());
            // If waiting fails, it is already gone.
            let _ = worker.wait();
        }
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> ")
}

/// Whether a signal ended a process.
fn was_killed(status: ExitStatus) -> bool {
    status.code().is_none()
}
