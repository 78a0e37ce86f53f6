//! Checkpoints: folders from which a run goes on to the same bits.
//!
//! A checkpoint is a folder `step-000001000` of three files: `manifest.json` (counters, configuration, target, versions),
//! `state.safetensors` (weights, moving average, moments, and those of the best validation) and `checksums.b3` (BLAKE3 of the other two, in the form that `b3sum`
//! checks). It is written under another name, flushed to the disk and renamed, so that there is a whole one or none.
//! Batches are functions of (seed, step) and have no state.

mod read;
#[cfg(test)]
mod tests;
mod write;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Divergence, Error, FitConfig, Result, state::TrainingState};

/// The version of this layout; another one is refused.
const FORMAT_VERSION: u32 = 2;
const MANIFEST: &str = "manifest.json";
const STATE: &str = "state.safetensors";
const CHECKSUMS: &str = "checksums.b3";
const PREFIX: &str = "step-";

/// How many checkpoints stay: if the last is damaged, the one before it is used.
const KEPT: usize = 3;

/// Where a run leaves its checkpoints.
#[derive(Clone, Debug)]
pub struct CheckpointFolder {
    /// The folder that holds them; it is made when it is missing.
    pub folder: PathBuf,
    /// Steps between checkpoints; 0 saves at the end and at an interruption only.
    pub every: usize,
    /// Go on from the last checkpoint, where there is one.
    pub resume: bool,
    /// What the configuration does not say of the target: the environment's hash, where conditions come from. A checkpoint of
    /// another target is refused.
    pub target: String,
}

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedRun {
    /// Weights, optimiser and counters.
    pub state: TrainingState,
    /// Wall-clock seconds so far.
    pub seconds: f64,
}

/// The counters and settings of a checkpoint.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format_version: u32,
    program_version: String,
    step: usize,
    skipped: usize,
    /// The last step's loss; `None` if there was none or it was no number.
    loss: Option<f32>,
    moves: u64,
    rate_factor: f64,
    /// Of the best validation; its lists are in the other file.
    kept: Option<KeptManifest>,
    seconds: f64,
    /// BLAKE3 of `config`, as JSON without spaces.
    config_hash: String,
    config: FitConfig,
    target: String,
}

/// What a checkpoint says of the best validation so far.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptManifest {
    divergence: Divergence,
    moves: u64,
}

impl CheckpointFolder {
    /// Makes the folder, and finds what to go on from: `None` without `resume`, or where nothing is saved yet.
    ///
    /// A run with more steps than the checkpoint's goes on from it, too. Checkpoints that are damaged are set aside under the name `refused-step-...`, told to `warn`, and the one before is taken.
    ///
    /// # Errors
    /// If the folder cannot be made or read, a checkpoint belongs to other settings, another target or another version, or
    /// there are checkpoints and `resume` is off.
    pub fn open(&self, config: &FitConfig, weights: usize, warn: &mut dyn FnMut(&Error)) -> Result<Option<SavedRun>> {
        std::fs::create_dir_all(&self.folder).map_err(|error| failed(&self.folder, &error))?;
        let mut names = self.steps()?;
        if !self.resume {
            return if names.is_empty() {
                Ok(None)
            } else {
                Err(refuse(&self.folder, "holds checkpoints of an earlier run: resume it, or take another folder"))
            };
        }
        while let Some(step) = names.pop() {
            let path = self.path(step);
            match read::read(&path, weights) {
                Ok((manifest, saved)) => {
                    self.check_run(&path, config, &manifest)?;
                    return Ok(Some(saved));
                }
                Err(error) => {
                    warn(&error);
                    write::set_aside(&path)?;
                }
            }
        }
        Ok(None)
    }

    /// Writes a checkpoint, then removes the oldest beyond those that stay.
    ///
    /// # Errors
    /// If the system refuses to write.
    pub fn save(&self, config: &FitConfig, run: &SavedRun) -> Result<()> {
        write::write(&self.path(run.state.step), config, &self.target, run)?;
        let steps = self.steps()?;
        for &step in &steps[..steps.len().saturating_sub(KEPT)] {
            write::remove(&self.path(step))?;
        }
        write::remove_unfinished(&self.folder)
    }

    /// Whether a checkpoint is due after `step`.
    pub fn is_due(&self, step: usize) -> bool {
        step.is_multiple_of(self.every)
    }

    fn path(&self, step: usize) -> PathBuf {
        self.folder.join(format!("{PREFIX}{step:09}"))
    }

    /// The steps that are saved, in ascending order.
    fn steps(&self) -> Result<Vec<usize>> {
        let entries = std::fs::read_dir(&self.folder).map_err(|error| failed(&self.folder, &error))?;
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut steps: Vec<usize> = names.filter_map(|name| name.strip_prefix(PREFIX)?.parse().ok()).collect();
        steps.sort_unstable();
        Ok(steps)
    }

    /// Checks that a sound checkpoint is one of this run.
    fn check_run(&self, path: &Path, config: &FitConfig, manifest: &Manifest) -> Result<()> {
        let version = env!("CARGO_PKG_VERSION");
        if manifest.program_version != version {
            let reason = format!("was written by version {}, this is {version}", manifest.program_version);
            return Err(refuse(path, &format!("{reason}: it would not go on to the same bits")));
        }
        // A run may be extended: the learning rate goes on as that of the longer run has it at this step.
        let saved = FitConfig { steps: manifest.config.steps.max(config.steps), ..manifest.config.clone() };
        if let Some(key) = first_difference(&saved, config) {
            return Err(refuse(path, &format!("was made with another `{key}`; its settings are in {MANIFEST}")));
        }
        if manifest.target != self.target {
            let reason = format!("is of another target: it has {}, this run {}", manifest.target, self.target);
            return Err(refuse(path, &reason));
        }
        Ok(())
    }
}

/// The dotted key of the first setting that differs.
fn first_difference(saved: &FitConfig, config: &FitConfig) -> Option<String> {
    fn differ(path: &str, a: &serde_json::Value, b: &serde_json::Value) -> Option<String> {
        match (a, b) {
            (serde_json::Value::Object(a), serde_json::Value::Object(b)) => {
                let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
                keys.into_iter().find_map(|key| {
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    let null = serde_json::Value::Null;
                    differ(&path, a.get(key).unwrap_or(&null), b.get(key).unwrap_or(&null))
                })
            }
            (a, b) => (a != b).then(|| path.to_owned()),
        }
    }
    let [saved, config] = [saved, config].map(|config| serde_json::to_value(config).unwrap_or_default());
    differ("", &saved, &config)
}

fn config_hash(config: &FitConfig) -> String {
    let text = serde_json::to_string(config).expect("a configuration can be written as JSON");
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

fn refuse(path: &Path, reason: &str) -> Error {
    Error::Checkpoint { path: path.to_owned(), reason: reason.to_owned() }
}

fn failed(path: &Path, error: &std::io::Error) -> Error {
    refuse(path, &error.to_string())
}
