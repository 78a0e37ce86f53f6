//! The file of training states: a checkpoint, or the file beside the result of a fit.
//!
//! Safetensors, then their BLAKE3 in hexadecimal. The metadata entry `headtail_state` is JSON: the settings
//! and the target of the states, and the numbers of each training run. Run `k` has the lists `k.weights`,
//! `k.average` (empty if disabled), `k.first_moments` and `k.second_moments`; those of its best validation
//! are `k.best.weights` and so on.

use std::{collections::HashMap, iter, path::Path, result};

use headtail_render::{file, tensor_file};
use safetensors::{Dtype, SafeTensors, serialize, tensor::TensorView};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::{
    Error, Result,
    state::{Parameters, TrainingState, as_json},
    trainer::Checkpoints,
};

/// Version of the format; others are rejected.
const FORMAT_VERSION: u32 = 3;
/// Name of the metadata entry.
const ENTRY: &str = "headtail_state";
/// Largest file that is read: eight lists of the largest model's weights, and their names.
const MAX_BYTES: u64 = 1 << 32;

/// A result whose error is a clause about a file.
type Checked<T> = result::Result<T, String>;

/// A file with the states of consecutive training runs, of which the last is in progress.
pub struct StateFile<'a> {
    /// The file.
    pub path: &'a Path,
    /// Steps between two saves.
    pub every: usize,
    /// Properties of the target that are not in the settings. A state of another target is rejected.
    pub target: String,
    /// The completed training runs.
    pub done: &'a [TrainingState],
}

impl Checkpoints for StateFile<'_> {
    fn every(&self) -> usize {
        self.every
    }

    fn open(
        &self,
        settings: &Value,
        blank: &TrainingState,
        _: &mut dyn FnMut(&Error),
    ) -> Result<Option<TrainingState>> {
        if !self.path.exists() {
            return Ok(None);
        }
        let state = read(self.path).and_then(|bytes| decode(&bytes, settings, &self.target, self.done.len(), blank));
        state.map_err(|reason| unusable(self.path, &reason))
    }

    fn save(&self, settings: &Value, state: &TrainingState) -> Result<()> {
        let trainings = self.done.iter().chain(iter::once(state)).collect();
        Ok(file::replace(self.path, &encode(settings, &self.target, trainings))?)
    }
}

/// The metadata entry, with states of type `T`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header<T> {
    format_version: u32,
    program_version: String,
    target: String,
    settings: Value,
    trainings: Vec<T>,
}

/// Returns the bytes of a file.
pub(crate) fn encode(settings: &Value, target: &str, trainings: Vec<&TrainingState>) -> Vec<u8> {
    let mut lists: Vec<(String, Vec<u8>)> = Vec::new();
    for (index, state) in trainings.iter().enumerate() {
        let best = state.best.iter().map(|best| ("best.", &best.parameters));
        for (prefix, parameters) in iter::once(("", &state.parameters)).chain(best) {
            for (name, list) in parameters.lists() {
                let bytes = list.iter().flat_map(|value| value.to_le_bytes()).collect();
                lists.push((format!("{index}.{prefix}{name}"), bytes));
            }
        }
    }
    let header = Header {
        format_version: FORMAT_VERSION,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        target: target.to_owned(),
        settings: settings.clone(),
        trainings,
    };
    let header = serde_json::to_string(&header).expect("a header can be written as JSON");
    let tensors = lists.iter().map(|(name, bytes)| {
        (name, TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).expect("four bytes a number"))
    });
    let metadata = HashMap::from([(ENTRY.to_owned(), header)]);
    let mut bytes = serialize(tensors, Some(metadata)).expect("lists of numbers make a safetensors file");
    let checksum = blake3::hash(&bytes).to_hex();
    bytes.extend_from_slice(checksum.as_bytes());
    bytes
}

/// Returns training run `index` of the bytes from [`read`], with the sizes of `blank`; `None` if it has not
/// started.
pub(crate) fn decode(
    bytes: &[u8],
    settings: &Value,
    target: &str,
    index: usize,
    blank: &TrainingState,
) -> Checked<Option<TrainingState>> {
    let (header, tensors) = open(bytes)?;
    let mut header: Header<TrainingState> =
        serde_json::from_value(header.into()).map_err(|error| format!("{ENTRY}: {error}"))?;
    check_origin(&mut header, settings, target)?;
    let Some(mut state) = header.trainings.into_iter().nth(index) else { return Ok(None) };
    check_numbers(&state, &header.settings)?;
    state.groups.clone_from(&blank.groups);
    read_lists(&tensors, &format!("{index}."), &mut state.parameters, &blank.parameters)?;
    if let Some(best) = &mut state.best {
        read_lists(&tensors, &format!("{index}.best."), &mut best.parameters, &blank.parameters)?;
    }
    Ok(Some(state))
}

/// Checks that states have this version, these settings and this target.
fn check_origin(header: &mut Header<TrainingState>, settings: &Value, target: &str) -> Checked<()> {
    let version = env!("CARGO_PKG_VERSION");
    if header.program_version != version {
        let reason = format!("was written by version {}, this is {version}", header.program_version);
        return Err(format!("{reason}: it would not go on to the same bits"));
    }
    // Read back from JSON like the saved settings: a decimal is read to within 1 ULP of the number.
    let settings = as_json(settings);
    // A run may be extended: the learning rate continues as in the longer run at this step.
    if let (Some(saved), Some(steps)) = (header.settings.get_mut("steps"), settings.get("steps"))
        && saved.as_u64().is_some_and(|saved| Some(saved) < steps.as_u64())
    {
        *saved = steps.clone();
    }
    for key in FREE {
        if let (Some(saved), Some(now)) = (header.settings.get_mut(key), settings.get(key)) {
            saved.clone_from(now);
        }
    }
    if let Some(difference) = first_difference("", &header.settings, &settings) {
        return Err(format!("was made with another {difference}"));
    }
    if header.target != target {
        return Err(format!("is of another target: it has {}, this run {target}", header.target));
    }
    Ok(())
}

/// Settings that may change within a run: they change its weights by rounding.
const FREE: [&str; 2] = ["backend", "gradient"];

/// Describes the changes of such settings since a file was written.
pub(crate) fn free_changes(bytes: &[u8], settings: &Value) -> Vec<String> {
    let Ok((header, _)) = open(bytes) else { return Vec::new() };
    let change = |key: &str| {
        let (saved, now) = (header.get("settings")?.get(key)?, settings.get(key)?);
        (saved != now).then(|| format!("was made with {key} = {saved}; it goes on with {now}, which rounds otherwise"))
    };
    FREE.into_iter().filter_map(change).collect()
}

/// Returns the settings and numbers in a file.
///
/// # Errors
/// If the file cannot be read, or is not a file of training states.
pub fn describe(path: &Path) -> Result<Map<String, Value>> {
    let header = read(path).and_then(|bytes| Ok(open(&bytes)?.0));
    header.map_err(|reason| unusable(path, &reason))
}

/// Reads a file, verifies its checksum and returns the bytes before it.
pub(crate) fn read(path: &Path) -> Checked<Vec<u8>> {
    let mut bytes = file::read(path, MAX_BYTES).map_err(|error| error.to_string())?;
    let end = bytes.len().saturating_sub(2 * blake3::OUT_LEN);
    if bytes[end..] != *blake3::hash(&bytes[..end]).to_hex().as_bytes() {
        return Err("does not have the checksum that was written with it".into());
    }
    bytes.truncate(end);
    Ok(bytes)
}

/// Returns the header, of this version, and the lists.
fn open(bytes: &[u8]) -> Checked<(Map<String, Value>, SafeTensors<'_>)> {
    let (metadata, tensors) = tensor_file::open(bytes)?;
    let entry = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
    let header = entry.ok_or_else(|| format!("has no metadata entry `{ENTRY}`"))?;
    let header: Map<String, Value> = serde_json::from_str(header).map_err(|error| format!("{ENTRY}: {error}"))?;
    if header.get("format_version") != Some(&Value::from(FORMAT_VERSION)) {
        return Err(format!("{ENTRY}: format_version is not {FORMAT_VERSION}"));
    }
    Ok((header, tensors))
}

/// Checks numbers on which training steps rely.
fn check_numbers(state: &TrainingState, settings: &Value) -> Checked<()> {
    let best = state.best.iter().map(|best| &best.parameters);
    let moves = best.chain([&state.parameters]).map(|parameters| parameters.optimizer.moves).max();
    for (field, is_in_range) in [
        ("step", settings["steps"].as_u64().is_some_and(|steps| state.step as u64 <= steps)),
        ("skipped", state.skipped <= state.step),
        ("moves", moves <= Some(state.step as u64)),
        ("rate_factor", state.rate_factor > 0.0 && state.rate_factor <= 1.0),
    ] {
        if !is_in_range {
            return Err(format!("{ENTRY}: `{field}` is out of range"));
        }
    }
    Ok(())
}

/// Reads the lists of parameters, which must have the lengths of `blank` and finite numbers.
fn read_lists(tensors: &SafeTensors<'_>, prefix: &str, into: &mut Parameters, blank: &Parameters) -> Checked<()> {
    for (list, (name, blank)) in into.lists_mut().into_iter().zip(blank.lists()) {
        let name = format!("{prefix}{name}");
        let tensor = tensors.tensor(&name).map_err(|error| format!("{name}: {error}"))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != [blank.len()] {
            let found = format!("{:?} {:?}", tensor.dtype(), tensor.shape());
            return Err(format!("{name}: {found}, expected F32 [{}]", blank.len()));
        }
        *list = tensor.data().as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        if let Some(value) = list.iter().find(|value| !value.is_finite()) {
            return Err(format!("{name}: {value} is not finite"));
        }
    }
    Ok(())
}

/// Returns the dotted key of the first setting that differs, with both values.
fn first_difference(key: &str, saved: &Value, own: &Value) -> Option<String> {
    let (Value::Object(a), Value::Object(b)) = (saved, own) else {
        return (saved != own).then(|| format!("`{key}`: it has {saved}, this run {own}"));
    };
    let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    keys.into_iter().find_map(|name| {
        let key = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
        first_difference(&key, a.get(name).unwrap_or(&Value::Null), b.get(name).unwrap_or(&Value::Null))
    })
}

/// Returns the error for a file of another run or format.
pub(crate) fn unusable(path: &Path, reason: &str) -> Error {
    Error::Checkpoint { path: path.to_owned(), reason: format!("{reason}; remove it to start again") }
}
