//! Measures the times of stored measurements again, in minutes: their errors are those of pictures, which changed
//! sources [may render the same](crate::verify); their times are not.

use std::{
    collections::HashMap,
    sync::atomic::{AtomicBool, Ordering},
};

use crate::{
    Budget, Entry, Error, Experiment, MeasurementEnvironment, OpenedView, Record, Renderer, Result, RunOptions, Store,
    ViewKey, Watch,
    clock::with_processor_seconds,
    experiment::SamplerEntry,
    runner::{self, Opened},
    store::rounded,
};

/// Renderings of each sampler at each budget, in turn: the shortest counts, since other work only adds to it.
const ROUNDS: u64 = 5;
/// Samples per pixel of a rendering, at most: they are about as long as those of more samples, which have passes of 16.
const SAMPLES: u32 = 8;
/// Largest relative difference of rays per sample between pictures of the same sampler: `auto` may choose another one.
const RAYS: f64 = 0.05;

/// Result of a [`retime`].
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Retiming {
    /// Measurements with times of the current sources.
    pub timed: usize,
    /// Measurements with earlier times: of views with missing files, and where `auto` chose another sampler.
    pub left: usize,
}

/// Times of a sampler at a budget.
#[derive(Clone, Copy, Debug)]
struct Times {
    /// Wall-clock and processor seconds of a sample of all pixels, and seconds of preparation.
    sample: f64,
    processor: f64,
    preparation: f64,
    rays_per_sample: f64,
}

/// Replaces seconds and preparation of the measurements for which `is_valid`, by renderings of a few samples; they become
/// measurements of the current sources, whose times stay. Each view is stored when it is done, and the same call resumes.
///
/// # Errors
/// If a view or a sampler cannot be opened, or the store cannot be written; [`Error::Interrupted`] if `stop` is set.
pub fn retime(
    experiment: &Experiment,
    store: &Store,
    options: &RunOptions,
    is_valid: &dyn Fn(&Record) -> bool,
    (stop, watch): (&AtomicBool, &(dyn Watch + Sync)),
) -> Result<Retiming> {
    let pool = runner::pool(experiment)?;
    let id = store.id_of(&pool.install(MeasurementEnvironment::current))?;
    let is_mine = |own: &Record, key: &ViewKey| own.view() == *key && own.environment != id && is_valid(own);
    for key in experiment.view_keys() {
        let records = store.records(&experiment.name)?;
        if !records.iter().any(|own| is_mine(own, &key)) || !runner::is_there(experiment, &key, options) {
            continue;
        }
        watch.message(&format!("{}: {} under {}, {}", experiment.name, key.scene, key.map, key.material));
        let samplers: Vec<&SamplerEntry> = experiment.samplers_for(&key).collect();
        let mine: Vec<&Record> = records.iter().filter(|own| is_mine(own, &key)).collect();
        let times = pool.install(|| {
            let Opened { view, entries, .. } = runner::open(experiment, &key, &samplers, options, (stop, watch))?;
            let budgets: Vec<Budget> = experiment.budgets.iter().map(|entry| entry.0).collect();
            times(&view, &entries, &budgets, &mine, stop)
        })?;
        store.update(&experiment.name, |own| {
            let new = times.get(&(own.sampler.clone(), own.budget.clone())).filter(|_| is_mine(own, &key));
            if let Some(new) = new.filter(|new| (new.rays_per_sample / own.rays_per_sample - 1.0).abs() < RAYS) {
                own.seconds = rounded(own.spp * new.sample);
                own.processor_seconds = rounded(own.spp * new.processor);
                own.preparation = rounded(new.preparation);
                own.environment.clone_from(&id);
            }
        })?;
    }
    let records = store.records(&experiment.name)?;
    let timed = records.iter().filter(|own| own.environment == id).count();
    Ok(Retiming { timed, left: records.len() - timed })
}

/// Renderings that have one time per sample.
struct Job<'a> {
    sampler: &'a str,
    budgets: Vec<Budget>,
    renderer: &'a dyn Renderer,
    samples: u32,
    times: Times,
}

/// Returns the times by sampler and budget of measured `records`. A sampler that learns visibility learns more for more samples,
/// which changes their time, so that it renders as many as were measured.
fn times(
    view: &OpenedView,
    entries: &[Entry],
    budgets: &[Budget],
    records: &[&Record],
    stop: &AtomicBool,
) -> Result<HashMap<(String, String), Times>> {
    let samples_of = |sampler: &str, budget: Budget| {
        let own = records.iter().find(|own| own.sampler == sampler && own.budget == budget.to_string());
        own.map(|own| own.spp as u32)
    };
    let mut jobs: Vec<Job<'_>> = Vec::new();
    for entry in entries {
        for &budget in budgets {
            let Some(most) = samples_of(&entry.name, budget) else { continue };
            let (renderer, preparation) = entry.at(budget);
            let (learns, _) = timed(view, renderer, 1, 0, stop)?;
            let known = jobs.iter_mut().find(|job| job.sampler == entry.name);
            if let (Some(job), false, false) = (known, learns, entry.is_chosen_by_clock(budget)) {
                job.budgets.push(budget);
                continue;
            }
            let samples = if learns { most } else { most.min(SAMPLES) };
            let times = Times { sample: f64::INFINITY, processor: f64::INFINITY, preparation, rays_per_sample: 0.0 };
            jobs.push(Job { sampler: &entry.name, budgets: vec![budget], renderer, samples, times });
        }
    }
    for round in 1..=ROUNDS {
        for job in &mut jobs {
            let (_, new) = timed(view, job.renderer, job.samples, round, stop)?;
            job.times.sample = job.times.sample.min(new.sample);
            job.times.processor = job.times.processor.min(new.processor);
            job.times.rays_per_sample = new.rays_per_sample;
        }
    }
    let mut found = HashMap::new();
    for job in jobs {
        found.extend(job.budgets.iter().map(|budget| ((job.sampler.to_owned(), budget.to_string()), job.times)));
    }
    Ok(found)
}

/// Renders some samples per pixel: whether the sampler learned visibility, and the times.
fn timed(
    view: &OpenedView,
    renderer: &dyn Renderer,
    samples: u32,
    seed: u64,
    stop: &AtomicBool,
) -> Result<(bool, Times)> {
    if stop.load(Ordering::Relaxed) {
        return Err(Error::Interrupted("while a view was timed; the same command goes on with it"));
    }
    let (budget, points) = (Budget::Samples(samples), view.points(seed));
    let (rendering, used) = with_processor_seconds(|| view.render_by(renderer, budget, points, stop, &|_| {}));
    let rendering = rendering?;
    let [sample, processor] =
        [rendering.seconds, used.unwrap_or(f64::NAN)].map(|seconds| seconds / f64::from(rendering.spp));
    let times = Times { sample, processor, preparation: 0.0, rays_per_sample: rendering.rays_per_sample };
    Ok((rendering.learned.is_some(), times))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    const EXPERIMENT: &str = "
        question = 'How long?'\nwidth = 64\nheight = 48\nbudgets = ['4spp']\nruns = 2\nthreads = 2\nreference_samples = 16
        scenes = [{ name = 'ball', file = 'sphere', tuned = true }]
        maps = [{ name = 'lamps', file = 'studio', kind = 'lamps', tuned = true }]
        materials = [{ name = 'diffuse', spec = 'lambert' }]
        views = [{ scenes = ['ball'], maps = ['lamps'], materials = ['diffuse'] }]
        samplers = [{ name = 'mis', spec = 'mis' }, { name = 'other', spec = 'patches' }]
        [quick]\nviews = 1\nwidth = 64\nheight = 48\nbudgets = ['4spp']\nruns = 1\n";

    #[test]
    fn times_are_new_and_errors_stay() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("short.toml");
        std::fs::write(&file, EXPERIMENT).unwrap();
        let (experiment, store) = (Experiment::open(&file).unwrap(), Store::new(folder.path()));
        let options = RunOptions {
            data: folder.path().to_owned(),
            cache: folder.path().join("cache"),
            program: PathBuf::new(),
            most_views: 1,
        };
        let stop = AtomicBool::new(false);
        crate::run(&experiment, &store, &options, (&stop, &())).unwrap();
        // A slow machine with other sources measured; one record is of another sampler.
        let disturbed = |own: &mut Record| {
            (own.seconds, own.environment) = (1e3, "e0".to_owned());
            own.rays_per_sample *= if own.sampler == "other" && own.run == 1 { 2.0 } else { 1.0 };
        };
        store.update("short", disturbed).unwrap();
        let before = store.records("short").unwrap();
        let none = retime(&experiment, &store, &options, &|_| false, (&stop, &())).unwrap();
        // Some fields are NaN, which equals nothing.
        let text = |records: &[Record]| format!("{records:?}");
        assert_eq!(none, Retiming { timed: 0, left: 4 });
        assert_eq!(text(&store.records("short").unwrap()), text(&before));
        let found = retime(&experiment, &store, &options, &|_| true, (&stop, &())).unwrap();
        assert_eq!(found, Retiming { timed: 3, left: 1 });
        let after = store.records("short").unwrap();
        for (old, new) in before.iter().zip(&after) {
            assert_eq!(
                (old.mse, old.spp, old.seed, old.rays_per_sample),
                (new.mse, new.spp, new.seed, new.rays_per_sample)
            );
            let is_other = old.sampler == "other" && old.run == 1;
            assert_eq!(is_other, new.seconds == 1e3 && new.environment == "e0", "{new:?}");
            assert!(is_other || new.seconds > 0.0 && new.seconds < 100.0, "{new:?}");
        }
        // Runs of one sampler have one time per sample.
        assert_eq!(after[0].seconds, after[1].seconds);
        // What is timed is not timed again.
        store
            .update("short", |own| {
                own.rays_per_sample = if own.environment == "e0" { 1e3 } else { own.rays_per_sample }
            })
            .unwrap();
        let known = store.records("short").unwrap();
        retime(&experiment, &store, &options, &|_| true, (&stop, &())).unwrap();
        assert_eq!(text(&store.records("short").unwrap()), text(&known));
    }
}
