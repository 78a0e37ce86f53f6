//! `headtail fit-material`: fit a neural material to a bidirectional texture.

use std::{path::PathBuf, time::Instant};

use anyhow::{Context, Result};
use clap::Args;
use headtail_render::fabric::SourceKind;
use headtail_train::{
    Progress, Run, StateFile,
    neural_texture::{Decibels, Settings, error_over, fit_material},
};

use crate::{
    output::{self, OutputFile},
    progress,
    terminal::{self, out, say},
};

/// Steps between saved states.
const SAVE_EVERY: usize = 250;
/// Queries of the error measurement, and light paths per query.
const QUESTIONS: usize = 2048;
const PATHS: u32 = 256;

/// Fit a neural material to cloth or layers.
/// Their light paths are traced during training.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail fit-material --source welt --out checkpoints/welt.safetensors
  headtail fit-material --source satin --steps 1000 --out out/satin.safetensors
  headtail render --scene cloth --material neural:out/satin.safetensors,repeat=24 --env studio --out out/cloth.exr

Sources: welt (a rough striped weave), satin (metallic threads), velvet (pressed, glossy pile), jersey (a plain knit of
wool), lacquer (a clear coat over a diffuse pattern), anodized (a tinted coat over brushed metal). After an
interruption, the same command continues from FILE.state.")]
pub struct Arguments {
    /// Source: welt, satin, velvet, jersey, lacquer or anodized.
    #[arg(long, value_name = "NAME")]
    source: SourceKind,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Texels per side of the texture's finest level: a power of two.
    #[arg(long, value_name = "N", default_value_t = 64)]
    side: usize,
    /// Training steps.
    #[arg(long, value_name = "N", default_value_t = 4000)]
    steps: usize,
    /// Samples per step.
    #[arg(long, value_name = "N", default_value_t = 8192)]
    batch: usize,
    /// Light paths per sample.
    #[arg(long, value_name = "N", default_value_t = 1)]
    paths: u32,
    /// Seed of weights and samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads. Default: all. The result does not depend on their number.
    #[arg(long, value_name = "N")]
    threads: Option<u16>,
    /// Print the errors as a JSON object.
    #[arg(long)]
    json: bool,
}

/// Fits and writes the material.
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
    let Arguments { side, steps, batch, paths, seed, .. } = *arguments;
    let settings = Settings { side, steps, batch, paths, seed };
    settings.check()?;
    let name = arguments.source.name();
    let source = arguments.source.build()?;
    let kept = arguments.out.with_added_extension("state");
    let has_gone_on = kept.exists();
    let file = StateFile { path: &kept, every: SAVE_EVERY, target: name.to_owned(), done: &[] };
    let bar = progress::TrainingBar::new(name);
    let mut show = |now: &Progress| {
        let error = now.mean_loss.map(|mean| format!("error of single light paths {mean:.4}"));
        bar.show(now, error.unwrap_or_default());
        Ok(())
    };
    let run = Run { progress: &mut show, interrupt: &stop, checkpoints: Some(&file), warn: &mut |_| {} };
    let (mut material, state) = fit_material(&settings, name, &*source, run)?;
    if state.step < steps {
        let what = format!("{} of {steps} steps are done; the same command goes on from there", state.step);
        return Err(progress::Interrupted::new(what).into());
    }
    bar.finish_and_clear();

    let Decibels { psnr, noise, snr } = error_over(&*source, &material, QUESTIONS, PATHS, seed);
    material.set_psnr(psnr);
    let seconds = start.elapsed().as_secs_f64();
    if !has_gone_on {
        material.set_seconds(seconds);
    }
    output.write(|path| material.write(path))?;
    output::remove_kept(&kept)?;
    if arguments.json {
        terminal::print_json(&serde_json::json!({
            "file": arguments.out.display().to_string(),
            "source": name,
            "steps": steps,
            "seconds": (!has_gone_on).then_some(seconds),
            "psnr": psnr,
            "noise_psnr": noise,
            "snr": snr,
            "path_error": state.mean_loss,
        }))?;
    } else {
        out!(
            "{}: {psnr:.1} dB against its source (over the mean square {snr:.1} dB), whose own noise is at {noise:.1} dB",
            arguments.out.display()
        );
    }
    if let Some(mean) = state.mean_loss {
        say!("weighted squared error of single light paths at the end: {mean:.4}");
    }
    say!("{seconds:.0} s");
    Ok(())
}
