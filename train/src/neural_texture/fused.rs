//! A step's gradient without a tensor library: lookups, networks, loss and their derivatives in one pass.
//!
//! Matrices are `[features, samples]`, row-major, so that samples lie in SIMD lanes; only matrix products use
//! a library. The result equals that of the graph in `graph.rs` to rounding.

use std::{f32::consts::FRAC_1_PI, ops::Range};

use glam::{Vec2, Vec3};
use headtail_render::{
    brdf::neural_texture::{
        COSINE_FLOOR, FARTHEST, FARTHEST_SHIFT, FEATURES, LARGEST_LOG, LEAST_SHIFT_COSINE, LOBE_FLOOR, Pyramid, WIDTHS,
    },
    simd::{self, Simd, Vectorized, sigmoid},
};
use rayon::prelude::*;

use super::{
    layout::{LEAKY_SLOPE, Layout},
    loss::Weighting,
    samples::Samples,
};
use crate::fused::{BackwardScratch, Hidden, Layer, Matrix};

/// Number of parts of a batch whose gradients are summed in order: fixed, so that the sum does not depend on
/// the number of threads.
const PARTS: usize = 4;
/// Samples that go through the networks side by side.
const GROUP: usize = 256;

/// Computes gradients of one layout; holds the buffers.
pub struct FusedGradient {
    layout: Layout,
    layers: [Vec<Layer>; 3],
    parts: Vec<Part>,
}

/// One part of a batch.
#[derive(Default)]
struct Part {
    error: f32,
    gradient: Vec<f32>,
    group: Group,
}

/// State of a group's samples on the forward pass, and derivatives on the backward pass.
#[derive(Default)]
struct Group {
    /// `[features + 2, samples]`: features of the position itself, `wo.xy`.
    place: Vec<f32>,
    /// `[features + 4, samples]`: features of the shifted position, `wo.xy`, `wi.xy`.
    seen: Vec<f32>,
    /// Shifted positions.
    shifted: Vec<Vec2>,
    hidden: [Hidden; 3],
    /// Outputs of the networks.
    shift: Vec<f32>,
    logs: Vec<f32>,
    mixture: Vec<f32>,
    scratch: BackwardScratch,
    /// Derivatives with respect to a network's output; below, its input.
    d_output: Vec<f32>,
    d_input: Vec<f32>,
}

impl FusedGradient {
    /// Creates buffers for materials of this layout.
    pub fn new(layout: Layout) -> Self {
        let layers = layout.networks().map(|(sizes, mut start)| {
            let layer = |size: &[usize]| {
                let layer = Layer { inputs: size[0], outputs: size[1], start };
                start += layer.length();
                layer
            };
            sizes.windows(2).map(layer).collect()
        });
        Self { layout, layers, parts: (0..PARTS).map(|_| Part::default()).collect() }
    }

    /// Returns the mean error of the samples, and the gradient of all losses.
    pub fn gradient(&mut self, weights: &[f32], samples: &Samples) -> (f32, Vec<f32>) {
        let weighting = Weighting::new(samples);
        let (count, side) = (samples.len(), self.layout.side());
        let (layers, length) = (&self.layers, weights.len());
        self.parts.par_iter_mut().enumerate().for_each(|(index, part)| {
            let range = index * count / PARTS..(index + 1) * count / PARTS;
            part.error = 0.0;
            part.gradient.clear();
            part.gradient.resize(length, 0.0);
            simd::dispatch(StepPart { part, side, layers, weights, samples, weighting: &weighting, range });
        });
        let mut gradient = vec![0.0; length];
        for part in &self.parts {
            gradient.iter_mut().zip(&part.gradient).for_each(|(sum, g)| *sum += g);
        }
        (self.parts.iter().map(|part| part.error).sum(), gradient)
    }
}

/// One part of a step.
struct StepPart<'a> {
    part: &'a mut Part,
    side: usize,
    layers: &'a [Vec<Layer>; 3],
    weights: &'a [f32],
    samples: &'a Samples,
    weighting: &'a Weighting,
    range: Range<usize>,
}

impl Vectorized for StepPart<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { part, side, layers, weights, samples, weighting, range } = self;
        for first in range.clone().step_by(GROUP) {
            let job = Job { side, weights, samples, weighting, range: first..(first + GROUP).min(range.end) };
            part.group.forward(&job, layers);
            part.error += part.group.backward(&job, layers, &mut part.gradient);
        }
    }
}

/// Samples that go through the networks side by side.
struct Job<'a> {
    side: usize,
    weights: &'a [f32],
    samples: &'a Samples,
    weighting: &'a Weighting,
    range: Range<usize>,
}

impl Job<'_> {
    fn texels(&self) -> &[[f32; FEATURES]] {
        &self.weights.as_chunks().0[..Pyramid::texel_count(self.side)]
    }
}

impl Group {
    #[inline(always)]
    fn forward(&mut self, job: &Job<'_>, layers: &[Vec<Layer>; 3]) {
        let count = job.range.len();
        let queries = &job.samples.queries[job.range.clone()];
        let levels = &job.samples.levels[job.range.clone()];
        let Self { place, seen, shifted, hidden, shift, logs, mixture, .. } = self;
        place.resize((FEATURES + 2) * count, 0.0);
        seen.resize((FEATURES + 4) * count, 0.0);
        for (k, (query, &level)) in queries.iter().zip(levels).enumerate() {
            store(job, query.uv, level, place, count, k);
            for (row, value) in [query.wo.x, query.wo.y].into_iter().enumerate() {
                place[(FEATURES + row) * count + k] = value;
            }
        }
        through(&layers[0], &mut hidden[0], job.weights, place, count, shift);
        shifted.clear();
        for (k, (query, &level)) in queries.iter().zip(levels).enumerate() {
            let amount = FARTHEST_SHIFT * (2.0 * sigmoid(shift[k]) - 1.0);
            let place = query.uv + amount * slope(query.wo);
            shifted.push(place);
            store(job, place, level, seen, count, k);
            for (row, value) in [query.wo.x, query.wo.y, query.wi.x, query.wi.y].into_iter().enumerate() {
                seen[(FEATURES + row) * count + k] = value;
            }
        }
        through(&layers[1], &mut hidden[1], job.weights, seen, count, logs);
        through(&layers[2], &mut hidden[2], job.weights, &seen[..(FEATURES + 2) * count], count, mixture);
    }

    /// Adds to the gradient and returns the sum of the group's errors.
    #[inline(always)]
    fn backward(&mut self, job: &Job<'_>, layers: &[Vec<Layer>; 3], gradient: &mut [f32]) -> f32 {
        let count = job.range.len();
        let queries = &job.samples.queries[job.range.clone()];
        let levels = &job.samples.levels[job.range.clone()];
        let Self { place, seen, shifted, hidden, shift, logs, mixture, scratch, d_output, d_input } = self;

        d_output.resize(mixture.len(), 0.0);
        for (k, query) in queries.iter().enumerate() {
            let raw = std::array::from_fn(|row| mixture[row * count + k]);
            let weight = job.weighting.likelihood[job.range.start + k];
            for (row, derivative) in likelihood(&raw, query.wo, query.wi).into_iter().enumerate() {
                d_output[row * count + k] = -weight * derivative;
            }
        }
        // Lobes do not propagate to the features.
        let mixture_seen = &seen[..(FEATURES + 2) * count];
        back(&layers[2], &hidden[2], job.weights, mixture_seen, d_output, count, scratch, gradient);

        d_output.resize(logs.len(), 0.0);
        let error = errors(job, logs, d_output);
        back(&layers[1], &hidden[1], job.weights, seen, d_output, count, scratch, gradient);
        layers[1][0].backward(job.weights, Matrix::new(&scratch.d_hidden, layers[1][0].outputs, count), d_input);

        d_output.resize(count, 0.0);
        for (k, (query, &level)) in queries.iter().zip(levels).enumerate() {
            let derivatives: [f32; FEATURES] = std::array::from_fn(|row| d_input[row * count + k]);
            let taps = Pyramid::taps(job.side, shifted[k], level);
            scatter(&taps, &derivatives, gradient);
            let by_place = slope_of_lookup(job, &taps, shifted[k], level, &derivatives);
            let half = sigmoid(shift[k]);
            d_output[k] = by_place.dot(slope(query.wo)) * FARTHEST_SHIFT * 2.0 * half * (1.0 - half);
        }
        back(&layers[0], &hidden[0], job.weights, place, d_output, count, scratch, gradient);
        layers[0][0].backward(job.weights, Matrix::new(&scratch.d_hidden, layers[0][0].outputs, count), d_input);
        for (k, (query, &level)) in queries.iter().zip(levels).enumerate() {
            let derivatives = std::array::from_fn(|row| d_input[row * count + k]);
            scatter(&Pyramid::taps(job.side, query.uv, level), &derivatives, gradient);
        }
        error
    }
}

/// Returns the direction of a lookup's shift, and its length for a depth of 1.
#[inline(always)]
fn slope(wo: Vec3) -> Vec2 {
    Vec2::new(wo.x, wo.y) / wo.z.max(LEAST_SHIFT_COSINE)
}

/// Writes the features of a position to column `k` of the first rows.
#[inline(always)]
fn store(job: &Job<'_>, uv: Vec2, level: f32, rows: &mut [f32], count: usize, k: usize) {
    let texels = job.texels();
    let mut sum = [0.0; FEATURES];
    for (texel, weight) in Pyramid::taps(job.side, uv, level) {
        for (sum, feature) in sum.iter_mut().zip(&texels[texel]) {
            *sum += weight * feature;
        }
    }
    for (row, value) in sum.into_iter().enumerate() {
        rows[row * count + k] = value;
    }
}

/// Propagates derivatives from looked-up features to texels, which come first in the weights.
#[inline(always)]
fn scatter(taps: &[(usize, f32); 8], derivatives: &[f32; FEATURES], gradient: &mut [f32]) {
    let texels = gradient.as_chunks_mut::<FEATURES>().0;
    for &(texel, weight) in taps {
        for (sum, derivative) in texels[texel].iter_mut().zip(derivatives) {
            *sum += weight * derivative;
        }
    }
}

/// Returns the derivatives with respect to the position of a lookup.
#[inline(always)]
fn slope_of_lookup(job: &Job<'_>, taps: &[(usize, f32); 8], uv: Vec2, level: f32, d: &[f32; FEATURES]) -> Vec2 {
    let (texels, coarsest) = (job.texels(), job.side.ilog2());
    let dot = |(texel, _): (usize, f32)| texels[texel].iter().zip(d).map(|(a, b)| a * b).sum::<f32>();
    let below = (level.max(0.0) as u32).min(coarsest);
    let between = level.clamp(0.0, coarsest as f32) - below as f32;
    let mut sum = Vec2::ZERO;
    for (k, level_weight) in [(0, 1.0 - between), (1, between)] {
        let side = (job.side >> (below + k as u32).min(coarsest)) as f32;
        // The same operations as in the lookup, so that both find the same texel.
        let inside = |x: f32| {
            let x = (x - x.floor()) * side - 0.5;
            x - x.floor()
        };
        let (s, t) = (inside(uv.x), inside(uv.y));
        let [a, b, c, e] = [0, 1, 2, 3].map(|tap| dot(taps[4 * k + tap]));
        let along_u = (1.0 - t) * (b - a) + t * (e - c);
        let along_v = (1.0 - s) * (c - a) + s * (e - b);
        sum += level_weight * side * Vec2::new(along_u, along_v);
    }
    sum
}

/// Evaluates a network over the columns of its input.
#[inline(always)]
fn through(layers: &[Layer], hidden: &mut Hidden, flat: &[f32], input: &[f32], count: usize, out: &mut Vec<f32>) {
    layers[0].forward(flat, Matrix::new(input, layers[0].inputs, count), hidden.first(layers));
    hidden.forward(layers, flat, LEAKY_SLOPE, count, out);
}

/// Adds the derivatives of a network's weights; those of the first layer's output remain in `scratch`.
#[expect(clippy::too_many_arguments, reason = "a network's way back takes all that its way forward left")]
#[inline(always)]
fn back(
    layers: &[Layer],
    hidden: &Hidden,
    flat: &[f32],
    input: &[f32],
    d_output: &[f32],
    count: usize,
    scratch: &mut BackwardScratch,
    gradient: &mut [f32],
) {
    let last = layers.last().expect("networks have layers");
    hidden.backward(layers, flat, LEAKY_SLOPE, Matrix::new(d_output, last.outputs, count), scratch, gradient);
    let d_first = Matrix::new(&scratch.d_hidden, layers[0].outputs, count);
    layers[0].add_gradient(d_first, Matrix::new(input, layers[0].inputs, count), gradient);
}

/// Computes errors of a group and their derivatives with respect to `ln f_r`.
#[inline(always)]
fn errors(job: &Job<'_>, logs: &[f32], d_logs: &mut [f32]) -> f32 {
    let count = job.range.len();
    let mut sum = 0.0;
    for k in 0..count {
        let (query, truth) = (&job.samples.queries[job.range.start + k], job.samples.values[job.range.start + k]);
        let raw = Vec3::new(logs[k], logs[count + k], logs[2 * count + k]);
        let value = query.wi.z * Vec3::new(simd_exp(raw.x), simd_exp(raw.y), simd_exp(raw.z));
        let weight = job.weighting.of(value);
        let apart = value - truth;
        sum += weight * apart.length_squared();
        let derivative = 2.0 * weight * apart * value;
        for channel in 0..3 {
            // Beyond the largest logarithm the derivative is zero.
            d_logs[channel * count + k] = if raw[channel] < LARGEST_LOG { derivative[channel] } else { 0.0 };
        }
    }
    sum
}

#[inline(always)]
fn simd_exp(raw: f32) -> f32 {
    simd::exp(if raw < LARGEST_LOG { raw } else { LARGEST_LOG })
}

/// Computes derivatives of the log-densities of both mixtures with respect to the network's outputs: mixture
/// weight, widths and shift of the first; mixture weight and width of the second.
#[inline(always)]
fn likelihood(raw: &[f32; 7], wo: Vec3, wi: Vec3) -> [f32; 7] {
    let h = wo + wi;
    let slopes = Vec2::new(-h.x, -h.y) / h.z;
    let jacobian = h.dot(h) / (2.0 * h.z * h.z * h.z);
    let cosine = FRAC_1_PI * wi.z;
    let [lobe_weight, x, y, shift_x, shift_y, round_weight, round] = raw.map(sigmoid);
    let slope_of = |half: f32| half * (1.0 - half);
    let mixed = |lobe_weight: f32, widths: Vec2, middle: Vec2| {
        let widths = Vec2::splat(WIDTHS[0]) + WIDTHS[1] * widths;
        let lobe_weight = LOBE_FLOOR + (1.0 - LOBE_FLOOR - COSINE_FLOOR) * lobe_weight;
        let apart = (slopes - middle) / widths;
        let q = 1.0 + apart.dot(apart);
        let lobe = FRAC_1_PI * jacobian / (q * q * widths.x * widths.y);
        let density = lobe_weight * lobe + (1.0 - lobe_weight) * cosine;
        // Derivatives of the logarithm with respect to mixture weight, widths and centre.
        let of_lobe = lobe_weight * lobe / density;
        let by_widths = of_lobe * (4.0 * apart * apart / q - Vec2::ONE) / widths;
        ((lobe - cosine) / density, by_widths, of_lobe * 4.0 * apart / (q * widths))
    };
    let of_weight = 1.0 - LOBE_FLOOR - COSINE_FLOOR;
    let middle = FARTHEST * Vec2::new(2.0 * shift_x - 1.0, 2.0 * shift_y - 1.0);
    let (by_weight, by_widths, by_middle) = mixed(lobe_weight, Vec2::new(x, y), middle);
    let (by_round_weight, by_round, _) = mixed(round_weight, Vec2::splat(round), Vec2::ZERO);
    [
        by_weight * of_weight * slope_of(lobe_weight),
        by_widths.x * WIDTHS[1] * slope_of(x),
        by_widths.y * WIDTHS[1] * slope_of(y),
        by_middle.x * FARTHEST * 2.0 * slope_of(shift_x),
        by_middle.y * FARTHEST * 2.0 * slope_of(shift_y),
        by_round_weight * of_weight * slope_of(round_weight),
        (by_round.x + by_round.y) * WIDTHS[1] * slope_of(round),
    ]
}
