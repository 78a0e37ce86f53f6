//! `headtail compare`: samplers side by side, at equal samples or equal time.

mod reference;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use clap::Args;
use headtail_render::{
    color::luminance,
    export::{ExportedSampler, Intermediate},
    image::{Image, write_exr},
    integrator::{Budget, DirectEstimator, Rendering},
    sampler::SamplerSpec,
    statistics::{ErrorMetrics, RELATIVE_EPSILON, ttuv},
};
use reference::Reference;

use crate::{
    arguments::{OpenedView, ViewArguments, budget, make_folder, note_use},
    progress,
    render::{attributes, quietly},
    report::{self, Comparison, Preparation, RenderedImage, Row},
};

/// Compare samplers on one view; writes results.csv, report.html and the images.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail compare --scene temple --env studio --samplers cosine,emitter,mis,ris:4 --spp 4,16,64 --out out/temple
  headtail compare --scene spot.glb --ground --material lambert --env room.hdr --samplers mis,direct:out/room-direct.safetensors,oracle --spp 16 --out out/spot
  headtail compare --scene dishes --env sunset --samplers mis,ris:4,head+mis:out/sunset/sampler.safetensors --seconds 1,4 --runs 5 --out out/dishes

Errors are measured over the pixels that surfaces cover entirely: what the camera sees of the environment is the same for \
every sampler. Ctrl-C writes a report of the runs that are done.")]
pub struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    /// Samplers, separated by commas: brdf (or cosine), emitter, mis, mis2, mis-comp, ris:M, head+mis:FILE, head:FILE, baked:FILE, direct:FILE,
    /// ris:M:head:FILE, ris:M:direct:FILE, oracle.
    #[arg(long, value_name = "SPEC,...", value_delimiter = ',', required = true)]
    samplers: Vec<SamplerSpec>,
    /// Samples per pixel; several are separated by commas.
    #[arg(long, value_name = "N,...", value_delimiter = ',', required_unless_present = "seconds")]
    spp: Vec<u32>,
    /// Seconds per image; several are separated by commas. Each sampler is timed beforehand, and then takes the
    /// number of samples that fits.
    #[arg(long, value_name = "T,...", value_delimiter = ',')]
    seconds: Vec<f64>,
    /// Runs with different seeds for each sampler and budget.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Seed of the first run; run k has seed + k.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// OpenEXR image to measure errors against. Default: render one with the direct bake (glossy
    /// scenes: RIS over it and the BRDF) and --reference-spp.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Samples per pixel of the reference that is rendered.
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    reference_spp: u32,
    /// Folder in which rendered references are kept and looked for, by a hash of all that they depend on.
    #[arg(long, value_name = "DIR", conflicts_with = "reference")]
    reference_cache: Option<PathBuf>,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Arguments {
    /// The comparison that `headtail demo` makes.
    pub fn new(view: ViewArguments, samplers: Vec<SamplerSpec>, out: PathBuf) -> Self {
        let (spp, seconds) = (vec![1, 4, 16], vec![1.0]);
        Self {
            view,
            samplers,
            spp,
            seconds,
            runs: 3,
            seed: 1,
            reference: None,
            reference_spp: 512,
            reference_cache: None,
            out,
        }
    }
}

/// A sampler ready to render.
struct Entry {
    label: String,
    estimator: Box<dyn DirectEstimator>,
    preparation: Preparation,
}

/// What a run's image says, over the covered pixels.
struct Measured {
    metrics: ErrorMetrics,
    mean_luminance: f64,
}

/// Renders everything and writes the report.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut budgets = Vec::new();
    for &spp in &arguments.spp {
        budgets.push((format!("{spp}spp"), budget(Some(spp), None)?));
    }
    for &seconds in &arguments.seconds {
        budgets.push((format!("{seconds}s"), budget(None, Some(seconds))?));
    }
    let opened = arguments.view.open()?;
    let entries = arguments.samplers.iter().map(|spec| Entry::build(spec, &opened)).collect::<Result<Vec<_>>>()?;
    make_folder(&arguments.out)?;
    let stop = progress::stop_flag()?;

    let Reference { image: reference, covered, note: reference_note } = Reference::obtain(arguments, &opened, &stop)?;
    ensure!(covered.iter().any(|covered| *covered), "no pixel is covered by a surface: move the camera");
    let reference_pixels = select(&reference, &covered);

    let mut comparison = Comparison {
        scene: opened.scene_name(),
        env: opened.environment.name().to_owned(),
        width: arguments.view.camera.width as usize,
        height: arguments.view.camera.height as usize,
        command: command(),
        machine: machine(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        reference,
        measured: covered.clone(),
        reference_note,
        rows: Vec::new(),
        images: Vec::new(),
        preparation: Vec::new(),
    };
    let bar = progress::bar((budgets.len() * entries.len()) as u64 * u64::from(arguments.runs), "comparing");
    for (budget_label, budget) in &budgets {
        let taken = |entry: &Entry| match budget {
            Budget::Time(limit) => calibrated(&opened, entry, limit.as_secs_f64(), arguments.seed),
            Budget::Spp(_) => *budget,
        };
        let taken: Vec<Budget> = entries.iter().map(taken).collect();
        // Runs outside, samplers inside: a machine that slows down for a while slows all samplers down.
        for run in 0..arguments.runs {
            for (entry, &budget) in entries.iter().zip(&taken) {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                bar.set_message(format!("{} {budget_label}", entry.label));
                let seed = arguments.seed + u64::from(run);
                let rendering = quietly(opened.view(), &*entry.estimator, budget, seed);
                let pixels = select(&rendering.surfaces, &covered);
                let metrics = ErrorMetrics::of(&pixels, &reference_pixels)?;
                let measured = Measured { metrics, mean_luminance: mean_luminance(&pixels) };
                comparison.rows.push(row(&comparison, entry, budget_label, run, seed, &rendering, &measured));
                if run == 0 {
                    let image = rendering.composite();
                    let stem = format!("{}_{budget_label}", file_name(&entry.label));
                    let attributes = attributes(&entry.label, &rendering, seed);
                    write_exr(&arguments.out.join(format!("{stem}.exr")), &image, &attributes)?;
                    let errors = error_image(&image, &comparison.reference, &covered);
                    write_exr(&arguments.out.join(format!("{stem}_error.exr")), &errors, &attributes)?;
                    comparison.images.push(RenderedImage {
                        sampler: entry.label.clone(),
                        budget: budget_label.clone(),
                        image,
                    });
                }
                bar.inc(1);
            }
        }
    }
    bar.finish_and_clear();
    ensure!(!comparison.rows.is_empty(), "interrupted before the first run was done");
    comparison.preparation = entries.into_iter().map(|entry| entry.preparation).collect();
    report::write(&arguments.out, &comparison)?;
    summarise(&comparison);
    println!("open {}", arguments.out.join("report.html").display());
    Ok(())
}

impl Entry {
    fn build(spec: &SamplerSpec, opened: &OpenedView) -> Result<Self> {
        let label = spec.to_string();
        let start = Instant::now();
        let estimator = spec.build(&opened.environment)?;
        let built = start.elapsed().as_secs_f64();
        let mut preparation = Preparation { sampler: label.clone(), seconds: built, text: "tables built".into() };
        note_use(spec)?;
        if let SamplerSpec::Head(file)
        | SamplerSpec::Baked(file)
        | SamplerSpec::WithMis(_, file)
        | SamplerSpec::RisOf(_, _, file) = spec
            && let exported = ExportedSampler::read(file)?
            && let Some(training) = exported.training
        {
            preparation.text =
                format!("file read; trained before for {} steps on {}", training.steps, training.backend);
            if let Intermediate::Head(head) = &exported.intermediate {
                let parameters: usize =
                    head.layers().iter().map(|(_, layer)| (layer.inputs() + 1) * layer.outputs()).sum();
                preparation.text += &format!("; {parameters} parameters");
            }
            if let Some(seconds) = training.seconds {
                preparation.seconds += seconds;
                preparation.text += &format!(" ({seconds:.1} s)");
            }
        }
        Ok(Self { label, estimator, preparation })
    }
}

/// The budget of samples that takes `seconds`: a short rendering says about how many, one with that many sets it right.
///
/// All runs of a sampler then take the same number of samples, which does not depend on what else the machine does.
fn calibrated(opened: &OpenedView, entry: &Entry, seconds: f64, seed: u64) -> Budget {
    let mut trial = Budget::Time(Duration::from_secs_f64(0.25 * seconds));
    // A long rendering is faster per sample than a short one: passes are longer.
    for _ in 0..2 {
        let rendering = quietly(opened.view(), &*entry.estimator, trial, seed);
        let spp = f64::from(rendering.spp) * seconds / rendering.seconds;
        trial = Budget::Spp((spp.round() as u32).max(1));
    }
    trial
}

/// Squared error of each pixel and channel over the squared reference (plus the same small number as in relMSE); black where
/// nothing is measured.
fn error_image(image: &Image, reference: &Image, covered: &[bool]) -> Image {
    let error = |((x, r), covered): ((&[f32; 3], &[f32; 3]), &bool)| {
        let of = |c: usize| (x[c] - r[c]).powi(2) / (r[c] * r[c] + RELATIVE_EPSILON as f32);
        if *covered { [of(0), of(1), of(2)] } else { [0.0; 3] }
    };
    Image { pixels: image.pixels.iter().zip(&reference.pixels).zip(covered).map(error).collect(), ..*image }
}

/// The chosen pixels as an image of one row.
fn select(image: &Image, chosen: &[bool]) -> Image {
    let pixels: Vec<_> =
        image.pixels.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(pixel, _)| *pixel).collect();
    Image { width: pixels.len(), height: 1, pixels }
}

fn mean_luminance(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|&pixel| f64::from(luminance(pixel.into()))).sum();
    sum / image.pixels.len() as f64
}

fn row(
    comparison: &Comparison,
    entry: &Entry,
    budget: &str,
    run: u32,
    seed: u64,
    rendering: &Rendering,
    measured: &Measured,
) -> Row {
    let metrics = &measured.metrics;
    Row {
        scene: comparison.scene.clone(),
        env: comparison.env.clone(),
        sampler: entry.label.clone(),
        budget: budget.to_owned(),
        run: Some(run),
        spp: f64::from(rendering.spp),
        rays_per_sample: rendering.rays_per_sample,
        seconds: rendering.seconds,
        mse: metrics.mse,
        relmse: metrics.relmse,
        relmse_trimmed: metrics.relmse_trimmed,
        ttuv: ttuv(metrics.mse, rendering.seconds),
        mean_luminance: measured.mean_luminance,
        max_weight: f64::from(rendering.max_weight),
        seed,
        version: comparison.version.clone(),
    }
}

/// A sampler's label as part of a file name: of a path, the file and its folder are kept.
fn file_name(label: &str) -> String {
    let (name, argument) = label.split_once(':').unwrap_or((label, ""));
    let path = Path::new(argument).with_extension("");
    let folder = path.parent().and_then(Path::file_name);
    let parts = [Some(name.as_ref()), folder, path.file_name()];
    let joined: Vec<_> = parts.into_iter().flatten().map(|part| part.to_string_lossy()).collect();
    joined.join("-").chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

/// Mean MSE, time and the ratio to one-sample MIS (else the first sampler) for each budget, on standard output.
fn summarise(comparison: &Comparison) {
    println!("{:10} {:44} {:>10} {:>10} {:>9} {:>9}", "budget", "sampler", "MSE", "ratio", "spp", "seconds");
    let mut groups: Vec<(&str, &str)> = Vec::new();
    for row in &comparison.rows {
        if !groups.contains(&(&row.budget, &row.sampler)) {
            groups.push((&row.budget, &row.sampler));
        }
    }
    let mean = |budget: &str, sampler: &str, of: fn(&Row) -> f64| {
        let values: Vec<f64> =
            comparison.rows.iter().filter(|row| row.budget == budget && row.sampler == sampler).map(of).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    for (budget, sampler) in &groups {
        let base = groups.iter().find(|(b, s)| b == budget && *s == "mis").or(groups.iter().find(|(b, _)| b == budget));
        let base = base.map_or(f64::NAN, |(budget, sampler)| mean(budget, sampler, |row| row.mse));
        let mse = mean(budget, sampler, |row| row.mse);
        println!(
            "{budget:10} {sampler:44} {mse:>10.3e} {:>10.2} {:>9.1} {:>9.3}",
            base / mse,
            mean(budget, sampler, |row| row.spp),
            mean(budget, sampler, |row| row.seconds)
        );
    }
}

/// The command line, the program without its folder.
fn command() -> String {
    let quote = |argument: String| {
        let plain = argument.chars().all(|c| c.is_ascii_alphanumeric() || "-_./:,=+".contains(c));
        if plain { argument } else { format!("'{}'", argument.replace('\'', "'\\''")) }
    };
    std::iter::once("headtail".to_owned()).chain(std::env::args().skip(1).map(quote)).collect::<Vec<_>>().join(" ")
}

/// Processor and threads.
pub fn machine() -> String {
    let model = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?.split_once(':')?.1.trim().to_owned();
        Some(line)
    });
    let model = model.unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    format!("{model}, {} threads", rayon::current_num_threads())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_become_plain_file_names() {
        assert_eq!(file_name("ris:4"), "ris-4");
        assert_eq!(file_name("head:a/b c/sampler.safetensors"), "head-b_c-sampler");
        assert_eq!(file_name("mis-comp"), "mis-comp");
    }
}
