//! One training step's gradient, in two ways that agree.
//!
//! The reference, [`in_graph`], runs splines and loss in the tensor library's graph. The fast way, [`injected`], keeps only the
//! networks in the graph: splines, loss and the loss's gradient `G` with respect to the logits are computed beside it, in closed form, and `sum(logits * G)`, with `G` constant, is what the graph differentiates. Its gradient with
//! respect to every weight is the loss's.
//!
//! In coupled mode the azimuth's network also sees `z_v`, which depends on the elevation's logits `a`. The graph gets it as
//! `sum(a * dz/da)` plus the constant that corrects the value, so that value and derivative are both right.

use std::panic::resume_unwind;

use crate::{Loss, loss::log_weights, target::Batch};
use headtail_model::{
    Head, Mode,
    burn::{
        module::{ModuleVisitor, Param},
        optim::GradientsParams,
        prelude::{Device, Module, Tensor, TensorData},
    },
    spline::{
        Topology,
        analytic::{AnalyticSpline, Derivatives, LogitGradient},
        bin_count,
    },
};

/// Points of a batch that one thread takes through the networks: few enough that activations stay in its cache, enough that
/// the cost of an operation is not that of starting it.
const SHARD: usize = 2048;

/// The mean loss of `batch` and the gradients of the head's weights, everything in the tensor library's graph.
///
/// `device` is the head's, with autodiff. `None` if the target is zero under every condition.
pub fn in_graph(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, GradientsParams)> {
    let (y, c) = tensors(batch, device);
    let loss = loss.of_batch(batch, &head.log_density(&y, c))?;
    let gradients = GradientsParams::from_grads(loss.backward(), head);
    Some((loss.into_scalar::<f32>(), gradients))
}

/// The same with splines and loss beside the graph, and the batch divided among threads.
///
/// The division depends on the batch alone and its parts are added in order, so the result does not depend on the number
/// of threads.
pub fn injected(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, GradientsParams)> {
    let lit =
        batch.densities.chunks_exact(batch.samples).filter(|densities| densities.iter().any(|&g| g > 0.0)).count();
    let shards = batch.split((SHARD / batch.samples).max(1));
    if lit == 0 {
        return None;
    }
    let threads = rayon::current_num_threads().min(shards.len());
    // Threads of their own, not rayon's: a step of the backward pass holds its graph's lock, and one that waits for a parallel
    // matrix product there must not be given another shard. Forked weights, because graphs that share leaves share one lock.
    let parts: Vec<(f32, GradientsParams)> = std::thread::scope(|scope| {
        let work = |shards: &'_ [Batch], head: Head| -> Vec<_> {
            shards.iter().map(|shard| injected_shard(&head, loss, shard, lit as f32, device)).collect()
        };
        let threads: Vec<_> = shards
            .chunks(shards.len().div_ceil(threads))
            .map(|shards| (shards, head.clone().fork(device)))
            .map(|(shards, head)| scope.spawn(move || work(shards, head)))
            .collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic))).collect()
    });
    parts.into_iter().reduce(|(loss, gradients), (other_loss, other_gradients)| {
        let mut sum = Add { to: gradients, from: other_gradients };
        head.visit(&mut sum);
        (loss + other_loss, sum.to)
    })
}

/// A shard's part of the mean loss over `lit` conditions, and of its gradients.
fn injected_shard(head: &Head, loss: Loss, batch: &Batch, lit: f32, device: &Device) -> (f32, GradientsParams) {
    let (y, c) = tensors(batch, device);
    let coupled = head.config().mode == Mode::Coupled;
    let elevation = head.elevation_logits(&y, c.clone());
    let at_elevation = Splines::evaluate(Topology::Interval, &elevation, batch, coupled);
    let seen =
        if coupled { at_elevation.z_in_graph(&elevation, device) } else { y.slice_dim(2, 1).squeeze_dim::<2>(2) };
    let azimuth = head.azimuth_logits(&seen, c);
    let at_azimuth = Splines::evaluate(Topology::Circle, &azimuth, batch, false);

    let log_q: Vec<f32> = at_elevation.log_slopes.iter().zip(&at_azimuth.log_slopes).map(|(v, u)| v + u).collect();
    let (loss, by_log_q) = loss_sum(loss, batch, &log_q);
    let inject = |logits: Tensor<3>, splines: &Splines| {
        let gradient = splines.gradient(&by_log_q, logits.dims(), device);
        (logits * gradient).sum()
    };
    let sum = (inject(elevation, &at_elevation) + inject(azimuth, &at_azimuth)).div_scalar(lit);
    (loss / lit, GradientsParams::from_grads(sum.backward(), head))
}

/// Adds gradients of the same head.
struct Add {
    to: GradientsParams,
    from: GradientsParams,
}

impl ModuleVisitor for Add {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let Some(term) = self.from.remove::<D>(param.id) else { return };
        let sum = match self.to.remove::<D>(param.id) {
            Some(gradient) => gradient + term,
            None => term,
        };
        self.to.register(param.id, sum);
    }
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
    topology: Topology,
    logits: Vec<f32>,
    /// Logits per spline.
    width: usize,
    /// Points per spline: 1, or all of a condition's.
    group: usize,
    z: Vec<f32>,
    log_slopes: Vec<f32>,
    of_log_slopes: Vec<Derivatives>,
    /// Gradient of each `z` with respect to its spline's logits, if asked for.
    z_gradients: Vec<f32>,
}

impl Splines {
    /// `logits` are `[conditions, samples or 1, 3K + 1]`.
    fn evaluate(topology: Topology, logits: &Tensor<3>, batch: &Batch, with_z_gradients: bool) -> Self {
        let [_, splines_per_condition, width] = logits.dims();
        let count = batch.densities.len();
        let coordinate = match topology {
            Topology::Circle => 0,
            Topology::Interval => 1,
        };
        let mut splines = Self {
            topology,
            logits: logits.clone().try_into_vec_as::<f32>().expect("logits are readable and convert to f32"),
            width,
            group: batch.samples / splines_per_condition,
            z: vec![0.0; count],
            log_slopes: vec![0.0; count],
            of_log_slopes: vec![Derivatives::default(); count],
            z_gradients: vec![0.0; if with_z_gradients { count * width } else { 0 }],
        };
        let group = splines.group;
        let (mut spline, mut sums) = splines.workspace();
        for (index, logits) in splines.logits.chunks_exact(width).enumerate() {
            spline.prepare(logits);
            for point in index * group..(index + 1) * group {
                let at = spline.evaluate(batch.points[2 * point + coordinate]);
                splines.z[point] = at.z;
                splines.log_slopes[point] = at.log_slope;
                splines.of_log_slopes[point] = at.of_log_slope;
                if with_z_gradients {
                    sums.add(&at.of_z, 1.0);
                    sums.finish(&spline, &mut splines.z_gradients[point * width..(point + 1) * width]);
                }
            }
        }
        splines
    }

    /// `z` of one spline per point as a tensor `[conditions, samples]` whose derivative by `logits` is the spline's.
    fn z_in_graph(&self, logits: &Tensor<3>, device: &Device) -> Tensor<2> {
        let shape = logits.dims();
        let gradient = Tensor::<3>::from_data(TensorData::new(self.z_gradients.clone(), shape), device);
        let z = Tensor::<2>::from_data(TensorData::new(self.z.clone(), [shape[0], shape[1]]), device);
        let linear = (logits.clone() * gradient).sum_dim(2).squeeze_dim::<2>(2);
        linear.clone() - linear.detach() + z
    }

    /// The gradient with respect to the logits of a number whose derivatives by the points' log-slopes are given.
    fn gradient(&self, by_log_slopes: &[f32], shape: [usize; 3], device: &Device) -> Tensor<3> {
        let mut gradient = vec![0.0; self.logits.len()];
        let (mut spline, mut sums) = self.workspace();
        let points = self.of_log_slopes.chunks_exact(self.group).zip(by_log_slopes.chunks_exact(self.group));
        let rows = gradient.chunks_exact_mut(self.width).zip(self.logits.chunks_exact(self.width));
        for ((gradient, logits), (derivatives, weights)) in rows.zip(points) {
            spline.prepare(logits);
            for (derivatives, &weight) in derivatives.iter().zip(weights) {
                sums.add(derivatives, weight);
            }
            sums.finish(&spline, gradient);
        }
        Tensor::from_data(TensorData::new(gradient, shape), device)
    }

    fn workspace(&self) -> (AnalyticSpline, LogitGradient) {
        let bins = bin_count(self.width);
        (AnalyticSpline::new(self.topology, bins), LogitGradient::new(bins))
    }
}

/// The sum of the loss over the conditions whose target is not zero everywhere, and its derivatives by every log-density.
fn loss_sum(loss: Loss, batch: &Batch, log_q: &[f32]) -> (f32, Vec<f32>) {
    let mut derivatives = vec![0.0; log_q.len()];
    let rows = derivatives.chunks_exact_mut(batch.samples).zip(batch.densities.chunks_exact(batch.samples));
    let losses = rows.zip(log_q.chunks_exact(batch.samples)).filter_map(|((derivatives, densities), log_q)| {
        Some(loss.evaluate(&log_weights(densities)?, log_q, derivatives))
    });
    let sum = losses.sum();
    (sum, derivatives)
}

#[cfg(test)]
mod tests {
    use headtail_model::{EncoderConfig, HeadConfig};
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget,
        test_support::{random_head, sky},
    };

    /// All gradients one after another.
    fn by_weight(head: &Head, gradients: &GradientsParams) -> Vec<f32> {
        let mut list = Vec::new();
        struct Collect<'a>(&'a GradientsParams, &'a mut Vec<f32>);
        impl ModuleVisitor for Collect<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                let gradient = self.0.get::<D>(param.id).expect("every weight has a gradient");
                self.1.extend(gradient.try_into_vec_as::<f32>().unwrap());
            }
        }
        head.visit(&mut Collect(gradients, &mut list));
        list
    }

    /// Two shards of different size; the first condition is empty.
    fn batch() -> Batch {
        let mut batch = Batch::draw(&CosineTarget::new(&sky), (100, 5), 0, Purpose::Test, 0).unwrap();
        batch.densities[..25].fill(0.0);
        batch
    }

    #[test]
    fn injected_gradients_are_those_of_the_graph() {
        let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
        for backend in Backend::ALL {
            let Ok(device) = backend.device() else { continue };
            let device = device.autodiff();
            for mode in [Mode::Coupled, Mode::Autoregressive] {
                for config in [
                    HeadConfig { mode, ..HeadConfig::COSINE },
                    HeadConfig { mode, encoder, bins: 8, ..HeadConfig::COSINE },
                ] {
                    let head = random_head(config, &device);
                    for loss in [Loss::ForwardKl, Loss::LogChiSquare] {
                        let (expected_loss, expected) = in_graph(&head, loss, &batch(), &device).unwrap();
                        let (found_loss, found) = injected(&head, loss, &batch(), &device).unwrap();
                        assert!((expected_loss - found_loss).abs() < 1e-5, "{expected_loss} {found_loss}");
                        let (expected, found) = (by_weight(&head, &expected), by_weight(&head, &found));
                        let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| x * x).sum::<f32>().sqrt();
                        let size = norm(&mut expected.iter().copied());
                        let error = norm(&mut expected.iter().zip(&found).map(|(a, b)| a - b));
                        assert!(error <= 1e-5 * size, "{backend} {config:?} {loss:?}: {error} of {size}");
                        assert!(size > 1e-3);
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
        assert!(in_graph(&head, Loss::LogChiSquare, &batch, &device).is_none());
        assert!(injected(&head, Loss::LogChiSquare, &batch, &device).is_none());
    }
}
