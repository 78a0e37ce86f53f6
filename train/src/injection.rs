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
    spline::{
        Topology,
        analytic::{AnalyticSpline, Derivatives, LogitGradient},
        bin_count,
    },
};

use crate::{Objective, gradient::StepGradient, loss::LossDerivatives, target::Batch};

/// Points of a batch that one thread takes through the networks: few enough that activations stay in its cache, enough that
/// the cost of an operation is not that of starting it.
const SHARD: usize = 2048;

/// Everything in the tensor library's graph.
///
/// `head` lives on `device`, which has autodiff. `None` if the target is zero under every condition.
pub fn in_graph(head: &Head, objective: Objective, batch: &Batch, device: &Device) -> Option<StepGradient> {
    let (y, c) = tensors(batch, device);
    let loss = objective.of_batch(batch, head.log_density(&y, c.clone()), head.selection_logits(c))?;
    let gradients = GradientsParams::from_grads(loss.backward(), head);
    Some(StepGradient { loss: loss.into_scalar::<f32>(), by_weight: head.flat_gradients(&gradients) })
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
    parts.into_iter().reduce(|mut sum, part| {
        sum.loss += part.loss;
        sum.by_weight.iter_mut().zip(part.by_weight).for_each(|(sum, term)| *sum += term);
        sum
    })
}

/// A shard's part of the mean loss over `lit` conditions, and of its gradients.
fn injected_shard(head: &Head, objective: Objective, batch: &Batch, lit: f32, device: &Device) -> StepGradient {
    let (y, c) = tensors(batch, device);
    let coupled = head.config().mode == Mode::Coupled;
    let elevation = head.elevation_logits(&y, c.clone());
    let at_elevation = Splines::evaluate(Topology::Interval, &elevation, batch, coupled);
    let seen =
        if coupled { at_elevation.z_in_graph(&elevation, device) } else { y.slice_dim(2, 1).squeeze_dim::<2>(2) };
    let azimuth = head.azimuth_logits(&seen, c.clone());
    let at_azimuth = Splines::evaluate(Topology::Circle, &azimuth, batch, false);
    let selection = head.selection_logits(c);

    let log_q: Vec<f32> = at_elevation.log_slopes.iter().zip(&at_azimuth.log_slopes).map(|(v, u)| v + u).collect();
    let selection_logits =
        selection.clone().map(|logits| logits.try_into_vec_as::<f32>().expect("logits are readable"));
    let sums = LossSums::new(objective, batch, &log_q, selection_logits.as_deref());
    let inject = |logits: Tensor<3>, splines: &Splines| {
        let gradient = splines.gradient(&sums.by_log_q, logits.dims(), device);
        (logits * gradient).sum()
    };
    let mut sum = inject(elevation, &at_elevation) + inject(azimuth, &at_azimuth);
    if let Some(logits) = selection {
        let gradient = TensorData::new(sums.by_selection, logits.dims());
        sum = sum + (logits * Tensor::from_data(gradient, device)).sum();
    }
    let gradients = GradientsParams::from_grads(sum.div_scalar(lit).backward(), head);
    StepGradient { loss: sums.loss / lit, by_weight: head.flat_gradients(&gradients) }
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

/// The loss summed over the conditions whose target is not zero everywhere, and its derivatives.
struct LossSums {
    loss: f32,
    /// By the head's log-density at every point.
    by_log_q: Vec<f32>,
    /// By every condition's selection logit.
    by_selection: Vec<f32>,
}

impl LossSums {
    fn new(objective: Objective, batch: &Batch, log_q: &[f32], selection_logits: Option<&[f32]>) -> Self {
        let mut sums =
            Self { loss: 0.0, by_log_q: vec![0.0; log_q.len()], by_selection: vec![0.0; batch.condition_count()] };
        let rows = sums.by_log_q.chunks_exact_mut(batch.samples).zip(log_q.chunks_exact(batch.samples));
        for (condition, (by_log_q, log_q)) in rows.enumerate() {
            let logit = selection_logits.map(|logits| logits[condition]);
            let mut out = LossDerivatives { by_log_q, by_selection: 0.0 };
            let Some(loss) = objective.evaluate(&batch.condition(condition), log_q, logit, &mut out) else { continue };
            sums.by_selection[condition] = out.by_selection;
            sums.loss += loss;
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use headtail_model::{EncoderConfig, HeadConfig};
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget, Loss,
        target::BatchShape,
        test_support::{random_head, studio},
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
                    HeadConfig { mode, encoder, bins: 8, selection: true, ..HeadConfig::COSINE },
                ] {
                    let head = random_head(config, &device);
                    for objective in objectives() {
                        let expected = in_graph(&head, objective, &batch, &device).unwrap();
                        let found = injected(&head, objective, &batch, &device).unwrap();
                        let scale = expected.loss.abs().max(1.0);
                        assert!((expected.loss - found.loss).abs() < 1e-5 * scale, "{} {}", expected.loss, found.loss);
                        let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| x * x).sum::<f32>().sqrt();
                        let size = norm(&mut expected.by_weight.iter().copied());
                        let error = norm(&mut expected.by_weight.iter().zip(&found.by_weight).map(|(a, b)| a - b));
                        assert!(error <= 1e-5 * size, "{backend} {config:?} {objective:?}: {error} of {size}");
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
        assert!(in_graph(&head, Loss::LogChiSquare.into(), &batch, &device).is_none());
        assert!(injected(&head, Loss::LogChiSquare.into(), &batch, &device).is_none());
    }
}
