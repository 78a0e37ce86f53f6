//! Reading an exported sampler. All content is validated.

use std::{path::Path, sync::Arc};

use glam::Vec2;
use safetensors::{SafeTensors, tensor::Dtype};

use super::{Description, ExportedSampler, FORMAT_VERSION, Intermediate, IntermediateDescription};
use crate::{
    bake::{BakedTable, CellGrid, NormalGrid},
    error::{Error, Result},
    file,
    head::{Head, Linear},
    tail::{Tail, TailKind, WarpMap},
    tensor_file,
};

/// Larger files are rejected before they are read.
const LARGEST_FILE: u64 = 1 << 30;
/// Maximum number of layers of a network.
const MOST_LAYERS: usize = 16;

impl ExportedSampler {
    /// Reads an exported file.
    ///
    /// # Errors
    /// An error that names the file and the field if the file is not of this format, is damaged, or
    /// holds an unknown field, tensor or version.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = file::read(path, LARGEST_FILE).map_err(|error| Error::io(path, error))?;
        let reason =
            |error: String| Error::invalid(path, "header", format!("not a sampler written by headtail ({error})"));
        let (metadata, tensors) = tensor_file::open(&bytes).map_err(reason)?;
        let text = metadata.metadata().as_ref().and_then(|entries| entries.get("headtail")).ok_or_else(|| {
            Error::invalid(path, "metadata 'headtail'", "is missing: not a sampler written by headtail")
        })?;
        let description = describe(path, text)?;
        let sampler = Tensors { path, tensors, used: Vec::new() }.assemble(description)?;
        sampler.intermediate.check().map_err(|reason| Error::invalid(path, "weights", reason))?;
        Ok(sampler)
    }
}

/// Parses the description, the version first, since other versions may have other fields.
fn describe(path: &Path, text: &str) -> Result<Description> {
    let invalid = |error: serde_json::Error| Error::invalid(path, "metadata 'headtail'", error.to_string());
    let value: serde_json::Value = serde_json::from_str(text).map_err(invalid)?;
    let version = value.get("format_version").and_then(serde_json::Value::as_u64);
    if !version.is_some_and(|version| (1..=u64::from(FORMAT_VERSION)).contains(&version)) {
        let found = version.map_or("none".into(), |version| version.to_string());
        let reason = format!("is {found}; this program reads versions 1 to {FORMAT_VERSION}");
        return Err(Error::invalid(path, "format_version", reason));
    }
    if value.get("compact_emitters") == Some(&serde_json::Value::Bool(true)) {
        let reason = "is true: the file was made by `fit --compact-emitters`, which this version does not read; run `headtail fit` again \
                      without the flag, or render with --sampler patches";
        return Err(Error::invalid(path, "compact_emitters", reason));
    }
    serde_json::from_value(value).map_err(invalid)
}

/// The tensors of a file, and the names of those read so far.
struct Tensors<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    used: Vec<String>,
}

impl Tensors<'_> {
    fn assemble(mut self, description: Description) -> Result<ExportedSampler> {
        let (shape, luminance) = self.take("tail.luminance", 2)?;
        let (height, width) = (shape[0], shape[1]);
        let tail = match description.tail {
            TailKind::Flow => {
                let (shape, values) = self.take("tail.map", 3)?;
                let nodes: Vec<Vec2> = values.chunks_exact(2).map(Vec2::from_slice).collect();
                if shape[2] != 2 || shape[0] != shape[1] + 1 {
                    let reason = format!("is {shape:?}; [cells + 1, cells, 2] is expected");
                    return Err(Error::invalid(self.path, "tensor 'tail.map'", reason));
                }
                WarpMap::new(shape[1], &nodes).and_then(|map| Tail::flow(map, width, height, &luminance))
            }
            kind => Tail::new(kind, width, height, &luminance),
        };
        let tail = tail.map_err(|error| error.in_file(self.path))?;
        let is_head = matches!(description.intermediate, IntermediateDescription::Head { .. });
        if description.patches.is_some() && !(is_head && description.tail == TailKind::Hierarchical) {
            let reason = "are only between a head and the hierarchical tail";
            return Err(Error::invalid(self.path, "patches", reason));
        }
        let intermediate = match description.intermediate {
            IntermediateDescription::Head {
                mode,
                leaky_slope,
                encoder_layers,
                network_layers,
                mixture_weight_layers,
            } => {
                let encoder = self.layers("encoder", encoder_layers)?;
                let networks = [self.layers("layer0", network_layers)?, self.layers("layer1", network_layers)?];
                let mixture_weight = self.layers("selection", mixture_weight_layers)?;
                let head = Head::new(description.condition, mode, leaky_slope, encoder, networks)
                    .and_then(|head| head.with_mixture_weight(mixture_weight));
                Intermediate::Head(head.map_err(|error| error.in_file(self.path))?)
            }
            IntermediateDescription::Bake => Intermediate::Bake(self.table()?),
            IntermediateDescription::DirectBake => Intermediate::DirectBake(self.table()?),
        };
        if let Some(name) = self.tensors.names().into_iter().find(|name| !self.used.iter().any(|used| used == name)) {
            return Err(Error::invalid(self.path, format!("tensor '{name}'"), "is not known to this reader"));
        }
        Ok(ExportedSampler {
            intermediate,
            tail: Arc::new(tail),
            patches: description.patches,
            luminance: (width, height, luminance),
            environment: description.environment,
            environment_hash: description.environment_hash,
            training: description.training,
            run: description.run,
        })
    }

    fn layers(&mut self, part: &str, count: usize) -> Result<Vec<Linear>> {
        if count > MOST_LAYERS {
            return Err(Error::invalid(self.path, part, format!("has {count} layers; at most {MOST_LAYERS} are read")));
        }
        (0..count)
            .map(|index| {
                let name = format!("{part}.linear{index}");
                let (shape, weight) = self.take(&format!("{name}.weight"), 2)?;
                let (_, bias) = self.take(&format!("{name}.bias"), 1)?;
                Linear::new(&name, shape[1], shape[0], &weight, bias).map_err(|error| error.in_file(self.path))
            })
            .collect()
    }

    fn table(&mut self) -> Result<BakedTable> {
        let (shape, masses) = self.take("table.masses", 4)?;
        let table = NormalGrid::new(shape[0], shape[1])
            .and_then(|normals| Ok((normals, CellGrid::new(shape[2], shape[3])?)))
            .and_then(|(normals, cells)| {
                BakedTable::require_memory(normals, cells)?;
                BakedTable::new(normals, cells, masses)
            });
        table.map_err(|error| error.in_file(self.path))
    }

    /// Reads the shape and the values of an f32 tensor with `rank` axes.
    fn take(&mut self, name: &str, rank: usize) -> Result<(Vec<usize>, Vec<f32>)> {
        let field = || format!("tensor '{name}'");
        let view = self.tensors.tensor(name).map_err(|_| Error::invalid(self.path, field(), "is missing"))?;
        if view.dtype() != Dtype::F32 || view.shape().len() != rank {
            let reason = format!("is {:?} {:?}; f32 with {rank} axes is expected", view.dtype(), view.shape());
            return Err(Error::invalid(self.path, field(), reason));
        }
        self.used.push(name.to_owned());
        // The library has checked that the bytes match the shape.
        let values =
            view.data().chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        Ok((view.shape().to_vec(), values.collect()))
    }
}
