//! A training step's gradient in the tensor library's graph: the reference for [`crate::fused`], and the form
//! for GPUs.

use burn::{
    optim::GradientsParams,
    prelude::{Device, Tensor, TensorData},
};
use headtail_model::Head;

use crate::{Objective, StepGradient, integrand::Batch};

/// Returns loss and gradient of a batch, or `None` if the target is zero under every condition. `head` lives
/// on `device`, which has autodiff.
pub fn in_graph(head: &Head, objective: Objective, batch: &Batch, device: &Device) -> Option<StepGradient> {
    let (y, c) = tensors(batch, device);
    let loss = objective.of_batch(batch, head.log_density(&y, c.clone()), head.mixture_weight_logits(c))?;
    let gradients = GradientsParams::from_grads(loss.backward(), head);
    Some(StepGradient { loss: loss.into_scalar::<f32>(), d_weight: head.flat_gradients(&gradients) })
}

/// Returns points `[conditions, samples, 2]` and conditions of a batch as tensors.
pub fn tensors(batch: &Batch, device: &Device) -> (Tensor<3>, Tensor<2>) {
    let conditions = batch.condition_count();
    let y = TensorData::new(batch.points.clone(), [conditions, batch.samples, 2]);
    let c = TensorData::new(batch.conditions.clone(), [conditions, batch.condition_length]);
    (Tensor::from_data(y, device), Tensor::from_data(c, device))
}

#[cfg(test)]
mod tests {
    use headtail_model::HeadConfig;
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget, Loss,
        integrand::BatchShape,
        test_support::{random_head, studio},
    };

    #[test]
    fn a_batch_without_light_has_no_gradient() {
        let device = Backend::default().device().unwrap().autodiff();
        let head = random_head(HeadConfig::COSINE, &device);
        let shape = BatchShape { conditions: 4, strata: 4, brdf_samples: 9 };
        let mut batch = Batch::draw(&CosineTarget::new(&studio()), shape, 0, Purpose::Test, 0).unwrap();
        batch.densities.fill(0.0);
        assert!(in_graph(&head, Loss::LogChiSquare.into(), &batch, &device).is_none());
    }
}
