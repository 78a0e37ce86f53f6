//! Performs a run: from settings to files.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, bail};
use headtail_eval::nanoseconds_per_sample;
use headtail_render::{
    environment::Environment,
    file,
    head::Condition,
    scene::MaterialSpec,
    spec::SamplerSpec,
    tail::{Tail, TailKind},
};
use headtail_train::{
    CheckpointFolder, Checkpoints, DensityPair, Fitted, FlowSummary, MetricsFile, Progress, Run, Summary, TensorBoard,
    Viewpoints, build_target, condition_of, density_pairs, exported_sampler, fit_tail, fit_with,
};

use super::{
    measure::{self, Measures},
    table::RunConfig,
    view::Picture,
};
use crate::terminal::{say, warning};
use crate::{
    arguments::{open_environment, open_scene},
    output::make_folder,
    progress,
    report::{
        chart::{Panel, Scale, Sides, densities},
        vector::Chart,
    },
};

/// File of the resolved table.
const RESOLVED: &str = "resolved.toml";
/// File of the exported sampler.
pub const SAMPLER: &str = "sampler.safetensors";
/// File of the figures.
const MEASURES: &str = "measures.json";
/// File with a line per validation.
pub const METRICS: &str = "metrics.jsonl";

/// Files of a run.
pub const RESULTS: [&str; 4] = [SAMPLER, MEASURES, METRICS, RESOLVED];

/// Conditions for which densities are drawn.
const PICTURES: u64 = 4;

/// Output locations and callbacks of a run.
pub struct RunContext<'a> {
    /// Folder for the results.
    pub out: PathBuf,
    /// Folder for references of measured views.
    pub references: PathBuf,
    /// Folder for TensorBoard event files.
    pub tensorboard: Option<PathBuf>,
    /// Folder for pictures of densities.
    pub pictures: Option<PathBuf>,
    /// Pauses after this step, like an interruption; the run can resume from its checkpoint.
    pub until: Option<usize>,
    /// Ends the run at the next step.
    pub stop: &'a AtomicBool,
    /// Called after every step.
    pub watch: &'a mut dyn FnMut(&Progress),
}

/// Result of a run.
pub struct Finished {
    /// Figures of the training.
    pub summary: Summary,
    /// All measurements, if the run was not interrupted.
    pub measures: Measures,
    /// The sampler, if one was written.
    pub sampler: Option<SamplerSpec>,
}

/// Trains, exports and measures; the resolved table is written beside the results and into the exported file.
///
/// # Errors
/// If something cannot be opened, trained or written; [`progress::Interrupted`] while a flow tail is fitted.
pub fn perform(run: &RunConfig, context: RunContext<'_>) -> Result<Finished> {
    let RunContext { out, references, tensorboard, pictures, until, stop, watch } = context;
    let config = &run.fit;
    let environment = open_environment(&run.env)?;
    make_folder(&out)?;
    let resolved = run.to_toml()?;
    file::replace(&out.join(RESOLVED), resolved.as_bytes())?;
    let viewpoints = run
        .viewpoints
        .as_ref()
        .map_or(Ok(Viewpoints::Sphere), |picture| seen(picture, &config.material, config.seed))?;
    let checkpoints = run.checkpoints.as_ref().map(|checkpoints| CheckpointFolder {
        folder: checkpoints.folder.clone(),
        every: checkpoints.every,
        resume: checkpoints.resume,
        target: describe_target(run.viewpoints.as_ref(), &environment),
    });
    let mut metrics = MetricsFile::new(&out.join(METRICS), config.seed);
    let mut board = tensorboard.as_deref().map(TensorBoard::create).transpose()?;

    let tail = tail_of(&environment, run, checkpoints.as_ref(), stop)?;
    if config.tail == TailKind::Flow && stop.load(Ordering::Relaxed) {
        let but = if checkpoints.is_some() { " but its checkpoint" } else { "" };
        bail!(progress::Interrupted::new(format!("while the flow tail was fitted; nothing was written{but}")));
    }
    let target = build_target(config, &tail, viewpoints)?;
    let pause = AtomicBool::new(false);
    let mut show = |progress: &Progress| {
        metrics.add(progress)?;
        if let Some(board) = &mut board {
            board.add(progress)?;
        }
        watch(progress);
        if stop.load(Ordering::Relaxed) || until.is_some_and(|until| progress.step >= until) {
            pause.store(true, Ordering::Relaxed);
        }
        Ok(())
    };
    let warn = &mut |error: &headtail_train::Error| warning!("{error}");
    let checkpoints = checkpoints.as_ref().map(|folder| folder as &dyn Checkpoints);
    let around = Run { progress: &mut show, interrupt: &pause, checkpoints, warn };
    if let Some(name) = config.gradient.graphics_device()? {
        say!("gradients by shaders on {name}");
    }
    let fitted = fit_with(config, &*target, around)?;
    if let Some(folder) = pictures {
        make_folder(&folder)?;
        for (index, pair) in density_pairs(&fitted.head, config, &*target, PICTURES)?.iter().enumerate() {
            draw(pair, index)?.write(&folder)?;
        }
    }

    let mut finished = Finished { measures: of_summary(&fitted), summary: fitted.summary, sampler: None };
    if run.export.file {
        let file = out.join(SAMPLER);
        let with_time = !run.export.reproducible;
        let exported = exported_sampler(&fitted.head, config, &fitted.summary, &environment, &tail, with_time)?;
        let exported = exported.with_run(resolved);
        exported.write(&file)?;
        let bytes = std::fs::metadata(&file).with_context(|| file.display().to_string())?.len();
        finished.measures.insert("bytes".into(), bytes as f64);
        let spec = SamplerSpec::of_exported(&exported, file);
        if !finished.summary.interrupted {
            finished.measures.extend(measured(run, &environment, &spec, &references)?);
        }
        finished.sampler = Some(spec);
    }
    write_measures(&out, &finished.measures)?;
    Ok(finished)
}

/// Measures time and errors of the exported sampler, as requested by the run.
fn measured(
    run: &RunConfig,
    environment: &Arc<Environment>,
    spec: &SamplerSpec,
    references: &Path,
) -> Result<Measures> {
    let mut measures = Measures::new();
    if run.measure.time {
        let estimator = spec.build(environment)?;
        let nanoseconds = nanoseconds_per_sample(&*estimator, environment, &run.fit.material)?;
        measures.insert("ns_per_sample".into(), nanoseconds);
    }
    for view in &run.measure.views {
        measures.extend(measure::errors_of_view(view, &run.env, &run.fit.material, spec, references)?);
    }
    Ok(measures)
}

fn of_summary(Fitted { head, summary }: &Fitted) -> Measures {
    let figures = [
        ("kl", summary.divergence.kl),
        ("relative_variance", summary.divergence.relative_variance),
        ("untrained_relative_variance", summary.initial.relative_variance),
        ("training_seconds", summary.seconds),
        ("weights", head.weight_count() as f64),
        ("steps", summary.steps as f64),
    ];
    figures.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn write_measures(out: &Path, measures: &Measures) -> Result<()> {
    Ok(file::replace(&out.join(MEASURES), (serde_json::to_string_pretty(measures)? + "\n").as_bytes())?)
}

/// Returns the tail of the configuration; a flow is fitted, with a progress bar, and its checkpoints are in
/// the folder `tail` of the head's.
fn tail_of(
    environment: &Environment,
    run: &RunConfig,
    checkpoints: Option<&CheckpointFolder>,
    stop: &AtomicBool,
) -> Result<Arc<Tail>> {
    let checkpoints = checkpoints.map(CheckpointFolder::of_tail);
    let bar = progress::TrainingBar::new("flow tail");
    let mut show = |now: &Progress| {
        bar.show(now, format!("loss {:.4}, {:.2} M samples/s", now.loss, now.samples_per_second / 1e6));
        Ok(())
    };
    let around = Run {
        progress: &mut show,
        interrupt: stop,
        checkpoints: checkpoints.as_ref().map(|folder| folder as &dyn Checkpoints),
        warn: &mut |error| warning!("{error}"),
    };
    let (tail, summary) = fit_tail(&run.fit, environment, around)?;
    bar.finish_and_clear();
    if let Some(FlowSummary { steps, kl, table_kl, initial_kl, repair, seconds, .. }) = summary {
        let blended = match repair.blended {
            0.0 => String::new(),
            fraction => format!(", which took {:.0} % of the identity", 100.0 * fraction),
        };
        say!(
            "flow tail: KL(light || flow) {kl:.4} nats (uniform {initial_kl:.3}), its table {table_kl:.4}, {steps} steps, {seconds:.1} s; \
             {} cells repaired{blended}",
            repair.cells
        );
    }
    Ok(tail)
}

/// Returns the surfaces that a camera sees in a scene.
fn seen(picture: &Picture, material: &MaterialSpec, seed: u64) -> Result<Viewpoints> {
    let mut scene = open_scene(&picture.scene, true)?;
    let camera = picture.camera().open(&scene)?;
    if picture.ground {
        scene.add_ground();
    }
    if condition_of(material) == Condition::Texture {
        let bounds = scene.bounds();
        scene = material.dress(scene, &bounds)?;
    }
    Ok(Viewpoints::of_scene(&scene, &camera, picture.width as usize, picture.height as usize, seed)?)
}

/// Describes what a checkpoint must match in addition to the configuration.
fn describe_target(viewpoints: Option<&Picture>, environment: &Environment) -> String {
    let conditions = match viewpoints {
        Some(picture) => format!("conditions from {picture:?}"),
        None => "conditions from everywhere".into(),
    };
    format!("environment {}, {conditions}", environment.hash())
}

/// Draws target and learned density at a condition, on one scale.
fn draw(pair: &DensityPair, index: usize) -> Result<Chart> {
    let scale = Scale::of(&pair.target, 4.0);
    let panel =
        |title: &str, values: &[f32]| Panel::density(title, (values, pair.side), Sides::Square, (scale, "of the mean"));
    let panels = [panel("target", &pair.target)?, panel("head", &pair.learned)?];
    densities(&format!("condition-{index}"), &[format!("Densities over the square, condition {index}")], &panels, 2)
}
