//! The arguments of `headtail fit`, and the configuration that they make.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use headtail_train::{
    Backend, ConfigBuilder, FitConfig, FlowSize, Loss, Material, Preset,
    config::{Over, Points},
};

use crate::{
    arguments::{CameraArguments, MapArguments, TailArgument},
    given::given,
    run::{Checkpoints, Picture, RunTable},
};

/// Train a head for an environment map and write DIR/sampler.safetensors.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit --env studio --material lambert --out out/studio
  headtail fit --env room.hdr --material ggx:alpha=0.2..0.8 --steps 3000 --out out/room
  headtail fit --env sky.exr --preset paper-ggx --set head.bins=16 --print-config
  headtail fit --env sky.exr --config run.toml --backend ndarray --seed 7 --out out/sky
  headtail fit --config whole-run.toml

A configuration is a preset, then the keys of --config, then those of --set, then the flags below. A file can describe the whole run: its \
keys env, out, viewpoints, checkpoints, export and measure are in docs/sweeps.md. The fast presets learn how \
often to draw from BRDF sampling, and keep the untrained head, which makes head+mis the sampler mis, where training did not lower the variance.")]
pub struct Arguments {
    /// A built-in environment (overcast, window, studio, sunset) or a Radiance .hdr or OpenEXR map.
    #[arg(long, value_name = "MAP", required_unless_present_any = ["print_config", "config"], value_parser = given::<String>())]
    env: Option<String>,
    #[command(flatten)]
    map: MapArguments,
    /// The settings to begin with: paper-cosine, paper-ggx, fast-cosine, fast-ggx, over-patches. Default: the fast one for the material, or with --over
    /// patches the last one.
    #[arg(long)]
    preset: Option<Preset>,
    /// A TOML file of settings, with the keys that --print-config shows, or of a whole run.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One setting, as in head.bins=8; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the settings as TOML and stop.
    #[arg(long)]
    pub print_config: bool,
    /// The material to sample for: lambert, ggx:alpha=0.4, (any of a range) ggx:alpha=0.2..0.8, or measured: nbrdf:FILE#NAME, and one head for
    /// many: nbrdf:FILE#NAME,NAME and so on.
    #[arg(long, value_name = "MATERIAL", required_unless_present_any = ["preset", "config"], value_parser = given::<Material>())]
    material: Option<Material>,
    /// The tail warp under the head.
    #[arg(long)]
    tail: Option<TailArgument>,
    /// What is under the head: the tail, or patches of sky between it and the tail, for which a head learns what their closed form leaves over
    /// (--sampler head+patches:FILE).
    #[arg(long)]
    over: Option<OverArgument>,
    /// The size of a flow tail, small, medium or paper: takes the place of all keys flow.* of presets and files. --set goes over it.
    #[arg(long, value_name = "SIZE")]
    flow: Option<FlowSize>,
    /// Sample a sun or small lamps on their own, and train the head for the rest of the light. Off by default: it gains under suns, but not
    /// under every lamp.
    #[arg(long)]
    compact_emitters: bool,
    /// How to draw training points.
    #[arg(long)]
    target: Option<TargetArgument>,
    /// Fit the product without a tail: the paper's strawman, to measure it.
    #[arg(long)]
    naive: bool,
    /// Train and measure only.
    #[arg(long)]
    no_export: bool,
    /// Where to train.
    #[arg(long)]
    backend: Option<BackendArgument>,
    /// Optimiser steps.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    steps: Option<u64>,
    /// Seed of weights and batches.
    #[arg(long)]
    seed: Option<u64>,
    /// Peak learning rate of AdamW; it falls along half a cosine.
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// What to minimise.
    #[arg(long)]
    loss: Option<LossArgument>,
    /// Take conditions from what a camera sees of this scene (a built-in one or a glTF file) instead of from everywhere.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    conditions_from: Option<String>,
    #[command(flatten)]
    camera: CameraArguments,
    /// Keep checkpoints in this folder, the last three.
    #[arg(long, value_name = "DIR")]
    checkpoint_dir: Option<PathBuf>,
    /// Steps between checkpoints; there is one at the end and at an interruption (Ctrl-C, SIGTERM) too.
    #[arg(long, value_name = "STEPS", default_value_t = 250, requires = "checkpoint_dir")]
    checkpoint_every: usize,
    /// Go on from the last checkpoint, or begin where there is none. The result is that of a run that was never stopped.
    #[arg(long, requires = "checkpoint_dir")]
    resume: bool,
    /// Write event files for TensorBoard into this folder.
    #[arg(long, value_name = "DIR")]
    pub tensorboard: Option<PathBuf>,
    /// Draw target and learned density for four conditions into this folder, in the end.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Leave the training time out of the file, so that the same command writes the same bytes.
    #[arg(long)]
    reproducible: bool,
    /// Print the figures of the run as a JSON object.
    #[arg(long)]
    pub json: bool,
    /// Folder for the result and for metrics.jsonl, which has a line for each validation.
    #[arg(long, value_name = "DIR", required_unless_present_any = ["print_config", "config"])]
    pub out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum TargetArgument {
    /// In strata of the intermediate square, joined by BRDF samples.
    Strata,
    /// From a 512 x 1024 table of the product for each condition, as the paper does it: slow.
    Tabulated,
}

impl From<TargetArgument> for Points {
    fn from(argument: TargetArgument) -> Self {
        match argument {
            TargetArgument::Strata => Self::Strata,
            TargetArgument::Tabulated => Self::Tabulated,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum OverArgument {
    /// The tail.
    Tail,
    /// Patches of sky.
    Patches,
    /// Finer patches of sky.
    FinePatches,
}

impl From<OverArgument> for Over {
    fn from(argument: OverArgument) -> Self {
        match argument {
            OverArgument::Tail => Self::Tail,
            OverArgument::Patches => Self::Patches,
            OverArgument::FinePatches => Self::FinePatches,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum BackendArgument {
    /// burn's CPU backend.
    Flex,
    /// The older CPU backend.
    Ndarray,
    /// GPU through Vulkan, Metal or DX12; needs a build with `--features wgpu`.
    Wgpu,
}

impl From<BackendArgument> for Backend {
    fn from(argument: BackendArgument) -> Self {
        match argument {
            BackendArgument::Flex => Self::Flex,
            BackendArgument::Ndarray => Self::Ndarray,
            BackendArgument::Wgpu => Self::Wgpu,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum LossArgument {
    /// ln(1 + relative variance) per condition: what a renderer pays for.
    LogChiSquare,
    /// The relative variance itself: its gradients have the size of the largest weights.
    ChiSquare,
    /// Weighted maximum likelihood.
    ForwardKl,
    /// Kullback-Leibler divergence the other way round: unstable.
    ReverseKl,
}

impl From<LossArgument> for Loss {
    fn from(argument: LossArgument) -> Self {
        match argument {
            LossArgument::LogChiSquare => Self::LogChiSquare,
            LossArgument::ChiSquare => Self::ChiSquare,
            LossArgument::ForwardKl => Self::ForwardKl,
            LossArgument::ReverseKl => Self::ReverseKl,
        }
    }
}

impl Arguments {
    /// The table of the run: that of the file, changed by the flags that are not settings of the training.
    pub fn table(&self) -> Result<RunTable> {
        let file = self.config.as_deref().map(RunTable::open).transpose()?;
        let mut table = file.unwrap_or_default();
        let camera = &self.camera;
        if let Some(env) = &self.env {
            table.set_env(self.map.of(env));
        }
        match &self.conditions_from {
            Some(scene) => table.set_viewpoints(Picture::new(scene.clone(), camera)),
            None => {
                ensure!(camera.look_from.is_none() && camera.fov.is_none(), "a camera needs --conditions-from SCENE");
            }
        }
        if let Some(folder) = &self.checkpoint_dir {
            let (folder, every, resume) = (folder.clone(), self.checkpoint_every, self.resume);
            table.set_checkpoints(Checkpoints { folder, every, resume });
        }
        table.change_export(self.no_export, self.reproducible);
        Ok(table)
    }

    /// The configuration that preset, file, values and flags make.
    pub fn config(&self, described: &RunTable) -> Result<FitConfig> {
        let material = self.material.or_else(|| described.material()).unwrap_or(Material::Lambert);
        let preset = match self.preset {
            Some(preset) => preset,
            None => described.preset()?.unwrap_or(match self.over {
                Some(OverArgument::Patches | OverArgument::FinePatches) => Preset::OverPatches,
                Some(OverArgument::Tail) | None => Preset::fast_for(material),
            }),
        };
        let mut builder = ConfigBuilder::new(preset);
        described.lay_over(&mut builder)?;
        if let Some(size) = self.flow {
            builder.flow(size);
        }
        for assignment in &self.set {
            builder.assignment(assignment)?;
        }
        let mut config = builder.build()?;
        if let Some(material) = self.material {
            config = config.for_material(material);
        }
        if let Some(over) = self.over {
            config = config.over(over.into());
        }
        if let Some(steps) = self.steps {
            config.steps = usize::try_from(steps).context("--steps")?;
        }
        let FitConfig { tail, points, naive, compact_emitters, backend, seed, learning_rate, loss, .. } = config;
        let config = FitConfig {
            tail: self.tail.map_or(tail, Into::into),
            points: self.target.map_or(points, Into::into),
            naive: naive || self.naive,
            compact_emitters: compact_emitters || self.compact_emitters,
            backend: self.backend.map_or(backend, Into::into),
            seed: self.seed.unwrap_or(seed),
            learning_rate: self.learning_rate.unwrap_or(learning_rate),
            loss: self.loss.map_or(loss, Into::into),
            ..config
        };
        config.validate()?;
        Ok(config)
    }
}
