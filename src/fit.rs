//! `headtail fit`: train a head for an environment map and export it.

use std::{path::PathBuf, sync::Arc, sync::atomic::AtomicBool, time::Instant};

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use headtail_render::{environment::Environment, export::ExportedSampler, tail::Tail};
use headtail_train::{Backend, CosineTarget, FitConfig, Loss, Progress, Summary, exported_sampler};

use crate::{
    arguments::{TailArgument, make_folder, open_environment},
    progress,
};

/// Train a head for an environment map and write DIR/sampler.safetensors.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit --env studio --material lambert --out out/studio
  headtail fit --env room.hdr --material lambert --steps 3000 --out out/room
  headtail fit --env sky.exr --material lambert --tail row-column --backend ndarray --seed 7 --out out/sky")]
pub struct Arguments {
    /// A built-in environment (overcast, window, studio, sunset) or a Radiance .hdr or OpenEXR map.
    #[arg(long, value_name = "MAP")]
    env: String,
    /// The material to sample for.
    #[arg(long)]
    material: Material,
    /// The tail warp under the head.
    #[arg(long, default_value = "hierarchical")]
    tail: TailArgument,
    /// Where to train.
    #[arg(long, default_value = "flex")]
    backend: BackendArgument,
    /// Optimiser steps.
    #[arg(long, default_value_t = FitConfig::default().steps as u64, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    steps: u64,
    /// Seed of weights and batches.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Peak learning rate of AdamW (0.9, 0.999); it rises over the first 5 % of the steps and falls along half a cosine.
    #[arg(long, value_name = "RATE", default_value_t = FitConfig::default().learning_rate)]
    learning_rate: f64,
    /// What to minimise.
    #[arg(long, default_value = "log-chi-square")]
    loss: LossArgument,
    /// Leave the training time out of the file, so that the same command writes the same bytes.
    #[arg(long)]
    reproducible: bool,
    /// Folder for the result.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Clone, Copy, ValueEnum)]
enum Material {
    /// Diffuse surfaces: the head is conditioned on the normal.
    Lambert,
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
}

impl From<LossArgument> for Loss {
    fn from(argument: LossArgument) -> Self {
        match argument {
            LossArgument::LogChiSquare => Self::LogChiSquare,
            LossArgument::ForwardKl => Self::ForwardKl,
        }
    }
}

/// Trains and exports.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let Material::Lambert = arguments.material;
    let environment = open_environment(&arguments.env)?;
    make_folder(&arguments.out)?;
    let config = FitConfig {
        backend: arguments.backend.into(),
        steps: usize::try_from(arguments.steps).context("--steps")?,
        seed: arguments.seed,
        learning_rate: arguments.learning_rate,
        loss: arguments.loss.into(),
        ..FitConfig::default()
    };
    let (sampler, summary) =
        train(&environment, arguments.tail, &config, !arguments.reproducible, &*progress::stop_flag()?)?;
    let file = arguments.out.join("sampler.safetensors");
    sampler.write(&file)?;
    let (before, after) = (summary.initial, summary.divergence);
    println!(
        "KL {:.4} nats (tail alone {:.4}), relative variance {:.4} (tail alone {:.3}), {} steps{}",
        after.kl,
        before.kl,
        after.relative_variance,
        before.relative_variance,
        summary.steps,
        if summary.interrupted { " (interrupted: the learning rate had not come down)" } else { "" },
    );
    println!("{} written after {:.1} s", file.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Trains a cosine head for a map, with a progress bar.
pub fn train(
    environment: &Arc<Environment>,
    tail: TailArgument,
    config: &FitConfig,
    with_time: bool,
    stop: &AtomicBool,
) -> Result<(ExportedSampler, Summary)> {
    let kind = tail.into();
    let tail = Tail::new(kind, environment.width(), environment.height(), &environment.luminance())?;
    let target = CosineTarget::new(&tail);
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
    let fitted = headtail_train::fit(config, &target, &mut show, stop)?;
    bar.finish_and_clear();
    let sampler = exported_sampler(&fitted.head, config, &fitted.summary, kind, environment, with_time)?;
    Ok((sampler, fitted.summary))
}
