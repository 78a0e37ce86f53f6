//! What stands for graphics devices in a build without them: none is ever opened.

use std::fmt;

use headtail_model::{Flow, Head};

use crate::{
    Error, FitConfig, GradientSource, Objective, Result, StepGradient, TrainingState, integrand::Batch, state::Outcome,
};

/// No device.
#[derive(Clone, Copy, Debug)]
pub enum Gpu {}

impl Gpu {
    pub fn open() -> Result<Self> {
        Err(Error::DeviceNotCompiled)
    }

    #[expect(clippy::unnecessary_wraps, reason = "as with graphics devices")]
    pub fn open_card() -> Result<Option<Self>> {
        Ok(None)
    }
}

impl fmt::Display for Gpu {
    fn fmt(&self, _: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {}
    }
}

/// Gradients of heads on no device.
#[derive(Clone, Copy, Debug)]
pub struct DeviceGradient(Gpu);

impl DeviceGradient {
    pub fn new(gpu: Gpu, _: &Head) -> Result<Self> {
        match gpu {}
    }
}

impl GradientSource for DeviceGradient {
    fn gradient(&mut self, _: &[f32], _: Objective, _: &Batch) -> Result<Option<StepGradient>> {
        match self.0 {}
    }
}

/// Gradients of flows on no device.
#[derive(Clone, Copy, Debug)]
pub struct DeviceFlow(Gpu);

impl DeviceFlow {
    pub fn new(gpu: Gpu, _: &Flow) -> Result<Self> {
        match gpu {}
    }

    pub fn gradient(&mut self, _: &[f32], _: &[f32]) -> Result<StepGradient> {
        match self.0 {}
    }

    pub fn take_steps(
        &mut self,
        _: &FitConfig,
        _: &mut TrainingState,
        _: usize,
        _: &dyn Fn(u64) -> Vec<f32>,
    ) -> Result<Vec<Outcome>> {
        match self.0 {}
    }
}
