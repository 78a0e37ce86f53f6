//! Files of fits that were interrupted: lists of numbers with names, and what they belong to as JSON, in the form of safetensors.

use std::{collections::HashMap, path::Path, sync::Arc};

use headtail_render::file;
use safetensors::{Dtype, SafeTensors, serialize, tensor::TensorView};
use serde::{Serialize, de::DeserializeOwned};

use crate::{Error, Result};

/// Larger files are refused before they are read.
const LARGEST_FILE: u64 = 1 << 28;
/// The entry of the metadata.
const ENTRY: &str = "headtail-fit";

/// What a file holds.
pub(crate) struct StateFile<'a> {
    path: &'a Path,
    lists: HashMap<String, Vec<f32>>,
}

/// Replaces the file at `path`.
pub(crate) fn write(path: &Path, about: &impl Serialize, lists: &[(String, &[f32])]) -> Result<()> {
    let about = serde_json::to_string(about).expect("settings are JSON");
    let little = |list: &[f32]| list.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let bytes: Vec<Vec<u8>> = lists.iter().map(|(_, list)| little(list)).collect();
    let tensors = lists.iter().zip(&bytes).map(|((name, list), bytes)| {
        (name.as_str(), TensorView::new(Dtype::F32, vec![list.len()], bytes).expect("four bytes a number"))
    });
    let metadata = HashMap::from([(ENTRY.to_owned(), about)]);
    let bytes = serialize(tensors, Some(metadata)).expect("lists of numbers make a safetensors file");
    file::replace(path, &bytes).map_err(|error| Error::Render(Arc::new(error)))
}

/// An error of the file at `path`.
pub(crate) fn wrong(path: &Path, reason: &str) -> Error {
    Error::ConfigFile { name: path.display().to_string(), reason: reason.to_owned() }
}

fn damaged(path: &Path) -> Error {
    wrong(path, "is no state of a fit: remove it to begin anew")
}

/// Reads a file: what it belongs to, and its lists.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<(T, StateFile<'_>)> {
    let bytes = file::read(path, LARGEST_FILE).map_err(|error| wrong(path, &error.to_string()))?;
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|_| damaged(path))?;
    let about = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
    let about = about.and_then(|text| serde_json::from_str(text).ok()).ok_or_else(|| damaged(path))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|_| damaged(path))?;
    let mut lists = HashMap::new();
    for (name, view) in tensors.iter().filter(|(_, view)| view.dtype() == Dtype::F32) {
        let values = view.data().as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        lists.insert(name.to_owned(), values);
    }
    Ok((about, StateFile { path, lists }))
}

impl StateFile<'_> {
    /// The list of this name, all of whose numbers are finite.
    pub fn list(&mut self, name: &str) -> Result<Vec<f32>> {
        let list = self.lists.remove(name).filter(|list| list.iter().all(|value| value.is_finite()));
        list.ok_or_else(|| damaged(self.path))
    }
}
