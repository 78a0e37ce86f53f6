//! Fitting a flow tail to the light of a map, and tabulating it.
//!
//! Points are drawn in proportion to the light by an exact tail, and the flow's likelihood at them is maximised: with `p` the
//! density of the light over X, the loss is `KL(p || q)` up to a constant.
//!
//! | file | concept |
//! | --- | --- |
//! | `settings.rs` | the settings of a fit |
//! | `gradient.rs` | the gradient of the likelihood |
//! | `invert.rs`, `table.rs` | the sampling direction in f64; the flow as a table |

mod gradient;
mod invert;
mod settings;
mod table;
#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering;

use glam::Vec2;
use headtail_model::Flow;
use headtail_render::{
    random::{Purpose, Stream},
    tail::{Repair, Tail, TailWarp},
};

pub use gradient::FlowGradient;
pub use settings::{FlowSettings, FlowSize};
pub use table::tabulate;

use crate::{
    Error, FitConfig, Result, Run, StepGradient, TrainingState,
    trainer::{Trainable, Trainer},
};

/// Strata along a side of the validation points.
const VALIDATION_STRATA: usize = 96;
/// How often in a run its divergence is measured.
const VALIDATIONS: usize = 20;
/// Cells along a side of the table of a flow that was interrupted: nobody will use it, and a large flow's own takes minutes.
const INTERRUPTED_CELLS: usize = 4;

/// A fitted flow tail.
pub struct FittedFlow {
    /// The tabulated tail; of a run that was interrupted, a coarse one.
    pub tail: Tail,
    /// The flow itself.
    pub flow: Flow,
    /// The figures.
    pub summary: FlowSummary,
}

/// A flow's fit in figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSummary {
    /// Steps done; fewer than configured where the target was met, or the run interrupted.
    pub steps: usize,
    /// `KL(p || q)` in nats of the flow on points of its own.
    pub kl: f64,
    /// The same of the table, at the same points.
    pub table_kl: f64,
    /// The same of the untrained flow: of uniform points of X.
    pub initial_kl: f64,
    /// What had to be repaired in the table.
    pub repair: Repair,
    /// Wall-clock seconds, table included.
    pub seconds: f64,
    /// Steps left out because loss or gradient was not finite.
    pub skipped: usize,
}

/// Fits a flow to the light of an exact tail, with the settings `config.flow`, on `config.backend`; the optimiser's other settings are
/// those of the head. `run.progress` has no divergence but the KL. A run that is resumed ends with the same bits.
///
/// # Errors
/// As [`crate::fit_with`].
pub fn fit_flow(config: &FitConfig, exact: &Tail, run: Run<'_>) -> Result<FittedFlow> {
    let config = config.flow.optimizer(config);
    config.flow.validate()?;
    let device = config.backend.device()?;
    let blank = Flow::new(config.flow.shape, config.seed, &device)?;
    let (initial, interrupt) = (blank.flat_weights(), run.interrupt);
    let points_per_step = config.flow.strata * config.flow.strata;
    let state = TrainingState::new(&config, initial.clone());
    let mut trainer = Trainer::new(&config, &config, state, points_per_step, run)?;
    let mut gradient = FlowGradient::new(&config, &blank, &device);
    let validation = Validation::new(exact, config.seed);
    let initial_kl = validation.kl(&mut gradient, &initial);
    let mut training = FlowTraining { config: &config, exact, gradient, validation };
    trainer.train(&mut training)?;
    trainer.finish(None)?;
    let &TrainingState { step: steps, skipped, ref parameters, .. } = &trainer.state;
    let kl = training.validation.kl(&mut training.gradient, &parameters.weights);
    if !kl.is_finite() {
        return Err(Error::Diverged { step: steps, skipped });
    }
    let flow = blank.with_flat_weights(&parameters.weights, &device);
    let cells = if interrupt.load(Ordering::Relaxed) { INTERRUPTED_CELLS } else { config.flow.cells };
    let (map, repair) = tabulate(&flow, cells)?;
    let table_kl = training.validation.table_kl(|x| map.inverse(x).1);
    let tail = Tail::Flow(headtail_render::tail::FlowTail::new(map, exact.light().clone()));
    let summary = FlowSummary { steps, kl, table_kl, initial_kl, repair, seconds: trainer.seconds(), skipped };
    Ok(FittedFlow { tail, flow, summary })
}

/// The training of a flow.
struct FlowTraining<'a> {
    config: &'a FitConfig,
    exact: &'a Tail,
    gradient: FlowGradient,
    validation: Validation,
}

impl Trainable for FlowTraining<'_> {
    fn gradient(&mut self, weights: &[f32], step: usize) -> Result<Option<StepGradient>> {
        let FlowSettings { strata, uniform, .. } = self.config.flow;
        let points = draw(self.exact, strata, uniform, self.config.seed, step as u64);
        Ok(Some(self.gradient.gradient(weights, &points)))
    }

    /// Not where a resumed run happens to begin: a whole run would not have ended there.
    fn is_done(&mut self, state: &TrainingState) -> bool {
        let target = self.config.flow.kl_target;
        let is_measured = state.step.is_multiple_of((self.config.steps / VALIDATIONS).max(1));
        target > 0.0 && is_measured && self.validation.kl(&mut self.gradient, &state.parameters.weights) <= target
    }
}

/// A point of X in each stratum of Y, `[strata^2, 2]`: distributed like the light, but for a share that is uniform over X.
fn draw(exact: &Tail, strata: usize, uniform: f32, seed: u64, index: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, Purpose::Tail, index);
    let stratum = |k: usize| Vec2::new((k % strata) as f32, (k / strata) as f32);
    let y: Vec<Vec2> = (0..strata * strata).map(|k| (stratum(k) + stream.uniform2()) / strata as f32).collect();
    let mut x = exact.forward_points(&y);
    for (x, _) in &mut x {
        if stream.uniform() < uniform {
            *x = stream.uniform2();
        }
    }
    x.iter().flat_map(|(x, _)| x.to_array()).collect()
}

/// Fixed points with the density of the light.
struct Validation {
    points: Vec<f32>,
    /// The mean of its logarithm.
    entropy: f64,
    densities: Vec<f32>,
}

impl Validation {
    fn new(exact: &Tail, seed: u64) -> Self {
        let points = draw(exact, VALIDATION_STRATA, 0.0, seed, u64::MAX);
        let x: Vec<Vec2> = points.chunks_exact(2).map(Vec2::from_slice).collect();
        let densities: Vec<f32> = exact.inverse_points(&x).into_iter().map(|(_, density)| density).collect();
        let entropy = densities.iter().map(|&p| f64::from(p).ln()).sum::<f64>() / densities.len() as f64;
        Self { points, entropy, densities }
    }

    fn kl(&self, gradient: &mut FlowGradient, weights: &[f32]) -> f64 {
        self.entropy + f64::from(gradient.gradient(weights, &self.points).loss)
    }

    fn table_kl(&self, density: impl Fn(Vec2) -> f32) -> f64 {
        let logs = self.points.chunks_exact(2).zip(&self.densities);
        let sum: f64 = logs.map(|(x, &p)| f64::from(p).ln() - f64::from(density(Vec2::from_slice(x))).ln()).sum();
        sum / self.densities.len() as f64
    }
}
