//! One training step's gradient, in two ways that agree.
//!
//! The reference, [`in_graph`], runs splines and loss in the tensor library's graph. The fast way, [`injected`], keeps only the
//! networks in the graph: splines, loss and the loss's gradient `G` with respect to the logits are computed beside it, in closed form and
//! in parallel over conditions, and `sum(logits * G)`, with `G` constant, is what the graph differentiates. Its gradient with
//! respect to every weight is the loss's.
//!
//! In coupled mode the azimuth's network also sees `z_v`, which depends on the elevation's logits `a`. The graph gets it as
//! `sum(a * dz/da)` plus the constant that corrects the value, so that value and derivative are both right.

use headtail_model::{
    Head, Mode,
    burn::{
        prelude::{Device, Tensor, TensorData},
        tensor::Gradients,
    },
    spline::{
        Topology,
        analytic::{AnalyticSpline, Derivatives, LogitGradient},
        bin_count,
    },
};
use rayon::prelude::*;

use crate::{Loss, loss::log_weights, target::Batch};

/// The mean loss of `batch` and the gradients of the head's weights, everything in the tensor library's graph.
///
/// `device` is the head's, with autodiff. `None` if the target is zero under every condition.
pub fn in_graph(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, Gradients)> {
    let (y, c) = tensors(batch, device);
    let loss = loss.of_batch(batch, &head.log_density(&y, c))?;
    let gradients = loss.backward();
    Some((loss.into_scalar::<f32>(), gradients))
}

/// The same with splines and loss beside the graph.
pub fn injected(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, Gradients)> {
    let (y, c) = tensors(batch, device);
    let coupled = head.config().mode == Mode::Coupled;
    let elevation = head.elevation_logits(&y, c.clone());
    let at_elevation = Splines::evaluate(Topology::Interval, &elevation, batch, coupled);
    let seen =
        if coupled { at_elevation.z_in_graph(&elevation, device) } else { y.slice_dim(2, 1).squeeze_dim::<2>(2) };
    let azimuth = head.azimuth_logits(&seen, c);
    let at_azimuth = Splines::evaluate(Topology::Circle, &azimuth, batch, false);

    let log_q: Vec<f32> = at_elevation.log_slopes.iter().zip(&at_azimuth.log_slopes).map(|(v, u)| v + u).collect();
    let (loss, by_log_q) = mean_loss(loss, batch, &log_q)?;
    let inject = |logits: Tensor<3>, splines: &Splines| {
        let gradient = splines.gradient(&by_log_q, logits.dims(), device);
        (logits * gradient).sum()
    };
    let sum = inject(elevation, &at_elevation) + inject(azimuth, &at_azimuth);
    Some((loss, sum.backward()))
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

/// Splines per parallel task, so that starting one costs little beside its work.
const TASK: usize = 64;

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
        // Without gradients of z there is nothing to zip: one empty slice per spline stands for them.
        let mut z_gradients: Vec<&mut [f32]> = if with_z_gradients {
            splines.z_gradients.chunks_exact_mut(width * group).collect()
        } else {
            (0..count / group).map(|_| Default::default()).collect()
        };
        splines
            .logits
            .par_chunks_exact(width)
            .zip(batch.points.par_chunks_exact(2 * group))
            .zip(splines.z.par_chunks_exact_mut(group))
            .zip(splines.log_slopes.par_chunks_exact_mut(group))
            .zip(splines.of_log_slopes.par_chunks_exact_mut(group))
            .zip(z_gradients.par_iter_mut())
            .with_min_len(TASK.div_ceil(group))
            .for_each_init(
                || Workspace::new(topology, width),
                |Workspace { spline, sums }, (((((logits, points), z), log_slopes), of_log_slopes), z_gradients)| {
                    spline.prepare(logits);
                    for (i, y) in points.chunks_exact(2).enumerate() {
                        let at = spline.evaluate(y[coordinate]);
                        (z[i], log_slopes[i], of_log_slopes[i]) = (at.z, at.log_slope, at.of_log_slope);
                        if let Some(gradient) = z_gradients.get_mut(i * width..(i + 1) * width) {
                            sums.add(&at.of_z, 1.0);
                            sums.finish(spline, gradient);
                        }
                    }
                },
            );
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
        gradient
            .par_chunks_exact_mut(self.width)
            .zip(self.logits.par_chunks_exact(self.width))
            .zip(self.of_log_slopes.par_chunks_exact(self.group))
            .zip(by_log_slopes.par_chunks_exact(self.group))
            .with_min_len(TASK.div_ceil(self.group))
            .for_each_init(
                || Workspace::new(self.topology, self.width),
                |Workspace { spline, sums }, (((gradient, logits), derivatives), weights)| {
                    spline.prepare(logits);
                    for (derivatives, &weight) in derivatives.iter().zip(weights) {
                        sums.add(derivatives, weight);
                    }
                    sums.finish(spline, gradient);
                },
            );
        Tensor::from_data(TensorData::new(gradient, shape), device)
    }
}

/// Buffers of one task.
struct Workspace {
    spline: AnalyticSpline,
    sums: LogitGradient,
}

impl Workspace {
    fn new(topology: Topology, width: usize) -> Self {
        let bins = bin_count(width);
        Self { spline: AnalyticSpline::new(topology, bins), sums: LogitGradient::new(bins) }
    }
}

/// The loss averaged over the conditions whose target is not zero everywhere, and its derivatives by every log-density.
fn mean_loss(loss: Loss, batch: &Batch, log_q: &[f32]) -> Option<(f32, Vec<f32>)> {
    let mut derivatives = vec![0.0; log_q.len()];
    // Collected and added in order: the sum does not depend on the number of threads.
    let losses: Vec<f32> = derivatives
        .par_chunks_exact_mut(batch.samples)
        .zip(batch.densities.par_chunks_exact(batch.samples))
        .zip(log_q.par_chunks_exact(batch.samples))
        .map(|((derivatives, densities), log_q)| Some(loss.evaluate(&log_weights(densities)?, log_q, derivatives)))
        .collect::<Vec<Option<f32>>>()
        .into_iter()
        .flatten()
        .collect();
    let count = losses.len() as f32;
    derivatives.iter_mut().for_each(|derivative| *derivative /= count);
    (!losses.is_empty()).then(|| (losses.iter().sum::<f32>() / count, derivatives))
}

#[cfg(test)]
mod tests {
    use headtail_model::{EncoderConfig, HeadConfig, burn::optim::GradientsParams, burn::prelude::Module};
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget,
        test_support::{random_head, sky},
    };

    /// Gradients under the exported names' order, by a unit step of plain descent.
    fn by_weight(head: &Head, gradients: Gradients) -> Vec<f32> {
        let gradients = GradientsParams::from_grads(gradients, head);
        let mut list = Vec::new();
        struct Collect<'a>(&'a GradientsParams, &'a mut Vec<f32>);
        impl headtail_model::burn::module::ModuleVisitor for Collect<'_> {
            fn visit_float<const D: usize>(&mut self, param: &headtail_model::burn::module::Param<Tensor<D>>) {
                let gradient = self.0.get::<D>(param.id).expect("every weight has a gradient");
                self.1.extend(gradient.try_into_vec_as::<f32>().unwrap());
            }
        }
        head.visit(&mut Collect(&gradients, &mut list));
        list
    }

    fn batch() -> Batch {
        let mut batch = Batch::draw(&CosineTarget::new(&sky), (12, 5), 0, Purpose::Test, 0).unwrap();
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
                        let (expected, found) = (by_weight(&head, expected), by_weight(&head, found));
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
