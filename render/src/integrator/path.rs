//! Paths: light that reaches a surface over other surfaces, with the light estimate of any sampler at every bounce.

use glam::Vec3A;

use super::{
    direct::View,
    estimator::{DirectEstimator, Estimate, Visibility},
    timings::{Stage, timed},
};
use crate::{
    random::{Stream, Streams},
    sampler::ShadingPoint,
    scene::Ray,
};

/// From this bounce on, paths end at random.
const ROULETTE_FROM: u32 = 3;

/// The largest chance to go on: also a path between white walls ends.
const MOST_SURVIVAL: f32 = 0.95;

/// A path that goes on.
#[derive(Clone, Copy)]
struct Path {
    /// Which of the first hits it began at.
    index: usize,
    throughput: Vec3A,
}

/// Light reflected at each of `hits`: from the environment directly, and over up to `view.depth - 1` further surfaces. The stream of hit
/// `k` is `streams[of[k]]`.
///
/// Directions are continued by BRDF sampling. A path that leaves the scene adds nothing: the estimator at its last surface
/// stands for all light from the environment. All paths make a bounce before any makes the next, so that samplers get batches.
pub(super) fn reflected(
    view: &View<'_>,
    estimator: &dyn DirectEstimator,
    visibility: &dyn Visibility,
    hits: &[ShadingPoint],
    (streams, of): (&mut [Stream], &[usize]),
) -> Vec<Estimate> {
    let mut sums = vec![Estimate::default(); hits.len()];
    let mut at = hits.to_vec();
    let mut paths: Vec<Path> = (0..hits.len()).map(|index| Path { index, throughput: Vec3A::ONE }).collect();
    for bounce in 1..=view.depth {
        let of_paths: Vec<usize> = paths.iter().map(|path| of[path.index]).collect();
        let estimates = estimator.estimate_batch(&at, visibility, &mut Streams::new(streams, &of_paths));
        for (path, estimate) in paths.iter().zip(estimates) {
            let sum = &mut sums[path.index];
            sum.radiance += path.throughput * estimate.radiance;
            sum.rays += estimate.rays;
            sum.max_weight = sum.max_weight.max(path.throughput.max_element() * estimate.max_weight);
        }
        if bounce == view.depth || paths.is_empty() {
            break;
        }
        let mut random = Streams::new(streams, &of_paths);
        let on = |(k, (path, at)): (usize, (&Path, &ShadingPoint))| {
            let (throughput, ray) = continued(view, bounce, at, path.throughput, random.of(k))?;
            Some((Path { throughput, ..*path }, ray))
        };
        let (going, rays): (Vec<Path>, Vec<Ray>) = paths.iter().zip(&at).enumerate().filter_map(on).unzip();
        let mut arrived = Vec::with_capacity(rays.len());
        at.clear();
        timed(Stage::CameraRays, || view.scene.intersect_batch(&rays, &mut arrived, &mut at));
        paths = arrived.into_iter().map(|k| going[k]).collect();
    }
    sums
}

/// The ray along which a path goes on from `at`, and its throughput there; `None` where it ends.
fn continued(
    view: &View<'_>,
    bounce: u32,
    at: &ShadingPoint,
    mut throughput: Vec3A,
    random: &mut Stream,
) -> Option<(Vec3A, Ray)> {
    let (wi, pdf) = at.brdf.sample(at.ns, at.wo, random.uniform2())?;
    throughput *= at.brdf_cosine(wi) / pdf;
    if bounce >= ROULETTE_FROM {
        let survival = throughput.max_element().min(MOST_SURVIVAL);
        if random.uniform() >= survival {
            return None;
        }
        throughput /= survival;
    }
    (throughput != Vec3A::ZERO).then(|| (throughput, view.scene.leaving(at, wi)))
}
