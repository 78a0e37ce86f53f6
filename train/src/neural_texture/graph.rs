//! The material in the tensor library: the reference for the renderer's evaluation and the fused gradient.

use std::f32::consts::FRAC_1_PI;

use burn::{
    prelude::{Device, Int, Tensor, TensorData},
    tensor::activation::{relu, sigmoid},
};
use glam::{Vec2, Vec3};
use headtail_render::{
    brdf::neural_texture::{
        COSINE_FLOOR, FARTHEST, FARTHEST_SHIFT, FEATURES, LARGEST_LOG, LEAST_SHIFT_COSINE, LOBE_FLOOR, Pyramid, WIDTHS,
    },
    fabric::Query,
};

use super::{
    Samples,
    layout::{LEAKY_SLOPE, Layout, NETWORKS},
    loss::Weighting,
};

/// The weights as tensors.
struct Tensors {
    texels: Tensor<2>,
    /// For each network, weights `[out, in]` and biases `[1, out]`.
    networks: Vec<Vec<(Tensor<2>, Tensor<2>)>>,
}

impl Layout {
    /// Returns the weights as tensors.
    fn tensors(&self, weights: &[f32], device: &Device) -> Tensors {
        let tensor = |values: &[f32], shape: [usize; 2]| {
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), shape), device).require_grad()
        };
        let (texels, mut rest) = weights.split_at(FEATURES * self.texels());
        let texels = tensor(texels, [self.texels(), FEATURES]);
        let mut networks = Vec::new();
        for sizes in NETWORKS {
            let mut layers = Vec::new();
            for size in sizes.windows(2) {
                let (weight, others) = rest.split_at(size[0] * size[1]);
                let (bias, others) = others.split_at(size[1]);
                layers.push((tensor(weight, [size[1], size[0]]), tensor(bias, [1, size[1]])));
                rest = others;
            }
            networks.push(layers);
        }
        Tensors { texels, networks }
    }

    /// Returns the mean error, and the gradient of all losses.
    pub fn gradient(&self, weights: &[f32], samples: &Samples, device: &Device) -> (f32, Vec<f32>) {
        let tensors = self.tensors(weights, device);
        let features = self.features(&tensors, samples, device);
        let directions = Directions::new(&samples.queries, device);
        let values = directions.reflectance(&tensors, features.clone());

        let flat: Vec<f32> = samples.values.iter().flat_map(Vec3::to_array).collect();
        let truth = Tensor::<2>::from_data(TensorData::new(flat, [samples.len(), 3]), device);
        // Sample weights are constants: no gradient propagates through them.
        let weighting = Weighting::new(samples);
        let of = |value: &[f32; 3]| [weighting.of(Vec3::from_array(*value)); 3];
        let known = values.clone().detach().try_into_vec_as::<f32>().expect("values are readable");
        let sample_weights: Vec<f32> = known.as_chunks().0.iter().flat_map(of).collect();
        let sample_weights = Tensor::<2>::from_data(TensorData::new(sample_weights, [samples.len(), 3]), device);
        let error = ((values - truth).powi_scalar(2) * sample_weights).sum();

        let likelihood = directions.likelihood(&tensors, features.detach(), samples, device);
        let loss = error.clone() - likelihood;
        let gradients = loss.backward();
        let mut flat = Vec::with_capacity(weights.len());
        let layers = tensors.networks.iter().flatten().flat_map(|(weight, bias)| [weight, bias]);
        for tensor in [&tensors.texels].into_iter().chain(layers) {
            match tensor.grad(&gradients) {
                Some(gradient) => flat.extend(gradient.try_into_vec_as::<f32>().expect("gradients are readable")),
                None => flat.resize(flat.len() + tensor.dims().iter().product::<usize>(), 0.0),
            }
        }
        (error.into_scalar::<f32>(), flat)
    }

    /// Returns the features of the shifted positions: `[samples, FEATURES]`.
    fn features(&self, tensors: &Tensors, samples: &Samples, device: &Device) -> Tensor<2> {
        let count = samples.len();
        let column =
            |values: Vec<f32>, width: usize| Tensor::<2>::from_data(TensorData::new(values, [count, width]), device);
        let (mut texels, mut weights) = (Vec::new(), Vec::new());
        for (query, &level) in samples.queries.iter().zip(&samples.levels) {
            for (texel, weight) in Pyramid::taps(self.side(), query.uv, level) {
                texels.push(texel as i32);
                weights.push(weight);
            }
        }
        let first = gathered(&tensors.texels, texels, column(weights, 8), device);

        let views = samples.queries.iter().flat_map(|query| [query.wo.x, query.wo.y]).collect();
        let raw = network(&tensors.networks[0], Tensor::cat(vec![first, column(views, 2)], 1));
        let amount = sigmoid(raw).mul_scalar(2.0).sub_scalar(1.0).mul_scalar(FARTHEST_SHIFT);
        let slopes = |query: &Query| Vec2::new(query.wo.x, query.wo.y) / query.wo.z.max(LEAST_SHIFT_COSINE);
        let slopes = samples.queries.iter().flat_map(|query| slopes(query).to_array()).collect();
        let places = samples.queries.iter().flat_map(|query| query.uv.to_array()).collect();
        let places = column(places, 2) + column(slopes, 2) * amount;
        self.lookup(tensors, &places, &samples.levels, device)
    }

    /// Performs the trilinear lookup at positions that gradients propagate to.
    fn lookup(&self, tensors: &Tensors, places: &Tensor<2>, levels: &[f32], device: &Device) -> Tensor<2> {
        let known = places.clone().detach().try_into_vec_as::<f32>().expect("places are readable");
        let count = levels.len();
        let mut texels = Vec::with_capacity(8 * count);
        // For each of the two levels: texels along an axis, texel offset of the positions, the level's
        // weight.
        let mut of_levels = [(); 2].map(|()| (Vec::new(), Vec::new(), Vec::new()));
        for (uv, &level) in known.as_chunks::<2>().0.iter().zip(levels) {
            let taps = Pyramid::taps(self.side(), Vec2::from_array(*uv), level);
            texels.extend(taps.iter().map(|&(texel, _)| texel as i32));
            let coarsest = self.side().ilog2();
            let below = (level.max(0.0) as u32).min(coarsest);
            let between = level.clamp(0.0, coarsest as f32) - below as f32;
            for (k, (sides, starts, level_weights)) in of_levels.iter_mut().enumerate() {
                let side = (self.side() >> (below + k as u32).min(coarsest)) as f32;
                sides.push(side);
                // The same operations as in the renderer, so that both find the same texel.
                starts.extend(uv.map(|x| x.floor() * side + ((x - x.floor()) * side - 0.5).floor() + 0.5));
                level_weights.push(if k == 0 { 1.0 - between } else { between });
            }
        }
        let column =
            |values: Vec<f32>, width: usize| Tensor::<2>::from_data(TensorData::new(values, [count, width]), device);
        let mut weights = Vec::new();
        for (sides, starts, level_weights) in of_levels {
            let inside = places.clone() * column(sides, 1) - column(starts, 2);
            let (s, t) = (inside.clone().narrow(1, 0, 1), inside.narrow(1, 1, 1));
            let level_weight = column(level_weights, 1);
            let (left, right) = (s.clone().neg().add_scalar(1.0) * level_weight.clone(), s * level_weight);
            let (top, bottom) = (t.clone().neg().add_scalar(1.0), t);
            weights.extend([left.clone() * top.clone(), right.clone() * top, left * bottom.clone(), right * bottom]);
        }
        gathered(&tensors.texels, texels, Tensor::cat(weights, 1), device)
    }
}

/// Returns sums of eight texels each, with weights `[samples, 8]`.
fn gathered(texels: &Tensor<2>, indices: Vec<i32>, weights: Tensor<2>, device: &Device) -> Tensor<2> {
    let count = indices.len() / 8;
    let indices = Tensor::<1, Int>::from_data(TensorData::new(indices, [8 * count]), device);
    let all = texels.clone().select(0, indices).reshape([count, 8, FEATURES]);
    (all * weights.reshape([count, 8, 1])).sum_dim(1).reshape([count, FEATURES])
}

/// Evaluates a network with leaky ReLU after all layers but the last.
fn network(layers: &[(Tensor<2>, Tensor<2>)], mut x: Tensor<2>) -> Tensor<2> {
    for (index, (weight, bias)) in layers.iter().enumerate() {
        x = x.matmul(weight.clone().transpose()) + bias.clone();
        if index + 1 < layers.len() {
            let positive = relu(x.clone());
            x = (x - positive.clone()).mul_scalar(LEAKY_SLOPE) + positive;
        }
    }
    x
}

/// Directions of a batch as tensors.
struct Directions {
    /// `wo.xy`, `wi.xy`.
    views: Tensor<2>,
    lights: Tensor<2>,
    /// `[samples, 1]`.
    cos_i: Tensor<2>,
    /// Slopes of half vectors, and the Jacobian from their density to solid angle.
    slopes: Tensor<2>,
    jacobian: Tensor<2>,
}

impl Directions {
    fn new(queries: &[Query], device: &Device) -> Self {
        let column = |width: usize, of: &dyn Fn(&Query) -> Vec3| {
            let values =
                queries.iter().flat_map(|query| of(query).to_array().into_iter().take(width)).collect::<Vec<_>>();
            Tensor::<2>::from_data(TensorData::new(values, [queries.len(), width]), device)
        };
        Self {
            views: column(2, &|query| query.wo),
            lights: column(2, &|query| query.wi),
            cos_i: column(1, &|query| Vec3::splat(query.wi.z)),
            slopes: column(2, &|query| -(query.wo + query.wi) / (query.wo.z + query.wi.z)),
            jacobian: column(1, &|query| {
                let h = query.wo + query.wi;
                Vec3::splat(h.dot(h) / (2.0 * h.z * h.z * h.z))
            }),
        }
    }

    /// Returns `f_r cos` per channel.
    fn reflectance(&self, tensors: &Tensors, features: Tensor<2>) -> Tensor<2> {
        let seen = Tensor::cat(vec![features, self.views.clone(), self.lights.clone()], 1);
        let logs = network(&tensors.networks[1], seen).clamp_max(LARGEST_LOG);
        logs.exp() * self.cos_i.clone()
    }

    /// Returns the mean log-density of both mixtures over samples, weighted by their reflectance.
    fn likelihood(&self, tensors: &Tensors, features: Tensor<2>, samples: &Samples, device: &Device) -> Tensor<1> {
        let raw = network(&tensors.networks[2], Tensor::cat(vec![features, self.views.clone()], 1));
        let column = |k: usize, count: usize| raw.clone().narrow(1, k, count);
        let lobe_weight = |k| sigmoid(column(k, 1)).mul_scalar(1.0 - LOBE_FLOOR - COSINE_FLOOR).add_scalar(LOBE_FLOOR);
        let width = |k, count| sigmoid(column(k, count)).mul_scalar(WIDTHS[1]).add_scalar(WIDTHS[0]);
        let shift = sigmoid(column(3, 2)).mul_scalar(2.0).sub_scalar(1.0).mul_scalar(FARTHEST);
        let moved = self.log_density(lobe_weight(0), width(1, 2), self.slopes.clone() - shift);
        let round = width(6, 1);
        let round = self.log_density(lobe_weight(5), Tensor::cat(vec![round.clone(), round], 1), self.slopes.clone());

        let weights = Weighting::new(samples).likelihood;
        let weights = Tensor::<2>::from_data(TensorData::new(weights, [samples.len(), 1]), device);
        ((moved + round) * weights).sum()
    }

    /// Returns a mixture's log-density for slopes relative to the centre of its lobe.
    fn log_density(&self, lobe_weight: Tensor<2>, widths: Tensor<2>, slopes: Tensor<2>) -> Tensor<2> {
        let q = (slopes / widths.clone()).powi_scalar(2).sum_dim(1).add_scalar(1.0);
        let area = widths.clone().narrow(1, 0, 1) * widths.narrow(1, 1, 1);
        let lobe = self.jacobian.clone() * (q.powi_scalar(2) * area).recip().mul_scalar(FRAC_1_PI);
        let cosine = self.cos_i.clone().mul_scalar(FRAC_1_PI);
        (lobe_weight.clone() * lobe + (lobe_weight.neg().add_scalar(1.0)) * cosine).log()
    }
}

/// Returns `f_r cos` per channel for each query, computed by the tensor library.
pub fn predict(side: usize, weights: &[f32], samples: &Samples, device: &Device) -> Vec<Vec3> {
    // Leaves of a graph need an autodiff device.
    let device = &device.clone().autodiff();
    let layout = Layout::new(side);
    let tensors = layout.tensors(weights, device);
    let features = layout.features(&tensors, samples, device);
    let values = Directions::new(&samples.queries, device).reflectance(&tensors, features);
    let flat = values.try_into_vec_as::<f32>().expect("values are readable");
    flat.as_chunks::<3>().0.iter().map(|&value| Vec3::from_array(value)).collect()
}
