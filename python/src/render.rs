//! The native renderer.

use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicBool, Ordering},
};

use headtail_eval::{Budget, CameraSettings, OpenedView, choose};
use headtail_render::{
    environment, memory,
    points::PointSet,
    remark::Remark,
    scene::{self, MaterialSpec},
    spec::Source,
};
use numpy::{PyArray3, ToPyArray, ndarray::Array2};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    environment::{array_of, remarks},
    error::{of_eval, of_render, refused},
    sampler::Sampler,
};

/// A scene.
#[pyclass(frozen, module = "headtail._native")]
pub struct Scene {
    scene: Arc<scene::Scene>,
    /// The material of every surface; empty for the scene's own.
    pub material: String,
    remarks: Vec<Remark>,
}

#[pymethods]
impl Scene {
    #[staticmethod]
    fn open(
        py: Python<'_>,
        name_or_path: &str,
        material: Option<&str>,
        ground: bool,
        camera: Option<&str>,
    ) -> PyResult<Self> {
        py.detach(|| {
            let spec: Option<MaterialSpec> = material.map(str::parse).transpose()?;
            let is_dressed = spec.as_ref().is_some_and(MaterialSpec::is_for_all);
            let mut scene = scene::Scene::open_dressed(name_or_path, !is_dressed)?;
            let remarks = scene.remarks().to_vec();
            if let Some(name) = camera {
                scene.use_camera(name)?;
            }
            let bounds = scene.bounds();
            if ground {
                scene.add_ground();
            }
            if let Some(spec) = spec {
                scene = spec.dress(scene, &bounds)?;
            }
            Ok(Self { scene: Arc::new(scene), material: material.unwrap_or_default().to_owned(), remarks })
        })
        .map_err(of_render)
    }

    #[getter]
    fn name(&self) -> String {
        self.scene.name().to_owned()
    }

    #[getter]
    fn triangle_count(&self) -> usize {
        self.scene.triangle_count()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        remarks(&self.remarks, false)
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        remarks(&self.remarks, true)
    }

    /// Returns the vertices of all triangles, `[triangles, 3, 3]`.
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let vertices: Vec<[f32; 3]> = self.scene.triangles().flatten().map(Into::into).collect();
        array_of(py, (vertices.len() / 3, 3), &vertices)
    }

    /// Returns position, target and vertical field of view in degrees of the camera.
    #[getter]
    fn camera(&self) -> ([f32; 3], [f32; 3], f32) {
        let camera = self.scene.camera();
        (camera.look_from().into(), camera.look_at().into(), camera.vertical_fov())
    }

    #[getter]
    fn is_diffuse(&self) -> bool {
        self.scene.is_diffuse()
    }
}

/// The view arguments of `render` and `compare`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct ViewArguments {
    width: u32,
    height: u32,
    points: String,
    depth: u32,
    unshadowed: bool,
    look_from: Option<[f32; 3]>,
    look_at: Option<[f32; 3]>,
    fov: Option<f32>,
}

impl ViewArguments {
    /// Opens a scene under a map; `kept` finished pictures must fit into memory in addition to the current
    /// one.
    pub fn open(&self, scene: &Scene, map: Arc<environment::Environment>, kept: usize) -> PyResult<OpenedView> {
        let Self { width, height, look_from, look_at, fov, ref points, .. } = *self;
        let points: PointSet = points.parse().map_err(|error| refused(format!("points '{points}': {error}")))?;
        let size = (width as usize, height as usize);
        memory::require_pictures(size.0, size.1, kept).map_err(of_render)?;
        let camera = CameraSettings { width, height, look_from, look_at, fov }.open(&scene.scene).map_err(of_eval)?;
        let mut view = OpenedView::new(scene.scene.clone(), camera, map, size);
        (view.points, view.depth, view.unshadowed) = (points, self.depth, self.unshadowed);
        Ok(view)
    }
}

/// Returns the budget; exactly one kind must be given.
pub fn budget(spp: Option<u32>, seconds: Option<f64>) -> PyResult<Budget> {
    match (spp, seconds) {
        (Some(spp), None) if spp > 0 => Ok(Budget::Samples(spp)),
        (None, Some(seconds)) if seconds > 0.0 && seconds <= 1e6 => Ok(Budget::Seconds(seconds)),
        _ => Err(refused("budget: give one of spp, at least 1, and seconds, between 0 and 1e6")),
    }
}

#[pyfunction]
#[pyo3(signature = (scene, sampler, view, spp, seconds, seed, progress))]
#[expect(clippy::too_many_arguments, reason = "the settings of one picture")]
pub fn render<'py>(
    py: Python<'py>,
    scene: &Scene,
    sampler: &Sampler,
    view: ViewArguments,
    spp: Option<u32>,
    seconds: Option<f64>,
    seed: u64,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (budget, view) = (budget(spp, seconds)?, view.open(scene, sampler.map.clone(), 0)?);
    let (points, watch) = (view.points(seed), Watch::new(progress));
    let rendering = py.detach(|| {
        let (spec, estimator) = match &sampler.spec {
            Some(spec) if *spec.source() == Source::Auto => {
                let choice = choose(&view, budget, &watch.stop).map_err(of_eval)?;
                (choice.spec.to_string(), choice.estimator)
            }
            _ => (sampler.name.clone(), sampler.estimator(&view)?),
        };
        let rendering = view.render(&*estimator, budget, points, &watch.stop, &|fraction| watch.tell(fraction));
        PyResult::Ok((spec, rendering))
    });
    let (spec, rendering) = watch.result(rendering)?;
    let (height, width) = (view.part().height, view.part().width);
    let result = PyDict::new(py);
    result.set_item("image", array_of(py, (height, width), &rendering.composite().pixels)?)?;
    let coverage = Array2::from_shape_vec((height, width), rendering.coverage);
    let coverage = coverage.map_err(|error| refused(error.to_string()))?;
    result.set_item("coverage", coverage.to_pyarray(py))?;
    result.set_item("sampler", spec)?;
    result.set_item("spp", rendering.spp)?;
    result.set_item("seconds", rendering.seconds)?;
    result.set_item("rays_per_sample", rendering.rays_per_sample)?;
    Ok(result)
}

/// Stops work after Ctrl-C, and calls back with its progress.
pub struct Watch {
    callback: Option<Py<PyAny>>,
    /// Set after Ctrl-C or an exception of the callback.
    pub stop: AtomicBool,
    raised: Mutex<Option<PyErr>>,
}

impl Watch {
    pub fn new(callback: Option<Py<PyAny>>) -> Self {
        Self { callback, stop: AtomicBool::new(false), raised: Mutex::new(None) }
    }

    /// Handles signals, and calls back with the completed fraction until an exception is raised.
    pub fn tell(&self, fraction: f64) {
        let callback = self.callback.as_ref().filter(|_| !self.stop.load(Ordering::Relaxed));
        let result = Python::attach(|py| {
            py.check_signals()?;
            callback.map_or(Ok(()), |callback| callback.call1(py, (fraction,)).map(|_| ()))
        });
        if let Err(error) = result {
            *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            self.stop.store(true, Ordering::Relaxed);
        }
    }

    /// Returns the exception that stopped the work, or else its result.
    pub fn result<T>(self, result: PyResult<T>) -> PyResult<T> {
        self.raised.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(result, Err)
    }
}
