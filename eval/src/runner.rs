//! Measures an experiment view by view, skipping what the store holds.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
};

use headtail_render::statistics::sidak;

use crate::{
    Budget, Entry, Error, Experiment, GraphicsDevice, Measurement, MeasurementEnvironment, OpenedView, Plan, Reference,
    ReferencePolicy, Result, Store, ViewKey, Watch, engine,
    experiment::{self, SamplerEntry},
};

/// Factor by which the samples of a reference may grow.
const MOST_REFINEMENT: u32 = 16;
/// Probability of a false warning about a view.
const SIGNIFICANCE: f64 = 0.001;

/// Locations of an experiment's files, and limits.
pub struct RunOptions {
    /// Folder of maps and scenes.
    pub data: PathBuf,
    /// Cache folder for references and samplers' files.
    pub cache: PathBuf,
    /// The program `headtail`, which makes samplers' files.
    pub program: PathBuf,
    /// Maximum number of views; the first ones whose files exist.
    pub most_views: usize,
}

/// Result of an experiment.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Views measured by this call.
    pub measured: usize,
    /// Views measured earlier.
    pub known: usize,
    /// Views with missing files, or that a graphics device cannot render.
    pub missing: Vec<ViewKey>,
}

/// Measures the missing views of an experiment. Each view is stored when it is done, so that an interrupted
/// experiment resumes with the next one.
///
/// # Errors
/// If a view or a sampler cannot be opened, or the store cannot be written; [`Error::Interrupted`] if `stop`
/// is set.
pub fn run(
    experiment: &Experiment,
    store: &Store,
    options: &RunOptions,
    (stop, watch): (&AtomicBool, &(dyn Watch + Sync)),
) -> Result<Outcome> {
    let pool = pool(experiment)?;
    let mut outcome = Outcome::default();
    let records = store.records(&experiment.name)?;
    let is_measured = |key: &ViewKey, sampler: &SamplerEntry| {
        let own = records.iter().filter(|own| own.sampler == sampler.name && own.view() == *key);
        let wanted = |budget: &str| experiment.budgets.iter().any(|entry| entry.0.to_string() == budget);
        own.filter(|own| own.run < experiment.runs && wanted(&own.budget)).count()
            == experiment.budgets.len() * experiment.runs as usize
    };
    for key in experiment.view_keys() {
        if outcome.measured + outcome.known == options.most_views {
            break;
        }
        if !is_there(experiment, &key, options) {
            outcome.missing.push(key);
            continue;
        }
        let samplers: Vec<&SamplerEntry> =
            experiment.samplers_for(&key).filter(|sampler| !is_measured(&key, sampler)).collect();
        if samplers.is_empty() {
            outcome.known += 1;
            continue;
        }
        let measured = pool.install(|| measure_view(experiment, &key, &samplers, options, (stop, watch)));
        if let Err(error @ Error::NotOnDevice(_)) = &measured {
            watch.warning(&error.to_string());
            outcome.missing.push(key);
            continue;
        }
        let (measurements, environment) = measured?;
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted("while a view was measured; the same command goes on with it"));
        }
        store.add(&experiment.name, &measurements, &environment)?;
        outcome.measured += 1;
    }
    Ok(outcome)
}

/// Returns the thread pool of an experiment.
pub(crate) fn pool(experiment: &Experiment) -> Result<rayon::ThreadPool> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(experiment.threads).build();
    pool.map_err(|error| Error::argument("threads", error.to_string()))
}

/// Whether the files of a view exist.
pub(crate) fn is_there(experiment: &Experiment, key: &ViewKey, options: &RunOptions) -> bool {
    let scene = experiment.scene(&key.scene).map(|entry| entry.file.as_str());
    let map = experiment.map(&key.map).map(|entry| entry.file.as_str());
    [scene, map].into_iter().flatten().all(|file| experiment::is_there(file, &options.data))
}

/// A view with its samplers.
pub(crate) struct Opened {
    pub view: OpenedView,
    pub entries: Vec<Entry>,
    /// What the samplers are on, if the experiment is on a graphics device.
    device: Option<GraphicsDevice>,
}

/// Opens a view and its samplers. A sampler is skipped with a warning if its file cannot be made, or if a graphics
/// device does not have it.
pub(crate) fn open(
    experiment: &Experiment,
    key: &ViewKey,
    samplers: &[&SamplerEntry],
    options: &RunOptions,
    (stop, watch): (&AtomicBool, &dyn Watch),
) -> Result<Opened> {
    let settings = experiment.view(key, &options.data)?;
    let view = settings.open()?;
    let device = experiment.is_on_device.then(|| GraphicsDevice::open(&view)).transpose()?;
    let budgets: Vec<Budget> = experiment.budgets.iter().map(|entry| entry.0).collect();
    let mut entries = Vec::new();
    'samplers: for sampler in samplers {
        let (mut spec, mut preparation) = (sampler.spec.clone(), 0.0);
        for artifact in &experiment.artifacts {
            let name = format!("{{{}}}", artifact.name);
            if spec.contains(&name) {
                let made = artifact.obtain(&settings, &options.program, &options.cache);
                let (file, seconds) = match made {
                    Err(error) if !stop.load(Ordering::Relaxed) => {
                        watch.warning(&format!("{} is left out: {error}", sampler.name));
                        continue 'samplers;
                    }
                    made => made?,
                };
                spec = spec.replace(&name, &file.display().to_string());
                preparation += seconds;
            }
        }
        match Entry::open(&sampler.name, &spec.parse()?, preparation, (&view, device.as_ref()), (&budgets, stop)) {
            Err(error @ Error::NotOnDevice(_)) => watch.warning(&format!("{} is left out: {error}", sampler.name)),
            opened => entries.push(opened?),
        }
    }
    Ok(Opened { view, entries, device })
}

/// Returns the cache folder of references.
fn references(options: &RunOptions) -> PathBuf {
    options.cache.join("references")
}

/// Returns the reference of a view, from the cache if it holds it.
pub(crate) fn reference(
    experiment: &Experiment,
    view: &OpenedView,
    options: &RunOptions,
    stop: &AtomicBool,
) -> Result<Reference> {
    let policy = ReferencePolicy {
        most_samples: experiment.reference_samples.saturating_mul(MOST_REFINEMENT),
        ..ReferencePolicy::new(experiment.reference_samples, experiment.seed)
    };
    Reference::obtain(view, policy, Some(&references(options)), stop, &|_| {})
}

fn measure_view(
    experiment: &Experiment,
    key: &ViewKey,
    samplers: &[&SamplerEntry],
    options: &RunOptions,
    (stop, watch): (&AtomicBool, &(dyn Watch + Sync)),
) -> Result<(Vec<Measurement>, MeasurementEnvironment)> {
    watch.message(&format!("{}: {} under {}, {}", experiment.name, key.scene, key.map, key.material));
    let Opened { view, entries, device } = open(experiment, key, samplers, options, (stop, watch))?;
    let mut reference = reference(experiment, &view, options, stop)?;
    let plan = Plan {
        scene: key.scene.clone(),
        env: key.map.clone(),
        material: key.material.clone(),
        budgets: experiment.budgets.iter().map(|entry| entry.0).collect(),
        runs: experiment.runs,
        seed: experiment.seed,
        cache: Some(references(options)),
    };
    let measured = engine::measure(&view, &entries, &mut reference, &plan, (stop, watch), &mut |_| Ok::<_, Error>(()))?;
    // Samplers are independent techniques, so each must have the reference's mean in every tile.
    let level = sidak(SIGNIFICANCE, measured.len());
    for own in measured.iter().filter(|own| own.tile_p < level) {
        watch.warning(&format!(
            "{} under {}, {}: {} at {} differs from the reference in a tile (p = {:.1e}, level {level:.1e})",
            own.scene, own.env, own.material, own.sampler, own.budget, own.tile_p
        ));
    }
    let on_device = device.map(|device| MeasurementEnvironment::of_device(device.name()));
    Ok((measured, on_device.unwrap_or_else(MeasurementEnvironment::current)))
}
