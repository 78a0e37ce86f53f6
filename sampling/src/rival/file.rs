//! The file of samplers trained for materials: safetensors of f32 layers. All content is validated.

use std::{collections::HashMap, path::Path};

use safetensors::{
    SafeTensors,
    tensor::{Dtype, TensorView, serialize},
};
use serde::{Deserialize, Serialize};

use super::{Rival, RivalKind};
use crate::{
    error::{Error, Result},
    file,
    head::Linear,
    tensor_file,
};

/// Version of the format that is written and read.
pub const FORMAT_VERSION: u32 = 1;

/// Larger files are rejected before they are read: a flow has 40 kB, and a file at most [`MOST_MATERIALS`] of
/// them.
const LARGEST_FILE: u64 = 1 << 25;
/// Largest number of materials of a file.
const MOST_MATERIALS: usize = 256;

/// The metadata of a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    format_version: u32,
    kind: RivalKind,
    materials: Vec<Material>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
}

/// A material that a sampler was trained for.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Material {
    name: String,
    /// [`crate::brdf::Brdf::identity`], in hexadecimal.
    identity: String,
}

/// Samplers of one kind, each with its material's name and identity.
#[derive(Clone, Debug)]
pub struct RivalFile {
    /// Kind of all samplers.
    pub kind: RivalKind,
    /// Name and identity of the material, and its sampler.
    pub rivals: Vec<(String, blake3::Hash, Rival)>,
    /// Wall-clock seconds of their training, if known.
    pub seconds: Option<f64>,
}

impl RivalFile {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, is not of this format, is damaged, or has an unknown field, tensor or
    /// version. The error names the file and the field.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = file::read(path, LARGEST_FILE).map_err(|error| Error::io(path, error))?;
        Self::from_bytes(path, &bytes)
    }

    /// Parses bytes as [`Self::read`] does; `path` is for errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self> {
        let none =
            |reason: String| Error::invalid(path, "header", format!("not a file of samplers of materials ({reason})"));
        let (metadata, tensors) = tensor_file::open(bytes).map_err(none)?;
        let field = "metadata 'headtail-rival'";
        let text = metadata.metadata().as_ref().and_then(|entries| entries.get("headtail-rival"));
        let text = text.ok_or_else(|| none(format!("{field} is missing")))?;
        let described: Description =
            serde_json::from_str(text).map_err(|error| Error::invalid(path, field, error.to_string()))?;
        let Description { format_version, kind, materials, seconds } = described;
        if format_version != FORMAT_VERSION {
            let reason = format!("is {format_version}; this program reads version {FORMAT_VERSION}");
            return Err(Error::invalid(path, "format_version", reason));
        }
        if materials.is_empty() || materials.len() > MOST_MATERIALS {
            let reason = format!("there are {}; 1 to {MOST_MATERIALS} are expected", materials.len());
            return Err(Error::invalid(path, "materials", reason));
        }
        let known: usize = kind.networks().iter().map(|(_, sizes)| 2 * (sizes.len() - 1)).sum();
        if tensors.len() != known * materials.len() {
            let reason = format!("there are {} instead of {}", tensors.len(), known * materials.len());
            return Err(Error::invalid(path, "tensors", reason));
        }
        let mut rivals = Vec::with_capacity(materials.len());
        for (index, Material { name, identity }) in materials.into_iter().enumerate() {
            let identity = blake3::Hash::from_hex(identity.as_bytes())
                .map_err(|_| Error::invalid(path, "identity", "is not a hexadecimal hash of a material"))?;
            let layers_of = |(part, sizes): &(&str, &[usize])| -> Result<Vec<Linear>> {
                (0..sizes.len() - 1)
                    .map(|layer| read_layer(path, &tensors, &format!("{index}.{part}.linear{layer}")))
                    .collect()
            };
            if rivals.iter().any(|(_, known, _)| *known == identity) {
                return Err(Error::invalid(path, "materials", "the same material is there twice"));
            }
            let networks = kind.networks().iter().map(layers_of).collect::<Result<_>>()?;
            let rival = Rival::new(kind, networks).map_err(|error| error.in_file(path))?;
            rivals.push((name, identity, rival));
        }
        Ok(Self { kind, rivals, seconds: seconds.filter(|seconds| seconds.is_finite()) })
    }

    /// Writes to a temporary file beside `path` and renames it. Equal samplers give equal bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let failed = |reason: String| Error::invalid(path, "tensors", reason);
        let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
        let little = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        for (index, (_, _, rival)) in self.rivals.iter().enumerate() {
            for ((part, _), layers) in self.kind.networks().iter().zip(rival.networks()) {
                for (k, layer) in layers.iter().enumerate() {
                    let name = format!("{index}.{part}.linear{k}");
                    let shape = vec![layer.outputs(), layer.inputs()];
                    tensors.push((format!("{name}.weight"), shape, little(layer.weight())));
                    tensors.push((format!("{name}.bias"), vec![layer.outputs()], little(layer.bias())));
                }
            }
        }
        let material = |(name, identity, _): &(String, blake3::Hash, Rival)| Material {
            name: name.clone(),
            identity: identity.to_hex().to_string(),
        };
        let materials = self.rivals.iter().map(material).collect();
        let description =
            Description { format_version: FORMAT_VERSION, kind: self.kind, materials, seconds: self.seconds };
        let text = serde_json::to_string(&description).map_err(|error| failed(error.to_string()))?;
        let mut views = Vec::with_capacity(tensors.len());
        for (name, shape, bytes) in &tensors {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|error| failed(error.to_string()))?;
            views.push((name.as_str(), view));
        }
        // A single entry, because the order of several would change between runs.
        let metadata = HashMap::from([("headtail-rival".to_owned(), text)]);
        file::replace(path, &serialize(views, Some(metadata)).map_err(|error| failed(error.to_string()))?)
    }
}

/// Reads the layer `NAME.weight` `[out, in]`, `NAME.bias` `[out]`.
fn read_layer(path: &Path, tensors: &SafeTensors<'_>, name: &str) -> Result<Linear> {
    let take = |part: &str, rank: usize| {
        let field = format!("tensor '{name}.{part}'");
        let view =
            tensors.tensor(&format!("{name}.{part}")).map_err(|_| Error::invalid(path, field.clone(), "is missing"))?;
        if view.dtype() != Dtype::F32 || view.shape().len() != rank {
            let reason = format!("is {:?} {:?}; f32 with {rank} axes is expected", view.dtype(), view.shape());
            return Err(Error::invalid(path, field, reason));
        }
        let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok((view.shape().to_vec(), values.collect::<Vec<f32>>()))
    };
    let ((shape, weight), (_, bias)) = (take("weight", 2)?, take("bias", 1)?);
    Linear::new(name, shape[1], shape[0], &weight, bias).map_err(|error| error.in_file(path))
}

/// Converts the networks to an array.
pub(super) fn of_count<const N: usize>(networks: Vec<Vec<Linear>>) -> Result<[Vec<Linear>; N]> {
    let found = networks.len();
    networks.try_into().map_err(|_| Error::argument("networks", format!("are {found} instead of {N}")))
}

/// Checks the sizes of a network's layers, from input to output.
pub(super) fn check_sizes(name: &str, sizes: &[usize], layers: &[Linear]) -> Result<()> {
    if layers.len() + 1 != sizes.len() {
        let reason = format!("has {} layers instead of {}", layers.len(), sizes.len() - 1);
        return Err(Error::argument(name, reason));
    }
    for (index, (layer, size)) in layers.iter().zip(sizes.windows(2)).enumerate() {
        if [layer.inputs(), layer.outputs()] != size {
            let reason = format!("is {} x {} instead of {} x {}", layer.outputs(), layer.inputs(), size[1], size[0]);
            return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
        }
    }
    Ok(())
}
