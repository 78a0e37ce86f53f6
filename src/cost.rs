//! Estimates of run time, printed before long work.

use headtail_eval::DirectionEffort;
use headtail_render::tail::TailKind;
use headtail_train::FitConfig;

/// Core-seconds per training point of a network with few bins. All figures: AMD EPYC (Zen 3) with AVX2.
const TRAINING_POINT: f64 = 3e-6;
/// Core-seconds per step of a flow tail of 64 bins and 4096 points; the smaller one of quick runs takes as
/// long.
const FLOW_STEP: f64 = 0.03;
/// Core-seconds per point at which the samplers of a regime are measured.
const MEASURED_POINT: f64 = 2e-5;

/// Core-seconds to train the head of a configuration.
pub fn training(config: &FitConfig) -> f64 {
    let shape = config.batch_shape();
    let points = config.steps * shape.conditions * shape.samples();
    // Splines of more bins need wider last layers.
    points as f64 * TRAINING_POINT * (0.75 + config.head.bins as f64 / 32.0)
}

/// Core-seconds to train a flow tail.
pub fn flow_tail(steps: usize) -> f64 {
    steps as f64 * FLOW_STEP
}

/// Seconds to train a configuration, flow tail included, on the available threads.
pub fn fit(config: &FitConfig) -> f64 {
    let flow = if config.tail == TailKind::Flow { flow_tail(config.flow.steps) } else { 0.0 };
    (training(config) + flow) / rayon::current_num_threads() as f64
}

/// Seconds that a regime of the stability suite takes on the available threads.
pub fn regime(config: &FitConfig, effort: DirectionEffort) -> f64 {
    let points = effort.conditions as f64 * (effort.strata.0.pow(2) + effort.strata.1.pow(2) + effort.draws) as f64;
    // Heads are trained without and with a learned mixture weight; the other samplers reuse one of them.
    2.0 * fit(config) + points * MEASURED_POINT / rayon::current_num_threads() as f64
}
