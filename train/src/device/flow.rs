//! The likelihood of a flow tail and its gradient.

use headtail_model::Flow;
use headtail_shaders::gpu::{Gpu, GpuError};

use super::{
    coupling::FlowMemory,
    dispatch::TILE,
    engine::{Engine, Prepared},
    plan::Plan,
    points_together,
};
use crate::{Error, FitConfig, Result, StepGradient, TrainingState, fused::FlowLayout, state::Outcome};

/// What needs memory.
const WHAT: &str = "a flow's step (flow.shape, flow.strata)";

/// Computes likelihoods of flows of one shape, and their gradients, on a graphics device.
pub struct DeviceFlow {
    pub(super) engine: Engine,
    layout: FlowLayout,
    points: usize,
    /// The step of batches of one number of points.
    pub(super) prepared: Option<(usize, Prepared)>,
}

impl DeviceFlow {
    /// Prepares gradients of flows of the shape of `flow`.
    ///
    /// # Errors
    /// If the device has too little memory.
    pub fn new(gpu: Gpu, flow: &Flow) -> Result<Self> {
        let layout = FlowLayout::new(*flow.config());
        assert_eq!(layout.length, flow.weight_count(), "the layout is that of the flow's flat weights");
        Ok(Self { points: points_together(&gpu), engine: Engine::new(gpu, layout.length)?, layout, prepared: None })
    }

    /// Sets how many points pass through the network together; the gradient changes by rounding.
    #[must_use]
    pub fn in_pieces_of(mut self, points: usize) -> Self {
        self.points = points;
        self.prepared = None;
        self
    }

    /// Returns the buffers of steps of `count` points: those of the last step, if it had as many.
    fn prepared(&mut self, count: usize) -> Result<(&Engine, &mut Prepared)> {
        let own = match self.prepared.take().filter(|(own, _)| *own == count) {
            Some(own) => own,
            None => {
                let plan = self.plan(count)?;
                (count, self.engine.prepare(plan, 2 * count, WHAT)?)
            }
        };
        let (_, prepared) = self.prepared.insert(own);
        Ok((&self.engine, prepared))
    }

    /// Returns the plan of steps of `count` points, as many together as one buffer holds.
    fn plan(&self, count: usize) -> Result<Plan> {
        let (allowed, mut together) = (self.engine.gpu.largest_buffer(), self.points.min(count));
        loop {
            let memory = FlowMemory::new(&self.layout, together);
            let needed = 4 * memory.largest() as u64;
            if needed <= allowed {
                return Ok(memory.plan(count));
            }
            if together <= TILE {
                return Err(GpuError::TooLarge { what: WHAT, needed, allowed }.into());
            }
            together = together.div_ceil(2);
        }
    }

    /// Returns `-mean ln q(x)` over points of X, `[samples, 2]`, and its gradient.
    ///
    /// # Errors
    /// If the device fails or has too little memory.
    pub fn gradient(&mut self, weights: &[f32], points: &[f32]) -> Result<StepGradient> {
        let (engine, prepared) = self.prepared(points.len() / 2)?;
        engine.gpu.queue.write_buffer(&prepared.batch, 0, bytemuck::cast_slice(points));
        let found = engine.gradient(prepared, weights)?;
        found.ok_or_else(|| Error::Device { reason: "it computed nothing".into() })
    }

    /// Takes steps of a run, as [`crate::GradientSource::take_steps`]; `draw` returns the points of a step.
    ///
    /// # Errors
    /// As [`gradient`](Self::gradient).
    pub fn take_steps(
        &mut self,
        config: &FitConfig,
        state: &mut TrainingState,
        most: usize,
        draw: &dyn Fn(u64) -> Vec<f32>,
    ) -> Result<Vec<Outcome>> {
        let (engine, prepared) = self.prepared(config.flow.points())?;
        engine.prepare_optimizer(prepared, config)?;
        engine.take_steps(prepared, config, state, most, |step| {
            engine.gpu.queue.write_buffer(&prepared.batch, 0, bytemuck::cast_slice(&draw(step)));
            Ok(())
        })
    }
}
