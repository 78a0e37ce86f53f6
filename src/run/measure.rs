//! What is measured of a trained sampler, as figures by name.

use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

use anyhow::{Context, Result};
use headtail_render::{
    environment::Environment,
    estimator::Estimator,
    image::Image,
    integrator::{Budget, View},
    points::{PointSet, Points},
    scene::{MaterialSpec, Scene},
    spec::SamplerSpec,
    statistics::ErrorMetrics,
};
use headtail_train::Material;

use super::view::MeasuredView;
use crate::{
    compare::{self, Reference},
    render::quietly,
};

/// Figures by name: `kl`, `mse:temple`, ...
pub type Measures = BTreeMap<String, f64>;

/// Edge of the picture that is timed, in pixels.
const TIMED_SIDE: usize = 96;
const TIMED_SPP: u32 = 16;
const TIMINGS: usize = 3;

/// Nanoseconds of a light estimate on one thread: the time of a picture of the scene `sphere` without shadow rays over its estimates, camera
/// rays included; the least of three pictures.
pub fn nanoseconds_per_sample(
    estimator: &dyn Estimator,
    environment: &Arc<Environment>,
    material: Material,
) -> Result<f64> {
    let scene = Scene::open("sphere")?;
    let bounds = scene.bounds();
    let camera = scene.camera();
    let scene = material.to_string().parse::<MaterialSpec>()?.dress(scene, &bounds)?;
    let view = View {
        scene: &scene,
        camera: &camera,
        environment,
        width: TIMED_SIDE,
        height: TIMED_SIDE,
        unshadowed: true,
        depth: 1,
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("a thread for timings")?;
    let points = Points::new(PointSet::Sobol, 1);
    let times = (0..TIMINGS).map(|_| {
        let rendering = pool.install(|| quietly(view, estimator, Budget::Spp(TIMED_SPP), points));
        let estimates = f64::from(rendering.coverage.iter().sum::<f32>()) * f64::from(TIMED_SPP);
        1e9 * rendering.seconds / estimates
    });
    Ok(times.fold(f64::INFINITY, f64::min))
}

/// Mean squared errors of a picture over the pixels that surfaces cover entirely: `mse:NAME` at equal samples and
/// `mse_at_time:NAME` at equal time.
///
/// # Errors
/// If the scene or the sampler's file cannot be opened, or the reference not be rendered.
pub fn errors_of_view(
    measured: &MeasuredView,
    env: &str,
    material: Material,
    spec: &SamplerSpec,
    cache: &Path,
) -> Result<Measures> {
    let view = measured.view(env, material)?;
    let opened = view.open()?;
    let estimator = opened.estimator(spec)?;
    let reference = Reference::shared(&view, &opened, measured.reference_spp, cache)?;
    let truth = compare::select(&reference.image, &reference.covered);
    let error = |budget: Budget| -> Result<f64> {
        let mut sum = 0.0;
        for run in 0..measured.runs {
            let points = opened.points(budget, 1 + u64::from(run));
            let rendering = quietly(opened.view(), &*estimator, budget, points);
            let pixels: Image = compare::select(&rendering.surfaces, &reference.covered);
            sum += ErrorMetrics::of(&pixels, &truth)?.mse;
        }
        Ok(sum / f64::from(measured.runs))
    };
    let mut measures = Measures::new();
    if let Some(spp) = measured.spp {
        measures.insert(format!("mse:{}", measured.name()), error(Budget::Spp(spp))?);
    }
    if let Some(seconds) = measured.seconds {
        let budget = Budget::Time(Duration::from_secs_f64(seconds));
        measures.insert(format!("mse_at_time:{}", measured.name()), error(budget)?);
    }
    Ok(measures)
}
