//! Arguments of `headtail fit`, and the configuration that they define.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use headtail_render::{scene::MaterialSpec, tail::TailKind};
use headtail_train::{
    Backend, ConfigBuilder, FitConfig, FlowSize, Loss, Preset,
    config::{Over, Points},
};

use crate::{
    arguments::{CameraArguments, MapArguments, TAILS},
    given::{given, one_of},
    run::{Checkpoints, Picture, RunTable},
};

/// Train a head for an environment map.
/// Writes DIR/sampler.safetensors.
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
    /// Built-in environment, or Radiance .hdr or OpenEXR map.
    /// Built-in: overcast, window, studio, sunset.
    #[arg(long, value_name = "MAP", required_unless_present_any = ["print_config", "config"], value_parser = given::<String>())]
    env: Option<String>,
    #[command(flatten)]
    map: MapArguments,
    /// Initial settings.
    /// paper-cosine, paper-ggx, fast-cosine, fast-ggx or over-patches. Default: the fast one for the
    /// material; with --over patches, over-patches.
    #[arg(long)]
    preset: Option<Preset>,
    /// TOML file of settings, or of a whole run.
    /// Keys are those of --print-config.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one setting, as in head.bins=8; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the settings as TOML and stop.
    #[arg(long)]
    pub print_config: bool,
    /// Material to sample for.
    /// lambert; ggx:alpha=0.4; ggx:alpha=0.2..0.8 (any of a range); nbrdf:FILE#NAME (measured);
    /// nbrdf:FILE#NAME,NAME,... (one head for several).
    #[arg(long, value_name = "MATERIAL", required_unless_present_any = ["preset", "config"], value_parser = given::<MaterialSpec>())]
    material: Option<MaterialSpec>,
    /// Tail warp under the head.
    #[arg(long, value_parser = one_of(&TAILS))]
    tail: Option<TailKind>,
    /// Layer under the head: the tail, or patches of sky over it.
    /// Over patches, the head is trained on what their closed form leaves (--sampler head+patches:FILE).
    #[arg(long, value_parser = one_of(&OVER))]
    over: Option<Over>,
    /// Size of a flow tail: small, medium or paper.
    /// Overrides all keys flow.* of presets and files; --set overrides it.
    #[arg(long, value_name = "SIZE")]
    flow: Option<FlowSize>,
    /// Method of drawing training points.
    #[arg(long, value_parser = one_of(&TARGETS))]
    target: Option<Points>,
    /// Fit the product without a tail, as the paper's naive baseline.
    #[arg(long)]
    naive: bool,
    /// Train and measure only; write no sampler.
    #[arg(long)]
    no_export: bool,
    /// Training backend.
    #[arg(long, value_parser = one_of(&BACKENDS))]
    backend: Option<Backend>,
    /// Optimiser steps.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    steps: Option<u64>,
    /// Seed of weights and batches.
    #[arg(long)]
    seed: Option<u64>,
    /// Peak learning rate of AdamW; decays along half a cosine.
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// Loss to minimise.
    #[arg(long, value_parser = one_of(&LOSSES))]
    loss: Option<Loss>,
    /// Take conditions from what a camera sees of this scene.
    /// A built-in scene or a glTF file. Default: conditions from everywhere.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    conditions_from: Option<String>,
    #[command(flatten)]
    camera: CameraArguments,
    /// Keep the last three checkpoints in this folder.
    #[arg(long, value_name = "DIR")]
    checkpoint_dir: Option<PathBuf>,
    /// Steps between checkpoints.
    /// One is also written at the end and at an interruption (Ctrl-C, SIGTERM).
    #[arg(long, value_name = "STEPS", default_value_t = 250, requires = "checkpoint_dir")]
    checkpoint_every: usize,
    /// Continue from the last checkpoint, or begin if there is none.
    /// The result equals that of an uninterrupted run.
    #[arg(long, requires = "checkpoint_dir")]
    resume: bool,
    /// Write TensorBoard event files into this folder.
    #[arg(long, value_name = "DIR")]
    pub tensorboard: Option<PathBuf>,
    /// Draw densities for four conditions into this folder at the end.
    /// Target and learned density side by side.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Omit the training time, so that output bytes are reproducible.
    #[arg(long)]
    reproducible: bool,
    /// Print the figures of the run as a JSON object.
    #[arg(long)]
    pub json: bool,
    /// Folder for the result and metrics.jsonl.
    /// metrics.jsonl has one line per validation.
    #[arg(long, value_name = "DIR", required_unless_present_any = ["print_config", "config"])]
    pub out: Option<PathBuf>,
}

const TARGETS: [(Points, &str, &str); 2] = [
    (Points::Strata, "strata", "In strata of the intermediate square, joined by BRDF samples"),
    (Points::Tabulated, "tabulated", "From a 512 x 1024 table for each condition, as in the paper: slow"),
];

const OVER: [(Over, &str, &str); 3] = [
    (Over::Tail, "tail", "The tail"),
    (Over::Patches, "patches", "Patches of the map"),
    (Over::FinePatches, "fine-patches", "Finer patches of the map"),
];

const BACKENDS: [(Backend, &str, &str); 3] = [
    (Backend::Ndarray, "ndarray", "CPU"),
    (Backend::Flex, "flex", "CPU; needs a build with `--features flex`"),
    (Backend::Wgpu, "wgpu", "GPU through Vulkan, Metal or DX12; needs a build with `--features wgpu`"),
];

const LOSSES: [(Loss, &str, &str); 4] = [
    (Loss::LogChiSquare, "log-chi-square", "ln(1 + relative variance) per condition: what a renderer pays for"),
    (Loss::ChiSquare, "chi-square", "The relative variance itself: its gradients have the size of the largest weights"),
    (Loss::ForwardKl, "forward-kl", "Weighted maximum likelihood, the paper's"),
    (Loss::ReverseKl, "reverse-kl", "Reverse Kullback-Leibler divergence: unstable"),
];

impl Arguments {
    /// Returns the table of the run: that of the file, changed by the flags that are not training settings.
    pub fn table(&self) -> Result<RunTable> {
        let file = self.config.as_deref().map(RunTable::open).transpose()?;
        let mut table = file.unwrap_or_default();
        let camera = &self.camera;
        if let Some(env) = &self.env {
            table.set_env(self.map.of(env));
        }
        match &self.conditions_from {
            Some(scene) => table.set_viewpoints(Picture::new(scene.clone(), camera.settings())),
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

    /// Returns the configuration from preset, file, values and flags.
    pub fn config(&self, described: &RunTable) -> Result<FitConfig> {
        let material = self.material.clone().or_else(|| described.material()).unwrap_or(MaterialSpec::LAMBERT);
        let preset = match self.preset {
            Some(preset) => preset,
            None => described.preset()?.unwrap_or(match self.over {
                Some(Over::Patches | Over::FinePatches) => Preset::OverPatches,
                Some(Over::Tail) | None => Preset::fast_for(&material),
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
        if let Some(material) = &self.material {
            config = config.for_material(material.clone());
        }
        if let Some(over) = self.over {
            config = config.over(over);
        }
        if let Some(steps) = self.steps {
            config.steps = usize::try_from(steps).context("--steps")?;
        }
        let FitConfig { tail, points, naive, backend, seed, learning_rate, loss, .. } = config;
        let config = FitConfig {
            tail: self.tail.unwrap_or(tail),
            points: self.target.unwrap_or(points),
            naive: naive || self.naive,
            backend: self.backend.unwrap_or(backend),
            seed: self.seed.unwrap_or(seed),
            learning_rate: self.learning_rate.unwrap_or(learning_rate),
            loss: self.loss.unwrap_or(loss),
            ..config
        };
        config.validate()?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use serde::Serialize;

    use super::*;

    #[test]
    fn flags_use_the_names_of_configuration_files() {
        fn check<T: Serialize>(values: &[(T, &str, &str)]) {
            for (value, name, _) in values {
                assert_eq!(serde_json::to_value(value).unwrap(), *name);
            }
        }
        check(&TAILS);
        check(&TARGETS);
        check(&OVER);
        check(&BACKENDS);
        check(&LOSSES);
    }
}
