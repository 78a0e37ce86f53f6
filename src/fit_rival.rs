//! `headtail fit-rival`: train a sampler of others for a neural material, to compare with.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use anyhow::{Context, Result};
use clap::Args;
use headtail_render::rival::{Rival, RivalFile, RivalKind};
use headtail_train::rival::{RivalFit, RivalMaterial, RivalQuality, RivalSettings, RivalState};

use crate::{
    given::given,
    output::{self, OutputFile},
    progress,
    terminal::{self, out, say},
};

/// Steps between two savings of the state.
const SAVE_EVERY: usize = 50;
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
neusample+emitter:FILE, reparam (a reparameterising network) as reparam:FILE or reparam+emitter:FILE. A file holds a sampler for each material. \
A command that was interrupted goes on where it was when it is given again; what it needs for that is beside the file, in FILE.state.")]
pub struct Arguments {
    /// Which sampler: lobes, flow or reparam.
    #[arg(long, value_name = "KIND")]
    kind: RivalKind,
    /// The material: neural:FILE, nbrdf:FILE#NAME or nbrdf:FILE#NAME,NAME and so on, which get a sampler each.
    #[arg(long, value_name = "MATERIAL", value_parser = given::<String>())]
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
    let mut training = Training::begin(settings, &materials, arguments.out.with_added_extension("state"))?;
    let (mut rivals, mut figures) = (Vec::new(), Vec::new());
    for material in &materials {
        let rival = training.train(material, &stop)?;
        figures.push(Figures::of(material, &rival, training.loss(), seed));
        if !arguments.json {
            out!("{}", figures[figures.len() - 1]);
        }
        rivals.push((material.name.clone(), material.identity, rival));
    }
    let seconds = (!training.has_gone_on).then(|| start.elapsed().as_secs_f64());
    output.write(|path| RivalFile { kind, rivals, seconds }.write(path))?;
    output::remove_kept(&training.kept)?;
    if arguments.json {
        terminal::print_json(&figures)?;
    }
    say!("{} written after {:.0} s", arguments.out.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// The trainings of a command, material by material.
struct Training<'a> {
    settings: RivalSettings,
    materials: &'a [RivalMaterial],
    /// What an earlier command left, of which the first are used up.
    left: std::vec::IntoIter<RivalState>,
    done: Vec<RivalState>,
    kept: PathBuf,
    /// Whether an earlier command did a part, whose time is not known.
    has_gone_on: bool,
}

impl<'a> Training<'a> {
    /// Begins, or goes on where the file `kept` was left.
    fn begin(settings: RivalSettings, materials: &'a [RivalMaterial], kept: PathBuf) -> Result<Self> {
        let has_gone_on = kept.exists();
        let left =
            if has_gone_on { RivalState::read_all(&kept, &settings, materials)? } else { Vec::new() }.into_iter();
        Ok(Self { settings, materials, left, done: Vec::new(), kept, has_gone_on })
    }

    fn train(&mut self, material: &'a RivalMaterial, stop: &AtomicBool) -> Result<Rival> {
        let steps = self.settings.steps;
        let mut fit = RivalFit::new(self.settings, material, self.left.next())?;
        let bar = progress::bar(steps as u64, &material.name);
        bar.set_position(fit.step() as u64);
        while fit.step() < steps {
            fit.advance()?;
            bar.set_position(fit.step() as u64);
            bar.set_message(format!("cross-entropy {:.4} nats", fit.state().loss.unwrap_or(f32::NAN)));
            let stopped = stop.load(Ordering::Relaxed);
            if stopped || fit.step() % SAVE_EVERY == 0 {
                self.save(fit.state())?;
            }
            if stopped {
                let step = fit.step();
                let what =
                    format!("{}: {step} of {steps} steps are done; the same command goes on from there", material.name);
                return Err(progress::Interrupted::new(what).into());
            }
        }
        bar.finish_and_clear();
        let rival = fit.rival()?;
        self.done.push(fit.state().clone());
        Ok(rival)
    }

    /// The last training's, in nats.
    fn loss(&self) -> Option<f32> {
        self.done.last().and_then(|state| state.loss)
    }

    fn save(&self, current: &RivalState) -> Result<()> {
        let states: Vec<&RivalState> = self.done.iter().chain([current]).chain(self.left.as_slice()).collect();
        Ok(RivalState::write_all(&self.kept, &self.settings, self.materials, &states)?)
    }
}

/// How good a sampler is.
#[derive(serde::Serialize)]
struct Figures {
    material: String,
    /// Under a white sky.
    relative_variance: f64,
    own_relative_variance: f64,
    /// The share of draws that are samples.
    kept: f64,
    cross_entropy: Option<f32>,
}

impl Figures {
    fn of(material: &RivalMaterial, rival: &Rival, cross_entropy: Option<f32>, seed: u64) -> Self {
        let RivalQuality { own_variance, variance, kept } =
            RivalQuality::measure(material, rival, VIEWS, DIRECTIONS, seed);
        let (relative_variance, own_relative_variance) = (variance, own_variance);
        Self { material: material.name.clone(), relative_variance, own_relative_variance, kept, cross_entropy }
    }
}

impl std::fmt::Display for Figures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}: relative variance under a white sky {:.4} (the material's own sampling {:.4}), {:.2} % of the draws are samples, \
             cross-entropy {:.4} nats",
            self.material,
            self.relative_variance,
            self.own_relative_variance,
            100.0 * self.kept,
            self.cross_entropy.unwrap_or(f32::NAN)
        )
    }
}
