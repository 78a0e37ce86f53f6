//! Fitting a flow tail to the light of a map, and tabulating it.
//!
//! Points are drawn in proportion to the light by an exact tail, and the flow's likelihood at them is
//! maximised: with `p` the density of the light over X, the loss is `KL(p || q)` up to a constant.
//!
//! | file | concept |
//! | --- | --- |
//! | `settings.rs` | the settings of a fit |
//! | `gradient.rs` | the gradient of the likelihood, in each form |
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
    state::Outcome,
    trainer::{Trainable, Trainer},
};

/// Strata along a side of the validation points.
const VALIDATION_STRATA: usize = 96;
/// Number of divergence measurements in a run.
const VALIDATIONS: usize = 20;
/// Cells along a side of the table of an interrupted flow: it is discarded, and a large table takes minutes.
const INTERRUPTED_CELLS: usize = 4;

/// A fitted flow tail.
pub struct FittedFlow {
    /// The tabulated tail; coarse if the run was interrupted.
    pub tail: Tail,
    /// The flow itself.
    pub flow: Flow,
    /// The statistics.
    pub summary: FlowSummary,
}

/// Statistics of a flow's fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSummary {
    /// Steps done: fewer than configured if the target was met or the run was interrupted.
    pub steps: usize,
    /// `KL(p || q)` of the flow in nats, on separate points.
    pub kl: f64,
    /// `KL(p || q)` of the table, on the same points.
    pub table_kl: f64,
    /// `KL(p || q)` of the untrained flow: of uniform points of X.
    pub initial_kl: f64,
    /// Repairs of the table.
    pub repair: Repair,
    /// Wall-clock seconds, table included.
    pub seconds: f64,
    /// Steps skipped because loss or gradient was not finite.
    pub skipped: usize,
}

/// Fits a flow to the light of an exact tail, with the settings `config.flow`, on `config.backend`; the other
/// optimiser settings are those of the head. Of the divergences, `run.progress` has only the KL. A resumed
/// run ends with bit-identical weights.
///
/// # Errors
/// As [`crate::fit_with`].
pub fn fit_flow(config: &FitConfig, exact: &Tail, run: Run<'_>) -> Result<FittedFlow> {
    let config = config.flow.optimizer(config);
    config.flow.validate()?;
    let device = config.backend.device()?;
    let blank = Flow::new(config.flow.shape, config.seed, &device)?;
    let (initial, interrupt) = (blank.flat_weights(), run.interrupt);
    let state = TrainingState::new(&config, initial.clone());
    let mut trainer = Trainer::new(&config, &config, state, config.flow.points(), run)?;
    let mut gradient = FlowGradient::new(&config, &blank, &device)?;
    let validation = Validation::new(exact, config.seed);
    let initial_kl = validation.kl(&mut gradient, &initial)?;
    let mut training = FlowTraining { config: &config, exact, gradient, validation };
    trainer.train(&mut training)?;
    trainer.finish(None)?;
    let &TrainingState { step: steps, skipped, ref parameters, .. } = &trainer.state;
    let kl = training.validation.kl(&mut training.gradient, &parameters.weights)?;
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

/// Training of a flow.
struct FlowTraining<'a> {
    config: &'a FitConfig,
    exact: &'a Tail,
    gradient: FlowGradient,
    validation: Validation,
}

impl FlowTraining<'_> {
    /// Returns the number of steps between two measurements of the divergence.
    fn measured_every(&self) -> usize {
        (self.config.steps / VALIDATIONS).max(1)
    }
}

impl Trainable for FlowTraining<'_> {
    fn gradient(&mut self, weights: &[f32], step: usize) -> Result<Option<StepGradient>> {
        let points = draw(self.exact, &self.config.flow, self.config.seed, step as u64);
        Ok(Some(self.gradient.gradient(weights, &points)?))
    }

    fn take_steps(&mut self, state: &mut TrainingState, most: usize) -> Result<Vec<Outcome>> {
        let every = self.measured_every();
        let to_the_next_look = if self.config.flow.kl_target > 0.0 { every - state.step % every } else { most };
        let (exact, config) = (self.exact, self.config);
        let draw = |step| draw(exact, &config.flow, config.seed, step);
        self.gradient.take_steps(config, state, most.min(to_the_next_look), &draw)
    }

    /// Only at measured steps, so that a resumed run ends at the same step as an uninterrupted one.
    fn is_done(&mut self, state: &TrainingState) -> Result<bool> {
        let target = self.config.flow.kl_target;
        if target <= 0.0 || !state.step.is_multiple_of(self.measured_every()) {
            return Ok(false);
        }
        Ok(self.validation.kl(&mut self.gradient, &state.parameters.weights)? <= target)
    }
}

/// Draws a point of X in each stratum of Y, `[strata^2, 2]`: distributed like the light, except for a
/// fraction `uniform` that is uniform over X.
fn draw(exact: &Tail, settings: &FlowSettings, seed: u64, index: u64) -> Vec<f32> {
    let FlowSettings { strata, uniform, .. } = *settings;
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
    /// The mean log-density of the light.
    entropy: f64,
    densities: Vec<f32>,
}

impl Validation {
    fn new(exact: &Tail, seed: u64) -> Self {
        let settings = FlowSettings { strata: VALIDATION_STRATA, uniform: 0.0, ..FlowSettings::default() };
        let points = draw(exact, &settings, seed, u64::MAX);
        let x: Vec<Vec2> = points.chunks_exact(2).map(Vec2::from_slice).collect();
        let densities: Vec<f32> = exact.inverse_points(&x).into_iter().map(|(_, density)| density).collect();
        let entropy = densities.iter().map(|&p| f64::from(p).ln()).sum::<f64>() / densities.len() as f64;
        Self { points, entropy, densities }
    }

    fn kl(&self, gradient: &mut FlowGradient, weights: &[f32]) -> Result<f64> {
        Ok(self.entropy + f64::from(gradient.gradient(weights, &self.points)?.loss))
    }

    fn table_kl(&self, density: impl Fn(Vec2) -> f32) -> f64 {
        let logs = self.points.chunks_exact(2).zip(&self.densities);
        let sum: f64 = logs.map(|(x, &p)| f64::from(p).ln() - f64::from(density(Vec2::from_slice(x))).ln()).sum();
        sum / self.densities.len() as f64
    }
}
