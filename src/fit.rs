//! `headtail fit`: train a head for an environment map and export it.

use std::{path::PathBuf, sync::Arc, sync::atomic::AtomicBool, time::Instant};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use headtail_render::{environment::Environment, tail::Tail};
use headtail_train::{
    Backend, ConfigBuilder, FitConfig, Fitted, Loss, Material, Preset, Progress, Viewpoints, build_target,
    check_exportable, config::Points, exported_sampler,
};

use crate::{
    arguments::{TailArgument, make_folder, open_environment},
    progress,
};

/// Train a head for an environment map and write DIR/sampler.safetensors.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit --env studio --material lambert --out out/studio
  headtail fit --env room.hdr --material ggx:alpha=0.2..0.8 --steps 3000 --out out/room
  headtail fit --env sky.exr --preset paper-ggx --set head.bins=16 --print-config
  headtail fit --env sky.exr --config run.toml --backend ndarray --seed 7 --out out/sky

A configuration is a preset, then the keys of --config, then those of --set, then the flags below.")]
pub struct Arguments {
    /// A built-in environment (overcast, window, studio, sunset) or a Radiance .hdr or OpenEXR map.
    #[arg(long, value_name = "MAP", required_unless_present = "print_config")]
    env: Option<String>,
    /// The settings to begin with: paper-cosine, paper-ggx, fast-cosine, fast-ggx. Default: the fast one for the material.
    #[arg(long)]
    preset: Option<Preset>,
    /// A TOML file of settings, with the keys that --print-config shows.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One setting, as in head.bins=8; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the settings as TOML and stop.
    #[arg(long)]
    print_config: bool,
    /// The material to sample for: lambert, ggx:alpha=0.4 or (any of a range) ggx:alpha=0.2..0.8.
    #[arg(long, value_name = "MATERIAL", required_unless_present_any = ["preset", "config"])]
    material: Option<Material>,
    /// The tail warp under the head.
    #[arg(long)]
    tail: Option<TailArgument>,
    /// How to draw training points.
    #[arg(long)]
    target: Option<TargetArgument>,
    /// Fit the product without a tail, the paper's strawman, to measure it; it cannot be exported.
    #[arg(long, requires = "no_export")]
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
    /// Leave the training time out of the file, so that the same command writes the same bytes.
    #[arg(long)]
    reproducible: bool,
    /// Folder for the result.
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    out: Option<PathBuf>,
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
    /// Weighted maximum likelihood.
    ForwardKl,
    /// Kullback-Leibler divergence the other way round: unstable.
    ReverseKl,
}

impl From<LossArgument> for Loss {
    fn from(argument: LossArgument) -> Self {
        match argument {
            LossArgument::LogChiSquare => Self::LogChiSquare,
            LossArgument::ForwardKl => Self::ForwardKl,
            LossArgument::ReverseKl => Self::ReverseKl,
        }
    }
}

impl Arguments {
    /// The configuration that preset, file, values and flags make.
    fn config(&self) -> Result<FitConfig> {
        let preset = self.preset.unwrap_or_else(|| Preset::fast_for(self.material.unwrap_or(Material::Lambert)));
        let mut builder = ConfigBuilder::new(preset);
        if let Some(file) = &self.config {
            builder.file(file)?;
        }
        for assignment in &self.set {
            builder.assignment(assignment)?;
        }
        let mut config = builder.build()?;
        if let Some(material) = self.material {
            config = config.for_material(material);
        }
        if let Some(steps) = self.steps {
            config.steps = usize::try_from(steps).context("--steps")?;
        }
        let FitConfig { tail, points, naive, backend, seed, learning_rate, loss, .. } = config;
        let config = FitConfig {
            tail: self.tail.map_or(tail, Into::into),
            points: self.target.map_or(points, Into::into),
            naive: naive || self.naive,
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
    let fitted = train(&environment, &config, &*progress::stop_flag()?)?;
    let (summary, before, after) = (&fitted.summary, fitted.summary.initial, fitted.summary.divergence);
    println!(
        "KL {:.4} nats ({} {:.4}), relative variance {:.4} ({1} {:.3}), {} steps{}",
        after.kl,
        if config.naive { "untrained" } else { "tail alone" },
        before.kl,
        after.relative_variance,
        before.relative_variance,
        summary.steps,
        if summary.interrupted { " (interrupted: the learning rate had not come down)" } else { "" },
    );
    if arguments.no_export {
        println!("trained for {:.1} s; nothing was exported", start.elapsed().as_secs_f64());
        return Ok(());
    }
    let file = out.join("sampler.safetensors");
    exported_sampler(&fitted.head, &config, summary, &environment, !arguments.reproducible)?.write(&file)?;
    println!("{} written after {:.1} s", file.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Trains a head for a map, with a progress bar.
pub fn train(environment: &Arc<Environment>, config: &FitConfig, stop: &AtomicBool) -> Result<Fitted> {
    let tail = Tail::new(config.tail, environment.width(), environment.height(), &environment.luminance())?;
    let target = build_target(config, &tail, Viewpoints::Sphere);
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
    };
    let fitted = headtail_train::fit(config, &*target, &mut show, stop)?;
    bar.finish_and_clear();
    Ok(fitted)
}
