//! Arguments of `headtail sweep`, and its commands.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Subcommand};

use super::{
    Sweep, collect, local,
    location::{Checkpoints, SweepLocation},
    report, retry, slurm, status, worker,
};
use crate::terminal::{self, only_data, out, print_json, say};
use crate::{device, output::OutputFile, progress};

/// Run a space of settings.
/// Every trial runs once and resumes where it was stopped.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail sweep plan space.toml
  headtail sweep run space.toml --jobs 2
  headtail sweep status space.toml
  headtail sweep submit space.toml --tasks 8 --sbatch=--partition=long --sbatch=--time=4:00:00
  headtail sweep report space.toml

The file is described in docs/sweeps.md. Results go to the folder space.sweep beside space.toml, unless --out names another. Running a sweep again \
runs the missing trials only; interrupted trials continue from their last checkpoint.")]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Print the trials.
    Plan(Plan),
    /// Run the missing trials in several processes.
    Run(local::Arguments),
    /// Submit one array job to Slurm, print its number and return.
    Submit(slurm::Arguments),
    /// Print the progress of the sweep.
    Status(Status),
    /// Allow failed trials to run again.
    Retry(SweepLocation),
    /// Write all trials to one table.
    Collect(Collect),
    /// Write one page with tables and charts.
    Report(Output),
    /// The worker that `run` and `submit` start.
    #[command(hide = true)]
    Work(WorkArguments),
}

#[derive(Args)]
struct Plan {
    #[command(flatten)]
    location: SweepLocation,
    /// Print every trial. Default: the first twenty.
    #[arg(long)]
    all: bool,
    /// Print every trial as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct Status {
    #[command(flatten)]
    location: SweepLocation,
    /// Print a JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct Collect {
    #[command(flatten)]
    output: Output,
    /// Also print the rows as an array of JSON objects.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct Output {
    #[command(flatten)]
    location: SweepLocation,
    /// File to write. Default: trials.csv or report.html.
    /// The default is in the folder of the sweep.
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
}

#[derive(Args)]
struct WorkArguments {
    #[command(flatten)]
    location: SweepLocation,
    #[command(flatten)]
    checkpoints: Checkpoints,
    /// Run as a task of a Slurm array.
    #[arg(long)]
    task: bool,
    /// Train on this graphics adapter, counted from 0.
    #[arg(long, value_name = "K")]
    gpu: Option<usize>,
}

/// Runs the given command.
pub fn run(arguments: &Arguments) -> Result<()> {
    match &arguments.action {
        Action::Plan(plan) => print_plan(plan),
        Action::Run(arguments) => local::run(arguments),
        Action::Submit(arguments) => slurm::submit(arguments),
        Action::Status(status) => print_status(status),
        Action::Retry(location) => retry::run(&location.open()?),
        Action::Collect(arguments) => collect(arguments),
        Action::Report(output) => {
            let sweep = output.location.open()?;
            written(&output.file(&sweep, "report.html"), |file| report::page(&sweep, &terminal::command(), file))
        }
        Action::Work(arguments) => work(arguments),
    }
}

impl Output {
    fn file(&self, sweep: &Sweep, name: &str) -> PathBuf {
        self.file.clone().unwrap_or_else(|| sweep.folder.path().join(name))
    }
}

/// Writes a text to a file; it is made for the file's location, to which the page's links are relative.
fn written(file: &Path, text: impl FnOnce(&Path) -> Result<String>) -> Result<()> {
    let output = OutputFile::take(file)?;
    let text = text(file)?;
    output.write(|path| headtail_render::file::replace(path, text.as_bytes()))?;
    say!("{} written", file.display());
    Ok(())
}

fn collect(arguments: &Collect) -> Result<()> {
    if arguments.json {
        only_data();
    }
    let sweep = arguments.output.location.open()?;
    let rows = collect::rows(&sweep);
    if arguments.json {
        print_json(&rows.iter().map(|row| row.record(&sweep)).collect::<Vec<_>>())?;
    }
    written(&arguments.output.file(&sweep, "trials.csv"), |_| collect::csv(&sweep, &rows))
}

fn print_status(arguments: &Status) -> Result<()> {
    let status = status::Status::of(&arguments.location.open()?)?;
    if arguments.json {
        return print_json(&status);
    }
    status.print();
    Ok(())
}

fn print_plan(arguments: &Plan) -> Result<()> {
    let sweep = arguments.location.open()?;
    let (trials, configurations) = (&sweep.plan.trials, sweep.plan.configurations.len());
    if arguments.json {
        return print_json(trials);
    }
    let shown = if arguments.all { usize::MAX } else { 20 };
    out!("{} trials of {configurations} configurations", trials.len());
    if sweep.wants_suggestions() {
        out!("adaptive search makes {} configurations as it goes", sweep.space.search.n);
    }
    for trial in trials.iter().take(shown) {
        out!("{}  {}", trial.id, super::plan::text(&trial.assignment));
    }
    if trials.len() > shown {
        out!("... and {} more (--all)", trials.len() - shown);
    }
    Ok(())
}

fn work(arguments: &WorkArguments) -> Result<()> {
    arguments.gpu.map_or(Ok(()), device::use_adapter).context("--gpu")?;
    let stop = progress::stop_flag()?;
    let mut sweep = arguments.location.open()?;
    let manner = worker::Manner {
        every: arguments.checkpoints.checkpoint_every as usize,
        ticks: !arguments.task,
        watch_input: !arguments.task,
    };
    if arguments.task {
        return slurm::task(&mut sweep, manner, &stop);
    }
    worker::work(&mut sweep, manner, &stop)
}
