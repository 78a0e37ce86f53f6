//! Files of measured materials: this project's format, and the raw rows in which the networks are published.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use safetensors::{
    SafeTensors,
    tensor::{Dtype, TensorView, serialize},
};
use serde::{Deserialize, Serialize};

use super::{INPUTS, LAYERS, Network, OUTPUTS};
use crate::{
    error::{Error, Result},
    file,
    linear::Linear,
    tensor_file,
};

/// The version of the format, in the metadata `headtail-materials`.
const FORMAT_VERSION: u32 = 1;
/// Larger files are rejected before they are read.
const LARGEST_FILE: u64 = 64 << 20;
/// Maximum number of materials in a file.
const MOST_MATERIALS: usize = 4096;
/// Width of the hidden layers of raw rows.
const RAW_HIDDEN: usize = 21;
/// Numbers of a raw row: weights `[in][out]` and biases of each layer in turn.
const RAW_ROW: usize = (INPUTS + 1) * RAW_HIDDEN + (RAW_HIDDEN + 1) * RAW_HIDDEN + (RAW_HIDDEN + 1) * OUTPUTS;

/// The metadata, as JSON.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    format_version: u32,
    /// `neural-brdf`.
    kind: String,
    /// The materials in order.
    names: Vec<String>,
}

const KIND: &str = "neural-brdf";

/// Reads the named networks of a file: `.safetensors` as [`write_networks`] writes it, or `.f32`, raw
/// rows with their names in `.names.txt` beside it.
///
/// # Errors
/// An error that names the file and the field.
pub fn read_networks(path: &Path) -> Result<Vec<(String, Network)>> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("safetensors") => read_safetensors(path),
        Some("f32") => read_raw(path),
        _ => Err(Error::invalid(path, "name", "ends in neither .safetensors nor .f32, which hold neural BRDFs")),
    }
}

fn read_bounded(path: &Path) -> Result<Vec<u8>> {
    file::read(path, LARGEST_FILE).map_err(|error| Error::io(path, error))
}

/// Checks that there are 1 to [`MOST_MATERIALS`] names, all valid and distinct.
fn check_names(path: &Path, names: &[String]) -> Result<()> {
    if names.is_empty() || names.len() > MOST_MATERIALS {
        let reason = format!("there are {}; 1 to {MOST_MATERIALS} are read", names.len());
        return Err(Error::invalid(path, "names", reason));
    }
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort_unstable();
    if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(Error::invalid(path, "names", format!("'{}' is there twice", pair[0])));
    }
    // Commas and number signs are syntax of material specifications.
    let is_bad = |name: &&String| name.is_empty() || name.contains([',', '#']) || name.chars().any(char::is_control);
    match names.iter().find(is_bad) {
        Some(name) => Err(Error::invalid(path, "names", format!("{name:?} is not the name of a material"))),
        None => Ok(()),
    }
}

/// Returns the file that holds the names of the raw rows of `path`.
pub fn names_file(path: &Path) -> PathBuf {
    path.with_extension("names.txt")
}

fn read_raw(path: &Path) -> Result<Vec<(String, Network)>> {
    let bytes = read_bounded(path)?;
    if bytes.is_empty() || bytes.len() % (4 * RAW_ROW) != 0 {
        let reason = format!("{} bytes are not a whole number of rows of {RAW_ROW} numbers (f32)", bytes.len());
        return Err(Error::invalid(path, "size", reason));
    }
    let listed = names_file(path);
    let text =
        String::from_utf8(read_bounded(&listed)?).map_err(|_| Error::invalid(&listed, "names", "are not UTF-8"))?;
    let names: Vec<String> = text.lines().map(|line| line.trim().to_owned()).collect();
    let rows = bytes.len() / (4 * RAW_ROW);
    if names.len() != rows {
        let reason = format!("there are {}, and {rows} rows in {}", names.len(), path.display());
        return Err(Error::invalid(&listed, "names", reason));
    }
    check_names(&listed, &names)?;
    let numbers = bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let numbers: Vec<f32> = numbers.collect();
    names
        .into_iter()
        .zip(numbers.chunks_exact(RAW_ROW))
        .map(|(name, row)| Ok((name.clone(), of_row(path, &name, row)?)))
        .collect()
}

/// Makes the network of a raw row.
fn of_row(path: &Path, name: &str, mut row: &[f32]) -> Result<Network> {
    let sizes = [(INPUTS, RAW_HIDDEN), (RAW_HIDDEN, RAW_HIDDEN), (RAW_HIDDEN, OUTPUTS)];
    let mut layers = Vec::with_capacity(LAYERS);
    for (inputs, outputs) in sizes {
        let (weight, rest) = row.split_at(inputs * outputs);
        let (bias, rest) = rest.split_at(outputs);
        let turned: Vec<f32> = (0..inputs * outputs).map(|k| weight[(k % inputs) * outputs + k / inputs]).collect();
        layers.push(Linear::new(name, inputs, outputs, &turned, bias.to_vec()).map_err(|error| error.in_file(path))?);
        row = rest;
    }
    network(path, name, layers)
}

fn network(path: &Path, name: &str, layers: Vec<Linear>) -> Result<Network> {
    let layers: [Linear; LAYERS] = layers.try_into().expect("a network has LAYERS layers");
    Network::new(name, layers).map_err(|error| error.in_file(path))
}

fn read_safetensors(path: &Path) -> Result<Vec<(String, Network)>> {
    let bytes = read_bounded(path)?;
    let reason = |error: String| {
        Error::invalid(path, "header", format!("not a file of materials written by headtail ({error})"))
    };
    let (metadata, tensors) = tensor_file::open(&bytes).map_err(reason)?;
    let field = "metadata 'headtail-materials'";
    let text = metadata.metadata().as_ref().and_then(|entries| entries.get("headtail-materials"));
    let text = text.ok_or_else(|| Error::invalid(path, field, "is missing: not a file of materials"))?;
    let invalid = |error: serde_json::Error| Error::invalid(path, field, error.to_string());
    let value: serde_json::Value = serde_json::from_str(text).map_err(invalid)?;
    let version = value.get("format_version").and_then(serde_json::Value::as_u64);
    if version != Some(u64::from(FORMAT_VERSION)) {
        let found = version.map_or("none".into(), |version| version.to_string());
        let reason = format!("is {found}; this program reads version {FORMAT_VERSION}");
        return Err(Error::invalid(path, "format_version", reason));
    }
    let description: Description = serde_json::from_value(value).map_err(invalid)?;
    if description.kind != KIND {
        return Err(Error::invalid(path, "kind", format!("is '{}'; '{KIND}' is expected", description.kind)));
    }
    check_names(path, &description.names)?;
    let expected = description.names.len() * LAYERS * 2;
    if tensors.len() != expected {
        let reason = format!("there are {}; {} materials have {expected}", tensors.len(), description.names.len());
        return Err(Error::invalid(path, "tensors", reason));
    }
    let layers_of = |name: &String| {
        let layers: Result<Vec<Linear>> = (0..LAYERS).map(|index| layer(path, &tensors, name, index)).collect();
        Ok((name.clone(), network(path, name, layers?)?))
    };
    description.names.iter().map(layers_of).collect()
}

/// Reads a layer of a material: `NAME.linearK.weight` `[out, in]` and `NAME.linearK.bias` `[out]`.
fn layer(path: &Path, tensors: &SafeTensors<'_>, material: &str, index: usize) -> Result<Linear> {
    let take = |part: &str, rank: usize| {
        let name = format!("{material}.linear{index}.{part}");
        let field = format!("tensor '{name}'");
        let view = tensors.tensor(&name).map_err(|_| Error::invalid(path, field.clone(), "is missing"))?;
        if view.dtype() != Dtype::F32 || view.shape().len() != rank {
            let reason = format!("is {:?} {:?}; f32 with {rank} axes is expected", view.dtype(), view.shape());
            return Err(Error::invalid(path, field, reason));
        }
        let numbers = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok((view.shape().to_vec(), numbers.collect::<Vec<f32>>()))
    };
    let ((shape, weight), (_, bias)) = (take("weight", 2)?, take("bias", 1)?);
    let name = format!("{material}.linear{index}");
    Linear::new(&name, shape[1], shape[0], &weight, bias).map_err(|error| error.in_file(path))
}

/// Writes named networks to one file, atomically. Equal networks give equal bytes.
///
/// # Errors
/// The file cannot be written, or [`read_networks`] would not accept the names.
pub fn write_networks(path: &Path, networks: &[(String, Network)]) -> Result<()> {
    let names: Vec<String> = networks.iter().map(|(name, _)| name.clone()).collect();
    check_names(path, &names)?;
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    let bytes = |numbers: &[f32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    for (name, network) in networks {
        for (index, layer) in network.layers().iter().enumerate() {
            let shape = vec![layer.outputs(), layer.inputs()];
            tensors.push((format!("{name}.linear{index}.weight"), shape, bytes(layer.weight())));
            tensors.push((format!("{name}.linear{index}.bias"), vec![layer.outputs()], bytes(layer.bias())));
        }
    }
    let failed = |reason: String| Error::invalid(path, "tensors", reason);
    let description = Description { format_version: FORMAT_VERSION, kind: KIND.into(), names };
    let text = serde_json::to_string(&description).map_err(|error| failed(error.to_string()))?;
    let mut views = Vec::with_capacity(tensors.len());
    for (name, shape, bytes) in &tensors {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|error| failed(error.to_string()))?;
        views.push((name.as_str(), view));
    }
    // A single entry: the order of several would vary between runs.
    let metadata = HashMap::from([("headtail-materials".to_owned(), text)]);
    file::replace(path, &serialize(views, Some(metadata)).map_err(|error| failed(error.to_string()))?)
}
