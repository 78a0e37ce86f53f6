//! `headtail demo`: the whole path on built-in data.

use std::{
    path::PathBuf,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use anyhow::{Result, bail};
use clap::Args;
use headtail_render::{
    bake::{CellGrid, NormalGrid},
    points::PointSet,
    spec::{FileKind, SamplerSpec},
    tail::{Tail, TailKind},
};
use headtail_train::{FitConfig, exported_sampler};

use crate::terminal::say;
use crate::{
    arguments::{CameraArguments, ViewArguments, open_environment},
    bake, compare, fit,
    given::given,
    output::OutputFolder,
    progress,
    run::RunTable,
};

/// Train, bake, render and compare on a built-in scene.
/// Prints the page to open. Needs no files, takes under 2 minutes.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail demo
  headtail demo --out /tmp/headtail-demo --env window")]
pub struct Arguments {
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    /// A built-in environment (overcast, window, studio, sunset) or a map.
    #[arg(long, value_name = "NAME|FILE", default_value = "studio", value_parser = given::<String>())]
    env: String,
    /// Sample points: lattice, lattice:N, sobol or independent.
    #[arg(long, value_name = "POINTS", default_value = "lattice")]
    points: PointSet,
}

/// Runs every step and reports on it.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let output =
        OutputFolder::take(&arguments.out, &["head.safetensors", "direct.safetensors", "results.csv", "report.html"])?;
    let environment = open_environment(&arguments.env)?;
    output.begin()?;

    say!("1. Train a cosine head for the environment '{}'.", environment.name());
    let stop = progress::stop_flag()?;
    let config = FitConfig::default();
    let tail = Arc::new(Tail::of_environment(config.tail, &environment)?);
    let fitted = fit::train(&tail, &config, &stop)?;
    if stop.load(Ordering::Relaxed) {
        bail!(progress::Interrupted::new("while training; nothing was written"));
    }
    let summary = &fitted.summary;
    let (before, after) = (summary.initial, summary.divergence);
    say!("   {} steps, {:.1} s: KL {:.3} -> {:.3} nats", summary.steps, summary.seconds, before.kl, after.kl);
    let head = output.file("head.safetensors")?;
    let mut described = RunTable::default();
    described.set_env(arguments.env.clone());
    let settings = described.with_fit(config.clone())?.to_toml()?;
    exported_sampler(&fitted.head, &config, summary, &environment, &tail, true)?.with_run(settings).write(&head)?;

    say!("2. Bake light x cosine directly, without training.");
    let baking = Instant::now();
    let direct = bake::direct(
        &arguments.env,
        &environment,
        TailKind::Hierarchical,
        NormalGrid::new(16, 32)?,
        CellGrid::new(32, 32)?,
    )?;
    let table = output.file("direct.safetensors")?;
    direct.write(&table)?;
    say!("   {:.2} s", baking.elapsed().as_secs_f64());

    say!("3. Render the temple with each sampler and compare.");
    let view = ViewArguments {
        points: arguments.points,
        ..ViewArguments::of("temple", &arguments.env, CameraArguments::of_size(320, 240))
    };
    let samplers = vec![
        SamplerSpec::brdf(),
        SamplerSpec::emitter(),
        SamplerSpec::mis(),
        SamplerSpec::ris(4),
        SamplerSpec::patches(),
        SamplerSpec::file_with_mis(FileKind::Head, head),
        SamplerSpec::file(FileKind::Direct, table),
    ];
    compare::perform(&compare::Arguments::new(view, samplers, arguments.out.clone()), &output)?;
    let page = arguments.out.join("report.html");
    say!("{:.0} s in all; the page to open is {}", start.elapsed().as_secs_f64(), page.display());
    Ok(())
}
