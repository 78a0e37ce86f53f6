//! Training the samplers of [`headtail_render::rival`]: they learn to draw in proportion to the material's
//! reflectance, for any light.
//!
//! Each step draws new views and positions, and for each of them directions by the material's own sampling,
//! weighted to be distributed as `f_r cos`. The loss is the cross-entropy of the sampler under these, per
//! view. Lobes and flows have their density in the graph. The reparameterised sampler has no closed-form
//! inverse: the renderer finds the point that maps to each direction, and the gradient of the density there
//! follows from the implicit function theorem (`model.rs`).
//!
//! | file | concept |
//! | --- | --- |
//! | `view.rs` | a view of a material |
//! | `points.rs` | views, and directions in proportion to reflectance |
//! | `model.rs` | densities with gradients |

mod model;
mod points;
#[cfg(test)]
mod tests;
mod view;

pub use points::{RivalMaterial, RivalQuality};

use burn::prelude::Device;
use headtail_render::rival::{Rival, RivalKind};

use serde::{Deserialize, Serialize};

use crate::{Backend, FitConfig, Result, Run, StepGradient, TrainingState, config::within, trainer::Trainer};
use points::Points;

/// Number of views that one thread evaluates together.
const SHARD: usize = 16;

/// Settings of the training of a rival.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RivalSettings {
    /// Which sampler.
    pub kind: RivalKind,
    /// Training steps.
    pub steps: usize,
    /// Views (with positions) per step.
    pub views: usize,
    /// Directions per view.
    pub directions: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Seed of weights and samples.
    pub seed: u64,
}

impl RivalSettings {
    /// Returns the default settings for a kind.
    pub fn new(kind: RivalKind) -> Self {
        Self { kind, steps: 2000, views: 128, directions: 64, learning_rate: 4e-3, seed: 0 }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming the field.
    pub fn check(&self) -> Result<()> {
        within("steps", self.steps, 1..=10_000_000, "in 1..=10000000")?;
        within("views", self.views, 1..=4096, "in 1..=4096")?;
        let most = MOST_DIRECTIONS / self.views;
        within("directions", self.directions, 2..=most, "at least 2, and at most 32768 over all views")
    }

    fn optimizer(&self) -> FitConfig {
        FitConfig {
            steps: self.steps,
            learning_rate: self.learning_rate,
            warmup: 0.02,
            weight_decay: 0.0,
            clip_norm: 5.0,
            beta_1: 0.9,
            beta_2: 0.99,
            ..FitConfig::default()
        }
    }
}

/// Largest number of directions per view: the capacity of a tile.
const MOST_DIRECTIONS: usize = headtail_render::tile::MAX_POINTS;

/// Trains a sampler for a material, and returns it with the last state, whose mean loss is the cross-entropy
/// in nats, over solid angle. A resumed run ends with bit-identical weights; the state of an interrupted run
/// has fewer steps.
///
/// # Errors
/// If a setting is out of range or the weights have diverged, and errors of `run`.
pub fn fit_rival(settings: &RivalSettings, material: &RivalMaterial, run: Run<'_>) -> Result<(Rival, TrainingState)> {
    settings.check()?;
    let config = settings.optimizer();
    let state = TrainingState::new(&config, model::initial_weights(settings.kind, settings.seed));
    let trainer = Trainer::new(&config, settings, state, settings.views * settings.directions, run)?;
    let device = Backend::default().device()?.autodiff();
    let state = trainer
        .run(&mut |weights: &[f32], step: usize| gradient(settings, material, &device, weights, step).map(Some))?;
    Ok((model::native(settings.kind, &state.parameters.weights)?, state))
}

/// Returns loss and gradient of a step.
fn gradient(
    settings: &RivalSettings,
    material: &RivalMaterial,
    device: &Device,
    weights: &[f32],
    step: usize,
) -> Result<StepGradient> {
    let &RivalSettings { kind, views, directions, seed, .. } = settings;
    let batch = Points::draw(material, views, directions, seed, step as u64);
    let shards = batch.split(SHARD);
    let rival = model::native(kind, weights)?;
    let threads = rayon::current_num_threads().min(shards.len()).max(1);
    // Separate threads, not rayon's: a step of the backward pass holds its graph's lock.
    let parts: Vec<(f32, Vec<f32>)> = std::thread::scope(|scope| {
        let (rival, work) = (&rival, |shards: &[Points], rival: &Rival| -> Vec<_> {
            shards.iter().map(|shard| model::gradient(kind, weights, rival, shard, device)).collect()
        });
        let handles: Vec<_> = shards
            .chunks(shards.len().div_ceil(threads))
            .map(|shards| scope.spawn(move || work(shards, rival)))
            .collect();
        let join = |handle: std::thread::ScopedJoinHandle<'_, Vec<_>>| {
            handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        handles.into_iter().flat_map(join).collect()
    });
    let mut d_weight = vec![0.0; weights.len()];
    let mut loss = 0.0;
    for (part, shard) in parts.iter().zip(&shards) {
        let fraction = shard.views() as f32 / views as f32;
        loss += fraction * part.0;
        d_weight.iter_mut().zip(&part.1).for_each(|(sum, g)| *sum += fraction * g);
    }
    Ok(StepGradient { loss, d_weight })
}
