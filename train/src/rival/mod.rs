//! Training the samplers of [`headtail_render::rival`]: they learn to draw in proportion to what a material reflects, whatever the light.
//!
//! Each step draws views and places anew, and for each of them directions by the material's own sampling, with weights that make them ones
//! of `f_r cos`. The loss is the cross-entropy of the sampler under these, per view. Lobes and flows have their density in the graph. The
//! reparameterised sampler has no inverse there: the renderer finds the point that each direction comes from, and the gradient of the
//! density there follows from the implicit function theorem (`model.rs`).

mod model;
mod points;
mod state;
#[cfg(test)]
mod tests;

pub use points::{RivalMaterial, RivalQuality};
pub use state::RivalState;

use std::sync::Arc;

use headtail_model::burn::prelude::Device;
use headtail_render::{
    brdf::neural_texture::FEATURES,
    rival::{Rival, RivalKind},
};

use serde::{Deserialize, Serialize};

use crate::{Backend, Error, FitConfig, Result, optimizer::Schedule};
use points::Points;

/// Views of a batch that one thread takes through the networks.
const SHARD: usize = 16;

/// What the training of a rival is set by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RivalSettings {
    /// Which sampler.
    pub kind: RivalKind,
    /// Training steps.
    pub steps: usize,
    /// Views (with places) of a step.
    pub views: usize,
    /// Directions of each.
    pub directions: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Seed of weights and samples.
    pub seed: u64,
}

impl RivalSettings {
    /// The settings for a kind.
    pub fn new(kind: RivalKind) -> Self {
        Self { kind, steps: 2000, views: 128, directions: 64, learning_rate: 4e-3, seed: 0 }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Config`] that names the field.
    pub fn check(&self) -> Result<()> {
        let wrong =
            |field, value: usize, requirement| Err(Error::Config { field, value: value.to_string(), requirement });
        match self {
            Self { steps, .. } if !(1..=10_000_000).contains(steps) => wrong("steps", *steps, "in 1..=10000000"),
            Self { views, .. } if !(1..=4096).contains(views) => wrong("views", *views, "in 1..=4096"),
            Self { directions, views, .. } if *directions < 2 || views * directions > MOST_DIRECTIONS => {
                wrong("directions", *directions, "at least 2, and at most 32768 over all views")
            }
            _ => Ok(()),
        }
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

/// Directions of a step: what a tile holds.
const MOST_DIRECTIONS: usize = headtail_render::tile::MAX_POINTS;

/// A training on its way.
pub struct RivalFit<'a> {
    settings: RivalSettings,
    material: &'a RivalMaterial,
    device: Device,
    state: RivalState,
}

impl<'a> RivalFit<'a> {
    /// A training before its first step, or where `state` was left.
    ///
    /// # Errors
    /// When a setting is out of range, or the state is of another kind of sampler.
    pub fn new(settings: RivalSettings, material: &'a RivalMaterial, state: Option<RivalState>) -> Result<Self> {
        settings.check()?;
        let initial = model::initial_weights(settings.kind, settings.seed);
        let state = state.unwrap_or_else(|| RivalState::new(initial.clone()));
        state.check(initial.len(), settings.steps)?;
        Ok(Self { settings, material, device: Backend::Flex.device()?.autodiff(), state })
    }

    /// Steps that are done.
    pub fn step(&self) -> usize {
        self.state.step
    }

    /// What the next step depends on.
    pub fn state(&self) -> &RivalState {
        &self.state
    }

    /// Takes the next step and gives its loss: the cross-entropy in nats, over solid angle.
    ///
    /// # Errors
    /// When the weights have diverged.
    pub fn advance(&mut self) -> Result<f32> {
        let RivalSettings { kind, views, directions, seed, .. } = self.settings;
        let batch = Points::draw(self.material, views, directions, seed, self.state.step as u64);
        let shards = batch.split(SHARD);
        let rival = self.rival()?;
        let threads = rayon::current_num_threads().min(shards.len()).max(1);
        let (weights, device) = (&self.state.weights[..], &self.device);
        // Threads of their own, not rayon's: a step of the backward pass holds its graph's lock.
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
        let mut gradient = vec![0.0; self.state.weights.len()];
        let mut loss = 0.0;
        for (part, shard) in parts.iter().zip(&shards) {
            let share = shard.views() as f32 / views as f32;
            loss += share * part.0;
            gradient.iter_mut().zip(&part.1).for_each(|(sum, g)| *sum += share * g);
        }
        let config = self.settings.optimizer();
        let state = &mut self.state;
        state.optimizer.step(&config, Schedule::new(&config).rate(state.step), &mut state.weights, &gradient);
        state.step += 1;
        // Over some fifty steps.
        state.loss = Some(state.loss.map_or(loss, |mean| mean + 0.02 * (loss - mean)));
        Ok(loss)
    }

    /// The sampler as it is now.
    ///
    /// # Errors
    /// When the weights have diverged.
    pub fn rival(&self) -> Result<Rival> {
        model::native(self.settings.kind, &self.state.weights)
    }
}

fn render_error(error: headtail_render::Error) -> Error {
    Error::Render(Arc::new(error))
}

/// What a sampler knows of a point, in the tangent frame: features and the direction to the viewer.
#[derive(Clone, Copy, Debug)]
struct View {
    features: [f32; FEATURES],
    wo: [f32; 3],
}
