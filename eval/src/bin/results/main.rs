//! Measures the experiments of a folder and builds the pages that show them.
//!
//! | file | concept |
//! | --- | --- |
//! | `main.rs` | the command line |
//! | `pages.rs` | pages and their generated blocks |
//! | `block.rs` | the heads of blocks |
//! | `data.rs`, `shown.rs` | the data that blocks show, and their age |
//! | `tables.rs`, `forest.rs`, `recorded.rs`, `bench.rs` | the contents of blocks |
//! | `markdown.rs` | tables and numbers as text |
//! | `prose.rs` | measured numbers outside generated blocks |

mod bench;
mod block;
mod data;
mod forest;
mod markdown;
mod pages;
mod prose;
mod recorded;
mod shown;
mod tables;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{Arc, Mutex, atomic::AtomicBool},
    time::Instant,
};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use headtail_eval::{
    Experiment, Outcome, Record, Recording, RunOptions, Store, VerifiedSources, Watch, device_source_hash, retime, run,
    source_hash, verify,
};

/// Measure experiments (results/*.toml) and build the pages of results.
#[derive(Parser)]
#[command(after_help = "Examples:
  results build
  results run equal-time --data maps-and-scenes
  results run --quick
  results stale
  results time equal-time --data maps-and-scenes

Measurements are resumable: Ctrl-C ends a run after the picture that is being rendered, and the same command goes on with the view that was being measured.")]
struct Arguments {
    /// Root of the repository.
    #[arg(long, value_name = "DIR", default_value = ".")]
    root: PathBuf,
    #[command(subcommand)]
    command: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Generate the blocks of all pages from the data.
    Build {
        /// Write nothing; fail if a page is out of date.
        /// Also fail if a measured number is outside a generated block.
        #[arg(long)]
        check: bool,
    },
    /// List experiments whose sources changed since they were measured.
    Stale,
    /// Check whether changed sources still draw the same samples.
    /// Renders first runs of stored measurements again. If all pictures agree, pages no longer call the data
    /// stale, and say so.
    Verify {
        /// Experiments by name. Default: all.
        names: Vec<String>,
        /// Views per experiment.
        #[arg(long, default_value_t = 6)]
        views: usize,
        #[command(flatten)]
        files: Files,
    },
    /// Measure the times of samples and preparations again.
    /// Errors stay those of the stored pictures, which `verify` must have found the same. Takes minutes, on an otherwise idle
    /// machine.
    Time {
        /// Experiments by name. Default: all.
        names: Vec<String>,
        #[command(flatten)]
        files: Files,
    },
    /// Run missing measurements.
    Run {
        /// Experiments by name. Default: all.
        names: Vec<String>,
        /// Also repeat measurements that were made with other sources.
        #[arg(long)]
        stale: bool,
        /// Measure miniatures and build the pages in memory only.
        #[arg(long)]
        quick: bool,
        /// What renders. gpu: the fastest graphics adapter, into results/NAME-gpu.csv; references are the CPU's. Only
        /// experiments run there, not recorded commands.
        #[arg(long, value_enum, default_value = "cpu", conflicts_with = "quick")]
        device: Device,
        #[command(flatten)]
        files: Files,
    },
}

/// What renders.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Device {
    Cpu,
    Gpu,
}

/// Locations of input and cached files.
#[derive(Args)]
struct Files {
    /// Folder of maps and scenes; views with missing files are skipped.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// Cache folder for references and samplers' files.
    #[arg(long, value_name = "DIR", default_value = "out/results")]
    cache: PathBuf,
    /// The program headtail, which makes samplers' files.
    /// Default: the one beside this program.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

impl Files {
    fn options(&self) -> Result<RunOptions> {
        let program = self.program.clone().map_or_else(beside, Ok)?;
        Ok(RunOptions { data: self.data.clone(), cache: self.cache.clone(), program, most_views: usize::MAX })
    }
}

fn main() -> ExitCode {
    match perform(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn perform(arguments: &Arguments) -> Result<()> {
    let root = &arguments.root;
    let folder = root.join("results");
    match &arguments.command {
        Task::Build { check } => {
            let site = pages::Site::open(root, &Store::new(&folder), &Plans::open(&folder)?)?;
            site.build(*check)
        }
        Task::Stale => {
            let (plans, store) = (Plans::open(&folder)?, Store::new(&folder));
            let current = current_environments(&store)?;
            for experiment in &plans.experiments {
                let records = store.records(&experiment.name)?;
                let stale = records.iter().filter(|own| !current.contains(&own.environment)).count();
                match (records.len(), stale) {
                    (0, _) => println!("{}: not measured", experiment.name),
                    (_, 0) => {}
                    (all, _) => println!("{}: {stale} of {all} measurements are of other sources", experiment.name),
                }
            }
            for recording in &plans.recordings {
                for command in &recording.commands {
                    match recording.output(&store, command)? {
                        None => println!("{}, {}: not recorded", recording.name, command.name),
                        Some(own) if !current.contains(&own.environment) => {
                            println!("{}, {}: recorded with other sources", recording.name, command.name);
                        }
                        Some(_) => {}
                    }
                }
            }
            Ok(())
        }
        Task::Verify { names, views, files } => {
            let (plans, store) = (Plans::open(&folder)?.on_cpu().chosen(names)?, Store::new(&folder));
            let pictures = verify_all(&plans, &store, &files.options()?, *views)?;
            // Only a check of all experiments shows that nothing changed.
            if names.is_empty() { keep_verified(&store, pictures) } else { Ok(()) }
        }
        Task::Time { names, files } => {
            let (plans, store) = (Plans::open(&folder)?.on_cpu().chosen(names)?, Store::new(&folder));
            let (stop, current) = (stop_flag()?, current_environments(&store)?);
            let is_valid = |own: &Record| current.contains(&own.environment);
            for experiment in
                plans.experiments.iter().filter(|own| own.budgets.iter().any(|budget| budget.0.seconds().is_some()))
            {
                let found = retime(experiment, &store, &files.options()?, &is_valid, (&stop, &Progress::new()))?;
                println!("{}: {} measurements have new times, {} do not", experiment.name, found.timed, found.left);
            }
            Ok(())
        }
        Task::Run { names, stale, quick, device, files } => {
            let (mut chosen, options) = (Plans::open(&folder)?.on_cpu().chosen(names)?, files.options()?);
            if *device == Device::Gpu {
                chosen.experiments = chosen.experiments.iter().map(Experiment::on_device).collect();
                chosen.recordings.clear();
            }
            if *quick {
                return in_temporary_folder(|temporary| run_quickly(root, chosen, &options, temporary));
            }
            let store = Store::new(&folder);
            for experiment in &chosen.experiments {
                if *stale {
                    let current = current_environments(&store)?;
                    store.retain(&experiment.name, |own| current.contains(&own.environment))?;
                }
                measure(experiment, &store, &options)?;
            }
            for recording in &chosen.recordings {
                for command in &recording.commands {
                    let known = recording.output(&store, command)?;
                    let current = current_environments(&store)?;
                    if known.is_some_and(|known| !*stale || current.contains(&known.environment)) {
                        continue;
                    }
                    eprintln!("{}: {}", recording.name, command.name);
                    recording.run(&store, command, false, [&options.program, &options.data, &options.cache])?;
                }
            }
            Ok(())
        }
    }
}

/// Calls a function with a new folder and removes the folder afterwards.
fn in_temporary_folder<T>(call: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let folder = std::env::temp_dir().join(format!("headtail-results-{}", std::process::id()));
    let result = call(&folder);
    drop(std::fs::remove_dir_all(&folder));
    result
}

/// Renders pictures of stored measurements again and returns their number.
///
/// # Errors
/// If pictures differ; it names them.
fn verify_all(plans: &Plans, store: &Store, options: &RunOptions, views: usize) -> Result<usize> {
    let (stop, mut pictures, mut different) = (stop_flag()?, 0, Vec::new());
    for experiment in &plans.experiments {
        let found = verify(experiment, store, options, views, &stop)?;
        ensure!(!stop.load(std::sync::atomic::Ordering::Relaxed), "interrupted");
        eprintln!("{}: {} pictures, {} differ", experiment.name, found.pictures, found.different.len());
        pictures += found.pictures;
        different.extend(found.different.into_iter().map(|own| format!("{}: {own}", experiment.name)));
    }
    ensure!(different.is_empty(), "{} of {pictures} pictures differ:\n{}", different.len(), different.join("\n"));
    println!("{pictures} pictures are the same");
    Ok(pictures)
}

/// Records that the data of all earlier sources are valid for the current ones.
fn keep_verified(store: &Store, pictures: usize) -> Result<()> {
    let environments = store.environments()?.into_iter().filter(|(_, own)| !own.is_of_device());
    let mut earlier: Vec<String> = environments.map(|(_, own)| own.sources).collect();
    earlier.sort();
    earlier.dedup();
    earlier.retain(|sources| sources != source_hash());
    let row = |measured| VerifiedSources { measured, verified: source_hash().to_owned(), pictures };
    Ok(store.add_verified(&earlier.into_iter().map(row).collect::<Vec<_>>())?)
}

/// Measures miniatures and builds the pages in memory.
fn run_quickly(root: &Path, mut plans: Plans, options: &RunOptions, folder: &Path) -> Result<()> {
    let store = Store::new(&folder.join("data"));
    plans.experiments = plans.experiments.into_iter().map(Experiment::quickly).collect();
    for recording in &plans.recordings {
        for command in recording.commands.iter().filter(|command| !command.quick.is_empty()) {
            eprintln!("{}: {}", recording.name, command.name);
            recording.run(&store, command, true, [&options.program, &options.data, folder])?;
        }
    }
    // Experiments that need files have no miniature.
    for experiment in plans.experiments.iter().filter(|own| own.quick.views > 0) {
        let options = RunOptions {
            most_views: experiment.quick.views,
            data: options.data.clone(),
            cache: folder.join("cache"),
            program: options.program.clone(),
        };
        let outcome = measure(experiment, &store, &options)?;
        ensure!(outcome.measured > 0, "{}: no view could be measured", experiment.name);
    }
    pages::Site::open(root, &store, &plans)?.build_in_memory()
}

fn measure(experiment: &Experiment, store: &Store, options: &RunOptions) -> Result<Outcome> {
    let progress = Progress::new();
    let stop = stop_flag()?;
    let outcome = run(experiment, store, options, (&stop, &progress)).with_context(|| experiment.name.clone())?;
    eprintln!("{}: {} views measured, {} known", experiment.name, outcome.measured, outcome.known);
    for key in &outcome.missing {
        let why = if experiment.is_on_device {
            "not on the device, or its files are missing"
        } else {
            "its files are missing"
        };
        eprintln!("warning: {}: {} under {} is skipped: {why}", experiment.name, key.scene, key.map);
    }
    Ok(outcome)
}

/// Experiments and recordings of a folder.
pub struct Plans {
    /// Measured by the engine.
    pub experiments: Vec<Experiment>,
    /// Made by commands.
    pub recordings: Vec<Recording>,
}

impl Plans {
    fn open(folder: &Path) -> Result<Self> {
        let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
        paths.sort();
        let mut plans = Self { experiments: Vec::new(), recordings: Vec::new() };
        for path in paths {
            if std::fs::read_to_string(&path)?.contains("[[commands]]") {
                plans.recordings.push(Recording::open(&path)?);
            } else {
                let experiment = Experiment::open(&path)?;
                let on_device = experiment.on_device();
                let is_measured = folder.join(format!("{}.csv", on_device.name)).exists();
                plans.experiments.push(experiment);
                plans.experiments.extend(is_measured.then_some(on_device));
            }
        }
        Ok(plans)
    }

    /// Returns those without measurements of graphics devices.
    fn on_cpu(mut self) -> Self {
        self.experiments.retain(|own| !own.is_on_device);
        self
    }

    /// Returns those with the given names; all if there are none.
    fn chosen(mut self, names: &[String]) -> Result<Self> {
        let known: Vec<&String> =
            self.experiments.iter().map(|own| &own.name).chain(self.recordings.iter().map(|own| &own.name)).collect();
        for name in names {
            ensure!(known.contains(&name), "there is no experiment '{name}'");
        }
        self.experiments.retain(|own| names.is_empty() || names.contains(&own.name));
        self.recordings.retain(|own| names.is_empty() || names.contains(&own.name));
        Ok(self)
    }
}

/// Returns the ids of environments whose sources are the current ones, or render the same.
fn current_environments(store: &Store) -> Result<Vec<String>> {
    let (known, verified) = (store.environments()?, store.verified()?);
    let is_current = |sources: &str| {
        let same = verified.iter().any(|own| own.measured == sources && own.verified == source_hash());
        sources == source_hash() || sources == device_source_hash() || same
    };
    Ok(known.into_iter().filter(|(_, own)| is_current(&own.sources)).map(|(id, _)| id).collect())
}

/// Returns the program `headtail` in this program's folder.
fn beside() -> Result<PathBuf> {
    let own = std::env::current_exe().context("this program's path")?;
    let found = own.with_file_name(format!("headtail{}", std::env::consts::EXE_SUFFIX));
    if found.exists() {
        Ok(found)
    } else {
        bail!(
            "{}: there is no such program; build it with `cargo build --release`, or name one with --program",
            found.display()
        )
    }
}

/// Returns a flag that SIGINT and SIGTERM set; a second signal ends the process.
fn stop_flag() -> Result<Arc<AtomicBool>> {
    static FLAG: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);
    let mut known = FLAG.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(flag) = &*known {
        return Ok(flag.clone());
    }
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 130, flag.clone())?;
        signal_hook::flag::register(signal, flag.clone())?;
    }
    *known = Some(flag.clone());
    Ok(flag)
}

/// Prints each view and its time on standard error.
struct Progress {
    start: Instant,
}

impl Progress {
    fn new() -> Self {
        Self { start: Instant::now() }
    }
}

impl Watch for Progress {
    fn planned(&self, seconds: f64) {
        eprintln!("    about {seconds:.0} s of runs");
    }

    fn message(&self, text: &str) {
        if text.contains(" under ") {
            eprintln!("{:6.0} s  {text}", self.start.elapsed().as_secs_f64());
        }
    }

    fn warning(&self, text: &str) {
        eprintln!("warning: {text}");
    }
}
