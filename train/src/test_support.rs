//! Shared test helpers.

use std::{
    f32::consts::TAU,
    sync::atomic::{AtomicBool, Ordering},
};

use burn::prelude::Device;
use headtail_model::{Head, HeadConfig};
use headtail_render::{
    brdf::neural::{INPUTS, Network, OUTPUTS},
    environment::built_in,
    head::Linear,
    random::{Purpose, Stream},
    tail::{Tail, TailKind},
};

use crate::{
    Checkpoints, CosineTarget, Progress, Result, Run, StepGradient,
    integrand::{Batch, BatchShape},
};

/// Trains until interrupted after `stop_at` steps.
pub fn train_until<C: Checkpoints, T>(
    stop_at: usize,
    checkpoints: Option<&C>,
    train: impl FnOnce(Run<'_>) -> Result<T>,
) -> Result<T> {
    let interrupt = AtomicBool::new(false);
    let mut progress = |now: &Progress| {
        interrupt.store(now.step == stop_at, Ordering::Relaxed);
        Ok(())
    };
    let checkpoints = checkpoints.map(|checkpoints| checkpoints as &dyn Checkpoints);
    train(Run { progress: &mut progress, interrupt: &interrupt, checkpoints, warn: &mut |error| panic!("{error}") })
}

/// Returns a head far from the identity: its last layers are random too.
pub fn random_head(config: HeadConfig, device: &Device) -> Head {
    let mut weights = Head::new(config, 1, device).unwrap().weights();
    let mut stream = Stream::new(1, Purpose::Test, 0);
    for weight in weights.iter_mut().filter(|weight| weight.values.iter().all(|&value| value == 0.0)) {
        weight.values.iter_mut().for_each(|value| *value = stream.uniform() - 0.5);
    }
    Head::from_weights(config, weights, device).unwrap()
}

/// Returns a grey lobe around the mirror direction: its logarithm falls with the sine of the half vector's
/// angle.
pub fn grey_lobe(peak: f32) -> Network {
    let first = Linear::new("first", INPUTS, 1, &[-2.0, 0.0, 0.0, 0.0, 0.0, 0.0], vec![1.0]).unwrap();
    let second = Linear::new("second", 1, 1, &[1.0], vec![0.0]).unwrap();
    let third = Linear::new("third", 1, OUTPUTS, &[peak; OUTPUTS], vec![0.1; OUTPUTS]).unwrap();
    Network::new("network", [first, second, third]).unwrap()
}

/// Maps Y as a tail of light that is uniform over the upper hemisphere: a downward normal receives little or
/// none.
pub fn sky(y: [f32; 2]) -> [f32; 3] {
    let cos = 1.0 - y[1];
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    [sin * (TAU * y[0]).sin(), cos, -sin * (TAU * y[0]).cos()]
}

/// Returns a batch of the cosine under [`sky`].
pub fn batch_of_sky(conditions: usize, strata: usize) -> Batch {
    let shape = BatchShape { conditions, strata, brdf_samples: 0 };
    Batch::draw(&CosineTarget::new(&sky), shape, 0, Purpose::Test, 0).unwrap()
}

/// Returns the tail of a built-in map with small lights.
pub fn studio() -> Tail {
    let map = built_in("studio").unwrap();
    Tail::new(TailKind::Hierarchical, map.width(), map.height(), &map.luminance()).unwrap()
}

/// Asserts that two gradients of a step agree to a fraction of their norm, and that they are not close to
/// zero.
pub fn assert_same(expected: &StepGradient, found: &StepGradient, tolerance: f32, what: &str) {
    let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| x * x).sum::<f32>().sqrt();
    let size = norm(&mut expected.d_weight.iter().copied());
    let error = norm(&mut expected.d_weight.iter().zip(&found.d_weight).map(|(a, b)| a - b));
    let apart = (expected.loss - found.loss).abs();
    assert!(apart < 1e-5_f32.max(0.1 * tolerance) * expected.loss.abs().max(1.0), "{what}: losses are {apart} apart");
    assert!(size > 1e-3 && error <= tolerance * size, "{what}: {error} of {size}");
}
