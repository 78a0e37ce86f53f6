//! `headtail backends`: the same short training with every form of the gradient on every compiled backend, side by side.

use anyhow::{Result, ensure};
use clap::Args;
use headtail_render::{environment::Environment, tail::Tail};
use headtail_train::{
    Backend, BackendTrial, Error, FitConfig, GradientForm, Preset, TrialRow, Viewpoints, build_target,
};

use crate::progress;
use crate::terminal::out;

/// Compare backends: speed, memory and agreement of a short training.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:
  headtail backends
  headtail backends --preset paper-cosine --mode autoregressive --backend ndarray --json
  headtail backends --gradient in-graph --conditions 16 --samples 64

Each row is one form of the gradient: fused, the same code for all CPU backends; by shaders on a graphics device, with --features gpu; in the graph of each backend. It has points per second through forward, backward and optimiser, and with the time in which targets are drawn; the \
process's peak memory; the last loss; the largest difference of a step's loss to the first row's; and the gradient's difference to \
central differences in f64, relative to its norm.")]
pub struct Arguments {
    /// Configuration.
    /// paper-cosine, paper-ggx, fast-cosine, fast-ggx or over-patches.
    #[arg(long, default_value = "paper-ggx")]
    preset: Preset,
    /// Composition of the coupling layers: coupled or autoregressive.
    /// Default: the preset's.
    #[arg(long, value_parser = parse::<headtail_train::Mode>)]
    mode: Option<headtail_train::Mode>,
    /// Conditions per step.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=65536))]
    conditions: u32,
    /// Points per condition.
    /// The largest square in N is stratified, the rest comes from BRDF sampling.
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Steps. If there are several, the first is not timed.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    steps: u32,
    /// Run only this backend: ndarray, flex or wgpu.
    #[arg(long, value_parser = parse::<Backend>)]
    backend: Option<Backend>,
    /// Run only this form of the gradient: fused, in-graph or device.
    #[arg(long, value_parser = form)]
    gradient: Option<GradientForm>,
    /// Print an array of JSON objects.
    #[arg(long)]
    json: bool,
}

/// Parses a value by its name in configuration files.
pub fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(text.into()).map_err(|error: serde_json::Error| error.to_string())
}

/// Parses a form of the gradient.
fn form(text: &str) -> Result<GradientForm, String> {
    let found = GradientForm::FORMS.into_iter().find(|form| form.to_string() == text);
    found.ok_or_else(|| "choose fused, in-graph or device".to_owned())
}

impl Arguments {
    /// Returns the wanted backends and forms. Forms outside the graph do not use the backend, so that one host backend stands for all.
    fn pairs(&self) -> Vec<(Backend, GradientForm)> {
        let own = [GradientForm::Fused, GradientForm::Device].map(|form| (self.backend.unwrap_or_default(), form));
        let in_graph = Backend::ALL.map(|backend| (backend, GradientForm::InGraph));
        let mut pairs: Vec<_> = own.into_iter().filter(|pair| pair.0.is_host()).chain(in_graph).collect();
        pairs.retain(|(backend, form)| {
            self.backend.is_none_or(|only| only == *backend) && self.gradient.is_none_or(|only| only == *form)
        });
        pairs
    }
}

/// Runs the trials and prints them.
pub fn run(arguments: &Arguments) -> Result<()> {
    let environment = Environment::open("studio")?;
    let mut config = arguments.preset.config();
    config.conditions = arguments.conditions as usize;
    let samples = arguments.samples as usize;
    config.strata = samples.isqrt();
    config.brdf_samples = samples - config.strata * config.strata;
    ensure!(
        config.brdf_samples == 0 || arguments.preset.config().brdf_samples > 0,
        "--samples {samples} is not a square number, and the target of {} has no BRDF samples to fill up with",
        arguments.preset
    );
    config.head.mode = arguments.mode.unwrap_or(config.head.mode);
    let tail = Tail::new(config.tail, environment.width(), environment.height(), &environment.luminance())?;
    let target = build_target(&config, &tail, Viewpoints::Sphere)?;
    let pairs = arguments.pairs();
    ensure!(!pairs.is_empty(), "the forms fused and device need a CPU backend beside them");
    let steps = arguments.steps as usize;
    let mut rows: Vec<TrialRow> = Vec::new();
    for (backend, gradient) in pairs {
        let trial = BackendTrial { config: FitConfig { gradient, ..config.clone() }, steps };
        let bar = progress::bar(steps as u64, &format!("{backend}, {gradient}"));
        let others = rows.first().map_or(&[][..], |first| &first.losses);
        let row = trial.run(backend, &*target, others, &|step| bar.set_position(step as u64));
        bar.finish_and_clear();
        match row {
            Ok(row) => rows.push(row),
            // Not in this build; an error only if requested by name.
            Err(Error::BackendNotCompiled { .. }) if arguments.backend.is_none() => {}
            Err(Error::DeviceNotCompiled) if arguments.gradient.is_none() => {}
            Err(error) => return Err(error.into()),
        }
    }
    if arguments.json {
        out!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        print_table(&config, steps, &rows);
    }
    Ok(())
}

fn print_table(config: &FitConfig, steps: usize, rows: &[TrialRow]) {
    out!(
        "{} conditions x {} points, K = {}, {} steps\n",
        config.conditions,
        config.batch_shape().samples(),
        config.head.bins,
        steps
    );
    out!(
        "{:<8} {:<15} {:<9} {:>12} {:>14} {:>9} {:>10} {:>11} {:>11}  {}",
        "backend",
        "mode",
        "gradient",
        "M samples/s",
        "with targets",
        "peak MB",
        "loss",
        "loss diff",
        "f64 diff",
        "device"
    );
    for row in rows {
        out!(
            "{:<8} {:<15} {:<9} {:>12.3} {:>14.3} {:>9} {:>10.5} {:>11.1e} {:>11.1e}  {}",
            row.backend.to_string(),
            format!("{:?}", row.mode).to_lowercase(),
            row.gradient.to_string(),
            row.samples_per_second / 1e6,
            row.samples_per_second_with_targets / 1e6,
            row.peak_memory_bytes.map_or("-".into(), |bytes| format!("{:.0}", bytes as f64 / 1e6)),
            row.final_loss,
            row.largest_loss_difference,
            row.gradient_error,
            row.device,
        );
    }
}
