//! All that the next step of a fit depends on, and its file.

use std::path::Path;

use super::{FEATURES, Layout, Settings};
use crate::{
    Error, FitConfig, Result,
    optimizer::{OptimizerState, Schedule},
    state_file,
};

/// Weights and what the optimisers remember of them.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Steps that are done.
    pub step: usize,
    /// Texels, then the networks.
    pub weights: Vec<f32>,
    /// Of texels and networks.
    optimizers: [OptimizerState; 2],
}

impl State {
    /// The state before the first step.
    pub fn new(weights: Vec<f32>, texels: usize) -> Self {
        let networks = weights.len() - FEATURES * texels;
        Self { step: 0, weights, optimizers: [FEATURES * texels, networks].map(OptimizerState::new) }
    }

    /// Whether it is of this layout.
    pub(super) fn check(&self, layout: &Layout) -> Result<()> {
        let expected = [FEATURES * layout.texels(), layout.weight_count() - FEATURES * layout.texels()];
        let found = [0, 1].map(|k: usize| self.optimizers[k].first_moments.len());
        let squares = [0, 1].map(|k: usize| self.optimizers[k].second_moments.len());
        if self.weights.len() != layout.weight_count() || found != expected || squares != expected {
            let value = format!("{} weights", self.weights.len());
            return Err(Error::Config { field: "state", value, requirement: "of the same texture size" });
        }
        Ok(())
    }

    /// Moves the weights; what is not finite moves nothing.
    pub(super) fn advance(&mut self, configs: &[FitConfig; 2], texel_weights: usize, gradient: &[f32]) {
        let (texels, networks) = self.weights.split_at_mut(texel_weights);
        let (of_texels, of_networks) = gradient.split_at(texel_weights);
        for ((optimizer, config), (weights, gradient)) in
            self.optimizers.iter_mut().zip(configs).zip([(texels, of_texels), (networks, of_networks)])
        {
            optimizer.step(config, Schedule::new(config).rate(self.step), weights, gradient);
        }
        self.step += 1;
    }

    /// Writes the state with the settings that it belongs to.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, settings: &Settings, source: &str) -> Result<()> {
        let moves = [0, 1].map(|k: usize| self.optimizers[k].moves);
        let lists = self.lists().map(|(name, list)| (name.to_owned(), &list[..]));
        state_file::write(path, &(self.step, moves, settings, source), &lists)
    }

    /// Reads the state of a fit of these settings.
    ///
    /// # Errors
    /// When the file is damaged, or was written by a fit of other settings.
    pub fn read(path: &Path, settings: &Settings, source: &str) -> Result<Self> {
        type About = (usize, [u64; 2], Settings, String);
        let ((step, moves, own, name), mut file) = state_file::read::<About>(path)?;
        if own != *settings || name != source {
            return Err(state_file::wrong(path, "belongs to a fit of other settings: name another file, or remove it"));
        }
        let mut optimizer = |k: usize| -> Result<OptimizerState> {
            let [first_moments, second_moments] = [file.list(NAMES[1 + 2 * k])?, file.list(NAMES[2 + 2 * k])?];
            Ok(OptimizerState { moves: moves[k], first_moments, second_moments })
        };
        let optimizers = [optimizer(0)?, optimizer(1)?];
        Ok(Self { step, weights: file.list(NAMES[0])?, optimizers })
    }

    fn lists(&self) -> [(&'static str, &Vec<f32>); 5] {
        let [texels, networks] = &self.optimizers;
        [
            (NAMES[0], &self.weights),
            (NAMES[1], &texels.first_moments),
            (NAMES[2], &texels.second_moments),
            (NAMES[3], &networks.first_moments),
            (NAMES[4], &networks.second_moments),
        ]
    }
}

/// Lists of numbers in a file.
const NAMES: [&str; 5] =
    ["weights", "texels.first_moments", "texels.second_moments", "networks.first_moments", "networks.second_moments"];
