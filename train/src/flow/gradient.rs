//! The gradient of a flow's likelihood, fused on the host or by burn.

use burn::{
    optim::GradientsParams,
    prelude::{Device, Tensor, TensorData},
};
use headtail_model::Flow;

use crate::{FitConfig, GradientForm, StepGradient, fused::FusedFlow};

/// Computes `-mean ln q` and its gradient. Both forms agree to rounding.
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
}

impl FlowGradient {
    /// Returns the form of a configuration.
    pub fn new(config: &FitConfig, flow: &Flow, device: &Device) -> Self {
        match config.gradient.on(config.backend) {
            GradientForm::Fused | GradientForm::Auto | GradientForm::Device => {
                Self::Fused(Box::new(FusedFlow::new(flow)))
            }
            GradientForm::InGraph => Self::InGraph { flow: Box::new(flow.clone()), device: device.clone().autodiff() },
        }
    }

    /// Returns loss and gradient at points of X, `[samples, 2]`. The caller skips results that are not
    /// finite.
    pub fn gradient(&mut self, weights: &[f32], points: &[f32]) -> StepGradient {
        match self {
            Self::Fused(fused) => fused.gradient(weights, points),
            Self::InGraph { flow, device } => {
                let flow = flow.clone().with_flat_weights(weights, device);
                let x = Tensor::<2>::from_data(TensorData::new(points.to_vec(), [points.len() / 2, 2]), &*device);
                let loss = flow.inverse(&x).1.mean().neg();
                let value = loss.clone().into_scalar::<f32>();
                let gradients = GradientsParams::from_grads(loss.backward(), &flow);
                StepGradient { loss: value, d_weight: flow.flat_gradients(&gradients) }
            }
        }
    }
}
