//! The gradient of a flow's likelihood: fused on the host, by burn, or on a graphics device.

use burn::{
    optim::GradientsParams,
    prelude::{Device, Tensor, TensorData},
};
use headtail_model::Flow;

use crate::{
    FitConfig, GradientForm, Result, StepGradient, TrainingState, device::DeviceFlow, fused::FusedFlow, state::Outcome,
};

/// Computes `-mean ln q` and its gradient. All forms agree to rounding.
pub enum FlowGradient {
    /// In one pass over SIMD lanes, on the host.
    Fused(Box<FusedFlow>),
    /// In the tensor library's graph, on any backend: the reference.
    InGraph {
        /// A flow of the shape.
        flow: Box<Flow>,
        /// With autodiff.
        device: Device,
    },
    /// By shaders on a graphics device.
    Device(Box<DeviceFlow>),
}

impl FlowGradient {
    /// Returns the form of a configuration.
    ///
    /// # Errors
    /// As [`GradientForm::source`].
    pub fn new(config: &FitConfig, flow: &Flow, device: &Device) -> Result<Self> {
        if let Some(gpu) = config.gradient.open_device()? {
            return Ok(Self::Device(Box::new(DeviceFlow::new(gpu, flow)?)));
        }
        Ok(match config.gradient.on(config.backend) {
            GradientForm::InGraph => Self::InGraph { flow: Box::new(flow.clone()), device: device.clone().autodiff() },
            _ => Self::Fused(Box::new(FusedFlow::new(flow))),
        })
    }

    /// Returns loss and gradient at points of X, `[samples, 2]`. The caller skips results that are not
    /// finite.
    ///
    /// # Errors
    /// If a graphics device fails or has too little memory.
    pub fn gradient(&mut self, weights: &[f32], points: &[f32]) -> Result<StepGradient> {
        match self {
            Self::Fused(fused) => Ok(fused.gradient(weights, points)),
            Self::InGraph { flow, device } => {
                let flow = flow.clone().with_flat_weights(weights, device);
                let x = Tensor::<2>::from_data(TensorData::new(points.to_vec(), [points.len() / 2, 2]), &*device);
                let loss = flow.inverse(&x).1.mean().neg();
                let value = loss.clone().into_scalar::<f32>();
                let gradients = GradientsParams::from_grads(loss.backward(), &flow);
                Ok(StepGradient { loss: value, d_weight: flow.flat_gradients(&gradients) })
            }
            Self::Device(device) => device.gradient(weights, points),
        }
    }

    /// Takes steps of `state` on a device, at most `most`, and returns what became of each; nothing in other forms.
    /// `draw` returns the `count` points of a step.
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
        match self {
            Self::Device(device) => device.take_steps(config, state, most, draw),
            Self::Fused(_) | Self::InGraph { .. } => Ok(Vec::new()),
        }
    }
}
