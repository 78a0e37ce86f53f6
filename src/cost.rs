//! About how long work takes, to be said before it begins.

use headtail_eval::DirectionEffort;
use headtail_render::tail::TailKind;
use headtail_train::FitConfig;

/// Seconds of one core for a training point of a network with few bins, measured on an AMD EPYC (Zen 3) with AVX2, as all numbers here.
const TRAINING_POINT: f64 = 3e-6;
/// Seconds of one core for a step of a head on the features of a neural material.
const NEURAL_HEAD_STEP: f64 = 0.009;
/// Seconds of one core for a step of a flow tail of 64 bins and 4096 points; the small one of quick runs takes as long.
const FLOW_STEP: f64 = 0.03;
/// Seconds of one core for a step of NeuSample's flow with 128 views.
const RIVAL_STEP: f64 = 0.052;
/// Seconds of one core for a point at which the samplers of a regime are measured.
const MEASURED_POINT: f64 = 2e-5;

/// Seconds that the head of a configuration takes to train on one core.
pub fn training(config: &FitConfig) -> f64 {
    let shape = config.batch_shape();
    let points = config.steps * shape.conditions * shape.samples();
    // Splines of more bins need wider last layers.
    points as f64 * TRAINING_POINT * (0.75 + config.head.bins as f64 / 32.0)
}

/// Seconds that a head on the features of a neural material takes for so many steps on one core.
pub fn neural_head(steps: usize) -> f64 {
    steps as f64 * NEURAL_HEAD_STEP
}

/// Seconds that a flow tail of so many steps takes on one core.
pub fn flow_tail(steps: usize) -> f64 {
    steps as f64 * FLOW_STEP
}

/// Seconds that NeuSample's flow takes for so many steps on one core.
pub fn rival(steps: usize) -> f64 {
    steps as f64 * RIVAL_STEP
}

/// Seconds that everything a configuration says takes to train on the threads that there are.
pub fn fit(config: &FitConfig) -> f64 {
    let flow = if config.tail == TailKind::Flow { flow_tail(config.flow.steps) } else { 0.0 };
    (training(config) + flow) / rayon::current_num_threads() as f64
}

/// Seconds that a regime of the stability suite takes on the threads that there are.
pub fn regime(config: &FitConfig, effort: DirectionEffort) -> f64 {
    let points = effort.conditions as f64 * (effort.strata.0.pow(2) + effort.strata.1.pow(2) + effort.draws) as f64;
    // Alone, and with a learned share; the rest takes one of these.
    2.0 * fit(config) + points * MEASURED_POINT
}
