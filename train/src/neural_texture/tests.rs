use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use headtail_render::{
    fabric::{Layered, Query},
    random::{Purpose, Stream},
};

use super::{graph::predict, samples::answers, *};
use crate::{Backend, StateFile, test_support::train_until};

/// A diffuse surface of one colour.
struct Plain;

impl Source for Plain {
    fn reflect(&self, queries: &[Query], _samples: u32, _seed: u64) -> Vec<Vec3> {
        queries.iter().map(|query| query.wi.z * FRAC_1_PI * Vec3::new(0.8, 0.4, 0.2)).collect()
    }
}

fn small(steps: usize) -> Settings {
    Settings { side: 8, steps, batch: 512, paths: 1, seed: 3 }
}

/// Runs a fit that is interrupted after `stop_at` steps.
fn fit(
    settings: &Settings,
    source: &dyn Source,
    file: Option<&StateFile<'_>>,
    stop_at: usize,
) -> Result<(NeuralTexture, TrainingState)> {
    train_until(stop_at, file, |run| fit_material(settings, "test", source, run))
}

#[test]
fn the_renderer_matches_the_tensor_library() {
    for seed in 0..3 {
        let layout = Layout::new(16);
        let mut random = Stream::new(seed, Purpose::Test, 0);
        let initial = layout.initial_weights(seed);
        // Larger texels and a shift, as in a trained material.
        let weights: Vec<f32> = initial.iter().map(|w| 2.0 * w + 0.1 * (random.uniform() - 0.5)).collect();
        let material = layout.material(&weights, Description::new("test", LEAKY_SLOPE)).unwrap();
        let samples = Samples::questions(16, 600, &mut random);
        let device = Backend::default().device().unwrap();
        let expected = predict(16, &weights, &samples, &device);
        let found = answers(&material, &samples.queries);
        for ((query, found), expected) in samples.queries.iter().zip(found).zip(expected) {
            let error = ((found - expected) / expected).abs().max_element();
            assert!(error < 1e-5, "{query:?}: {found} {expected}");
        }
    }
}

#[test]
fn the_fused_gradient_matches_the_graph() {
    for seed in 0..3 {
        let layout = Layout::new(16);
        let mut random = Stream::new(seed, Purpose::Test, 1);
        let initial = layout.initial_weights(seed);
        let weights: Vec<f32> = initial.iter().map(|w| 2.0 * w + 0.1 * (random.uniform() - 0.5)).collect();
        // More than one group, and not a whole number of groups.
        let mut samples = Samples::questions(16, 1500, &mut random);
        samples.values = Layered::lacquer().reflect(&samples.queries, 1, seed);
        let device = Backend::default().device().unwrap().autodiff();
        let (expected_error, expected) = layout.gradient(&weights, &samples, &device);
        let mut fused = FusedGradient::new(layout);
        // Twice, because buffers are reused.
        for _ in 0..2 {
            let (error, gradient) = fused.gradient(&weights, &samples);
            assert!((error / expected_error - 1.0).abs() < 1e-5, "{error} {expected_error}");
            let norm = expected.iter().map(|g| g * g).sum::<f32>().sqrt();
            // Sums of 6000 terms that cancel: rounding is relative to the whole gradient.
            for (k, (found, expected)) in gradient.iter().zip(&expected).enumerate() {
                assert!(
                    (found - expected).abs() < 1e-5 * norm,
                    "seed {seed}, weight {k}: {found} {expected} of {norm}"
                );
            }
        }
    }
}

#[test]
fn a_plain_surface_is_learned() {
    let [(_, first), (material, last)] = [1, 150].map(|steps| fit(&small(steps), &Plain, None, usize::MAX).unwrap());
    assert!(last.loss < first.loss.map(|loss| 0.02 * loss), "{:?} {:?}", first.loss, last.loss);
    // 1 % of an albedo of 0.5 is 46 dB.
    let Decibels { psnr, .. } = error_over(&Plain, &material, 1000, 2, 1);
    assert!(psnr > 30.0, "{psnr}");
}

#[test]
fn an_interrupted_fit_ends_like_an_uninterrupted_one() {
    let (settings, source) = (small(4), Layered::lacquer());
    let (_, whole) = fit(&settings, &source, None, usize::MAX).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let file = |target: &str| StateFile { path: &path, every: 1, target: target.into(), done: &[] };
    assert_eq!(fit(&settings, &source, Some(&file("lacquer")), 2).unwrap().1.step, 2);
    let error = |settings: &Settings, target: &str| {
        fit(settings, &source, Some(&file(target)), usize::MAX).err().unwrap().to_string()
    };
    assert!(error(&Settings { seed: 4, ..settings }, "lacquer").contains("another `seed`"));
    assert!(error(&Settings { side: 16, ..settings }, "lacquer").contains("another `side`"));
    assert!(error(&small(3), "lacquer").contains("another `steps`"));
    assert!(error(&settings, "satin").contains("another target"));
    let (_, end) = fit(&settings, &source, Some(&file("lacquer")), usize::MAX).unwrap();
    assert_eq!((end.step, end.skipped, end.mean_loss), (4, 0, whole.mean_loss));
    assert_eq!(end.parameters, whole.parameters);
    std::fs::write(&path, b"nothing").unwrap();
    assert!(error(&settings, "lacquer").contains("does not have the checksum"));
}

#[test]
fn settings_out_of_range_are_named() {
    for (settings, word) in [
        (Settings { side: 48, ..small(1) }, "side = 48"),
        (Settings { steps: 0, ..small(1) }, "steps = 0"),
        (Settings { batch: 1, ..small(1) }, "batch = 1"),
        (Settings { paths: 0, ..small(1) }, "paths = 0"),
    ] {
        assert!(settings.check().unwrap_err().to_string().contains(word), "{word}");
    }
}
