//! Properties of the head. `tests/reference_f64.rs` compares with an independent f64 implementation.

use burn::{
    module::Module,
    optim::GradientsParams,
    prelude::{Device, Tensor, TensorData},
};
use headtail_render::random::{Purpose, Stream};

use super::{EncoderConfig, Head, HeadConfig, mixture_weight_of_logit, mixture_weight_of_logits};
use crate::{Condition, Error, Mode, NamedTensor, linear::read};

const MODES: [Mode; 2] = [Mode::Coupled, Mode::Autoregressive];

const MICROFACET: HeadConfig = HeadConfig::MICROFACET;

fn uniforms(count: usize, seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, Purpose::Test, 0);
    (0..count).map(|_| stream.uniform()).collect()
}

/// Returns a head far from the identity: all weights are random, including the last layers.
fn random_head(config: HeadConfig, seed: u64, device: &Device) -> Head {
    let mut weights = Head::new(config, seed, device).unwrap().weights();
    for (index, weight) in weights.iter_mut().enumerate() {
        if weight.values.iter().all(|&value| value == 0.0) {
            let draws = uniforms(weight.values.len(), seed + 100 + index as u64);
            weight.values = draws.iter().map(|draw| draw * 1.0 - 0.5).collect();
        }
    }
    Head::from_weights(config, weights, device).unwrap()
}

fn points(conditions: usize, samples: usize, seed: u64, device: &Device) -> Tensor<3> {
    Tensor::from_data(TensorData::new(uniforms(conditions * samples * 2, seed), [conditions, samples, 2]), device)
}

fn conditions(count: usize, length: usize, seed: u64, device: &Device) -> Tensor<2> {
    let values: Vec<f32> = uniforms(count * length, seed).iter().map(|x| 2.0 * x - 1.0).collect();
    Tensor::from_data(TensorData::new(values, [count, length]), device)
}

fn configurations() -> Vec<HeadConfig> {
    let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
    MODES
        .into_iter()
        .flat_map(|mode| {
            let share = encoder.is_some();
            [HeadConfig { mode, ..HeadConfig::COSINE }, HeadConfig { mode, encoder, share, ..HeadConfig::COSINE }]
        })
        .collect()
}

#[test]
fn parameter_counts_match_the_documentation() {
    let device = crate::host();
    let count = |config| Head::new(config, 0, &device).unwrap().num_params();
    // Elevation depends on c alone: (3 + 1) 64 + (64 + 1) 64 + (64 + 1) 13; azimuth also on v: (3 + 1 + 1) 64
    // + ...
    assert_eq!(count(HeadConfig { mode: Mode::Autoregressive, ..HeadConfig::COSINE }), 10_586);
    // Elevation has two more features.
    assert_eq!(count(HeadConfig::COSINE), 10_714);
    // Encoder 13 x 64 + 65 x 64; networks (76 + 2 + 1 and 76 + 1 + 1) 64 + 65 x 64 + 65 x 97.
    assert_eq!(count(MICROFACET), 35_970);
    // Two inputs fewer in the condition: 2 x 64 fewer in the encoder and in each network.
    assert_eq!(count(HeadConfig { condition: Condition::Ggx, ..MICROFACET }), 35_970 - 3 * 128);
    // The mixture weight's network: 77 x 16 + 17.
    assert_eq!(count(HeadConfig { share: true, ..MICROFACET }), 35_970 + 1_249);
}

#[test]
fn a_new_head_is_the_identity() {
    let device = crate::host();
    for config in configurations() {
        let head = Head::new(config, 3, &device).unwrap();
        let (y, c) = (points(10, 20, 1, &device), conditions(10, 3, 2, &device));
        for (x, log) in [head.inverse(&y, c.clone()), head.sample(&y, c.clone())] {
            assert!(read(x).iter().zip(read(y.clone())).all(|(a, b)| (a - b).abs() <= 1e-6));
            assert!(read(log).iter().all(|log| log.abs() <= 4e-6));
        }
    }
}

#[test]
fn inverse_undoes_sample_and_agrees_on_the_density() {
    let device = crate::host();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, seed as u64, &device);
        let (z, c) = (points(100, 100, 3, &device), conditions(100, 3, 4, &device));
        let (y, log_sample) = head.sample(&z, c.clone());
        let (back, log_inverse) = head.inverse(&y, c);
        for (a, b) in read(back).iter().zip(read(z)) {
            let error = (a - b).abs();
            assert!(error.min(1.0 - error) < 2e-5, "{a} {b}");
        }
        for (a, b) in read(log_sample).iter().zip(read(log_inverse)) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
    }
}

#[test]
fn density_integrates_to_one_under_every_condition() {
    let device = crate::host();
    let side = 512;
    let mut grid = Vec::with_capacity(side * side * 2);
    for row in 0..side {
        for column in 0..side {
            grid.extend([(column as f32 + 0.5) / side as f32, (row as f32 + 0.5) / side as f32]);
        }
    }
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 10 + seed as u64, &device);
        let y = Tensor::<3>::from_data(TensorData::new(grid.clone(), [1, side * side, 2]), &device);
        let logs = read(head.log_density(&y, conditions(1, 3, seed as u64, &device)));
        let integral = logs.iter().map(|&log| f64::from(log).exp()).sum::<f64>() / (side * side) as f64;
        assert!((integral - 1.0).abs() < 1e-4, "{integral}");
        assert!(logs.iter().any(|log| log.abs() > 0.1), "the test needs a head that is not the identity");
    }
}

#[test]
fn density_is_the_same_on_both_sides_of_the_seam() {
    let device = crate::host();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 20 + seed as u64, &device);
        let c = conditions(1, 3, 5, &device);
        let at = |u: f32| {
            let y: Vec<f32> = (0..=10).flat_map(|i| [u, i as f32 / 10.0]).collect();
            read(head.log_density(&Tensor::from_data(TensorData::new(y, [1, 11, 2]), &device), c.clone()))
        };
        // The input of coupled networks is sin(2 pi) = 2e-7 instead of 0.
        assert!(at(0.0).iter().zip(at(1.0)).all(|(a, b)| (a - b).abs() < 1e-4));
    }
}

#[test]
fn batched_equals_looped() {
    let device = crate::host();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 30 + seed as u64, &device);
        let (y, c) = (points(6, 5, 6, &device), conditions(6, 3, 7, &device));
        let all = read(head.log_density(&y, c.clone()));
        for condition in 0..6 {
            for sample in 0..5 {
                let one = head.log_density(
                    &y.clone().narrow(0, condition, 1).narrow(1, sample, 1),
                    c.clone().narrow(0, condition, 1),
                );
                // Matrix products of different sizes sum in different orders.
                assert!((read(one)[0] - all[condition * 5 + sample]).abs() < 1e-5);
            }
        }
    }
}

#[test]
fn output_depends_on_condition_and_seed() {
    let device = crate::host();
    for config in configurations() {
        let y = points(2, 1, 8, &device).narrow(0, 0, 1).repeat_dim(0, 2);
        let c = conditions(2, 3, 9, &device);
        let density = |seed| read(random_head(config, seed, &device).log_density(&y, c.clone()));
        let (one, other) = (density(1), density(2));
        assert!(one[0] != one[1] && one[0] != other[0]);
        assert_eq!(one, density(1));
    }
}

#[test]
fn weights_restore_the_head_in_any_order() {
    let device = crate::host();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 40 + seed as u64, &device);
        let mut weights = head.weights();
        weights.reverse();
        let restored = Head::from_weights(config, weights, &device).unwrap();
        assert_eq!(restored.weights(), head.weights());
        let (y, c) = (points(4, 4, 10, &device), conditions(4, 3, 11, &device));
        assert_eq!(read(restored.log_density(&y, c.clone())), read(head.log_density(&y, c)));
    }
}

#[test]
fn weights_are_named_and_shaped_as_documented() {
    let config = HeadConfig { share: true, ..MICROFACET };
    let head = Head::new(config, 0, &crate::host()).unwrap();
    let list: Vec<(String, Vec<usize>)> = head.weights().into_iter().map(|w| (w.name, w.shape)).collect();
    let expected: [(&str, &[usize]); 20] = [
        ("encoder.linear0.weight", &[64, 12]),
        ("encoder.linear0.bias", &[64]),
        ("encoder.linear1.weight", &[64, 64]),
        ("encoder.linear1.bias", &[64]),
        ("layer0.linear0.weight", &[64, 78]),
        ("layer0.linear0.bias", &[64]),
        ("layer0.linear1.weight", &[64, 64]),
        ("layer0.linear1.bias", &[64]),
        ("layer0.linear2.weight", &[97, 64]),
        ("layer0.linear2.bias", &[97]),
        ("layer1.linear0.weight", &[64, 77]),
        ("layer1.linear0.bias", &[64]),
        ("layer1.linear1.weight", &[64, 64]),
        ("layer1.linear1.bias", &[64]),
        ("layer1.linear2.weight", &[97, 64]),
        ("layer1.linear2.bias", &[97]),
        ("selection.linear0.weight", &[16, 76]),
        ("selection.linear0.bias", &[16]),
        ("selection.linear1.weight", &[1, 16]),
        ("selection.linear1.bias", &[1]),
    ];
    assert!(list.iter().map(|(n, s)| (n.as_str(), s.as_slice())).eq(expected));
}

#[test]
fn weights_of_another_architecture_are_rejected() {
    let device = crate::host();
    let mut weights = Head::new(HeadConfig::COSINE, 0, &device).unwrap().weights();
    weights.push(NamedTensor { name: "layer2.linear0.bias".into(), shape: vec![1], values: vec![0.0] });
    let error = Head::from_weights(HeadConfig::COSINE, weights, &device).unwrap_err();
    assert_eq!(error, Error::UnknownWeight("layer2.linear0.bias".into()));
}

#[test]
fn configurations_out_of_range_are_rejected() {
    let device = crate::host();
    for config in [
        HeadConfig { bins: 1, ..HeadConfig::COSINE },
        HeadConfig { bins: 513, ..HeadConfig::COSINE },
        HeadConfig { hidden: 0, ..HeadConfig::COSINE },
        HeadConfig { hidden_layers: 0, ..HeadConfig::COSINE },
        HeadConfig { leaky_slope: f32::NAN, ..HeadConfig::COSINE },
        HeadConfig { encoder: Some(EncoderConfig { hidden: 0, output: 1 }), ..HeadConfig::COSINE },
    ] {
        assert!(matches!(Head::new(config, 0, &device), Err(Error::Config { .. })), "{config:?}");
    }
}

#[test]
fn a_new_head_and_brdf_sampling_are_equally_likely() {
    let device = crate::host();
    let config = HeadConfig { share: true, ..MICROFACET };
    let head = Head::new(config, 4, &device).unwrap();
    let logits = head.mixture_weight_logits(conditions(5, 12, 1, &device)).unwrap();
    assert_eq!(logits.dims(), [5, 1]);
    assert!(read(mixture_weight_of_logits(logits)).iter().all(|p| (p - 0.5).abs() < 1e-6));
    assert!(Head::new(MICROFACET, 4, &device).unwrap().mixture_weight_logits(conditions(1, 12, 1, &device)).is_none());
}

#[test]
fn both_strategies_keep_a_minimum_probability() {
    let logits = [-1e30_f32, -30.0, -1.0, 0.0, 2.0, 30.0, 1e30];
    let in_graph = Tensor::<2>::from_data(TensorData::new(logits.to_vec(), [7, 1]), &crate::host());
    for (logit, p) in logits.into_iter().zip(read(mixture_weight_of_logits(in_graph))) {
        assert!((0.02..=0.98).contains(&mixture_weight_of_logit(logit)), "{logit}");
        assert!((p - mixture_weight_of_logit(logit)).abs() < 1e-6, "{logit}: {p}");
    }
}

#[test]
fn the_mixture_weight_depends_on_the_condition() {
    let device = crate::host();
    let config = HeadConfig { share: true, ..HeadConfig::COSINE };
    let logits = read(random_head(config, 60, &device).mixture_weight_logits(conditions(2, 3, 9, &device)).unwrap());
    assert_ne!(logits[0], logits[1]);
}

#[test]
fn configurations_round_trip_with_and_without_encoder() {
    for config in [HeadConfig::COSINE, MICROFACET] {
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<HeadConfig>(&text).unwrap(), config, "{text}");
    }
    let text = serde_json::to_string(&HeadConfig::COSINE).unwrap().replace("\"none\"", "\"some\"");
    assert!(serde_json::from_str::<HeadConfig>(&text).unwrap_err().to_string().contains("head.encoder"));
}

#[test]
fn flat_weights_follow_the_named_order_and_restore_the_head() {
    let device = crate::host();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 70 + seed as u64, &device);
        let flat = head.flat_weights();
        assert_eq!(flat, head.weights().into_iter().flat_map(|weight| weight.values).collect::<Vec<_>>());
        assert_eq!(flat.len(), head.weight_count());
        let restored = Head::new(config, 0, &device).unwrap().with_flat_weights(&flat, &device);
        assert_eq!(restored.weights(), head.weights());
    }
}

/// A gradient descent step of rate 1 changes each weight by its gradient.
#[test]
fn flat_gradients_have_the_order_of_flat_weights() {
    let device = crate::host().autodiff();
    for (seed, config) in configurations().into_iter().enumerate() {
        let head = random_head(config, 80 + seed as u64, &device);
        let (y, c) = (points(4, 4, 10, &device), conditions(4, 3, 11, &device));
        let mut loss = head.log_density(&y, c.clone()).mean();
        if let Some(logits) = head.mixture_weight_logits(c) {
            loss = loss + logits.mean();
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &head);
        let flat = head.flat_gradients(&gradients);
        let moved = burn::optim::SgdConfig::new().init().step(1.0, head.clone(), gradients);
        let differences = head.flat_weights().iter().zip(moved.flat_weights()).map(|(a, b)| a - b).collect::<Vec<_>>();
        assert!(flat.iter().zip(&differences).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(flat.iter().any(|g| g.abs() > 1e-2));
    }
}
