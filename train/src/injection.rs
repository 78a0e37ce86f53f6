//! One training step's gradient through burn, in two ways that agree.
//!
//! The reference, [`in_graph`], runs splines and loss in the tensor library's graph. The fast way, [`injected`], keeps only the
//! networks in the graph: splines, loss and the loss's gradient `G` with respect to the logits are computed beside it, in closed form, and `sum(logits * G)`, with `G` constant, is what the graph differentiates. Its gradient with
//! respect to every weight is the loss's.
//!
//! In coupled mode the azimuth's network also sees `z_v`, which depends on the elevation's logits `a`. The graph gets it as
//! `sum(a * dz/da)` plus the constant that corrects the value, so that value and derivative are both right.

use std::panic::resume_unwind;

use headtail_model::{
    Head, Mode,
    burn::{
        optim::GradientsParams,
        prelude::{Device, Module, Tensor, TensorData},
    },
};
use headtail_render::spline::{self, Gradient, Logits, Topology, bin_count};

use crate::{Objective, StepGradient, integrand::Batch};

/// Points of a batch that one thread takes through the networks: few enough that activations stay in its cache, enough that
/// the cost of an operation is not that of starting it.
const SHARD: usize = 2048;

/// Everything in the tensor library's graph.
///
/// `head` lives on `device`, which has autodiff. `None` if the target is zero under every condition.
pub fn in_graph(head: &Head, objective: Objective, batch: &Batch, device: &Device) -> Option<StepGradient> {
    let (y, c) = tensors(batch, device);
    let loss = objective.of_batch(batch, head.log_density(&y, c.clone()), head.share_logits(c))?;
    let gradients = GradientsParams::from_grads(loss.backward(), head);
    Some(StepGradient { loss: loss.into_scalar::<f32>(), d_weight: head.flat_gradients(&gradients) })
}

/// Splines and loss beside the graph, and the batch divided among threads.
///
/// The division depends on the batch alone and its parts are added in order, so the result does not depend on the number
/// of threads.
pub fn injected(head: &Head, objective: Objective, batch: &Batch, device: &Device) -> Option<StepGradient> {
    let lit = batch.lit_count();
    if lit == 0 {
        return None;
    }
    let shards = batch.split((SHARD / batch.samples).max(1));
    let threads = rayon::current_num_threads().min(shards.len());
    // Threads of their own, not rayon's: a step of the backward pass holds its graph's lock, and one that waits for a parallel
    // matrix product there must not be given another shard. Forked weights, because graphs that share leaves share one lock.
    let parts: Vec<StepGradient> = std::thread::scope(|scope| {
        let work = |shards: &'_ [Batch], head: Head| -> Vec<_> {
            shards.iter().map(|shard| injected_shard(&head, objective, shard, lit as f32, device)).collect()
        };
        let threads: Vec<_> = shards
            .chunks(shards.len().div_ceil(threads))
            .map(|shards| (shards, head.clone().fork(device)))
            .map(|(shards, head)| scope.spawn(move || work(shards, head)))
            .collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic))).collect()
    });
    Some(StepGradient::sum(head.weight_count(), parts.iter().map(|part| (part.loss, &part.d_weight[..]))))
}

/// A shard's part of the mean loss over `lit` conditions, and of its gradients.
fn injected_shard(head: &Head, objective: Objective, batch: &Batch, lit: f32, device: &Device) -> StepGradient {
    let (y, c) = tensors(batch, device);
    let coupled = head.config().mode == Mode::Coupled;
    let elevation = head.elevation_logits(&y, c.clone());
    let at_elevation = Splines::evaluate(Topology::Interval, &elevation, batch);
    let seen =
        if coupled { at_elevation.z_in_graph(&elevation, device) } else { y.slice_dim(2, 1).squeeze_dim::<2>(2) };
    let azimuth = head.azimuth_logits(&seen, c.clone());
    let at_azimuth = Splines::evaluate(Topology::Circle, &azimuth, batch);
    let share = head.share_logits(c);

    let log_q: Vec<f32> = at_elevation.log_slopes.iter().zip(&at_azimuth.log_slopes).map(|(v, u)| v + u).collect();
    let shares =
        share.clone().map_or_else(Vec::new, |logits| logits.try_into_vec_as::<f32>().expect("logits are readable"));
    let (mut d_log_q, mut d_shares) = (vec![0.0; log_q.len()], vec![0.0; shares.len()]);
    let loss = objective.evaluate_conditions(batch, 0, &log_q, &shares, &mut d_log_q, &mut d_shares);
    let inject = |logits: Tensor<3>, splines: &Splines| {
        let gradient = splines.gradient(&d_log_q, logits.dims(), device);
        (logits * gradient).sum()
    };
    let mut sum = inject(elevation, &at_elevation) + inject(azimuth, &at_azimuth);
    if let Some(logits) = share {
        let gradient = TensorData::new(d_shares, logits.dims());
        sum = sum + (logits * Tensor::from_data(gradient, device)).sum();
    }
    let gradients = GradientsParams::from_grads(sum.div_scalar(lit).backward(), head);
    StepGradient { loss: loss / lit, d_weight: head.flat_gradients(&gradients) }
}

/// Points `[conditions, samples, 2]` and conditions of a batch as tensors.
pub fn tensors(batch: &Batch, device: &Device) -> (Tensor<3>, Tensor<2>) {
    let conditions = batch.condition_count();
    let y = TensorData::new(batch.points.clone(), [conditions, batch.samples, 2]);
    let c = TensorData::new(batch.conditions.clone(), [conditions, batch.condition_length]);
    (Tensor::from_data(y, device), Tensor::from_data(c, device))
}

/// Splines of one coordinate at the batch's points.
struct Splines {
    /// Logits per spline.
    width: usize,
    /// Points per spline: 1, or all of a condition's.
    group: usize,
    z: Vec<f32>,
    log_slopes: Vec<f32>,
    /// `[points, width]`: derivatives by the logits of each point's spline.
    d_z: Vec<f32>,
    d_log_slopes: Vec<f32>,
}

impl Splines {
    /// `logits` are `[conditions, samples or 1, 3K + 1]`.
    fn evaluate(topology: Topology, logits: &Tensor<3>, batch: &Batch) -> Self {
        let [_, splines_per_condition, width] = logits.dims();
        let (count, bins, group) = (batch.densities.len(), bin_count(width), batch.samples / splines_per_condition);
        let coordinate = match topology {
            Topology::Circle => 0,
            Topology::Interval => 1,
        };
        let values = logits.clone().try_into_vec_as::<f32>().expect("logits are readable and convert to f32");
        let zeros = |length: usize| vec![0.0; length];
        let (d_z, d_log_slopes) = (zeros(count * width), zeros(count * width));
        let mut splines = Self { width, group, z: zeros(count), log_slopes: zeros(count), d_z, d_log_slopes };
        let mut scratch = vec![[0.0]; 2 * bins];
        for point in 0..count {
            let columns = Logits { bins, values: &values[point / group * width..][..width], stride: 1, first: 0 };
            let y = [batch.points[2 * point + coordinate]];
            let found = spline::inverse_with_gradient(topology, columns, &mut scratch, &y);
            ([splines.z[point]], [splines.log_slopes[point]]) = (found.values, found.log_slopes);
            for (of, out) in [(Gradient::Value, &mut splines.d_z), (Gradient::LogSlope, &mut splines.d_log_slopes)] {
                found.write(of, &scratch, out, 1, point * width);
            }
        }
        splines
    }

    /// `z` of one spline per point as a tensor `[conditions, samples]` whose derivative by `logits` is the spline's.
    fn z_in_graph(&self, logits: &Tensor<3>, device: &Device) -> Tensor<2> {
        let shape = logits.dims();
        let gradient = Tensor::<3>::from_data(TensorData::new(self.d_z.clone(), shape), device);
        let z = Tensor::<2>::from_data(TensorData::new(self.z.clone(), [shape[0], shape[1]]), device);
        let linear = (logits.clone() * gradient).sum_dim(2).squeeze_dim::<2>(2);
        linear.clone() - linear.detach() + z
    }

    /// The gradient with respect to the logits of a number whose derivatives by the points' log-slopes are given.
    fn gradient(&self, d_log_slopes: &[f32], shape: [usize; 3], device: &Device) -> Tensor<3> {
        let mut gradient = vec![0.0; self.z.len() / self.group * self.width];
        for ((point, row), weight) in self.d_log_slopes.chunks_exact(self.width).enumerate().zip(d_log_slopes) {
            let sums = &mut gradient[point / self.group * self.width..][..self.width];
            sums.iter_mut().zip(row).for_each(|(sum, derivative)| *sum += weight * derivative);
        }
        Tensor::from_data(TensorData::new(gradient, shape), device)
    }
}

#[cfg(test)]
mod tests {
    use headtail_model::{EncoderConfig, HeadConfig};
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget, Loss,
        integrand::BatchShape,
        test_support::{assert_same, random_head, studio},
    };

    fn objectives() -> Vec<Objective> {
        let with = |entropic| Loss::ALL.map(|loss| Objective { loss, entropic });
        [with(0.0), with(1e-2)].concat()
    }

    /// Two shards of different size, points with weights; the first condition is empty.
    fn batch() -> Batch {
        let tail = studio();
        let shape = BatchShape { conditions: 100, strata: 4, brdf_samples: 9 };
        let mut batch = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, 0).unwrap();
        batch.densities[..25].fill(0.0);
        batch
    }

    #[test]
    fn injected_gradients_are_those_of_the_graph() {
        let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
        let batch = batch();
        for backend in Backend::ALL {
            let Ok(device) = backend.device() else { continue };
            let device = device.autodiff();
            for mode in [Mode::Coupled, Mode::Autoregressive] {
                for config in [
                    HeadConfig { mode, ..HeadConfig::COSINE },
                    HeadConfig { mode, encoder, bins: 8, share: true, ..HeadConfig::COSINE },
                ] {
                    let head = random_head(config, &device);
                    for objective in objectives() {
                        let expected = in_graph(&head, objective, &batch, &device).unwrap();
                        let found = injected(&head, objective, &batch, &device).unwrap();
                        assert_same(&expected, &found, 1e-5, &format!("{backend} {config:?} {objective:?}"));
                    }
                }
            }
        }
    }

    #[test]
    fn a_batch_without_light_has_no_gradient() {
        let device = Backend::Flex.device().unwrap().autodiff();
        let head = random_head(HeadConfig::COSINE, &device);
        let mut batch = batch();
        batch.densities.fill(0.0);
        assert!(in_graph(&head, Loss::LogChiSquare.into(), &batch, &device).is_none());
        assert!(injected(&head, Loss::LogChiSquare.into(), &batch, &device).is_none());
    }
}
