use std::{f32::consts::TAU, sync::atomic::Ordering};

use headtail_model::{Condition, HeadConfig, Mode};
use headtail_render::random::Stream;

use super::*;
use crate::{
    Backend, CheckpointFolder, Checkpoints, CosineTarget,
    integrand::PointValues,
    test_support::{sky, train_until},
};

/// A target whose normals are drawn from an angle.
struct OfAngle {
    draw: fn(f32) -> [f32; 3],
    density: fn(&[f32], [f32; 2]) -> f32,
}

impl Target for OfAngle {
    fn condition(&self) -> Condition {
        Condition::Normal
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        condition.copy_from_slice(&(self.draw)(TAU * stream.uniform()));
    }

    fn at_points(&self, condition: &[f32], y: &[[f32; 2]]) -> Vec<PointValues> {
        y.iter().map(|&y| PointValues::of((self.density)(condition, y))).collect()
    }
}

/// A von Mises density of the azimuth around the condition's angle, times a beta density of the elevation.
const VON_MISES_TIMES_BETA: OfAngle = OfAngle {
    draw: |angle| [angle.cos(), angle.sin(), 0.0],
    density: |condition, [u, v]| {
        let toward = condition[0] * (TAU * u).cos() + condition[1] * (TAU * u).sin();
        toward.exp() * v * (1.0 - v)
    },
};

fn small() -> FitConfig {
    let head = HeadConfig::COSINE;
    FitConfig { steps: 30, conditions: 8, strata: 4, validation_strata: 8, head, ..FitConfig::default() }
}

fn quiet(config: &FitConfig, target: &dyn Target) -> Result<Fitted> {
    fit(config, target, &mut |_| {}, &AtomicBool::new(false))
}

#[test]
fn a_known_target_is_recovered() {
    for mode in [Mode::Coupled, Mode::Autoregressive] {
        let config = FitConfig {
            head: HeadConfig { bins: 8, hidden: 32, mode, ..HeadConfig::COSINE },
            steps: 1500,
            conditions: 32,
            strata: 6,
            validate_every: 0,
            validation_conditions: 32,
            ..FitConfig::default()
        };
        let Summary { initial, divergence, skipped, .. } = quiet(&config, &VON_MISES_TIMES_BETA).unwrap().summary;
        assert!(initial.kl > 0.2 && divergence.kl < 1e-3 && skipped == 0, "{mode:?}: {initial:?} -> {divergence:?}");
    }
}

#[test]
fn training_reduces_the_variance_of_a_cosine_under_a_sky() {
    let config = FitConfig { steps: 200, conditions: 32, ..small() };
    let summary = quiet(&config, &CosineTarget::new(&sky)).unwrap().summary;
    assert_eq!((summary.steps, summary.interrupted), (200, false));
    assert!(summary.divergence.relative_variance < 0.2 * summary.initial.relative_variance, "{summary:?}");
}

#[test]
fn the_same_seed_gives_bit_identical_weights() {
    let train = |seed, threads| {
        // More than one shard per step.
        let config = FitConfig { seed, conditions: 160, ..small() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| quiet(&config, &CosineTarget::new(&sky)).unwrap().head.weights())
    };
    let weights = train(1, 1);
    assert_eq!(weights, train(1, 2));
    assert_ne!(weights, train(2, 2));
}

#[test]
fn backends_agree() {
    let train = |backend| {
        let config = FitConfig { backend, steps: 5, ..small() };
        match quiet(&config, &CosineTarget::new(&sky)) {
            Ok(fitted) => Some(fitted.head.weights()),
            Err(Error::BackendNotCompiled { .. }) => None,
            Err(error) => panic!("{error}"),
        }
    };
    let reference = train(Backend::default()).unwrap();
    for other in [Backend::Flex, Backend::Wgpu].into_iter().filter_map(train) {
        for (a, b) in reference.iter().zip(&other) {
            // Adam divides by the gradient's size: a weight moves by up to a learning rate for any size of
            // its gradient, and rounding determines the smallest ones. Five steps of warm-up move a weight by
            // at most 5e-2.
            let apart = a.values.iter().zip(&b.values).filter(|(a, b)| (**a - **b).abs() > 1e-4).count();
            assert!(apart * 100 <= a.values.len(), "{}: {apart} of {}", a.name, a.values.len());
        }
    }
}

#[test]
fn progress_is_reported_for_every_step_and_validation() {
    let mut seen = Vec::new();
    let config = FitConfig { validate_every: 10, ..small() };
    let mut progress = |progress: &Progress| seen.push((progress.step, progress.divergence.is_some()));
    fit(&config, &CosineTarget::new(&sky), &mut progress, &AtomicBool::new(false)).unwrap();
    let expected: Vec<(usize, bool)> = (0..=30).map(|step| (step, step % 10 == 0)).collect();
    assert_eq!(seen, expected);
}

#[test]
fn an_interruption_returns_the_trained_weights() {
    let interrupt = AtomicBool::new(false);
    let mut progress = |progress: &Progress| interrupt.store(progress.step == 12, Ordering::Relaxed);
    let fitted = fit(&small(), &CosineTarget::new(&sky), &mut progress, &interrupt).unwrap();
    assert_eq!((fitted.summary.steps, fitted.summary.interrupted), (12, true));
    assert!(fitted.summary.divergence.kl < fitted.summary.initial.kl);
}

#[test]
fn a_black_environment_is_an_error() {
    let black = OfAngle { density: |_, _| 0.0, ..VON_MISES_TIMES_BETA };
    assert!(matches!(quiet(&small(), &black), Err(Error::EmptyTarget { conditions: 64 })));
}

#[test]
fn a_head_for_another_target_is_rejected() {
    let head = HeadConfig { condition: Condition::Ggx, ..HeadConfig::COSINE };
    let error = quiet(&FitConfig { head, ..small() }, &VON_MISES_TIMES_BETA).err().unwrap();
    assert!(error.to_string().contains("head.condition = ggx"), "{error}");
    let head = HeadConfig { share: true, ..HeadConfig::COSINE };
    for config in [FitConfig { head, ..small() }, FitConfig { brdf_samples: 4, ..small() }] {
        let error = quiet(&config, &VON_MISES_TIMES_BETA).err().unwrap();
        assert!(error.to_string().contains("without BRDF sampling"), "{error}");
    }
}

#[test]
fn steps_that_are_not_finite_are_counted_and_end_the_run() {
    // A NaN condition makes all logits NaN.
    let broken = OfAngle { draw: |_| [f32::NAN; 3], density: |_, _| 1.0 };
    let config = FitConfig { max_skipped: 3, ..small() };
    assert!(matches!(quiet(&config, &broken), Err(Error::Diverged { step: 4, skipped: 4 })));
}

/// Compares runs that end after a few steps each, as if killed, with an uninterrupted run.
#[test]
fn a_resumed_run_is_bit_identical_to_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let target = CosineTarget::new(&sky);
    // A rate at which validation fluctuates, often enough for setbacks.
    let wild = FitConfig { learning_rate: 0.5, setback: 1.0, validate_every: 3, ..small() };
    for (name, config) in [("plain", small()), ("averaged", FitConfig { ema_decay: 0.9, ..small() }), ("wild", wild)] {
        let whole = quiet(&config, &target).unwrap();
        let checkpoints =
            CheckpointFolder { folder: folder.path().join(name), every: 7, resume: true, target: "sky".into() };
        let mut pieces = 0;
        let end = loop {
            let (interrupt, mut steps) = (AtomicBool::new(false), 0);
            let mut progress = |_: &Progress| {
                steps += 1;
                // A killed run is not an interruption: it saves nothing.
                if steps == 11 { Err(Error::EmptyTarget { conditions: 0 }) } else { Ok(()) }
            };
            pieces += 1;
            let checkpoints = Some(&checkpoints as &dyn Checkpoints);
            let warn: &mut dyn FnMut(&Error) = &mut |error| panic!("{error}");
            let run = Run { progress: &mut progress, interrupt: &interrupt, checkpoints, warn };
            match fit_with(&config, &target, run) {
                Ok(fitted) => break fitted,
                Err(Error::EmptyTarget { .. }) => {}
                Err(error) => panic!("{error}"),
            }
        };
        assert_eq!(pieces, 4, "steps 0 to 7, 7 to 14, 14 to 21, and the rest");
        assert_eq!(end.head.flat_weights(), whole.head.flat_weights());
        assert_eq!(end.summary.divergence, whole.summary.divergence);
    }
}

#[test]
fn a_run_ends_with_the_best_of_its_validations() {
    let config = FitConfig { learning_rate: 0.5, setback: 2.0, validate_every: 2, ..small() };
    let mut seen = Vec::new();
    let mut progress = |progress: &Progress| seen.extend(progress.divergence.map(|d| (progress.step, d)));
    let fitted = fit(&config, &CosineTarget::new(&sky), &mut progress, &AtomicBool::new(false)).unwrap();
    let trained = seen.iter().filter(|(step, _)| *step > 0).map(|(_, divergence)| divergence.relative_variance);
    let best = trained.fold(f64::INFINITY, f64::min);
    let worst = seen.iter().map(|(_, divergence)| divergence.relative_variance).fold(0.0, f64::max);
    let end = fitted.summary.divergence.relative_variance;
    assert!(end == best.min(fitted.summary.initial.relative_variance) && worst > 2.0 * best, "{end} {best} {worst}");
}

#[test]
fn an_interruption_is_saved_and_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let target = CosineTarget::new(&sky);
    let checkpoints = CheckpointFolder { folder: folder.path().into(), every: 0, resume: true, target: "sky".into() };
    let train = |stop_at| train_until(stop_at, Some(&checkpoints), |run| fit_with(&small(), &target, run)).unwrap();
    assert_eq!(train(12).summary.steps, 12);
    let end = train(usize::MAX);
    assert_eq!(end.summary.steps, 30);
    assert_eq!(end.head.flat_weights(), quiet(&small(), &target).unwrap().head.flat_weights());
}

#[test]
fn averaged_weights_differ_from_the_weights() {
    let target = CosineTarget::new(&sky);
    let average = quiet(&FitConfig { ema_decay: 0.99, ..small() }, &target).unwrap();
    let plain = quiet(&small(), &target).unwrap();
    assert_ne!(average.head.flat_weights(), plain.head.flat_weights());
    assert!(average.summary.divergence.kl < average.summary.initial.kl);
}
