//! All that the next step of a training depends on, and the file of several trainings.

use std::path::Path;

use super::{RivalMaterial, RivalSettings};
use crate::{Error, Result, optimizer::OptimizerState, state_file};

/// Weights and what the optimiser remembers of them.
#[derive(Clone, Debug, PartialEq)]
pub struct RivalState {
    /// Steps that are done.
    pub step: usize,
    /// The decaying mean of the losses; none before the first step.
    pub loss: Option<f32>,
    pub(super) weights: Vec<f32>,
    pub(super) optimizer: OptimizerState,
}

impl RivalState {
    pub(super) fn new(weights: Vec<f32>) -> Self {
        Self { step: 0, loss: None, optimizer: OptimizerState::new(weights.len()), weights }
    }

    /// Whether it is one of so many weights, and not beyond the last step.
    pub(super) fn check(&self, weights: usize, steps: usize) -> Result<()> {
        let OptimizerState { first_moments, second_moments, .. } = &self.optimizer;
        let lengths = [&self.weights, first_moments, second_moments].map(Vec::len);
        if lengths != [weights; 3] || self.step > steps {
            let value = format!("step {} of {} weights", self.step, self.weights.len());
            return Err(Error::Config { field: "state", value, requirement: "of this kind of sampler" });
        }
        Ok(())
    }
}

/// What a file belongs to: settings, identities of the materials, and of each training steps, moves and loss.
type About = (RivalSettings, Vec<String>, Vec<(usize, u64, Option<f32>)>);

impl RivalState {
    /// Writes the trainings of a command that were begun, in the order of their materials.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_all(
        path: &Path,
        settings: &RivalSettings,
        materials: &[RivalMaterial],
        states: &[&Self],
    ) -> Result<()> {
        let numbers = states.iter().map(|state| (state.step, state.optimizer.moves, state.loss)).collect();
        let about: About = (*settings, identities(materials), numbers);
        let mut lists = Vec::new();
        for (k, state) in states.iter().enumerate() {
            let Self { weights, optimizer: OptimizerState { first_moments, second_moments, .. }, .. } = state;
            for (name, list) in NAMES.iter().zip([weights, first_moments, second_moments]) {
                lists.push((format!("{k}.{name}"), &list[..]));
            }
        }
        state_file::write(path, &about, &lists)
    }

    /// Reads the trainings of a command with these settings and materials.
    ///
    /// # Errors
    /// When the file is damaged, or was written by another command.
    pub fn read_all(path: &Path, settings: &RivalSettings, materials: &[RivalMaterial]) -> Result<Vec<Self>> {
        let ((own, of, numbers), mut file) = state_file::read::<About>(path)?;
        if own != *settings || of != identities(materials) || numbers.len() > materials.len() {
            return Err(state_file::wrong(path, "belongs to a fit of other settings: name another file, or remove it"));
        }
        let mut states = Vec::new();
        for (k, (step, moves, loss)) in numbers.into_iter().enumerate() {
            let mut list = |name: &str| file.list(&format!("{k}.{name}"));
            let [weights, first_moments, second_moments] = [list(NAMES[0])?, list(NAMES[1])?, list(NAMES[2])?];
            let optimizer = OptimizerState { moves, first_moments, second_moments };
            states.push(Self { step, loss, weights, optimizer });
        }
        Ok(states)
    }
}

/// Lists of numbers of a training.
const NAMES: [&str; 3] = ["weights", "first_moments", "second_moments"];

fn identities(materials: &[RivalMaterial]) -> Vec<String> {
    materials.iter().map(|material| material.identity.to_hex().to_string()).collect()
}
