//! Time of one light estimate.

use std::sync::{Arc, atomic::AtomicBool};

use headtail_render::{
    environment::Environment,
    estimator::Estimator,
    points::{PointSet, Points},
    scene::{MaterialSpec, Scene},
};

use crate::{Budget, Error, OpenedView, Result};

/// Width and height of the picture in pixels.
const SIDE: usize = 96;
const SAMPLES: u32 = 16;
const RENDERINGS: usize = 3;

/// Returns the nanoseconds of a light estimate on one thread, camera rays included: the time of a picture of
/// the scene `sphere` with one material and no shadow rays, divided by its estimates; the minimum of three
/// pictures.
///
/// # Errors
/// If the material does not fit the scene, or no thread can be started.
pub fn nanoseconds_per_sample(
    estimator: &dyn Estimator,
    environment: &Arc<Environment>,
    material: &MaterialSpec,
) -> Result<f64> {
    let scene = Scene::open("sphere")?;
    let (bounds, camera) = (scene.bounds(), scene.camera());
    let scene = Arc::new(material.dress(scene, &bounds)?);
    let mut view = OpenedView::new(scene, camera, environment.clone(), (SIDE, SIDE));
    view.unshadowed = true;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = pool.map_err(|error| Error::argument("threads", error.to_string()))?;
    let points = Points::new(PointSet::Sobol, 1);
    let times = (0..RENDERINGS).map(|_| {
        let never = AtomicBool::new(false);
        let rendering = pool.install(|| view.render(estimator, Budget::Samples(SAMPLES), points, &never, &|_| {}));
        let estimates = f64::from(rendering.coverage.iter().sum::<f32>()) * f64::from(SAMPLES);
        1e9 * rendering.seconds / estimates
    });
    Ok(times.fold(f64::INFINITY, f64::min))
}
