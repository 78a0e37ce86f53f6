//! Paths: light that reaches a surface over other surfaces, with the light estimate of any sampler at every bounce.

use glam::Vec3A;

use super::{
    direct::View,
    estimator::{DirectEstimator, Estimate, Visibility},
    timings::{Stage, timed},
};
use crate::{random::Stream, sampler::ShadingPoint};

/// From this bounce on, paths end at random.
const ROULETTE_FROM: u32 = 3;

/// The largest chance to go on: also a path between white walls ends.
const MOST_SURVIVAL: f32 = 0.95;

/// Light reflected at `at`: from the environment directly, and over up to `view.depth - 1` further surfaces.
///
/// Directions are continued by BRDF sampling. A path that leaves the scene adds nothing: the estimator at its last surface
/// stands for all light from the environment.
pub(super) fn reflected(
    view: &View<'_>,
    estimator: &dyn DirectEstimator,
    visibility: &dyn Visibility,
    mut at: ShadingPoint,
    random: &mut Stream,
) -> Estimate {
    let mut sum = Estimate::default();
    let mut throughput = Vec3A::ONE;
    for bounce in 1..=view.depth {
        let estimate = estimator.estimate(&at, visibility, random);
        sum.radiance += throughput * estimate.radiance;
        sum.rays += estimate.rays;
        sum.max_weight = sum.max_weight.max(throughput.max_element() * estimate.max_weight);
        if bounce == view.depth {
            break;
        }
        let Some((wi, pdf)) = at.brdf.sample(at.ns, at.wo, random.uniform2()) else { break };
        throughput *= at.brdf_cosine(wi) / pdf;
        if bounce >= ROULETTE_FROM {
            let survival = throughput.max_element().min(MOST_SURVIVAL);
            if random.uniform() >= survival {
                break;
            }
            throughput /= survival;
        }
        if throughput == Vec3A::ZERO {
            break;
        }
        let ray = view.scene.leaving(&at, wi);
        match timed(Stage::CameraRays, || view.scene.intersect(&ray)) {
            Some(next) => at = next,
            None => break,
        }
    }
    sum
}
