//! `headtail fit`: train a head for an environment map and export it.

mod arguments;

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use anyhow::{Result, bail, ensure};
use headtail_render::{environment::Environment, scene::Scene, spec::SamplerSpec, tail::TailKind};
use headtail_train::{
    CheckpointFolder, FitConfig, Fitted, FlowSummary, MetricsFile, Progress, Run, TensorBoard, TrainingLight,
    Viewpoints, build_target, check_exportable, density_pictures, exported_sampler, fit_with,
};

pub use arguments::Arguments;

use crate::{
    arguments::{make_folder, open_environment},
    progress,
};

/// Trains and exports.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let config = arguments.config()?;
    if arguments.print_config {
        print!("{}", config.to_toml()?);
        return Ok(());
    }
    // The parser of arguments asks for both.
    let (Some(map), Some(out)) = (&arguments.env, &arguments.out) else { bail!("give --env and --out") };
    if !arguments.no_export {
        check_exportable(&config)?;
    }
    let environment = open_environment(map)?;
    make_folder(out)?;
    let outputs = Outputs {
        viewpoints: viewpoints(arguments, config.seed)?,
        checkpoints: arguments.checkpoints(describe_target(arguments, &environment)),
        metrics: Some(MetricsFile::new(&out.join("metrics.jsonl"), config.seed)),
        tensorboard: arguments.tensorboard.as_deref().map(TensorBoard::create).transpose()?,
        pictures: arguments.pictures.clone(),
    };
    let stop = progress::stop_flag()?;
    let light = fit_light(&environment, &config, outputs.checkpoints.as_ref(), &stop)?;
    if config.tail == TailKind::Flow && stop.load(Ordering::Relaxed) {
        let but = if outputs.checkpoints.is_some() { " but its checkpoint" } else { "" };
        bail!(progress::Interrupted::new(format!("while the flow tail was fitted; nothing was written{but}")));
    }
    if config.compact_emitters && light.luminance == environment.luminance() {
        eprintln!("note: {map} has no compact emitters; the head serves all of its light");
    }
    let fitted = train(&light, &config, outputs, &stop)?;
    let (summary, before, after) = (&fitted.summary, fitted.summary.initial, fitted.summary.divergence);
    let untrained = if config.naive || config.head.share { "untrained" } else { "tail alone" };
    println!(
        "KL {:.4} nats ({untrained} {:.4}), relative variance {:.4} ({untrained} {:.3}), {} steps{}",
        after.kl,
        before.kl,
        after.relative_variance,
        before.relative_variance,
        summary.steps,
        if summary.interrupted { " (interrupted: the learning rate had not come down)" } else { "" },
    );
    if summary.fell_back {
        eprintln!("warning: training did not lower the variance; the untrained head is kept");
    }
    if arguments.no_export {
        println!("trained for {:.1} s; nothing was exported", start.elapsed().as_secs_f64());
        return Ok(());
    }
    let file = out.join("sampler.safetensors");
    let exported = exported_sampler(&fitted.head, &config, summary, &environment, &light, !arguments.reproducible)?;
    exported.write(&file)?;
    let seconds = start.elapsed().as_secs_f64();
    println!("{} written after {seconds:.1} s", file.display());
    println!("render it with --sampler {}", SamplerSpec::of_exported(&exported, file));
    Ok(())
}

/// The tail that the configuration asks for; a flow is fitted, with a progress bar. Its checkpoints are in the folder `tail` of the head's.
fn fit_light(
    environment: &Environment,
    config: &FitConfig,
    checkpoints: Option<&CheckpointFolder>,
    stop: &AtomicBool,
) -> Result<TrainingLight> {
    let checkpoints = checkpoints.map(|head| CheckpointFolder {
        folder: head.folder.join("tail"),
        target: format!("tail of {}", head.target),
        ..head.clone()
    });
    let bar = progress::bar(config.flow.steps as u64, "flow tail");
    let mut show = |progress: &Progress| {
        bar.set_message(format!("loss {:.4}, {:.2} M samples/s", progress.loss, progress.samples_per_second / 1e6));
        bar.set_position(progress.step as u64);
        Ok(())
    };
    let run = Run {
        progress: &mut show,
        interrupt: stop,
        checkpoints: checkpoints.as_ref(),
        warn: &mut |error| eprintln!("warning: {error}; the checkpoint before it is used"),
    };
    let (light, summary) = TrainingLight::fit(config, environment, run)?;
    bar.finish_and_clear();
    if let Some(FlowSummary { steps, kl, table_kl, initial_kl, repair, seconds, .. }) = summary {
        println!(
            "flow tail: KL(light || flow) {kl:.4} nats (uniform {initial_kl:.3}), its table {table_kl:.4}, {steps} steps, {seconds:.1} s; \
             {} cells repaired",
            repair.cells
        );
    }
    Ok(light)
}

/// Conditions of `--pictures`.
const PICTURES: u64 = 4;

/// Where conditions come from, and what is written while a head is trained.
pub struct Outputs {
    viewpoints: Viewpoints,
    checkpoints: Option<CheckpointFolder>,
    metrics: Option<MetricsFile>,
    tensorboard: Option<TensorBoard>,
    pictures: Option<PathBuf>,
}

impl Outputs {
    /// Conditions from everywhere, no files.
    pub const NONE: Self =
        Self { viewpoints: Viewpoints::Sphere, checkpoints: None, metrics: None, tensorboard: None, pictures: None };

    fn add(&mut self, progress: &Progress) -> headtail_train::Result<()> {
        if let Some(metrics) = &mut self.metrics {
            metrics.add(progress)?;
        }
        if let Some(board) = &mut self.tensorboard {
            board.add(progress)?;
        }
        Ok(())
    }
}

/// Trains a head for a map, with a progress bar.
pub fn train(light: &TrainingLight, config: &FitConfig, mut outputs: Outputs, stop: &AtomicBool) -> Result<Fitted> {
    let target = build_target(config, &light.tail, outputs.viewpoints.clone());
    let (checkpoints, pictures) = (outputs.checkpoints.take(), outputs.pictures.take());
    let bar = progress::bar(config.steps as u64, "training");
    let mut kl = f64::NAN;
    let mut show = |progress: &Progress| {
        if let Some(divergence) = progress.divergence {
            kl = divergence.kl;
        }
        let known = if kl.is_nan() { String::new() } else { format!(", KL {kl:.4} nats") };
        let speed = progress.samples_per_second / 1e6;
        bar.set_message(format!("loss {:.4}{known}, {speed:.2} M samples/s", progress.loss));
        bar.set_position(progress.step as u64);
        outputs.add(progress)
    };
    let run = Run {
        progress: &mut show,
        interrupt: stop,
        checkpoints: checkpoints.as_ref(),
        warn: &mut |error| eprintln!("warning: {error}; the checkpoint before it is used"),
    };
    let fitted = fit_with(config, &*target, run)?;
    bar.finish_and_clear();
    if let Some(folder) = pictures {
        density_pictures(&fitted.head, config, &*target, PICTURES, &folder)?;
    }
    Ok(fitted)
}

/// Where surfaces are seen from.
fn viewpoints(arguments: &Arguments, seed: u64) -> Result<Viewpoints> {
    let Some(name) = &arguments.conditions_from else {
        let camera = &arguments.camera;
        ensure!(camera.look_from.is_none() && camera.fov.is_none(), "a camera needs --conditions-from SCENE");
        return Ok(Viewpoints::Sphere);
    };
    let scene = Scene::open(name)?;
    let camera = arguments.camera.open(&scene)?;
    Ok(Viewpoints::of_scene(&scene, &camera, arguments.camera.width as usize, arguments.camera.height as usize, seed)?)
}

/// What a checkpoint must agree on besides the configuration.
fn describe_target(arguments: &Arguments, environment: &Environment) -> String {
    let conditions = match &arguments.conditions_from {
        Some(scene) => format!("conditions from {scene} by {:?}", arguments.camera),
        None => "conditions from everywhere".into(),
    };
    format!("environment {}, {conditions}", environment.hash())
}
