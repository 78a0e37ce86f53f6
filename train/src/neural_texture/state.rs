//! All that the next step of a fit depends on, and its file.

use std::{path::Path, sync::Arc};

use headtail_render::file;
use safetensors::{Dtype, SafeTensors, serialize, tensor::TensorView};

use super::{FEATURES, Layout, Settings};
use crate::{
    Error, FitConfig, Result,
    optimizer::{OptimizerState, Schedule},
};

/// Larger files are refused before they are read.
const LARGEST_FILE: u64 = 1 << 28;

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
        if self.weights.len() != layout.weight_count() || found != expected {
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
        let about = serde_json::to_string(&(self.step, moves, settings, source)).expect("settings are JSON");
        let lists = self.lists();
        let bytes: Vec<Vec<u8>> =
            lists.iter().map(|(_, list)| list.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
        let tensors = lists.iter().zip(&bytes).map(|((name, list), bytes)| {
            (*name, TensorView::new(Dtype::F32, vec![list.len()], bytes).expect("four bytes a number"))
        });
        let metadata = std::collections::HashMap::from([("headtail-fit".to_owned(), about)]);
        let bytes = serialize(tensors, Some(metadata)).expect("lists of numbers make a safetensors file");
        file::replace(path, &bytes).map_err(|error| Error::Render(Arc::new(error)))
    }

    /// Reads the state of a fit of these settings.
    ///
    /// # Errors
    /// When the file is damaged, or was written by a fit of other settings.
    pub fn read(path: &Path, settings: &Settings, source: &str) -> Result<Self> {
        let wrong = |reason: &str| Error::ConfigFile { name: path.display().to_string(), reason: reason.to_owned() };
        let bytes = file::read(path, LARGEST_FILE).map_err(|error| wrong(&error.to_string()))?;
        let damaged = |_| wrong("is no state of a fit: remove it to begin anew");
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let about = metadata.metadata().as_ref().and_then(|entries| entries.get("headtail-fit"));
        let (step, moves, own, name): (usize, [u64; 2], Settings, String) = about
            .and_then(|text| serde_json::from_str(text).ok())
            .ok_or_else(|| wrong("is no state of a fit: remove it to begin anew"))?;
        if own != *settings || name != source {
            return Err(wrong("belongs to a fit of other settings: name another folder, or remove it"));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let list = |name: &str| -> Result<Vec<f32>> {
            let view = tensors.tensor(name).ok().filter(|view| view.dtype() == Dtype::F32);
            let view = view.ok_or_else(|| wrong("is no state of a fit: remove it to begin anew"))?;
            Ok(view.data().as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect::<Vec<f32>>())
        };
        let optimizer = |k: usize| -> Result<OptimizerState> {
            let [first_moments, second_moments] = [list(NAMES[1 + 2 * k])?, list(NAMES[2 + 2 * k])?];
            Ok(OptimizerState { moves: moves[k], first_moments, second_moments })
        };
        Ok(Self { step, weights: list(NAMES[0])?, optimizers: [optimizer(0)?, optimizer(1)?] })
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
