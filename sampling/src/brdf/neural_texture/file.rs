//! The file of a neural material: safetensors with half-precision texels and f32 networks. All content
//! is validated.

use std::{collections::HashMap, path::Path};

use safetensors::{
    SafeTensors,
    tensor::{Dtype, TensorView, serialize},
};
use serde::{Deserialize, Serialize};

use super::{FEATURES, Networks, NeuralTexture, Pyramid};
use crate::{
    error::{Error, Result},
    file, float16,
    linear::Linear,
    tensor_file,
};

/// The version of the format.
pub const FORMAT_VERSION: u32 = 1;

/// Larger files are rejected before they are read; a side of 1024 takes 22 MB.
const LARGEST_FILE: u64 = 1 << 25;
/// Names and numbers of layers of the three networks in a file.
const LAYERS: [(&str, usize); 3] = [("shift", 3), ("reflectance", 4), ("mixture", 3)];

/// The metadata of a material's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// `neural-texture`.
    pub kind: String,
    /// Name of the fitted material.
    pub name: String,
    /// Slope of the networks' leaky ReLU.
    pub leaky_slope: f32,
    /// Training steps.
    pub steps: u64,
    /// Peak signal-to-noise ratio in dB over held-out directions and positions; `None` if not measured.
    pub psnr: Option<f64>,
    /// Wall-clock seconds of the training, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

impl Description {
    /// Makes the description of a material called `name`.
    pub fn new(name: &str, leaky_slope: f32) -> Self {
        let kind = "neural-texture".to_owned();
        let (name, format_version) = (name.to_owned(), FORMAT_VERSION);
        Self { format_version, kind, name, leaky_slope, steps: 0, psnr: None, seconds: None }
    }
}

impl NeuralTexture {
    /// Reads a file.
    ///
    /// # Errors
    /// An error that names the file and the field if the file is not of this format, is damaged, or
    /// holds an unknown field, tensor or version.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = file::read(path, LARGEST_FILE).map_err(|error| Error::io(path, error))?;
        Self::from_bytes(path, &bytes)
    }

    /// [`Self::read`] from bytes; `path` is for errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self> {
        let no_material = |reason: String| Error::invalid(path, "header", format!("not a neural material ({reason})"));
        let (metadata, tensors) = tensor_file::open(bytes).map_err(no_material)?;
        let text = metadata.metadata().as_ref().and_then(|entries| entries.get("headtail"));
        let text = text.ok_or_else(|| no_material("metadata 'headtail' is missing".into()))?;
        let description: Description = serde_json::from_str(text)
            .map_err(|error| Error::invalid(path, "metadata 'headtail'", error.to_string()))?;
        if description.format_version != FORMAT_VERSION || description.kind != "neural-texture" {
            let (version, kind) = (description.format_version, &description.kind);
            let reason = format!("is {kind} {version}; this program reads neural-texture {FORMAT_VERSION}");
            return Err(Error::invalid(path, "format_version", reason));
        }
        let known = 1 + 2 * LAYERS.iter().map(|(_, layers)| layers).sum::<usize>();
        if tensors.len() != known {
            return Err(Error::invalid(path, "tensors", format!("there are {} instead of {known}", tensors.len())));
        }
        let pyramid = texels(path, &tensors)?;
        let [shift, reflectance, mixture] = LAYERS.map(|(part, count)| layers(path, &tensors, part, count));
        let networks = Networks {
            shift: shift?,
            reflectance: reflectance?,
            mixture: mixture?,
            leaky_slope: description.leaky_slope,
        };
        Self::new(pyramid, networks, description).map_err(|error| error.in_file(path))
    }

    /// Writes the file atomically; texels are rounded to half precision. Equal materials give equal bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let bytes = self.to_bytes().map_err(|reason| Error::invalid(path, "tensors", reason))?;
        file::replace(path, &bytes)
    }

    /// The same material with texels rounded to half precision, as in a file.
    ///
    /// # Errors
    /// A texel exceeds the range of half precision.
    pub fn rounded(&self) -> Result<Self> {
        let round = |texel: &[f32; FEATURES]| texel.map(|value| float16::decode(float16::encode(value)));
        let pyramid = Pyramid::new(self.pyramid.side(), self.pyramid.texels().iter().map(round).collect())?;
        let mut rounded = Self { pyramid, ..self.clone() };
        rounded.hash = rounded.content_hash();
        Ok(rounded)
    }

    fn to_bytes(&self) -> std::result::Result<Vec<u8>, String> {
        let texels = self.pyramid.texels().as_flattened().iter();
        let texels: Vec<u8> = texels.flat_map(|&value| float16::encode(value).to_le_bytes()).collect();
        let mut tensors = vec![("texels".to_owned(), Dtype::F16, vec![self.pyramid.texels().len(), FEATURES], texels)];
        let little = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        for (part, network) in [("shift", &self.shift), ("reflectance", &self.reflectance), ("mixture", &self.mixture)]
        {
            for (index, layer) in network.layers().iter().enumerate() {
                let name = format!("{part}.linear{index}");
                let shape = vec![layer.outputs(), layer.inputs()];
                tensors.push((format!("{name}.weight"), Dtype::F32, shape, little(layer.weight())));
                tensors.push((format!("{name}.bias"), Dtype::F32, vec![layer.outputs()], little(layer.bias())));
            }
        }
        let description = serde_json::to_string(&self.description).map_err(|error| error.to_string())?;
        // A single entry: the order of several would vary between runs.
        let metadata = HashMap::from([("headtail".to_owned(), description)]);
        let mut views = Vec::with_capacity(tensors.len());
        for (name, dtype, shape, bytes) in &tensors {
            let view = TensorView::new(*dtype, shape.clone(), bytes).map_err(|error| error.to_string())?;
            views.push((name.as_str(), view));
        }
        serialize(views, Some(metadata)).map_err(|error| error.to_string())
    }

    /// BLAKE3 hash of everything that reflectance depends on.
    pub(super) fn content_hash(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        let mut add = |values: &[f32]| {
            values.iter().for_each(|value| {
                hasher.update(&value.to_le_bytes());
            });
        };
        add(self.pyramid.texels().as_flattened());
        for network in [&self.shift, &self.reflectance, &self.mixture] {
            add(&[network.leaky_slope()]);
            network.layers().iter().for_each(|layer| {
                add(layer.weight());
                add(layer.bias());
            });
        }
        hasher.finalize()
    }
}

/// Reads the textures of a file.
fn texels(path: &Path, tensors: &SafeTensors<'_>) -> Result<Pyramid> {
    let invalid = |reason: String| Error::invalid(path, "tensor 'texels'", reason);
    let view = tensors.tensor("texels").map_err(|_| invalid("is missing".into()))?;
    let &[count, FEATURES] = view.shape() else {
        return Err(invalid(format!("is {:?}; [texels, {FEATURES}] is expected", view.shape())));
    };
    let side = (0..=10).map(|level| 1 << level).find(|&side| Pyramid::texel_count(side) == count);
    let Some(side) = side.filter(|_| view.dtype() == Dtype::F16) else {
        return Err(invalid(format!("is {:?} of {count} texels; f16 of a whole pyramid is expected", view.dtype())));
    };
    // The library has checked that the bytes match the shape.
    let values = view.data().chunks_exact(2).map(|bytes| float16::decode(u16::from_le_bytes([bytes[0], bytes[1]])));
    let values: Vec<f32> = values.collect();
    Pyramid::new(side, values.as_chunks().0.to_vec()).map_err(|error| error.in_file(path))
}

/// Reads the layers of a network of a file.
fn layers(path: &Path, tensors: &SafeTensors<'_>, part: &str, count: usize) -> Result<Vec<Linear>> {
    let take = |name: String, rank: usize| {
        let invalid = |reason: String| Error::invalid(path, format!("tensor '{name}'"), reason);
        let view = tensors.tensor(&name).map_err(|_| invalid("is missing".into()))?;
        if view.dtype() != Dtype::F32 || view.shape().len() != rank {
            let reason = format!("is {:?} {:?}; f32 with {rank} axes is expected", view.dtype(), view.shape());
            return Err(invalid(reason));
        }
        let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok((view.shape().to_vec(), values.collect::<Vec<f32>>()))
    };
    let layer = |index: usize| {
        let name = format!("{part}.linear{index}");
        let (shape, weight) = take(format!("{name}.weight"), 2)?;
        let (_, bias) = take(format!("{name}.bias"), 1)?;
        Linear::new(&name, shape[1], shape[0], &weight, bias).map_err(|error| error.in_file(path))
    };
    (0..count).map(layer).collect()
}
