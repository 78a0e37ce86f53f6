//! `headtail compare`: samplers side by side, at equal samples or equal time.

mod running;
mod samplers;

pub use samplers::SamplerList;

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use headtail_eval::{
    Budget, Entry, FilePreparation, GraphicsDevice, OpenedView, Plan, Reference, ReferencePolicy, machine,
};
use headtail_render::{file, image::write_exr, memory, spec::SamplerSpec};
use running::{RunningComparison, names_of, stems_of};

use crate::terminal::{self, say};
use crate::{
    arguments::{ViewArguments, budget, note_surfaces, note_use, samplers_help},
    crop::Crop,
    device::{DEVICES, Device},
    given::{given, one_of},
    light::LightArguments,
    output::OutputFolder,
    progress,
    report::{self, Comparison, Preparation, State},
};

/// Compare samplers on one view.
/// Writes results.csv, report.html and the images.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail compare --scene temple --env studio --samplers cosine,emitter,mis,ris:4 --spp 4,16,64 --out out/temple
  headtail compare --scene spot.glb --ground --material lambert --env room.hdr --samplers mis,direct:out/room-direct.safetensors,oracle --spp 16 --out out/spot
  headtail compare --scene dishes --env sunset --samplers mis,ris:4,head+mis:out/sunset/sampler.safetensors --seconds 1,4 --runs 5 --out out/dishes
  headtail compare --scene dishes --env studio --env-rotate 90 --env-scale 1,0.9,0.7 --crop 200,150,240,180 --samplers mis,patches --spp 16 --out out/crop

Errors are measured over the pixels that surfaces cover entirely: what the camera sees of the environment is the same for \
every sampler. Results are written after every run, so that an interruption loses one run at most. Ctrl-C ends the program after the \
current picture, with exit status 130; a second one ends it at once.")]
pub struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    #[arg(long, value_name = "SPEC,...", required = true, value_parser = given::<SamplerList>())]
    #[arg(help = "Samplers of directions, separated by commas; --help lists them", long_help = samplers_help("Samplers of directions, separated by commas. The name of a file that is there may hold commas."))]
    samplers: Vec<SamplerList>,
    /// Samples per pixel; several are separated by commas.
    #[arg(long, value_name = "N,...", value_delimiter = ',', required_unless_present = "seconds")]
    spp: Vec<u32>,
    /// Seconds per image; several are separated by commas.
    /// Each sampler is timed first, then takes the number of samples that fits.
    #[arg(long, value_name = "T,...", value_delimiter = ',')]
    seconds: Vec<f64>,
    /// What renders; the reference is always rendered on the CPU.
    #[arg(long, default_value = "cpu", value_parser = one_of(&DEVICES))]
    device: Device,
    /// Runs per sampler and budget, each with its own seed.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Seed of the first run; run k has seed + k.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// OpenEXR reference image.
    /// Default: render one with `patches` and --reference-spp.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Minimum samples per pixel of the rendered reference.
    /// Up to 4x as many are taken until its noise is below 5 % of the smallest error.
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    reference_spp: u32,
    /// Cache folder for rendered references.
    /// Files are named by a hash of everything that the reference depends on.
    #[arg(long, value_name = "DIR", conflicts_with = "reference")]
    reference_cache: Option<PathBuf>,
    #[command(flatten)]
    light: LightArguments,
    /// Compare only a part: first column, first row, width and height.
    /// In pixels of the whole picture.
    #[arg(long, value_name = "X,Y,W,H")]
    crop: Option<Crop>,
    /// Print all runs as an array of JSON objects.
    #[arg(long)]
    json: bool,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Arguments {
    /// Returns the comparison of `headtail demo`.
    pub fn new(view: ViewArguments, samplers: Vec<SamplerSpec>, out: PathBuf) -> Self {
        let (spp, seconds) = (vec![1, 4, 16], vec![1.0]);
        Self {
            view,
            samplers: vec![SamplerList(samplers)],
            spp,
            seconds,
            device: Device::Cpu,
            runs: 3,
            seed: 1,
            reference: None,
            reference_spp: 512,
            reference_cache: None,
            light: LightArguments::default(),
            crop: None,
            json: false,
            out,
        }
    }
}

/// Renders all runs and writes the results after each.
pub fn run(arguments: &Arguments) -> Result<()> {
    // From here on, signals end the command in order.
    progress::stop_flag()?;
    let output = OutputFolder::take(&arguments.out, &["results.csv", "report.html"])?;
    perform(arguments, &output)
}

/// Runs the comparison in an output folder that is already taken.
///
/// # Errors
/// If something cannot be opened, rendered or written; [`progress::Interrupted`] after a signal.
pub fn perform(arguments: &Arguments, output: &OutputFolder) -> Result<()> {
    if arguments.json {
        terminal::only_data();
    }
    let budgets = budgets(arguments)?;
    let specs: Vec<&SamplerSpec> = arguments.samplers.iter().flat_map(|list| &list.0).collect();
    check_different("--samplers", specs.iter().map(ToString::to_string))?;
    let stems = stems_of(&specs);
    let pictures = stems.iter().flat_map(|stem| budgets.iter().map(move |budget| names_of(stem, &budget.to_string())));
    output.plan(&pictures.flatten().collect::<Vec<_>>())?;
    if arguments.reference.is_none() {
        output.plan(&["reference.exr".into()])?;
    }
    let opened = arguments.view.open_part(arguments.light, arguments.crop)?;
    // The reference and its halves; for each sampler and budget, the first picture and its errors.
    memory::require_pictures(opened.part().width, opened.part().height, 4 + 2 * specs.len() * budgets.len())?;
    let stop = progress::stop_flag()?;
    let device = arguments.device.open(&opened)?;
    let mut entries = Vec::new();
    let mut preparation = Vec::new();
    for spec in specs {
        let (entry, prepared) = prepare(spec, device.as_ref(), (&opened, &budgets, &stop))?;
        entries.push(entry);
        preparation.push(prepared);
    }
    if let Some(file) = &arguments.reference {
        // An input that `begin` keeps.
        file::open_regular(file).with_context(|| file.display().to_string())?;
    }
    output.begin()?;
    let mut reference = obtain_reference(arguments, &opened, output, &stop)?;
    let plan = Plan {
        scene: opened.scene_name(),
        env: opened.light_name(),
        material: String::new(),
        budgets,
        runs: arguments.runs,
        seed: arguments.seed,
        cache: arguments.reference_cache.clone(),
    };

    let planned = plan.count(entries.len());
    let comparison = Comparison {
        scene: plan.scene.clone(),
        env: plan.env.clone(),
        width: opened.part().width,
        height: opened.part().height,
        command: terminal::command(),
        machine: device.as_ref().map_or_else(machine, GraphicsDevice::name),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        reference: reference.image.clone(),
        measured: reference.covered.clone(),
        reference_note: reference.note(),
        rows: Vec::new(),
        images: Vec::new(),
        preparation,
        state: State::Running { planned },
    };
    let mut running = RunningComparison::new(&opened, (&entries, stems), &stop, output, comparison, reference.noise)?;
    let ran = running.run_all(&mut reference, &plan);
    if ran.is_err() && !running.comparison.rows.is_empty() {
        // Keeps completed runs where possible; the first error is the one reported.
        drop(running.finish(State::Interrupted { planned }));
    }
    ran?;
    let interrupted = stop.load(Ordering::Relaxed) && running.comparison.rows.len() < planned;
    if interrupted && running.comparison.rows.is_empty() {
        bail!(progress::Interrupted::new("no run is done"));
    }
    running.finish(if interrupted { State::Interrupted { planned } } else { State::Complete })?;

    if arguments.json {
        terminal::print_json(&running.comparison.rows)?;
    }
    say!("{}", report::lines(&running.comparison.rows)?);
    say!("reference: {}", running.comparison.reference_note);
    let page = arguments.out.join("report.html");
    if interrupted {
        let done = running.comparison.rows.len();
        bail!(progress::Interrupted::new(format!("{done} of {planned} runs are done; {} shows them", page.display())));
    }
    say!("open {}", page.display());
    Ok(())
}

/// Returns the budgets of `--spp` and `--seconds`.
fn budgets(arguments: &Arguments) -> Result<Vec<Budget>> {
    let samples = arguments.spp.iter().map(|&spp| budget(Some(spp), None));
    let times = arguments.seconds.iter().map(|&seconds| budget(None, Some(seconds)));
    let budgets: Vec<Budget> = samples.chain(times).collect::<Result<_>>()?;
    check_different("--spp and --seconds", budgets.iter().map(ToString::to_string))?;
    Ok(budgets)
}

/// Returns the image named by `--reference`, else a cached or newly rendered one, which is copied to the
/// output folder.
///
/// # Errors
/// If an image cannot be read or written or has another size; [`progress::Interrupted`] after a signal, in
/// which case nothing is written.
fn obtain_reference(
    arguments: &Arguments,
    opened: &OpenedView,
    output: &OutputFolder,
    stop: &AtomicBool,
) -> Result<Reference> {
    let bar = progress::bar(progress::FRACTION_UNITS, "reference");
    let reference = match &arguments.reference {
        Some(file) => Reference::read(file, opened, stop, &bar.fraction_setter()),
        None => {
            let policy = ReferencePolicy::new(arguments.reference_spp, arguments.seed);
            Reference::obtain(opened, policy, arguments.reference_cache.as_deref(), stop, &bar.fraction_setter())
        }
    };
    bar.finish_and_clear();
    let reference = match reference {
        Err(headtail_eval::Error::Interrupted(when)) => {
            bail!(progress::Interrupted::new(format!("{when}; no run is done")))
        }
        other => other?,
    };
    if arguments.reference.is_none() {
        write_exr(&output.file("reference.exr")?, &reference.image, &reference.attributes())?;
    }
    Ok(reference)
}

/// Returns an error that names the first duplicate, if there is one.
fn check_different(what: &str, names: impl Iterator<Item = String>) -> Result<()> {
    let mut seen = std::collections::HashSet::new();
    for name in names {
        ensure!(seen.insert(name.clone()), "{what}: {name} is given twice");
    }
    Ok(())
}

/// Opens a sampler and measures its preparation, including the times recorded in its files.
fn prepare(
    spec: &SamplerSpec,
    device: Option<&GraphicsDevice>,
    (opened, budgets, stop): (&OpenedView, &[Budget], &AtomicBool),
) -> Result<(Entry, Preparation)> {
    let sampler = spec.to_string();
    note_use(spec)?;
    note_surfaces(spec, opened)?;
    let FilePreparation { seconds, text } = FilePreparation::of(spec)?;
    let busy = progress::busy(&sampler);
    let entry = Entry::open(&sampler, spec, seconds, (opened, device), (budgets, stop))?;
    drop(busy);
    let preparation = Preparation { sampler, seconds: entry.preparation(), text };
    Ok((entry, preparation))
}
