//! `headtail fit-rival`: trains a published sampler for a measured or neural material, as a baseline.

use std::{path::PathBuf, sync::atomic::AtomicBool, time::Instant};

use anyhow::{Context, Result};
use clap::Args;
use headtail_render::rival::{Rival, RivalFile, RivalKind};
use headtail_train::{
    Progress, Run, StateFile, TrainingState,
    rival::{RivalMaterial, RivalQuality, RivalSettings, fit_rival},
};

use crate::{
    given::given,
    output::{self, OutputFile},
    progress,
    terminal::{self, out, say},
};

/// Steps between saved states.
const SAVE_EVERY: usize = 50;
/// Views, and directions per view, with which a sampler is measured.
const VIEWS: usize = 256;
const DIRECTIONS: usize = 2048;

/// Train a published sampler for a measured or neural material.
/// These samplers depend on the material, not on the light.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit-rival --kind flow --material neural:checkpoints/welt.safetensors --out out/welt-flow.safetensors
  headtail fit-rival --kind reparam --material nbrdf:out/two.safetensors#merl/chrome,merl/teflon --out out/two-reparam.safetensors
  headtail render --scene bedroom --material neural:checkpoints/welt.safetensors,repeat=24 --env studio \\
      --sampler neusample+emitter:out/welt-flow.safetensors --out out/bedroom.exr

Kinds: lobes (NeuSample's two Gaussians and a cosine lobe) and flow (NeuSample's splines) are rendered as neusample:FILE or \
neusample+emitter:FILE, reparam (a reparameterising network) as reparam:FILE or reparam+emitter:FILE. A file holds a sampler for each material. \
After an interruption, the same command continues from FILE.state.")]
pub struct Arguments {
    /// Sampler: lobes, flow or reparam.
    #[arg(long, value_name = "KIND")]
    kind: RivalKind,
    /// Material: neural:FILE, nbrdf:FILE#NAME or nbrdf:FILE#NAME,NAME,...
    /// Each material gets a sampler.
    #[arg(long, value_name = "MATERIAL", value_parser = given::<String>())]
    material: String,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Training steps.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    steps: usize,
    /// Views per step.
    #[arg(long, value_name = "N", default_value_t = 128)]
    views: usize,
    /// Directions per view.
    #[arg(long, value_name = "N", default_value_t = 64)]
    directions: usize,
    /// Seed of weights and samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads. Default: all. The result does not depend on their number.
    #[arg(long, value_name = "N")]
    threads: Option<u16>,
    /// Print the figures of each material as an array of JSON objects.
    #[arg(long)]
    json: bool,
}

/// Trains a sampler for each material and writes them.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    if arguments.json {
        terminal::only_data();
    }
    let stop = progress::stop_flag()?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
    }
    let output = OutputFile::take(&arguments.out)?;
    let &Arguments { kind, steps, views, directions, seed, .. } = arguments;
    let settings = RivalSettings { steps, views, directions, seed, ..RivalSettings::new(kind) };
    settings.check()?;
    let materials = RivalMaterial::open(&arguments.material)?;
    let kept = arguments.out.with_added_extension("state");
    // The time of earlier, interrupted commands is unknown.
    let has_gone_on = kept.exists();
    let identities = materials.iter().map(|material| material.identity.to_hex().to_string());
    let target = format!("materials {}", identities.collect::<Vec<_>>().join(", "));
    let (mut rivals, mut figures, mut done) = (Vec::new(), Vec::new(), Vec::new());
    for material in &materials {
        let file = StateFile { path: &kept, every: SAVE_EVERY, target: target.clone(), done: &done };
        let (rival, state) = train(&settings, material, &file, &stop)?;
        let quality = RivalQuality::measure(material, &rival, VIEWS, DIRECTIONS, seed);
        figures.push(Figures { material: material.name.clone(), quality, cross_entropy: state.mean_loss });
        if !arguments.json {
            figures[figures.len() - 1].print();
        }
        rivals.push((material.name.clone(), material.identity, rival));
        done.push(state);
    }
    let seconds = (!has_gone_on).then(|| start.elapsed().as_secs_f64());
    output.write(|path| RivalFile { kind, rivals, seconds }.write(path))?;
    output::remove_kept(&kept)?;
    if arguments.json {
        terminal::print_json(&figures)?;
    }
    say!("{} written after {:.0} s", arguments.out.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Trains a sampler for a material; an interruption is an error.
fn train(
    settings: &RivalSettings,
    material: &RivalMaterial,
    file: &StateFile<'_>,
    stop: &AtomicBool,
) -> Result<(Rival, TrainingState)> {
    let bar = progress::TrainingBar::new(&material.name);
    let mut show = |now: &Progress| {
        let entropy = now.mean_loss.map(|mean| format!("cross-entropy {mean:.4} nats"));
        bar.show(now, entropy.unwrap_or_default());
        Ok(())
    };
    let run = Run { progress: &mut show, interrupt: stop, checkpoints: Some(file), warn: &mut |_| {} };
    let (rival, state) = fit_rival(settings, material, run)?;
    if state.step < settings.steps {
        let (name, step, steps) = (&material.name, state.step, settings.steps);
        let what = format!("{name}: {step} of {steps} steps are done; the same command goes on from there");
        return Err(progress::Interrupted::new(what).into());
    }
    bar.finish_and_clear();
    Ok((rival, state))
}

/// Quality of a sampler.
#[derive(serde::Serialize)]
struct Figures {
    material: String,
    #[serde(flatten)]
    quality: RivalQuality,
    cross_entropy: Option<f32>,
}

impl Figures {
    fn print(&self) {
        let RivalQuality { relative_variance, own_relative_variance, kept } = self.quality;
        out!(
            "{}: relative variance under a white sky {relative_variance:.4} (the material's own sampling \
             {own_relative_variance:.4}), {:.2} % of the draws are samples, cross-entropy {:.4} nats",
            self.material,
            100.0 * kept,
            self.cross_entropy.unwrap_or(f32::NAN)
        );
    }
}
