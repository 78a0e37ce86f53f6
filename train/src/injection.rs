//! One training step's gradient, in two ways that agree.
//!
//! The reference runs splines and loss in the tensor library's graph. Where the logits do not depend on each other
//! ([`Head::independent_logits`]), the graph needs to hold the networks only: the loss and its gradient `G` with respect to the logits
//! are computed beside it, in closed form and in parallel over conditions, and `sum(logits * G)` is what the graph
//! differentiates. Its gradient with respect to every weight is exactly the loss's.

use headtail_model::{
    Head,
    burn::{
        prelude::{Device, Tensor, TensorData},
        tensor::Gradients,
    },
    spline::{
        Topology,
        analytic::{AnalyticSpline, LogDensity, LogitGradient},
    },
};
use rayon::prelude::*;

use crate::{Loss, loss::log_weights, target::Batch};

/// The mean loss of `batch` and the gradients of the head's weights by the fastest way there is for this head.
///
/// `device` is the head's, with autodiff. `None` if the target is zero under every condition.
pub fn gradients(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, Gradients)> {
    let (y, c) = tensors(batch, device);
    match head.independent_logits(y, c) {
        Some(logits) => injected(logits, loss, batch, device),
        None => in_graph(head, loss, batch, device),
    }
}

/// The same with everything in the tensor library's graph.
pub fn in_graph(head: &Head, loss: Loss, batch: &Batch, device: &Device) -> Option<(f32, Gradients)> {
    let (y, c) = tensors(batch, device);
    let loss = loss.of_batch(batch, &head.log_density(y, c))?;
    let gradients = loss.backward();
    Some((loss.into_scalar::<f32>(), gradients))
}

/// Points `[conditions, samples, 2]` and conditions of a batch as tensors.
pub fn tensors(batch: &Batch, device: &Device) -> (Tensor<3>, Tensor<2>) {
    let conditions = batch.condition_count();
    let y = TensorData::new(batch.points.clone(), [conditions, batch.samples, 2]);
    let c = TensorData::new(batch.conditions.clone(), [conditions, batch.condition_length]);
    (Tensor::from_data(y, device), Tensor::from_data(c, device))
}

fn injected(
    [elevation, azimuth]: [Tensor<3>; 2],
    loss: Loss,
    batch: &Batch,
    device: &Device,
) -> Option<(f32, Gradients)> {
    let shapes = [elevation.dims(), azimuth.dims()];
    let logits = [read(&elevation), read(&azimuth)];
    let width = shapes[0][2];
    let mut by_elevation = vec![0.0; logits[0].len()];
    let mut by_azimuth = vec![0.0; logits[1].len()];
    let points = batch.points.par_chunks_exact(2 * batch.samples);
    let (total, count) = by_elevation
        .par_chunks_exact_mut(width)
        .zip(by_azimuth.par_chunks_exact_mut(width * batch.samples))
        .zip(logits[0].par_chunks_exact(width))
        .zip(logits[1].par_chunks_exact(width * batch.samples))
        .zip(points)
        .zip(batch.densities.par_chunks_exact(batch.samples))
        .map_init(
            || Workspace::new(headtail_model::spline::bin_count(width)),
            |workspace, (((((by_v, by_u), v_logits), u_logits), y), g)| {
                workspace.condition(loss, (y, g), (v_logits, u_logits), (by_v, by_u))
            },
        )
        // Collected and added in order: the sum does not depend on the number of threads.
        .collect::<Vec<Option<f32>>>()
        .into_iter()
        .flatten()
        .fold((0.0_f64, 0_usize), |(total, count), loss| (total + f64::from(loss), count + 1));
    if count == 0 {
        return None;
    }
    let scale = 1.0 / count as f64;
    let inject = |logits: Tensor<3>, gradient: Vec<f32>, shape: [usize; 3]| {
        let gradient = Tensor::<3>::from_data(TensorData::new(gradient, shape), device);
        (logits * gradient).sum()
    };
    let sum = inject(elevation, by_elevation, shapes[0]) + inject(azimuth, by_azimuth, shapes[1]);
    Some(((total * scale) as f32, sum.mul_scalar(scale).backward()))
}

fn read(tensor: &Tensor<3>) -> Vec<f32> {
    tensor.clone().try_into_vec_as::<f32>().expect("logits are readable and convert to f32")
}

/// Buffers of one thread.
struct Workspace {
    elevation: AnalyticSpline,
    azimuth: AnalyticSpline,
    sums: LogitGradient,
    at_elevation: Vec<LogDensity>,
    log_q: Vec<f32>,
    derivatives: Vec<f32>,
}

impl Workspace {
    fn new(bins: usize) -> Self {
        Self {
            elevation: AnalyticSpline::new(Topology::Interval, bins),
            azimuth: AnalyticSpline::new(Topology::Circle, bins),
            sums: LogitGradient::new(bins),
            at_elevation: Vec::new(),
            log_q: Vec::new(),
            derivatives: Vec::new(),
        }
    }

    /// The loss of one condition, and its gradient with respect to the elevation's logits (one spline) and the azimuth's (one
    /// per point). `None`, and gradients left at zero, if the target is zero everywhere.
    fn condition(
        &mut self,
        loss: Loss,
        (points, densities): (&[f32], &[f32]),
        (elevation, azimuth): (&[f32], &[f32]),
        (by_elevation, by_azimuth): (&mut [f32], &mut [f32]),
    ) -> Option<f32> {
        let log_weights = log_weights(densities)?;
        let width = elevation.len();
        self.elevation.prepare(elevation);
        self.at_elevation.clear();
        self.log_q.clear();
        // The azimuth's gradients first for a weight of one: the weights are known when all densities are.
        for ((y, logits), gradient) in
            points.chunks_exact(2).zip(azimuth.chunks_exact(width)).zip(by_azimuth.chunks_exact_mut(width))
        {
            let at_elevation = self.elevation.log_density(y[1]);
            self.azimuth.prepare(logits);
            let at_azimuth = self.azimuth.log_density(y[0]);
            self.sums.add(&at_azimuth, 1.0);
            self.sums.finish(&self.azimuth, gradient);
            self.log_q.push(at_elevation.value + at_azimuth.value);
            self.at_elevation.push(at_elevation);
        }
        self.derivatives.resize(densities.len(), 0.0);
        let value = loss.evaluate(&log_weights, &self.log_q, &mut self.derivatives);
        for ((at, gradient), &derivative) in
            self.at_elevation.iter().zip(by_azimuth.chunks_exact_mut(width)).zip(&self.derivatives)
        {
            self.sums.add(at, derivative);
            gradient.iter_mut().for_each(|g| *g *= derivative);
        }
        self.sums.finish(&self.elevation, by_elevation);
        Some(value)
    }
}
