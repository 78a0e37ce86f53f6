//! `headtail check-material`: compares a neural material with its source.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use glam::Vec3;
use headtail_render::{
    brdf::NeuralTexture,
    fabric::{Query, Source, SourceKind},
    image::write_png,
};
use headtail_train::neural_texture::{DISTANCES, Decibels, QUERIES, error_over, side_by_side};

use crate::{
    output::OutputFile,
    progress,
    terminal::{self, out},
};

/// Compare a neural material with its source, by error and side by side.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail check-material --material checkpoints/welt.safetensors --source welt --out out/welt.png

The picture has three rows: a flat piece of cloth from near to far, on the left as light paths find it, on the right as the material has \
it. Errors are peak signal-to-noise ratios of radiance, where 1 is that of a white diffuse surface that faces the light.")]
pub struct Arguments {
    /// Material to check.
    #[arg(long, value_name = "FILE")]
    material: PathBuf,
    /// Source: welt, satin, velvet, jersey, lacquer or anodized.
    #[arg(long, value_name = "NAME")]
    source: SourceKind,
    /// Light paths per pixel and light; error queries take twice as many.
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    paths: u32,
    /// Queries for the error over all directions and places.
    #[arg(long, value_name = "N", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(16..=1 << 20))]
    questions: u32,
    /// Threads. Default: all.
    #[arg(long, value_name = "N")]
    threads: Option<u16>,
    /// Print the errors as a JSON object.
    #[arg(long)]
    json: bool,
    /// PNG to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Source that shows completed light paths on a bar.
struct Watched<'a> {
    source: &'a dyn Source,
    bar: &'a progress::Bar,
}

/// Light paths per query between two updates of the bar.
const STEP: u32 = 128;

impl Source for Watched<'_> {
    /// Returns the mean over batches of light paths, each with its own seed.
    fn reflect(&self, queries: &[Query], samples: u32, seed: u64) -> Vec<Vec3> {
        let mut sum = vec![Vec3::ZERO; queries.len()];
        for part in 0..samples.div_ceil(STEP) {
            let count = STEP.min(samples - part * STEP);
            let values = self.source.reflect(queries, count, seed ^ u64::from(part) << 44);
            let fraction = count as f32 / samples as f32;
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += fraction * value);
            self.bar.inc(u64::from(count) * queries.len() as u64);
        }
        sum
    }
}

/// Measures the errors and writes the picture.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()?;
    }
    if arguments.json {
        terminal::only_data();
    }
    let is_png = arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    ensure!(is_png, "--out {}: the file's name must end in .png", arguments.out.display());
    let output = OutputFile::take(&arguments.out)?;
    let material = NeuralTexture::read(&arguments.material)?;
    let source = arguments.source.build()?;
    let (paths, questions) = (u64::from(arguments.paths), u64::from(arguments.questions));
    let bar = progress::bar((QUERIES as u64 + 2 * questions) * paths, "checking");
    let source = Watched { source: &*source, bar: &bar };
    let (image, errors) = side_by_side(&source, &material, arguments.paths);
    output.write(|path| write_png(path, &image, 0.0))?;
    if !arguments.json {
        for (distance, error) in DISTANCES.iter().zip(&errors) {
            out!("at {distance} tiles: {error:.1} dB");
        }
    }
    // Differs from the default seed of a fit, so that no query was used in training.
    let Decibels { psnr, noise, snr } =
        error_over(&source, &material, arguments.questions as usize, 2 * arguments.paths, 1 << 40);
    bar.finish_and_clear();
    if arguments.json {
        let at = DISTANCES.iter().zip(&errors);
        let at: Vec<_> = at.map(|(tiles, decibels)| serde_json::json!({ "tiles": tiles, "psnr": decibels })).collect();
        return terminal::print_json(
            &serde_json::json!({ "distances": at, "psnr": psnr, "noise_psnr": noise, "snr": snr }),
        );
    }
    out!(
        "over directions and places: {psnr:.1} dB (over the mean square {snr:.1} dB), with the noise of the source at {noise:.1} dB"
    );
    Ok(())
}
