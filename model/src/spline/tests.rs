//! Properties of the splines. `tests/reference_f64.rs` compares with an independent f64 implementation.

use burn::prelude::{Device, Tensor, TensorData};
use headtail_render::{
    random::{Purpose, Stream},
    spline::{Gradient, Logits, inverse_with_gradient},
};

use super::{Topology, forward, inverse, logit_count};
use crate::linear::read;

const TOPOLOGIES: [Topology; 2] = [Topology::Interval, Topology::Circle];

struct Random(Stream);

impl Random {
    fn new(seed: u64) -> Self {
        Self(Stream::new(seed, Purpose::Test, 0))
    }

    fn uniform(&mut self) -> f32 {
        self.0.uniform()
    }

    fn normal(&mut self) -> f32 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f32::consts::TAU * self.uniform()).cos()
    }

    fn normals(&mut self, count: usize, deviation: f32) -> Vec<f32> {
        (0..count).map(|_| deviation * self.normal()).collect()
    }

    fn uniforms(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.uniform()).collect()
    }
}

fn matrix(values: &[f32], columns: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len() / columns, columns]), device)
}

/// Returns logits as `[conditions, 1, 3K + 1]`.
fn shared(logits: &[f32], bins: usize, device: &Device) -> Tensor<3> {
    matrix(logits, logit_count(bins), device).unsqueeze_dim(1)
}

type Direction = fn(Topology, Tensor<2>, &Tensor<3>) -> (Tensor<2>, Tensor<2>);

/// Evaluates one spline at many points.
fn apply(direction: Direction, topology: Topology, points: &[f32], logits: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let device = crate::host();
    let bins = super::bin_count(logits.len());
    let (values, logs) = direction(topology, matrix(points, points.len(), &device), &shared(logits, bins, &device));
    (read(values), read(logs))
}

fn linspace(count: usize) -> Vec<f32> {
    (0..=count).map(|i| i as f32 / count as f32).collect()
}

#[test]
fn is_identity_for_zero_logits() {
    for topology in TOPOLOGIES {
        for bins in [2, 4, 32] {
            for direction in [inverse as Direction, forward] {
                let points: Vec<f32> = linspace(1000)[..1000].to_vec();
                let (values, logs) = apply(direction, topology, &points, &vec![0.0; logit_count(bins)]);
                for i in 0..points.len() {
                    assert!((values[i] - points[i]).abs() <= 1e-6, "{} -> {}", points[i], values[i]);
                    assert!(logs[i].abs() <= 2e-6, "{}", logs[i]);
                }
            }
        }
    }
}

#[test]
fn ends_of_the_interval_are_fixed() {
    let mut random = Random::new(1);
    for _ in 0..200 {
        let logits = random.normals(logit_count(32), 1.5);
        for direction in [inverse as Direction, forward] {
            let (values, logs) = apply(direction, Topology::Interval, &[0.0, 1.0], &logits);
            // The last knot is a running sum of 32 rounded sizes, each step within 6e-8.
            assert!(values[0] == 0.0 && (values[1] - 1.0).abs() < 2e-6, "{values:?}");
            assert!(logs.iter().all(|log| log.is_finite()));
        }
    }
}

#[test]
fn is_monotone_on_neighbouring_floats() {
    let mut random = Random::new(2);
    for topology in TOPOLOGIES {
        for _ in 0..100 {
            let mut logits = random.normals(logit_count(32), 1.5);
            if topology == Topology::Circle {
                *logits.last_mut().unwrap() = 0.0;
            }
            let points: Vec<f32> = random.uniforms(256).iter().flat_map(|&x| [x, x.next_up()]).collect();
            for direction in [inverse as Direction, forward] {
                let (values, _) = apply(direction, topology, &points, &logits);
                // Each value is rounded a few times, on a scale of at most 1.
                assert!(values.chunks(2).all(|pair| pair[1] >= pair[0] - 2.4e-7));
            }
        }
    }
}

/// 262,144 random cases per topology: round trips restore the value, and both directions agree on the
/// density.
#[test]
fn inverse_undoes_forward() {
    let device = crate::host();
    let (conditions, samples, bins) = (64, 256, 32);
    let mut random = Random::new(3);
    for topology in TOPOLOGIES {
        for _ in 0..16 {
            let logits = shared(&random.normals(conditions * logit_count(bins), 1.5), bins, &device);
            let z = random.uniforms(conditions * samples);
            let (y, log_forward) = forward(topology, matrix(&z, samples, &device), &logits);
            let (back, log_inverse) = inverse(topology, y.clone(), &logits);
            let (y, back, log_forward, log_inverse) = (read(y), read(back), read(log_forward), read(log_inverse));
            for i in 0..z.len() {
                let error = (back[i] - z[i]).abs();
                // Evaluating z has an error of 2e-6; y is rounded (three times on the circle), which the
                // slope magnifies.
                let tolerance = 2e-6 + 2.4e-7 * log_inverse[i].exp();
                let error = if topology == Topology::Circle { error.min(1.0 - error) } else { error };
                assert!(error <= tolerance, "z {} -> y {} -> z {}: {error} > {tolerance}", z[i], y[i], back[i]);
                // The log-slope changes by a few units over a bin; the narrowest bin is 1e-4 wide.
                let log_tolerance = 1e-3 + 1e4 * tolerance;
                assert!((log_forward[i] - log_inverse[i]).abs() <= log_tolerance);
                assert!((0.0..=1.0).contains(&y[i]));
            }
        }
    }
}

#[test]
fn extreme_logits_stay_finite_and_in_range() {
    let mut random = Random::new(4);
    for topology in TOPOLOGIES {
        for _ in 0..300 {
            let logits: Vec<f32> = (0..logit_count(32))
                .map(|_| if random.uniform() < 0.5 { -50.0 } else { 50.0 } * random.uniform())
                .collect();
            let mut points = random.uniforms(64);
            points.extend([0.0, 1.0, f32::MIN_POSITIVE, 1.0_f32.next_down(), 0.5]);
            for direction in [inverse as Direction, forward] {
                let (values, logs) = apply(direction, topology, &points, &logits);
                assert!(values.iter().all(|value| (0.0..=1.0).contains(value)), "{values:?}");
                assert!(logs.iter().all(|log| log.is_finite()), "{logs:?}");
            }
        }
    }
}

#[test]
fn density_integrates_to_one() {
    let mut random = Random::new(5);
    let count = 1 << 16;
    let points: Vec<f32> = (0..count).map(|i| (i as f32 + 0.5) / count as f32).collect();
    for topology in TOPOLOGIES {
        for _ in 0..20 {
            let (_, logs) = apply(inverse, topology, &points, &random.normals(logit_count(32), 1.0));
            let integral = logs.iter().map(|&log| f64::from(log).exp()).sum::<f64>() / f64::from(count);
            assert!((integral - 1.0).abs() < 1e-4, "{integral}");
        }
    }
}

#[test]
fn circle_is_periodic() {
    let mut random = Random::new(6);
    for _ in 0..50 {
        let logits = random.normals(logit_count(8), 1.5);
        // Dyadic points, so that adding 1 is exact.
        let (values, logs) = apply(inverse, Topology::Circle, &[0.0, 1.0, 0.25, 1.25, -0.75], &logits);
        assert_eq!((values[0], logs[0]), (values[1], logs[1]));
        assert_eq!((values[2], logs[2], logs[2]), (values[3], logs[3], logs[4]));
    }
}

#[test]
fn circle_has_no_seam() {
    let mut random = Random::new(7);
    for _ in 0..50 {
        let mut logits = random.normals(logit_count(8), 1.0);
        *logits.last_mut().unwrap() = 0.0;
        let (_, logs) = apply(inverse, Topology::Circle, &[0.0, 1e-7, 1.0_f32.next_down()], &logits);
        assert!((logs[0] - logs[1]).abs() < 1e-2 && (logs[0] - logs[2]).abs() < 1e-2, "{logs:?}");
    }
}

#[test]
fn shift_rotates_the_density() {
    let mut random = Random::new(8);
    let mut logits = random.normals(logit_count(8), 1.0);
    let points: Vec<f32> = (0..64).map(|i| i as f32 / 64.0).collect();
    *logits.last_mut().unwrap() = 0.0;
    let (_, still) = apply(inverse, Topology::Circle, &points, &logits);
    for turns in [0.25, 1.25, -2.75] {
        *logits.last_mut().unwrap() = turns;
        let (_, turned) = apply(inverse, Topology::Circle, &points, &logits);
        assert!((0..64).all(|i| turned[i] == still[(i + 16) % 64]));
    }
}

#[test]
fn tiny_negative_points_wrap_to_the_origin_of_the_circle() {
    let logits = Random::new(9).normals(logit_count(8), 1.0);
    let (values, logs) = apply(inverse, Topology::Circle, &[0.0, -1e-9], &logits);
    assert_eq!((values[0], logs[0]), (values[1], logs[1]));
}

#[test]
fn points_outside_the_interval_are_clamped() {
    let logits = Random::new(10).normals(logit_count(8), 1.0);
    let (values, logs) = apply(inverse, Topology::Interval, &[-1e-3, 0.0, 1.0, 1.5], &logits);
    assert_eq!((values[0], logs[0]), (values[1], logs[1]));
    assert_eq!((values[2], logs[2]), (values[3], logs[3]));
}

#[test]
fn batched_equals_looped() {
    let device = crate::host();
    let (conditions, samples, bins) = (5, 7, 4);
    let mut random = Random::new(11);
    for topology in TOPOLOGIES {
        for direction in [inverse as Direction, forward] {
            let width = logit_count(bins);
            let logits = random.normals(conditions * width, 1.5);
            let points = random.uniforms(conditions * samples);
            let (values, logs) =
                direction(topology, matrix(&points, samples, &device), &shared(&logits, bins, &device));
            // The same splines, once per sample instead of once per condition.
            let repeated = shared(&logits, bins, &device).repeat_dim(1, samples);
            let (values_each, logs_each) = direction(topology, matrix(&points, samples, &device), &repeated);
            let (values, logs) = (read(values), read(logs));
            assert_eq!((&values, &logs), (&read(values_each), &read(logs_each)));
            for condition in 0..conditions {
                let row = condition * samples..(condition + 1) * samples;
                let (one, one_log) = apply(
                    direction,
                    topology,
                    &points[row.clone()],
                    &logits[condition * width..(condition + 1) * width],
                );
                assert_eq!((&values[row.clone()], &logs[row]), (one.as_slice(), one_log.as_slice()));
            }
        }
    }
}

/// Returns the gradients of value and log-slope with respect to the logits by burn's autodiff, each
/// `[points, 3K + 1]`.
fn autodiff_gradients(topology: Topology, points: &[f32], logits: &[f32]) -> [Vec<f32>; 2] {
    let device = crate::host().autodiff();
    let width = logits.len() / points.len();
    let gradient = |output: fn((Tensor<2>, Tensor<2>)) -> Tensor<2>| {
        let logits = matrix(logits, width, &device).require_grad();
        let sum = output(inverse(topology, matrix(points, 1, &device), &logits.clone().unsqueeze_dim(1))).sum();
        read(logits.grad(&sum.backward()).expect("the logits take part"))
    };
    [gradient(|(z, _)| z), gradient(|(_, log)| log)]
}

/// Returns the tolerance and the smallest width.
///
/// Two evaluations of a spline round its knots differently, by about 2.4e-7. Relative to the bin, that is
/// 2.4e-7 over its width, and the derivatives with respect to the position in the bin are about 10. 1e-5
/// covers all other errors.
fn position_tolerance(logits: &[f32]) -> (f32, f32) {
    let widths = &logits[..super::bin_count(logits.len())];
    let total: f32 = widths.iter().map(|logit| logit.exp()).sum();
    let smallest = widths.iter().fold(f32::INFINITY, |m, logit| m.min(logit.exp() / total));
    (1e-5 + 2.4e-6 / smallest, smallest)
}

#[test]
fn gradients_are_finite_at_edges_and_outside() {
    let mut random = Random::new(12);
    for topology in TOPOLOGIES {
        for deviation in [0.0, 1.5, 30.0] {
            let points = [-1e-7, 0.0, 1e-45, 0.25, 0.5, 1.0_f32.next_down(), 1.0, 1.0 + 1e-6];
            let logits: Vec<f32> = random.normals(points.len() * logit_count(4), deviation);
            let gradients = autodiff_gradients(topology, &points, &logits);
            assert!(gradients.iter().flatten().all(|g| g.is_finite()));
        }
    }
}

#[test]
fn values_and_gradients_match_the_native_spline() {
    let mut random = Random::new(13);
    for topology in TOPOLOGIES {
        for bins in [2, 4, 32] {
            let width = logit_count(bins);
            let points = random.uniforms(500);
            let all = random.normals(points.len() * width, 1.0);
            let gradients = autodiff_gradients(topology, &points, &all);
            let mut scratch = vec![[0.0]; 2 * bins];
            for (i, (&point, logits)) in points.iter().zip(all.chunks_exact(width)).enumerate() {
                let columns = Logits { bins, values: logits, stride: 1, first: 0 };
                let native = inverse_with_gradient(topology, columns, &mut scratch, &[point]);
                let (z, log) = apply(inverse, topology, &[point], logits);
                let (tolerance, smallest) = position_tolerance(logits);
                assert!((native.values[0] - z[0]).abs() < 1e-6 + 2.4e-7 * log[0].exp(), "{:?} {z:?}", native.values);
                assert!((native.log_slopes[0] - log[0]).abs() < tolerance, "{:?} {log:?}", native.log_slopes);
                for (of, all) in [Gradient::Value, Gradient::LogSlope].into_iter().zip(&gradients) {
                    let (expected, mut found) = (&all[i * width..][..width], vec![f32::NAN; width]);
                    native.write(of, &scratch, &mut found, 1, 0);
                    let scale = expected.iter().fold(1.0_f32, |m, g| m.max(g.abs()));
                    for (j, (a, b)) in found.iter().zip(expected).enumerate() {
                        // The derivative with respect to the shift has another factor of one over the width.
                        let is_shift = topology == Topology::Circle && j + 1 == width;
                        let tolerance = tolerance * if is_shift { 1.0 / smallest } else { 1.0 };
                        assert!((a - b).abs() <= tolerance * scale, "{topology:?} {bins} {point}: {a} {b}");
                    }
                }
            }
        }
    }
}

#[test]
fn an_empty_batch_gives_an_empty_batch() {
    let device = crate::host();
    let logits = Tensor::<3>::zeros([3, 1, logit_count(4)], &device);
    let (values, logs) = inverse(Topology::Circle, Tensor::zeros([3, 0], &device), &logits);
    assert_eq!((values.dims(), logs.dims()), ([3, 0], [3, 0]));
}
