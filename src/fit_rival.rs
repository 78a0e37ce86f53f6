//! `headtail fit-rival`: train a sampler of others for a neural material, to compare with.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use anyhow::{Context, Result};
use clap::Args;
use headtail_render::rival::{RivalFile, RivalKind};
use headtail_train::rival::{RivalFit, RivalMaterial, RivalQuality, RivalSettings};

use crate::{
    output::OutputFile,
    progress,
    terminal::{out, say},
};

/// Views and directions of each that a sampler is measured with.
const VIEWS: usize = 256;
const DIRECTIONS: usize = 2048;

/// Train a sampler of others for a measured or neural material: they know the material and not the light.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit-rival --kind flow --material neural:checkpoints/welt.safetensors --out out/welt-flow.safetensors
  headtail fit-rival --kind reparam --material nbrdf:out/two.safetensors#merl/chrome,merl/teflon --out out/two-reparam.safetensors
  headtail render --scene bedroom --material neural:checkpoints/welt.safetensors,repeat=24 --env studio \\
      --sampler neusample+emitter:out/welt-flow.safetensors --out out/bedroom.exr

Kinds: lobes (NeuSample's two Gaussians and a cosine lobe) and flow (NeuSample's splines) are rendered as neusample:FILE or \
neusample+emitter:FILE, reparam (a reparameterising network) as reparam:FILE or reparam+emitter:FILE. A file holds a sampler for each material.")]
pub struct Arguments {
    /// Which sampler: lobes, flow or reparam.
    #[arg(long, value_name = "KIND")]
    kind: RivalKind,
    /// The material: neural:FILE, nbrdf:FILE#NAME or nbrdf:FILE#NAME,NAME and so on, which get a sampler each.
    #[arg(long, value_name = "MATERIAL")]
    material: String,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Training steps.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    steps: usize,
    /// Views of a step.
    #[arg(long, value_name = "N", default_value_t = 128)]
    views: usize,
    /// Directions of each view.
    #[arg(long, value_name = "N", default_value_t = 64)]
    directions: usize,
    /// Seed of weights and samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads; all by default. The result does not depend on their number.
    #[arg(long, value_name = "N")]
    threads: Option<u16>,
}

/// Trains a sampler for each material and writes them.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let stop = progress::stop_flag()?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
    }
    let _output = OutputFile::take(&arguments.out, |there| RivalFile::read(there).is_ok())?;
    let &Arguments { kind, steps, views, directions, seed, .. } = arguments;
    let settings = RivalSettings { steps, views, directions, seed, ..RivalSettings::new(kind) };
    settings.check()?;
    let mut rivals = Vec::new();
    for material in RivalMaterial::open(&arguments.material)? {
        rivals.push(train(settings, &material, &stop)?);
    }
    RivalFile { kind, rivals }.write(&arguments.out)?;
    say!("{} written after {:.0} s", arguments.out.display(), start.elapsed().as_secs_f64());
    Ok(())
}

fn train(
    settings: RivalSettings,
    material: &RivalMaterial,
    stop: &AtomicBool,
) -> Result<(String, blake3::Hash, headtail_render::rival::Rival)> {
    let mut fit = RivalFit::new(settings, material)?;
    let bar = progress::bar(settings.steps as u64, &material.name);
    let mut mean = None;
    while fit.step() < settings.steps {
        let loss = fit.advance()?;
        let recent = mean.map_or(loss, |mean: f32| mean + 0.02 * (loss - mean));
        mean = Some(recent);
        bar.set_position(fit.step() as u64);
        bar.set_message(format!("cross-entropy {recent:.4} nats"));
        if stop.load(Ordering::Relaxed) {
            return Err(progress::Interrupted::new("nothing is written".to_owned()).into());
        }
    }
    bar.finish_and_clear();
    let rival = fit.rival()?;
    let RivalQuality { own_variance, variance, kept } =
        RivalQuality::measure(material, &rival, VIEWS, DIRECTIONS, settings.seed);
    out!(
        "{}: relative variance under a white sky {variance:.4} (the material's own sampling {own_variance:.4}), {:.2} % of the draws are \
         samples, cross-entropy {:.4} nats",
        material.name,
        100.0 * kept,
        mean.unwrap_or(f32::NAN),
    );
    Ok((material.name.clone(), material.identity, rival))
}
