//! `headtail fit`: trains a head for an environment map and exports it.

mod arguments;

use std::{sync::atomic::AtomicBool, time::Instant};

use anyhow::{Context, Result};
use headtail_render::tail::Tail;
use headtail_train::{FitConfig, Fitted, Progress, Viewpoints, build_target, config::Over, fit};

pub use arguments::Arguments;

use crate::terminal::{self, out, say, warning};
use crate::{
    output::OutputFolder,
    progress::{self, TrainingBar},
    run::{self, Contents, RunContext},
};

/// Trains, exports and measures.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    if arguments.json {
        terminal::only_data();
    }
    let described = arguments.table()?;
    let config = arguments.config(&described)?;
    if arguments.print_config {
        let text = if described.has_env() { described.with_fit(config)?.to_toml()? } else { config.to_toml()? };
        out!("{}", text.trim_end());
        return Ok(());
    }
    let described = described.with_fit(config)?;
    let out = arguments.out.clone().or_else(|| described.out.clone());
    let out = out.context("give the folder of the results, by --out or as `out` of the run's table")?;
    let stop = progress::stop_flag()?;
    let resumes = described.checkpoints.as_ref().is_some_and(|checkpoints| checkpoints.resume);
    let results: &[&str] = if resumes { &[] } else { &run::RESULTS };
    let output = OutputFolder::take(&out, results)?;
    if run::RESULTS.iter().any(|name| out.join(name).exists()) {
        // Opens all inputs: none may be replaced.
        described.hash(&Contents::default())?;
    }
    let checkpoints = described.checkpoints.as_ref().map(|checkpoints| &checkpoints.folder);
    let others = [arguments.pictures.as_ref(), arguments.tensorboard.as_ref(), checkpoints];
    let others =
        others.into_iter().flatten().filter(|folder| **folder != out).map(|folder| OutputFolder::take_any(folder));
    let _others = others.collect::<Result<Vec<_>>>()?;
    output.begin()?;
    for name in run::RESULTS {
        output.file(name)?;
    }
    let bar = TrainingBar::new("training");
    let context = RunContext {
        references: out.join("references"),
        out: out.clone(),
        tensorboard: arguments.tensorboard.clone(),
        pictures: arguments.pictures.clone(),
        until: None,
        stop: &stop,
        watch: &mut shown_on(&bar),
    };
    let finished = run::perform(&described, context)?;
    bar.finish_and_clear();
    let (summary, before, after) = (&finished.summary, finished.summary.initial, finished.summary.divergence);
    let untrained = match described.fit.over {
        Over::Patches | Over::FinePatches => "patches alone",
        Over::Tail if described.fit.naive || described.fit.head.share => "untrained",
        Over::Tail => "tail alone",
    };
    say!(
        "KL {:.4} nats ({untrained} {:.4}), relative variance {:.4} ({untrained} {:.3}), {} steps{}",
        after.kl,
        before.kl,
        after.relative_variance,
        before.relative_variance,
        summary.steps,
        if summary.interrupted { " (interrupted: the learning rate had not come down)" } else { "" },
    );
    if summary.fell_back {
        warning!("training did not lower the variance; the untrained head is kept");
    }
    for (name, value) in finished.measures.iter().filter(|(name, _)| name.contains(':') || *name == "ns_per_sample") {
        say!("{name} {value:.4e}");
    }
    if arguments.json {
        terminal::print_json(&finished.measures)?;
    }
    let seconds = start.elapsed().as_secs_f64();
    match finished.sampler {
        None => say!("trained for {seconds:.1} s; nothing was exported"),
        Some(spec) => {
            say!("{} written after {seconds:.1} s", out.join(run::SAMPLER).display());
            say!("render it with --sampler {spec}");
        }
    }
    Ok(())
}

/// Returns a callback that shows the steps of a head's training.
fn shown_on(bar: &TrainingBar<'_>) -> impl FnMut(&Progress) {
    let mut kl = f64::NAN;
    move |progress| {
        kl = progress.divergence.map_or(kl, |divergence| divergence.kl);
        let known = if kl.is_nan() { String::new() } else { format!(", KL {kl:.4} nats") };
        let speed = progress.samples_per_second / 1e6;
        bar.show(progress, format!("loss {:.4}{known}, {speed:.2} M samples/s", progress.loss));
    }
}

/// Trains a head for a map under conditions from everywhere, with a progress bar and without writing files.
pub fn train(tail: &Tail, config: &FitConfig, stop: &AtomicBool) -> Result<Fitted> {
    let target = build_target(config, tail, Viewpoints::Sphere)?;
    let bar = TrainingBar::new("training");
    let fitted = fit(config, &*target, &mut shown_on(&bar), stop)?;
    bar.finish_and_clear();
    Ok(fitted)
}
