//! Folders of checkpoints, from which runs resume bit-identically.
//!
//! A checkpoint is a file `step-000001000` (see [`crate::state_file`]). It is written under another name,
//! flushed to disk and renamed, so that it is either complete or absent.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use serde_json::Value;

use crate::{
    Error, Result, TrainingState,
    state_file::{self, unusable},
    trainer::Checkpoints,
};

const PREFIX: &str = "step-";
/// The name of a checkpoint while it is written.
const UNFINISHED: &str = ".unfinished";

/// Number of checkpoints kept: if the last is damaged, the one before it is used.
const KEPT: usize = 3;

/// Where a run saves its checkpoints.
#[derive(Clone, Debug)]
pub struct CheckpointFolder {
    /// The folder; created if missing.
    pub folder: PathBuf,
    /// Steps between checkpoints; 0 saves at the end and at an interruption only.
    pub every: usize,
    /// Resume from the last checkpoint, if there is one.
    pub resume: bool,
    /// Properties of the target that are not in the settings: the environment's hash and the source of
    /// conditions. A checkpoint of another target is rejected.
    pub target: String,
}

impl Checkpoints for CheckpointFolder {
    fn every(&self) -> usize {
        self.every
    }

    /// Creates the folder and reads the last checkpoint: `None` without `resume` or if nothing is saved yet.
    /// A damaged one is renamed to `refused-step-...`, and the one before it is used. Without `resume`, no
    /// checkpoint may exist.
    fn open(
        &self,
        settings: &Value,
        blank: &TrainingState,
        warn: &mut dyn FnMut(&Error),
    ) -> Result<Option<TrainingState>> {
        fs::create_dir_all(&self.folder).map_err(failed(&self.folder))?;
        let mut steps = self.steps()?;
        if !self.resume && !steps.is_empty() {
            return Err(refuse(&self.folder, "holds checkpoints of an earlier run: resume it, or take another folder"));
        }
        while let Some(step) = steps.pop() {
            let path = self.path(step);
            if path.is_dir() {
                return Err(unusable(&path, "is a checkpoint of an earlier version"));
            }
            match state_file::read(&path) {
                Ok(bytes) => {
                    for change in state_file::free_changes(&bytes, settings) {
                        warn(&refuse(&path, &change));
                    }
                    let state = state_file::decode(&bytes, settings, &self.target, 0, blank);
                    return state.map_err(|reason| unusable(&path, &reason));
                }
                Err(reason) => {
                    warn(&refuse(&path, &format!("{reason}; the checkpoint before it is used")));
                    let refused = self.folder.join(format!("refused-{PREFIX}{step:09}"));
                    fs::rename(&path, refused).map_err(failed(&path))?;
                }
            }
        }
        Ok(None)
    }

    /// Writes a checkpoint, then removes the oldest ones beyond the number kept.
    fn save(&self, settings: &Value, state: &TrainingState) -> Result<()> {
        let (unfinished, path) = (self.folder.join(UNFINISHED), self.path(state.step));
        let bytes = state_file::encode(settings, &self.target, vec![state]);
        let write = || {
            let mut file = File::create(&unfinished)?;
            file.write_all(&bytes)?;
            file.sync_all()?;
            fs::rename(&unfinished, &path)?;
            // A name that is not flushed can be lost.
            File::open(&self.folder)?.sync_all()
        };
        write().map_err(failed(&path))?;
        let steps = self.steps()?;
        for &step in &steps[..steps.len().saturating_sub(KEPT)] {
            let oldest = self.path(step);
            fs::remove_file(&oldest).map_err(failed(&oldest))?;
        }
        Ok(())
    }
}

impl CheckpointFolder {
    /// Returns the folder of the flow tail for a run whose head uses this folder.
    #[must_use]
    pub fn of_tail(&self) -> Self {
        Self { folder: self.folder.join("tail"), target: format!("tail of {}", self.target), ..self.clone() }
    }

    fn path(&self, step: usize) -> PathBuf {
        self.folder.join(format!("{PREFIX}{step:09}"))
    }

    /// Returns the saved steps, in ascending order.
    fn steps(&self) -> Result<Vec<usize>> {
        let entries = fs::read_dir(&self.folder).map_err(failed(&self.folder))?;
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut steps: Vec<usize> = names.filter_map(|name| name.strip_prefix(PREFIX)?.parse().ok()).collect();
        steps.sort_unstable();
        Ok(steps)
    }
}

fn failed(path: &Path) -> impl Fn(io::Error) -> Error {
    move |error| refuse(path, &error.to_string())
}

fn refuse(path: &Path, reason: &str) -> Error {
    Error::Checkpoint { path: path.to_owned(), reason: reason.to_owned() }
}

#[cfg(test)]
mod tests;
