//! Measurements of samplers.

use std::{
    cell::Cell,
    panic::resume_unwind,
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use headtail_eval::{Budget, Entry, FilePreparation, Noise, OpenedView, Plan, Reference, ReferencePolicy, measure};
use headtail_render::spec::Source;
use numpy::{PyReadonlyArray3, ToPyArray, ndarray::Array2};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    environment::{Environment, array_of},
    error::{of_eval, refused},
    render::{Scene, ViewArguments, Watch, budget},
    sampler::Sampler,
};

/// Interval for handling signals.
const POLL: Duration = Duration::from_millis(50);

/// Measures samplers: returns the runs as a JSON array of `Measurement`s, and the fields of the `Reference`.
///
/// `reference` is a picture to use instead, with its MSE and relMSE, NaN if unknown.
#[pyfunction]
#[pyo3(signature = (scene, environment, samplers, view, spp, seconds, runs, seed, reference_spp, reference, progress))]
#[expect(clippy::too_many_arguments, reason = "the settings of one comparison")]
pub fn compare<'py>(
    py: Python<'py>,
    scene: &Scene,
    environment: &Environment,
    samplers: Vec<Py<Sampler>>,
    view: ViewArguments,
    spp: Vec<u32>,
    seconds: Vec<f64>,
    runs: u32,
    seed: u64,
    reference_spp: u32,
    reference: Option<(PyReadonlyArray3<'py, f32>, [f64; 2])>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, Bound<'py, PyDict>)> {
    let samples = spp.into_iter().map(|spp| budget(Some(spp), None));
    let budgets =
        samples.chain(seconds.into_iter().map(|seconds| budget(None, Some(seconds)))).collect::<PyResult<Vec<_>>>()?;
    let view = view.open(scene, environment.0.clone(), 4 + 2 * samplers.len() * budgets.len())?;
    let (env, material) = (view.light_name(), scene.material.clone());
    let plan = Plan { scene: view.scene_name(), env, material, budgets, runs, seed, cache: None };
    if plan.count(samplers.len()) == 0 || reference_spp == 0 {
        return Err(refused("compare: needs a sampler, a budget, a run and a sample of the reference"));
    }
    let (width, height) = (view.part().width, view.part().height);
    let given = reference.map(|(image, errors)| PyResult::Ok((image.as_slice()?.as_chunks().0.to_vec(), errors)));
    let given = given.transpose()?;
    let watch = Watch::new(progress);
    let measured = py.detach(|| {
        watch_over(&watch, |fraction| {
            let place = (&plan.budgets[..], &watch.stop);
            let entries =
                samplers.iter().map(|sampler| entry(sampler.get(), &view, place)).collect::<PyResult<Vec<_>>>()?;
            // For a given picture, a short rendering finds the covered pixels.
            let policy = ReferencePolicy::new(if given.is_some() { 64 } else { reference_spp }, seed);
            let mut reference = Reference::render(&view, policy, &watch.stop, &|_| {}).map_err(of_eval)?;
            if let Some((pixels, [mse, relmse])) = given {
                reference.image.pixels = pixels;
                (reference.noise, reference.samples) = ((!mse.is_nan()).then_some(Noise { mse, relmse }), 0);
            }
            let progress = Progress { planned: Cell::new(f64::NAN), fraction };
            let rows = measure(&view, &entries, &mut reference, &plan, (&watch.stop, &progress), &mut |_| Ok(()));
            Ok((rows.map_err(of_eval)?, reference))
        })
    });
    let (rows, reference) = watch.result(measured)?;
    let rows = serde_json::to_string(&rows).map_err(|error| refused(error.to_string()))?;
    let covered = Array2::from_shape_vec((height, width), reference.covered);
    let noise = reference.noise.unwrap_or(Noise { mse: f64::NAN, relmse: f64::NAN });
    let result = PyDict::new(py);
    result.set_item("image", array_of(py, (height, width), &reference.image.pixels)?)?;
    result.set_item("covered", covered.map_err(|error| refused(error.to_string()))?.to_pyarray(py))?;
    result.set_item("spp", reference.samples)?;
    result.set_item("mse", noise.mse)?;
    result.set_item("relmse", noise.relmse)?;
    Ok((rows, result))
}

/// Builds a sampler. Its preparation includes the time to build it here and the times in its files.
fn entry(sampler: &Sampler, view: &OpenedView, place: (&[Budget], &AtomicBool)) -> PyResult<Entry> {
    if let Some(spec) = sampler.spec.as_ref().filter(|spec| *spec.source() == Source::Auto) {
        return Entry::open(&sampler.name, spec, 0.0, (view, None), place).map_err(of_eval);
    }
    let start = Instant::now();
    let estimator = sampler.estimator(view)?;
    let built = start.elapsed().as_secs_f64();
    let files = match (&sampler.spec, &sampler.exported) {
        (Some(spec), _) => FilePreparation::of(spec).map_err(of_eval)?.seconds,
        (None, Some(exported)) => FilePreparation::of_exported(exported).seconds,
        (None, None) => 0.0,
    };
    Ok(Entry::prepared(&sampler.name, estimator, built + files))
}

/// Runs `work` on another thread while this one, possibly Python's main thread, handles signals. `work`
/// stores the bits of the completed fraction.
fn watch_over<T: Send>(watch: &Watch, work: impl FnOnce(&AtomicU64) -> T + Send) -> T {
    let fraction = AtomicU64::new(0);
    thread::scope(|scope| {
        let (ended, end) = channel::<()>();
        let worker = scope.spawn(|| {
            let _ended = ended;
            work(&fraction)
        });
        let mut is_running = true;
        while is_running {
            is_running = end.recv_timeout(POLL) == Err(RecvTimeoutError::Timeout);
            watch.tell(f64::from_bits(fraction.load(Ordering::Relaxed)));
        }
        worker.join().unwrap_or_else(|panic| resume_unwind(panic))
    })
}

/// Tracks the completed fraction of the planned time.
struct Progress<'a> {
    planned: Cell<f64>,
    fraction: &'a AtomicU64,
}

impl headtail_eval::Watch for Progress<'_> {
    fn planned(&self, seconds: f64) {
        self.planned.set(seconds);
    }

    fn spent(&self, seconds: f64) {
        self.fraction.store((seconds / self.planned.get()).min(1.0).to_bits(), Ordering::Relaxed);
    }

    fn warning(&self, text: &str) {
        eprintln!("warning: {text}");
    }
}
