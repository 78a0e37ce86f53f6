//! Pictures of the native renderer.

use std::sync::{
    Mutex,
    atomic::{AtomicBool, Ordering},
};
use std::time::Duration;

use glam::Vec3A;
use headtail_render::{
    image::Image,
    integrator::{self, Budget, View},
    memory,
    points::{PointSet, Points},
    scene::{self, Camera, MaterialSpec},
    statistics::ErrorMetrics,
};
use numpy::{PyArray3, PyReadonlyArray2, ToPyArray, ndarray::Array2};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    environment::array_of,
    error::{of_render, refused},
    sampler::{Sampler, rows},
};

/// A scene.
#[pyclass(frozen, module = "headtail._native")]
pub struct Scene {
    scene: scene::Scene,
    camera: Camera,
}

#[pymethods]
impl Scene {
    #[staticmethod]
    fn open(py: Python<'_>, name_or_path: &str, material: Option<&str>, ground: bool) -> PyResult<Self> {
        py.detach(|| {
            let material: Option<MaterialSpec> = material.map(str::parse).transpose()?;
            let mut scene = scene::Scene::open(name_or_path)?;
            // The camera frames the scene as it is, not the wide plane below it.
            let (camera, bounds) = (scene.camera(), scene.bounds());
            if ground {
                scene.add_ground();
            }
            if let Some(material) = material {
                scene = material.dress(scene, &bounds)?;
            }
            Ok(Self { scene, camera })
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

    /// The vertices of all triangles, `[triangles, 3, 3]`.
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let vertices: Vec<[f32; 3]> = self.scene.triangles().flatten().map(Into::into).collect();
        array_of(py, (vertices.len() / 3, 3), &vertices)
    }

    /// Position, target and vertical field of view in degrees of the camera.
    #[getter]
    fn camera(&self) -> ([f32; 3], [f32; 3], f32) {
        (self.camera.look_from().into(), self.camera.look_at().into(), self.camera.vertical_fov())
    }

    #[getter]
    fn is_diffuse(&self) -> bool {
        self.scene.is_diffuse()
    }
}

/// The camera of a call: what is not given is as in the scene's own.
fn camera(
    scene: &Scene,
    from: Option<[f32; 3]>,
    at: Option<[f32; 3]>,
    fov: Option<f32>,
) -> headtail_render::Result<Camera> {
    let own = &scene.camera;
    let point = |given: Option<[f32; 3]>, own: Vec3A| given.map_or(own, Vec3A::from_array);
    Camera::new(point(from, own.look_from()), point(at, own.look_at()), fov.unwrap_or(own.vertical_fov()))
}

fn budget(spp: Option<u32>, seconds: Option<f64>) -> PyResult<Budget> {
    match (spp, seconds) {
        (Some(spp), None) if spp > 0 => Ok(Budget::Spp(spp)),
        (None, Some(seconds)) if seconds > 0.0 && seconds <= 1e6 => Ok(Budget::Time(Duration::from_secs_f64(seconds))),
        _ => Err(refused("budget: give one of spp, at least 1, and seconds, between 0 and 1e6")),
    }
}

#[pyfunction]
#[pyo3(signature = (scene, sampler, size, spp, seconds, points, seed, depth, unshadowed, look_from, look_at, fov, progress))]
#[expect(clippy::too_many_arguments, reason = "the settings of one picture")]
pub fn render<'py>(
    py: Python<'py>,
    scene: &Scene,
    sampler: &Sampler,
    size: [usize; 2],
    spp: Option<u32>,
    seconds: Option<f64>,
    points: &str,
    seed: u64,
    depth: u32,
    unshadowed: bool,
    look_from: Option<[f32; 3]>,
    look_at: Option<[f32; 3]>,
    fov: Option<f32>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let [width, height] = size;
    if !(1..=1 << 14).contains(&width) || !(1..=1 << 14).contains(&height) {
        return Err(refused(format!("size: {width} x {height} is not between 1 and 16384")));
    }
    memory::require_pictures(width, height, 0).map_err(of_render)?;
    if !sampler.has_map {
        return Err(refused("sampler: was opened without its map"));
    }
    let points: PointSet =
        points.parse().map_err(|_| refused(format!("points '{points}': choose sobol, zsobol:N or independent")))?;
    let (budget, camera) = (budget(spp, seconds)?, camera(scene, look_from, look_at, fov).map_err(of_render)?);
    let view =
        View { scene: &scene.scene, camera: &camera, environment: &sampler.map, width, height, unshadowed, depth };
    let (stop, raised) = (AtomicBool::new(false), Mutex::new(None));
    let show = Watch { callback: progress, stop: &stop, raised: &raised };
    let rendering = py.detach(|| {
        let estimator = sampler.estimator()?;
        Ok(integrator::render(view, &*estimator, budget, Points::new(points, seed), &stop, &|spent| show.tell(spent)))
    });
    let rendering = rendering.map_err(of_render)?;
    if let Some(error) = raised.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
        return Err(error);
    }
    let result = PyDict::new(py);
    result.set_item("image", array_of(py, (height, width), &rendering.composite().pixels)?)?;
    let coverage = Array2::from_shape_vec((height, width), rendering.coverage);
    let coverage = coverage.map_err(|error| refused(error.to_string()))?;
    result.set_item("coverage", coverage.to_pyarray(py))?;
    result.set_item("spp", rendering.spp)?;
    result.set_item("seconds", rendering.seconds)?;
    result.set_item("rays_per_sample", rendering.rays_per_sample)?;
    Ok(result)
}

/// Lets Python look after a pass: Ctrl-C, and a callback.
struct Watch<'a> {
    callback: Option<Py<PyAny>>,
    stop: &'a AtomicBool,
    raised: &'a Mutex<Option<PyErr>>,
}

impl Watch<'_> {
    fn tell(&self, spent: f64) {
        let result = Python::attach(|py| {
            py.check_signals()?;
            self.callback.as_ref().map_or(Ok(()), |callback| callback.call1(py, (spent,)).map(|_| ()))
        });
        if let Err(error) = result {
            *self.raised.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(error);
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

/// Errors of an image against a reference, both as rows of pixels: MSE, relMSE, trimmed relMSE.
#[pyfunction]
pub fn errors(image: PyReadonlyArray2<'_, f32>, reference: PyReadonlyArray2<'_, f32>) -> PyResult<[f64; 3]> {
    let list = |pixels: &[[f32; 3]]| Image { width: pixels.len(), height: 1, pixels: pixels.to_vec() };
    let (image, reference) = (list(rows(&image)?), list(rows(&reference)?));
    if image.width != reference.width || image.width == 0 {
        return Err(refused(format!("image: has {} pixels, the reference {}", image.width, reference.width)));
    }
    let metrics = ErrorMetrics::of(&image, &reference).map_err(of_render)?;
    Ok([metrics.mse, metrics.relmse, metrics.relmse_trimmed])
}
