use std::{path::Path, sync::Arc};

use headtail_render::{
    brdf::neural_texture::NeuralTexture,
    random::{Purpose, Stream},
};

use super::{points::Points, *};
use crate::{StateFile, neural_texture::Layout, state_file::describe, test_support::train_until};

/// Returns a material of random weights; larger weights are less diffuse.
fn material(size: f32) -> RivalMaterial {
    use headtail_render::brdf::neural_texture::Description;
    let layout = Layout::new(8);
    let weights: Vec<f32> = layout.initial_weights(5).iter().map(|weight| size * weight).collect();
    let texture: NeuralTexture = layout.material(&weights, Description::new("test", 0.01)).unwrap();
    RivalMaterial::textured(Arc::new(texture))
}

/// Returns the last state of a training run that is interrupted after `stop_at` steps.
fn train(
    settings: &RivalSettings,
    material: &RivalMaterial,
    file: Option<&StateFile<'_>>,
    stop_at: usize,
) -> Result<TrainingState> {
    Ok(train_until(stop_at, file, |run| fit_rival(settings, material, run))?.1)
}

/// Returns weights that differ from the initial ones.
fn some_weights(kind: RivalKind, size: f32) -> Vec<f32> {
    let mut random = Stream::new(3, Purpose::Test, 0);
    model::initial_weights(kind, 1).iter().map(|w| w + size * (random.uniform() - 0.5)).collect()
}

#[test]
fn renderer_densities_match_the_tensor_library() {
    let material = material(1.5);
    let points = Points::draw(&material, 24, 16, 2, 0);
    let device = Backend::default().device().unwrap();
    for kind in [RivalKind::Lobes, RivalKind::Flow] {
        let weights = some_weights(kind, 0.3);
        let logs = model::log_densities(kind, &weights, &points, &device.clone().autodiff());
        let native = points.densities(&material, &model::native(kind, &weights).unwrap());
        for (k, (log, native)) in logs.iter().zip(native).enumerate() {
            let expected = log.exp() * points.wi[k][2];
            // The logarithm is a sum of about ten terms of the order of 1, rounded to 1e-7 each, and angles
            // of 8 pi are rounded to 2e-6. Far out, the renderer's exponentials underflow before those of
            // f32.
            let close = (native - expected).abs() < 3e-4 * expected || native.max(expected) < 1e-30;
            assert!(close, "{kind:?} {k}: {native} {expected}");
        }
    }
}

/// Returns the cross-entropy of weights at points, in nats.
fn entropy(kind: RivalKind, weights: &[f32], material: &RivalMaterial, points: &Points) -> f64 {
    let densities = points.densities(material, &model::native(kind, weights).unwrap());
    let logs = densities.iter().zip(&points.weights).filter(|(_, weight)| **weight > 0.0);
    -logs.map(|(q, weight)| f64::from(*weight) * f64::from(*q).ln()).sum::<f64>() / points.views() as f64
}

#[test]
fn gradients_match_finite_differences_of_renderer_densities() {
    let material = material(1.5);
    let points = Points::draw(&material, 16, 16, 4, 0);
    let device = Backend::default().device().unwrap().autodiff();
    for kind in RivalKind::ALL {
        let weights = some_weights(kind, 0.2);
        let rival = model::native(kind, &weights).unwrap();
        let (_, gradient) = model::gradient(kind, &weights, &rival, &points, &device);
        let entropy = |weights: &[f32]| entropy(kind, weights, &material, &points);
        // Along random directions: single weights change the entropy too little compared with the rounding of
        // densities.
        for seed in 0..4 {
            let mut random = Stream::new(seed, Purpose::Test, 1);
            let along: Vec<f32> = weights.iter().map(|_| random.uniform() - 0.5).collect();
            const STEP: f32 = 1e-3;
            let moved = |sign: f32| -> Vec<f32> {
                weights.iter().zip(&along).map(|(weight, along)| weight + sign * STEP * along).collect()
            };
            let expected = (entropy(&moved(1.0)) - entropy(&moved(-1.0))) / f64::from(2.0 * STEP);
            let found: f64 = gradient.iter().zip(&along).map(|(g, along)| f64::from(g * along)).sum();
            let size = gradient.iter().map(|g| f64::from(g * g)).sum::<f64>().sqrt();
            assert!((found - expected).abs() < 0.03 * size, "{kind:?}: {found} {expected} of {size}");
        }
    }
}

#[test]
fn training_lowers_the_cross_entropy_and_equal_seeds_give_equal_samplers() {
    let material = material(3.5);
    let points = Points::draw(&material, 64, 64, 9, 0);
    for kind in RivalKind::ALL {
        let settings = RivalSettings { steps: 40, views: 32, directions: 16, ..RivalSettings::new(kind) };
        let run = || train(&settings, &material, None, usize::MAX).unwrap().parameters.weights;
        let weights = run();
        let [before, after] = [&model::initial_weights(kind, settings.seed), &weights]
            .map(|weights| entropy(kind, weights, &material, &points));
        assert!(after < before - 0.02, "{kind:?}: {before} {after}");
        assert!(run() == weights, "{kind:?}");
    }
}

fn state_file<'a>(path: &'a Path, done: &'a [TrainingState]) -> StateFile<'a> {
    StateFile { path, every: 50, target: "two materials".into(), done }
}

#[test]
fn an_interrupted_training_ends_like_an_uninterrupted_one() {
    let materials = [material(2.0), material(3.0)];
    let settings = RivalSettings { steps: 6, views: 8, directions: 8, ..RivalSettings::new(RivalKind::Lobes) };
    let whole = materials.each_ref().map(|material| train(&settings, material, None, usize::MAX).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let first = |settings: &RivalSettings| train(settings, &materials[0], Some(&state_file(&path, &[])), usize::MAX);
    // The second material's training is interrupted; the file has both.
    let done = [first(&settings).unwrap()];
    let second = state_file(&path, &done);
    assert_eq!(train(&settings, &materials[1], Some(&second), 2).unwrap().step, 2);
    assert_eq!(first(&settings).unwrap().parameters, whole[0].parameters);
    assert_eq!(describe(&path).unwrap()["trainings"][1]["step"], 2);
    let end = train(&settings, &materials[1], Some(&second), usize::MAX).unwrap();
    assert_eq!((end.step, end.mean_loss, end.parameters), (6, whole[1].mean_loss, whole[1].parameters.clone()));

    let error = |settings: RivalSettings| first(&settings).err().unwrap().to_string();
    assert!(error(RivalSettings { seed: 1, ..settings }).contains("another `seed`"));
    assert!(error(RivalSettings { kind: RivalKind::Flow, ..settings }).contains("another `kind`"));
    std::fs::write(&path, b"nothing").unwrap();
    assert!(error(settings).contains("does not have the checksum"));
}
