//! Compares the model with an independent implementation in f64: splines by the formula of Gregory and
//! Delbourgo (1982) with roots by bisection, networks by plain loops, gradients by central differences.
//!
//! It is written from the documented layout of logits and weights, so it also tests that the documentation
//! suffices to read an exported head.

use burn::{
    optim::GradientsParams,
    prelude::{Device, Module, Tensor, TensorData},
};
use headtail_model::{
    EncoderConfig, Head, HeadConfig, Mode, NamedTensor,
    spline::{self, Topology},
};
use headtail_render::random::{Purpose, Stream};
use headtail_train::{Backend, Batch, GradientSource, Loss, Objective, fused::FusedGradient};

const MIN: f64 = 1e-4;

/// The CPU backend of the default build.
fn host() -> Device {
    Backend::default().device().expect("it is compiled")
}

/// One spline in f64, built from logits as documented in `headtail_model::spline`.
struct Spline {
    xs: Vec<f64>,
    ys: Vec<f64>,
    slopes: Vec<f64>,
    shift: f64,
}

impl Spline {
    fn new(topology: Topology, logits: &[f64]) -> Self {
        let k = (logits.len() - 1) / 3;
        let knots = |logits: &[f64]| {
            let total: f64 = logits.iter().map(|l| l.exp()).sum();
            let mut knots = vec![0.0];
            for logit in logits {
                knots.push(knots.last().unwrap() + MIN + (1.0 - k as f64 * MIN) * logit.exp() / total);
            }
            knots
        };
        let offset = ((1.0 - MIN).exp() - 1.0).ln();
        let slope = |logit: &f64| MIN + (1.0 + (logit + offset).exp()).ln();
        let mut slopes: Vec<f64> = logits[2 * k..3 * k].iter().map(slope).collect();
        let (last, shift) = match topology {
            Topology::Interval => (slope(&logits[3 * k]), 0.0),
            Topology::Circle => (slopes[0], logits[3 * k]),
        };
        slopes.push(last);
        Self { xs: knots(&logits[..k]), ys: knots(&logits[k..2 * k]), slopes, shift }
    }

    /// Returns value and derivative.
    fn inverse(&self, y: f64) -> (f64, f64) {
        let x = if self.shift == 0.0 { y } else { (y + self.shift).rem_euclid(1.0) };
        let k = (1..self.xs.len() - 1).rev().find(|&k| self.xs[k] <= x).unwrap_or(0);
        let (w, h) = (self.xs[k + 1] - self.xs[k], self.ys[k + 1] - self.ys[k]);
        let (d0, d1, s, t) = (self.slopes[k], self.slopes[k + 1], h / w, (x - self.xs[k]) / w);
        let denominator = s + (d1 + d0 - 2.0 * s) * t * (1.0 - t);
        let value = self.ys[k] + h * (s * t * t + d0 * t * (1.0 - t)) / denominator;
        let slope =
            s * s * (d1 * t * t + 2.0 * s * t * (1.0 - t) + d0 * (1.0 - t) * (1.0 - t)) / (denominator * denominator);
        (value, slope)
    }

    /// Returns the point before the shift whose value is `z`, by bisection.
    fn forward(&self, z: f64) -> f64 {
        let unshifted = Self { shift: 0.0, xs: self.xs.clone(), ys: self.ys.clone(), slopes: self.slopes.clone() };
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if unshifted.inverse(middle).0 < z { low = middle } else { high = middle }
        }
        (0.5 * (low + high) - self.shift).rem_euclid(1.0)
    }
}

/// A head in f64 from its exported weights.
struct Reference {
    config: HeadConfig,
    weights: Vec<(String, Vec<usize>, Vec<f64>)>,
}

impl Reference {
    fn new(config: HeadConfig, weights: &[NamedTensor]) -> Self {
        let widen =
            |w: &NamedTensor| (w.name.clone(), w.shape.clone(), w.values.iter().map(|&v| f64::from(v)).collect());
        Self { config, weights: weights.iter().map(widen).collect() }
    }

    fn affine(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let get = |suffix: &str| self.weights.iter().find(|w| w.0 == format!("{name}.{suffix}")).unwrap();
        let ((_, shape, weight), (_, _, bias)) = (get("weight"), get("bias"));
        assert_eq!(shape[1], x.len());
        (0..shape[0]).map(|o| bias[o] + (0..x.len()).map(|i| weight[o * x.len() + i] * x[i]).sum::<f64>()).collect()
    }

    fn leaky(&self, x: Vec<f64>) -> Vec<f64> {
        x.into_iter().map(|x| if x < 0.0 { f64::from(self.config.leaky_slope) * x } else { x }).collect()
    }

    fn logits(&self, layer: usize, condition: &[f64], features: &[f64]) -> Vec<f64> {
        let mut x = [condition, features].concat();
        for index in 0..self.config.hidden_layers {
            x = self.leaky(self.affine(&format!("layer{layer}.linear{index}"), &x));
        }
        self.affine(&format!("layer{layer}.linear{}", self.config.hidden_layers), &x)
    }

    /// Returns the condition and the encoder's output.
    fn encode(&self, c: &[f64]) -> Vec<f64> {
        let mut condition = c.to_vec();
        if self.config.encoder.is_some() {
            let hidden = self.leaky(self.affine("encoder.linear0", c));
            condition.extend(self.leaky(self.affine("encoder.linear1", &hidden)));
        }
        condition
    }

    /// The mixture weight of the head: the learned one relative to a given one with logit `prior`.
    fn mixture_weight(&self, c: &[f64], prior: f64) -> f64 {
        let hidden = self.leaky(self.affine("selection.linear0", &self.encode(c)));
        0.02 + 0.96 / (1.0 + (-self.affine("selection.linear1", &hidden)[0] - prior).exp())
    }

    fn log_density(&self, y: [f64; 2], c: &[f64]) -> f64 {
        let condition = self.encode(c);
        let angle = std::f64::consts::TAU * y[0];
        let (features, coupled) = match self.config.mode {
            Mode::Coupled => (vec![angle.cos(), angle.sin()], true),
            Mode::Autoregressive => (vec![], false),
        };
        let (z_v, slope_v) = Spline::new(Topology::Interval, &self.logits(0, &condition, &features)).inverse(y[1]);
        let seen = if coupled { z_v } else { y[1] };
        let (_, slope_u) = Spline::new(Topology::Circle, &self.logits(1, &condition, &[seen])).inverse(y[0]);
        slope_v.ln() + slope_u.ln()
    }
}

fn normal(stream: &mut Stream) -> f32 {
    let radius = (-2.0 * (1.0 - stream.uniform()).ln()).sqrt();
    radius * (std::f32::consts::TAU * stream.uniform()).cos()
}

fn read<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().unwrap()
}

fn widen(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn configurations() -> Vec<HeadConfig> {
    let encoder = Some(EncoderConfig { hidden: 7, output: 5 });
    [Mode::Coupled, Mode::Autoregressive]
        .into_iter()
        .flat_map(|mode| {
            [
                HeadConfig { mode, ..HeadConfig::COSINE },
                HeadConfig { mode, encoder, bins: 6, hidden: 16, ..HeadConfig::COSINE },
            ]
        })
        .collect()
}

/// A head far from the identity.
fn random_head(config: HeadConfig, device: &Device) -> Head {
    let mut weights = Head::new(config, 1, device).unwrap().weights();
    let mut stream = Stream::new(1, Purpose::Test, 0);
    for weight in &mut weights {
        if weight.values.iter().all(|&value| value == 0.0) {
            weight.values.iter_mut().for_each(|value| *value = 0.3 * normal(&mut stream));
        }
    }
    Head::from_weights(config, weights, device).unwrap()
}

fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
}

#[test]
fn reference_spline_derivatives_match_finite_differences() {
    let mut stream = Stream::new(0, Purpose::Test, 1);
    for topology in [Topology::Interval, Topology::Circle] {
        let logits: Vec<f64> = (0..3 * 8 + 1).map(|_| f64::from(normal(&mut stream))).collect();
        let spline = Spline::new(topology, &logits);
        for _ in 0..100 {
            let (y, step) = (f64::from(stream.uniform()).clamp(0.01, 0.99), 1e-7);
            let (low, high) = (spline.inverse(y - step).0, spline.inverse(y + step).0);
            let difference = (high - low).rem_euclid(1.0) / (2.0 * step);
            assert!((difference / spline.inverse(y).1 - 1.0).abs() < 1e-4);
        }
    }
}

#[test]
fn splines_agree_with_the_reference_in_both_directions() {
    let device = host();
    let mut stream = Stream::new(0, Purpose::Test, 2);
    let (bins, samples) = (32, 200);
    for topology in [Topology::Interval, Topology::Circle] {
        for _ in 0..50 {
            let logits: Vec<f32> = (0..spline::logit_count(bins)).map(|_| 1.5 * normal(&mut stream)).collect();
            let points: Vec<f32> = (0..samples).map(|_| stream.uniform()).collect();
            let reference = Spline::new(topology, &widen(&logits));
            let logits = tensor(&logits, [1, 1, spline::logit_count(bins)], &device);
            let (z, log) = spline::inverse(topology, tensor(&points, [1, samples], &device), &logits);
            let (y, _) = spline::forward(topology, tensor(&points, [1, samples], &device), &logits);
            let (z, log, y) = (read(z), read(log), read(y));
            let narrowest = reference.xs.windows(2).map(|x| x[1] - x[0]).fold(1.0, f64::min);
            for i in 0..samples {
                let point = f64::from(points[i]);
                let (value, slope) = reference.inverse(point);
                let turn = |error: f64| error.abs().min(1.0 - error.abs());
                // f32 knots have errors up to 1e-6, which the slope and the inverse of the width amplify.
                assert!(turn(f64::from(z[i]) - value) < 1e-6 + 1e-6 * slope, "{} {value}", z[i]);
                assert!((f64::from(log[i]) - slope.ln()).abs() < 1e-4 + 1e-5 / narrowest, "{} {}", log[i], slope.ln());
                let expected = reference.forward(point);
                let slope_there = reference.inverse(expected).1;
                assert!(turn(f64::from(y[i]) - expected) < 1e-6 + 1e-6 / slope_there, "{} {expected}", y[i]);
            }
        }
    }
}

#[test]
fn heads_agree_with_the_reference() {
    let device = host();
    let mut stream = Stream::new(0, Purpose::Test, 3);
    for config in configurations() {
        let head = random_head(config, &device);
        let reference = Reference::new(config, &head.weights());
        let (conditions, samples) = (20, 10);
        let y: Vec<f32> = (0..conditions * samples * 2).map(|_| stream.uniform()).collect();
        let c: Vec<f32> = (0..conditions).flat_map(|_| stream.direction().to_array()).collect();
        let logs = read(
            head.log_density(&tensor(&y, [conditions, samples, 2], &device), tensor(&c, [conditions, 3], &device)),
        );
        for (i, &log) in logs.iter().enumerate() {
            let condition = i / samples;
            let point = [f64::from(y[2 * i]), f64::from(y[2 * i + 1])];
            let expected = reference.log_density(point, &widen(&c[3 * condition..3 * condition + 3]));
            assert!((f64::from(log) - expected).abs() < 1e-4, "{log} {expected}");
        }
    }
}

/// Derivatives of the mean log-density by every weight, against central differences of the reference.
#[test]
fn gradients_agree_with_central_differences() {
    let device = host().autodiff();
    let mut stream = Stream::new(0, Purpose::Test, 4);
    for config in configurations() {
        let config = HeadConfig { hidden: 6, ..config };
        let head = random_head(config, &device);
        let (conditions, samples) = (4, 6);
        let y: Vec<f32> = (0..conditions * samples * 2).map(|_| stream.uniform()).collect();
        let c: Vec<f32> = (0..conditions).flat_map(|_| stream.direction().to_array()).collect();
        let loss = head
            .log_density(&tensor(&y, [conditions, samples, 2], &device), tensor(&c, [conditions, 3], &device))
            .mean();
        let gradients = GradientsParams::from_grads(loss.backward(), &head);
        // A step of plain gradient descent exposes the gradient under the exported names.
        let step = 1.0;
        let moved = burn::optim::SgdConfig::new().init().step(step, head.clone(), gradients);
        let (before, after) = (head.weights(), moved.weights());
        let mut reference = Reference::new(config, &before);
        let mean = |reference: &Reference| {
            let log = |i: usize| {
                let condition = i / samples;
                reference.log_density(
                    [f64::from(y[2 * i]), f64::from(y[2 * i + 1])],
                    &widen(&c[3 * condition..3 * condition + 3]),
                )
            };
            (0..conditions * samples).map(log).sum::<f64>() / (conditions * samples) as f64
        };
        let mut largest = 0.0_f64;
        for tensor in 0..before.len() {
            for value in 0..before[tensor].values.len() {
                let gradient = f64::from(before[tensor].values[value]) - f64::from(after[tensor].values[value]);
                let centre = reference.weights[tensor].2[value];
                let h = 1e-5;
                reference.weights[tensor].2[value] = centre + h;
                let high = mean(&reference);
                reference.weights[tensor].2[value] = centre - h;
                let low = mean(&reference);
                reference.weights[tensor].2[value] = centre;
                let expected = (high - low) / (2.0 * h);
                largest = largest.max(expected.abs());
                // f32 weights of magnitude 1 resolve the step to 1.2e-7; at h = 1e-5 the kinks of the leaky
                // ReLU are avoided.
                let name = &before[tensor].name;
                assert!(
                    (gradient - expected).abs() < 1e-4 * expected.abs().max(0.1),
                    "{name}[{value}]: {gradient} {expected}"
                );
            }
        }
        assert!(largest > 0.05, "a gradient of {largest} tests nothing");
        assert_eq!(head.num_params(), before.iter().map(|w| w.values.len()).sum::<usize>());
    }
}

/// The losses by definition, in f64. `q` is the density of the samples.
fn loss(kind: Loss, entropic: f64, batch: &Batch, condition: usize, q: &[f64]) -> f64 {
    let at = batch.condition(condition);
    let (g, v, tails) = (widen(at.densities), widen(at.weights), widen(at.tails));
    let n = q.len() as f64;
    let total: f64 = g.iter().zip(&v).map(|(g, v)| g * v).sum();
    let covered: f64 = q.iter().zip(&v).map(|(q, v)| q * v).sum();
    let (mut sum, mut regularisation) = (0.0, 0.0);
    for i in 0..q.len() {
        let (w, p, u) = (v[i] * g[i] / total, n * g[i] / total, v[i] * q[i] / covered);
        sum += match kind {
            Loss::ForwardKl if w > 0.0 => w * (p / q[i]).ln(),
            Loss::ForwardKl => 0.0,
            Loss::LogChiSquare | Loss::ChiSquare => w * p / q[i],
            // Targets near zero count as 1e-4 of their mean.
            Loss::ReverseKl => u * (u / (p.max(1e-4) * v[i] / n)).ln(),
        };
        regularisation += w * (q[i] * tails[i]) * (q[i] * tails[i]).ln();
    }
    let loss = match kind {
        Loss::LogChiSquare => sum.ln(),
        Loss::ChiSquare => sum - 1.0,
        Loss::ForwardKl | Loss::ReverseKl => sum,
    };
    loss + entropic * regularisation
}

/// Derivatives of every loss of a mixture with BRDF sampling by every weight, through the step of training.
#[test]
fn gradients_of_mixture_losses_agree_with_central_differences() {
    let device = host().autodiff();
    let mut stream = Stream::new(0, Purpose::Test, 5);
    let (conditions, samples) = (3, 8);
    let mut draw = |count: usize, low: f32, high: f32| -> Vec<f32> {
        (0..count).map(|_| low + (high - low) * stream.uniform()).collect()
    };
    let count = conditions * samples;
    let batch = Batch {
        condition_length: 3,
        samples,
        conditions: draw(3 * conditions, -1.0, 1.0),
        points: draw(2 * count, 0.0, 1.0),
        densities: draw(count, -0.3, 1.0).into_iter().map(|g| g.max(0.0)).collect(),
        weights: draw(count, 0.2, 2.0),
        brdf: draw(count, 0.0, 3.0),
        tails: draw(count, 0.1, 4.0),
        mixture_weight_logits: draw(conditions, -2.0, 2.0),
    };
    for config in configurations().into_iter().filter(|config| config.encoder.is_some()) {
        let config = HeadConfig { hidden: 6, share: true, ..config };
        let head = random_head(config, &device);
        let mut reference = Reference::new(config, &head.weights());
        for kind in Loss::ALL {
            let objective = Objective { loss: kind, entropic: 0.05 };
            let found = FusedGradient::new(&head).gradient(&head.flat_weights(), objective, &batch).unwrap().unwrap();
            let mean = |reference: &Reference| {
                let of_condition = |index: usize| {
                    let c = widen(&batch.conditions[3 * index..3 * index + 3]);
                    let p = reference.mixture_weight(&c, f64::from(batch.mixture_weight_logits[index]));
                    let q: Vec<f64> = (0..samples)
                        .map(|i| {
                            let point = index * samples + i;
                            let y = [f64::from(batch.points[2 * point]), f64::from(batch.points[2 * point + 1])];
                            p * reference.log_density(y, &c).exp() + (1.0 - p) * f64::from(batch.brdf[point])
                        })
                        .collect();
                    loss(kind, f64::from(objective.entropic), &batch, index, &q)
                };
                (0..conditions).map(of_condition).sum::<f64>() / conditions as f64
            };
            assert!((f64::from(found.loss) - mean(&reference)).abs() < 1e-5, "{kind}");
            let mut d_weight = found.d_weight.iter().map(|&g| f64::from(g));
            for tensor in 0..reference.weights.len() {
                for value in 0..reference.weights[tensor].2.len() {
                    let (centre, h) = (reference.weights[tensor].2[value], 1e-5);
                    let mut at = |step: f64| {
                        reference.weights[tensor].2[value] = centre + step;
                        mean(&reference)
                    };
                    let expected = (at(h) - at(-h)) / (2.0 * h);
                    reference.weights[tensor].2[value] = centre;
                    let gradient = d_weight.next().unwrap();
                    let name = &reference.weights[tensor].0;
                    assert!(
                        (gradient - expected).abs() < 1e-4 * expected.abs().max(0.1),
                        "{kind} {name}[{value}]: {gradient} {expected}"
                    );
                }
            }
            assert!(d_weight.next().is_none());
        }
    }
}
