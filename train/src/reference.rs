//! The loss of a head in f64, written plainly: the reference for all gradients.
//!
//! It shares no code with the training forms: dense layers are loops, splines are evaluated by their
//! definition (DESIGN 3.1, Durkan et al. 2019, eq. 4), and derivatives are central differences.

use std::f64::consts::TAU;

use headtail_model::{
    EncoderConfig, HeadConfig, Mode,
    head::{MIXTURE_WEIGHT_FLOOR, MIXTURE_WEIGHT_HIDDEN},
};
use headtail_render::spline::{MIN_BIN, MIN_SLOPE, SLOPE_OFFSET, bin_count};

use crate::integrand::Batch;

/// Returns the mean log-chi-square loss, mixed with BRDF sampling if the head has a learned mixture weight.
///
/// # Panics
/// If `weights` are not those of a head of this shape.
pub fn log_chi_square(config: &HeadConfig, weights: &[f64], batch: &Batch) -> f64 {
    let (mut sum, mut lit) = (0.0, 0);
    for (index, c) in batch.conditions.chunks_exact(batch.condition_length).enumerate() {
        let points = batch.condition(index);
        if !points.is_lit() {
            continue;
        }
        lit += 1;
        let head = Head::new(config, weights, c, f64::from(points.mixture_weight_logit));
        let product = |k: usize| f64::from(points.densities[k]) * f64::from(points.weights[k]);
        let total: f64 = (0..batch.samples).map(product).sum();
        let mean = total / batch.samples as f64;
        let term = |k: usize| {
            let at = 2 * (index * batch.samples + k);
            let q = head.density(f64::from(batch.points[at]), f64::from(batch.points[at + 1]));
            let q = head.mixture_weight.map_or(q, |p| p * q + (1.0 - p) * f64::from(points.brdf[k]));
            product(k) / total * f64::from(points.densities[k]) / mean / q
        };
        sum += (0..batch.samples).filter(|&k| product(k) > 0.0).map(term).sum::<f64>().ln();
    }
    sum / f64::from(lit)
}

/// Returns the largest difference between `gradient` along a few directions and central differences of
/// [`log_chi_square`], relative to the gradient's norm.
pub fn gradient_error(config: &HeadConfig, weights: &[f32], batch: &Batch, gradient: &[f32]) -> f64 {
    /// Truncation error is quadratic in the step; rounding is 1e-16 / STEP.
    const STEP: f64 = 1e-5;
    let norm = gradient.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
    let along = |direction: &[f64]| {
        let moved =
            |step: f64| -> Vec<f64> { weights.iter().zip(direction).map(|(&w, d)| f64::from(w) + step * d).collect() };
        let high = log_chi_square(config, &moved(STEP), batch);
        let low = log_chi_square(config, &moved(-STEP), batch);
        let found: f64 = gradient.iter().zip(direction).map(|(&g, d)| f64::from(g) * d).sum();
        (found - (high - low) / (2.0 * STEP)).abs() / norm
    };
    // The gradient's own direction, and four unrelated ones.
    let own: Vec<f64> = gradient.iter().map(|&g| f64::from(g) / norm).collect();
    let size = (weights.len() as f64).sqrt();
    let other = |k: usize| -> Vec<f64> {
        (0..weights.len())
            .map(|i| if (i * (2 * k + 3) / 7 + i / 5).is_multiple_of(2) { 1.0 / size } else { -1.0 / size })
            .collect()
    };
    (0..4).map(|k| along(&other(k))).fold(along(&own), f64::max)
}

/// A head at one condition.
struct Head<'a> {
    config: &'a HeadConfig,
    seen: Vec<f64>,
    elevation: Vec<Layer<'a>>,
    azimuth: Vec<Layer<'a>>,
    /// Probability of drawing from the head.
    mixture_weight: Option<f64>,
}

struct Layer<'a> {
    weight: &'a [f64],
    bias: &'a [f64],
}

impl Layer<'_> {
    fn forward(&self, x: &[f64]) -> Vec<f64> {
        let row = |(row, bias): (&[f64], &f64)| row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + bias;
        self.weight.chunks_exact(x.len()).zip(self.bias).map(row).collect()
    }
}

impl<'a> Head<'a> {
    fn new(config: &'a HeadConfig, mut weights: &'a [f64], condition: &[f32], mixture_weight_logit: f64) -> Self {
        let mut layers = |sizes: &[usize]| -> Vec<Layer<'a>> {
            let layer = |pair: &[usize]| {
                let (weight, rest) = weights.split_at(pair[0] * pair[1]);
                let (bias, rest) = rest.split_at(pair[1]);
                weights = rest;
                Layer { weight, bias }
            };
            sizes.windows(2).map(layer).collect()
        };
        let mut seen: Vec<f64> = condition.iter().map(|&x| f64::from(x)).collect();
        if let Some(EncoderConfig { hidden, output }) = config.encoder {
            let mut x = seen.clone();
            for layer in layers(&[seen.len(), hidden, output]) {
                x = activated(layer.forward(&x), config);
            }
            seen.extend(x);
        }
        let hidden = vec![config.hidden; config.hidden_layers];
        let mut network =
            |features: usize| layers(&[vec![seen.len() + features], hidden.clone(), vec![config.logits()]].concat());
        let elevation = network(if config.mode == Mode::Coupled { 2 } else { 0 });
        let azimuth = network(1);
        let floor = f64::from(MIXTURE_WEIGHT_FLOOR);
        let mixture_weight = config.share.then(|| {
            let logit = perceptron(&layers(&[seen.len(), MIXTURE_WEIGHT_HIDDEN, 1]), &seen, config)[0];
            floor + (1.0 - 2.0 * floor) / (1.0 + (-logit - mixture_weight_logit).exp())
        });
        assert!(weights.is_empty(), "the weights are those of a head of this shape");
        Self { config, seen, elevation, azimuth, mixture_weight }
    }

    /// Returns the density at `y = (u, v)`.
    fn density(&self, u: f64, v: f64) -> f64 {
        let coupled = self.config.mode == Mode::Coupled;
        let features = if coupled { vec![(TAU * u).cos(), (TAU * u).sin()] } else { Vec::new() };
        let logits = perceptron(&self.elevation, &[&self.seen[..], &features].concat(), self.config);
        let (z, d_v) = spline(&logits, v, false);
        let logits = perceptron(&self.azimuth, &[&self.seen[..], &[if coupled { z } else { v }]].concat(), self.config);
        let turns = logits[logits.len() - 1];
        d_v * spline(&logits, (u + turns).rem_euclid(1.0), true).1
    }
}

fn activated(x: Vec<f64>, config: &HeadConfig) -> Vec<f64> {
    x.into_iter().map(|x| if x > 0.0 { x } else { f64::from(config.leaky_slope) * x }).collect()
}

fn perceptron(layers: &[Layer<'_>], x: &[f64], config: &HeadConfig) -> Vec<f64> {
    let (last, inner) = layers.split_last().expect("a network has layers");
    let hidden = inner.iter().fold(x.to_vec(), |x, layer| activated(layer.forward(&x), config));
    last.forward(&hidden)
}

/// Returns value and slope of the spline at `x`.
fn spline(logits: &[f64], x: f64, circle: bool) -> (f64, f64) {
    let bins = bin_count(logits.len());
    let sizes = |logits: &[f64]| -> Vec<f64> {
        let total: f64 = logits.iter().map(|x| x.exp()).sum();
        logits.iter().map(|x| MIN_BIN + (1.0 - bins as f64 * MIN_BIN) * x.exp() / total).collect()
    };
    let (widths, heights) = (sizes(&logits[..bins]), sizes(&logits[bins..2 * bins]));
    let slope = |knot: usize| {
        let logit = logits[2 * bins + if circle { knot % bins } else { knot }];
        MIN_SLOPE + (logit + SLOPE_OFFSET).exp().ln_1p()
    };
    let (mut left, mut bottom, mut bin) = (0.0, 0.0, 0);
    while bin + 1 < bins && x >= left + widths[bin] {
        left += widths[bin];
        bottom += heights[bin];
        bin += 1;
    }
    let (width, height, d0, d1) = (widths[bin], heights[bin], slope(bin), slope(bin + 1));
    let (t, s) = ((x - left) / width, height / width);
    let o = 1.0 - t;
    let denominator = s + (d0 + d1 - 2.0 * s) * t * o;
    let value = bottom + height * (s * t * t + d0 * t * o) / denominator;
    (value, s * s * (d1 * t * t + 2.0 * s * t * o + d0 * o * o) / (denominator * denominator))
}
