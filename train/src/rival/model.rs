//! Densities of the samplers in the tensor library, with gradients.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use burn::{
    prelude::{Device, Tensor, TensorData},
    tensor::activation::{relu, sigmoid, softmax},
};
use headtail_model::spline::{self, Topology};
use headtail_render::{
    brdf::neural_texture::FEATURES,
    head::Linear,
    random::{Purpose, Stream},
    rival::{
        BINS, COORDINATE, LARGEST_LOG_SCALE, LARGEST_SHIFT, LEAKY_SLOPE, LEAST_COSINE_WEIGHT, LEAST_WIDTH, LOG_WIDTH,
        OCTAVES_OF_COORDINATE, OCTAVES_OF_VIEW, Rival, RivalKind, SPLINE_OUTPUTS, Traced, VIEW_CONDITION, WIDTH_RANGE,
    },
};

use super::{points::Points, view::View};
use crate::Result;

/// A network's layers: weights `[out, in]` and biases `[1, out]`.
type Layers = Vec<(Tensor<2>, Tensor<2>)>;

/// Returns the weights before the first step, network by network and layer by layer: a row-major `[out, in]`
/// weight, then a bias, initialised as in PyTorch. Last layers of splines and of the reparameterised sampler
/// are zero: they start as the identity.
pub fn initial_weights(kind: RivalKind, seed: u64) -> Vec<f32> {
    let mut random = Stream::new(seed, Purpose::Weights, 0);
    let mut weights = Vec::new();
    for (name, sizes) in kind.networks() {
        for (index, size) in sizes.windows(2).enumerate() {
            let begins_as_zero = index + 2 == sizes.len() && !matches!(*name, "lobes" | "prior");
            let bound = if begins_as_zero { 0.0 } else { 1.0 / (size[0] as f32).sqrt() };
            weights.extend((0..(size[0] + 1) * size[1]).map(|_| bound * (2.0 * random.uniform() - 1.0)));
        }
    }
    weights
}

/// Returns the renderer's form.
///
/// # Errors
/// If a weight is not finite.
pub fn native(kind: RivalKind, weights: &[f32]) -> Result<Rival> {
    let mut rest = weights;
    let mut networks = Vec::new();
    for (name, sizes) in kind.networks() {
        let mut layers = Vec::new();
        for size in sizes.windows(2) {
            let (weight, others) = rest.split_at(size[0] * size[1]);
            let (bias, others) = others.split_at(size[1]);
            layers.push(Linear::new(name, size[0], size[1], weight, bias.to_vec())?);
            rest = others;
        }
        networks.push(layers);
    }
    Ok(Rival::new(kind, networks)?)
}

fn tensors(kind: RivalKind, weights: &[f32], device: &Device) -> Vec<Layers> {
    let mut rest = weights;
    let mut take = |rows: usize, columns: usize| {
        let (own, others) = rest.split_at(rows * columns);
        rest = others;
        Tensor::<2>::from_data(TensorData::new(own.to_vec(), [rows, columns]), device).require_grad()
    };
    let networks = kind.networks().iter();
    networks.map(|(_, sizes)| sizes.windows(2).map(|s| (take(s[1], s[0]), take(1, s[1]))).collect()).collect()
}

/// Returns the cross-entropy over solid angle, averaged over views, and the gradient of the loss.
pub fn gradient(kind: RivalKind, weights: &[f32], rival: &Rival, points: &Points, device: &Device) -> (f32, Vec<f32>) {
    let networks = tensors(kind, weights, device);
    let batch = Columns { points, device };
    let by_cosine: f32 = points.wi.iter().zip(&points.weights).map(|(wi, weight)| weight * wi[2].ln()).sum();
    let (loss, value) = match rival {
        Rival::Lobes(_) | Rival::Flow(_) => {
            let logs = log_density(&networks, kind, &batch);
            let loss = (logs * batch.each(|_, k| points.weights[k])).sum().neg().div_scalar(points.views() as f32);
            let value = loss.clone().into_scalar::<f32>() - by_cosine / points.views() as f32;
            (loss, value)
        }
        Rival::Reparam(warp) => {
            let questions: Vec<_> = (0..points.wi.len())
                .map(|k| {
                    let view = &points.views[k / points.directions()];
                    (view.features, view.wo, points.wi[k])
                })
                .collect();
            implicit(&networks[0], &batch, &warp.trace(&questions))
        }
    };
    let gradients = loss.backward();
    let mut flat = Vec::with_capacity(weights.len());
    for tensor in networks.iter().flatten().flat_map(|(weight, bias)| [weight, bias]) {
        match tensor.grad(&gradients) {
            Some(gradient) => flat.extend(gradient.try_into_vec_as::<f32>().expect("gradients are readable")),
            None => flat.resize(flat.len() + tensor.dims().iter().product::<usize>(), 0.0),
        }
    }
    (value, flat)
}

/// Points as tensors.
pub struct Columns<'a> {
    pub points: &'a Points,
    pub device: &'a Device,
}

impl Columns<'_> {
    fn matrix(&self, values: Vec<f32>, columns: usize) -> Tensor<2> {
        let rows = values.len() / columns;
        Tensor::from_data(TensorData::new(values, [rows, columns]), self.device)
    }

    /// Returns one number per direction, `[views, directions]`, from the indices of its view and of the
    /// direction.
    fn each(&self, of: impl Fn(usize, usize) -> f32) -> Tensor<2> {
        let each = self.points.directions();
        self.matrix((0..self.points.wi.len()).map(|k| of(k / each, k)).collect(), each)
    }

    /// Returns the network inputs of each view, `[views, VIEW_CONDITION]`.
    fn conditions(&self) -> Tensor<2> {
        self.matrix(self.points.views.iter().flat_map(condition).collect(), VIEW_CONDITION)
    }

    /// Returns the network inputs of each direction, `[views * directions, VIEW_CONDITION]`.
    fn repeated_conditions(&self) -> Tensor<2> {
        let each = self.points.directions();
        let repeated = |view: &View| std::iter::repeat_n(condition(view), each).flatten();
        self.matrix(self.points.views.iter().flat_map(repeated).collect(), VIEW_CONDITION)
    }
}

/// Returns features, `wo.xy` and its sinusoidal encoding.
fn condition(view: &View) -> [f32; VIEW_CONDITION] {
    let mut out = [0.0; VIEW_CONDITION];
    out[..FEATURES].copy_from_slice(&view.features);
    out[FEATURES..FEATURES + 2].copy_from_slice(&view.wo[..2]);
    for axis in 0..2 {
        for k in 0..OCTAVES_OF_VIEW {
            let (sin, cos) = (PI * (1 << k) as f32 * view.wo[axis]).sin_cos();
            let at = FEATURES + 2 + 2 * (axis * OCTAVES_OF_VIEW + k);
            (out[at], out[at + 1]) = (sin, cos);
        }
    }
    out
}

/// Returns a coordinate and its sinusoidal encoding, with their derivatives.
fn coordinate(x: f32) -> [[f32; COORDINATE]; 2] {
    let (mut out, mut slopes) = ([0.0; COORDINATE], [0.0; COORDINATE]);
    (out[0], slopes[0]) = (x, 1.0);
    for k in 0..OCTAVES_OF_COORDINATE {
        let rate = PI * (1 << k) as f32;
        let (sin, cos) = (rate * x).sin_cos();
        (out[1 + 2 * k], out[2 + 2 * k]) = (sin, cos);
        (slopes[1 + 2 * k], slopes[2 + 2 * k]) = (rate * cos, -rate * sin);
    }
    [out, slopes]
}

/// Evaluates a network with leaky ReLU after all layers but the last.
fn network(layers: &Layers, mut x: Tensor<2>) -> Tensor<2> {
    for (index, (weight, bias)) in layers.iter().enumerate() {
        x = x.matmul(weight.clone().transpose()) + bias.clone();
        if index + 1 < layers.len() {
            let positive = relu(x.clone());
            x = (x - positive.clone()).mul_scalar(LEAKY_SLOPE) + positive;
        }
    }
    x
}

/// Returns the log-density over the disk, `[views, directions]`.
fn log_density(networks: &[Layers], kind: RivalKind, batch: &Columns<'_>) -> Tensor<2> {
    match kind {
        RivalKind::Flow => log_flow(networks, batch),
        _ => log_lobes(&networks[0], batch),
    }
}

fn log_lobes(layers: &Layers, batch: &Columns<'_>) -> Tensor<2> {
    let raw = network(layers, batch.conditions());
    let column = |k: usize| raw.clone().narrow(1, k, 1);
    let lobe_weights = softmax(raw.clone().narrow(1, 0, 3), 1).mul_scalar(1.0 - LEAST_COSINE_WEIGHT);
    let place = [0, 1].map(|axis| batch.each(|_, k| batch.points.wi[k][axis]));
    let cosine = lobe_weights.clone().narrow(1, 0, 1).add_scalar(LEAST_COSINE_WEIGHT).mul_scalar(FRAC_1_PI);
    let mut density = batch.each(|_, _| 0.0) + cosine;
    for gaussian in 0..2 {
        let width =
            |axis: usize| sigmoid(column(5 + 4 * gaussian + axis)).mul_scalar(WIDTH_RANGE).add_scalar(LEAST_WIDTH);
        let from_middle = |axis: usize| (place[axis].clone() - column(3 + 4 * gaussian + axis)) / width(axis);
        let squared = from_middle(0).powi_scalar(2) + from_middle(1).powi_scalar(2);
        let scale = lobe_weights.clone().narrow(1, 1 + gaussian, 1) / (width(0) * width(1)).mul_scalar(TAU);
        density = density + squared.mul_scalar(-0.5).exp() * scale;
    }
    density.log()
}

fn log_flow(networks: &[Layers], batch: &Columns<'_>) -> Tensor<2> {
    let points = batch.points;
    let [views, each] = [points.views(), points.directions()];
    let conditions = batch.repeated_conditions();
    let spline = |layers: &Layers, other: Tensor<2>, at: Tensor<2>| {
        let raw = network(layers, Tensor::cat(vec![conditions.clone(), other], 1));
        let raw = raw.reshape([views, each, SPLINE_OUTPUTS]);
        let end = Tensor::<3>::zeros([views, each, 1], batch.device);
        let logits = vec![raw.clone().narrow(2, 0, 2 * BINS), end.clone(), raw.narrow(2, 2 * BINS, BINS - 1), end];
        let unit = at.add_scalar(1.0).mul_scalar(0.5);
        let (z, log) = spline::inverse(Topology::Interval, unit, &Tensor::cat(logits, 2));
        (z.mul_scalar(2.0).sub_scalar(1.0), log)
    };
    let seen = batch.matrix(points.wi.iter().flat_map(|wi| coordinate(wi[0])[0]).collect(), COORDINATE);
    let (b, log_first) = spline(&networks[2], seen, batch.each(|_, k| points.wi[k][1]));
    let flat = b.clone().reshape([views * each, 1]);
    let mut waves = vec![flat.clone()];
    for k in 0..OCTAVES_OF_COORDINATE {
        let angle = flat.clone().mul_scalar(PI * (1 << k) as f32);
        waves.extend([angle.clone().sin(), angle.cos()]);
    }
    let (a, log_second) = spline(&networks[1], Tensor::cat(waves, 1), batch.each(|_, k| points.wi[k][0]));
    let prior = network(&networks[0], batch.conditions());
    let column = |k: usize| prior.clone().narrow(1, k, 1);
    let log_width = |axis: usize| {
        let between = sigmoid(column(2 + axis)).mul_scalar(2.0).sub_scalar(1.0);
        between.mul_scalar(LOG_WIDTH[1]).add_scalar(LOG_WIDTH[0])
    };
    let from_middle = |axis: usize, z: Tensor<2>| (z - column(axis)) / log_width(axis).exp();
    let squared = from_middle(0, a).powi_scalar(2) + from_middle(1, b).powi_scalar(2);
    squared.mul_scalar(-0.5) - log_width(0) - log_width(1) + log_first + log_second - TAU.ln()
}

/// Returns a loss with the gradient of the cross-entropy of the reparameterised sampler, and the
/// cross-entropy over solid angle.
///
/// A direction `s = F(p; w)` is fixed, so `p` moves with the weights: `dp/dw = -J^-1 dF/dw`. Therefore
/// `d ln q / dw = -d ln |det J| / dw - (J^-T v) . dF/dw` with `v` the gradient of `ln q` with respect to `p`:
/// that of `-ln |det J| - pull . F` with `p` and `pull` fixed. The cosine lobe reduces the gradient by its
/// responsibility.
fn implicit(layers: &Layers, batch: &Columns<'_>, traced: &[Traced]) -> (Tensor<1>, f32) {
    let points = batch.points;
    let count = traced.len();
    let column = |of: &dyn Fn(usize) -> f32| batch.matrix((0..count).map(of).collect(), 1);
    let inverse = |k: usize| (1.0 + traced[k].p[0].powi(2) + traced[k].p[1].powi(2)).sqrt().recip();
    let disk = |k: usize, axis: usize| traced[k].p[axis] * inverse(k);
    let encoded: Vec<[[[f32; COORDINATE]; 2]; 2]> =
        (0..count).map(|k| [coordinate(disk(k, 0)), coordinate(disk(k, 1))]).collect();
    let zeros = [0.0; COORDINATE];
    let wave = |of: &dyn Fn(usize) -> [[f32; COORDINATE]; 2]| {
        batch.matrix((0..count).flat_map(|k| of(k).into_iter().flatten()).collect(), 2 * COORDINATE)
    };
    let known = (0..count).flat_map(|k| {
        let view = &points.views[k / points.directions()];
        view.features.into_iter().chain([view.wo[0], view.wo[1]])
    });
    let known = batch.matrix(known.collect(), FEATURES + 2);
    let (first, bias) = &layers[0];
    let of_known = first.clone().narrow(1, 0, FEATURES + 2).transpose();
    let of_disk = first.clone().narrow(1, FEATURES + 2, 2 * COORDINATE).transpose();
    let mut x =
        known.matmul(of_known) + wave(&|k| [encoded[k][0][0], encoded[k][1][0]]).matmul(of_disk.clone()) + bias.clone();
    let mut by = [
        wave(&|k| [encoded[k][0][1], zeros]).matmul(of_disk.clone()),
        wave(&|k| [zeros, encoded[k][1][1]]).matmul(of_disk),
    ];
    for (weight, bias) in &layers[1..] {
        let s = sigmoid(x.clone());
        let slope = s.clone() * (x.clone() * s.clone().neg().add_scalar(1.0)).add_scalar(1.0);
        let weight = weight.clone().transpose();
        by = by.map(|by| (by * slope.clone()).matmul(weight.clone()));
        x = (x * s).matmul(weight) + bias.clone();
    }
    // The outputs, and their derivatives with respect to p: dd/dp is symmetric.
    let d_by_p = [
        column(&|k| inverse(k) * (1.0 - disk(k, 0).powi(2))),
        column(&|k| -inverse(k) * disk(k, 0) * disk(k, 1)),
        column(&|k| inverse(k) * (1.0 - disk(k, 1).powi(2))),
    ];
    let output = |k: usize, bound: f32| {
        let tanh = x.clone().narrow(1, k, 1).div_scalar(bound).tanh();
        let slope = tanh.clone().powi_scalar(2).neg().add_scalar(1.0);
        let [dx, dy] = [0, 1].map(|axis: usize| by[axis].clone().narrow(1, k, 1));
        let by_p = [
            slope.clone() * (dx.clone() * d_by_p[0].clone() + dy.clone() * d_by_p[1].clone()),
            slope * (dx * d_by_p[1].clone() + dy * d_by_p[2].clone()),
        ];
        (tanh.mul_scalar(bound), by_p)
    };
    let (log_scale, scale_by) = output(2, LARGEST_LOG_SCALE);
    let scale = log_scale.exp();
    let p = [0, 1].map(|axis| column(&|k| traced[k].p[axis]));
    let row = |axis: usize| {
        let (shift, shift_by) = output(axis, LARGEST_SHIFT);
        let s = scale.clone() * p[axis].clone() + shift;
        let [a, b] = shift_by;
        let by = |k: usize, of_shift: Tensor<2>| {
            let moved = scale.clone() * scale_by[k].clone() * p[axis].clone() + of_shift;
            if k == axis { moved + scale.clone() } else { moved }
        };
        (s, [by(0, a), by(1, b)])
    };
    let ((sx, [xx, xy]), (sy, [yx, yy])) = (row(0), row(1));
    let determinant = (xx * yy - xy * yx).abs().clamp_min(1e-12).log();
    let weight = column(&|k| points.weights[k] * traced[k].fraction / points.views() as f32);
    let pulled = sx * column(&|k| traced[k].pull[0]) + sy * column(&|k| traced[k].pull[1]);
    let rest = |k: usize| PI.ln() - 4.0 * inverse(k).ln() + 3.0 * points.wi[k][2].ln();
    let value = ((determinant.clone() + column(&rest)) * weight.clone()).sum().into_scalar::<f32>();
    (((determinant + pulled) * weight).sum(), value)
}

/// Returns the log-density over the disk for each direction, computed by the tensor library. For tests.
#[cfg(test)]
pub fn log_densities(kind: RivalKind, weights: &[f32], points: &Points, device: &Device) -> Vec<f32> {
    let networks = tensors(kind, weights, device);
    let logs = log_density(&networks, kind, &Columns { points, device });
    logs.try_into_vec_as::<f32>().expect("values are readable")
}
