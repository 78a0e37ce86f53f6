//! The file of a scene's visibility.

use std::{collections::HashMap, path::Path};

use glam::Vec3A;
use safetensors::tensor::{Dtype, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::{
    cells::{CellKey, Cells},
    counts::Counts,
    division::PATCHES,
    precomputed::SceneVisibility,
};
use crate::{
    error::{Error, Result},
    file, tensor_file,
};

/// Version of the format, and of the division of the sky into the patches of its counts.
const FORMAT_VERSION: u32 = 1;
/// Larger files are rejected before they are read.
const LARGEST_FILE: u64 = 1 << 30;
/// The entry of the metadata.
const ENTRY: &str = "headtail.visibility";

/// The metadata of a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    format_version: u32,
    program_version: String,
    scene_hash: String,
    environment: String,
    environment_hash: String,
    /// Position of the camera, in metres.
    eye: [f32; 3],
    /// Side of a cell over its distance from the camera.
    angle: f32,
    /// Wall-clock seconds of learning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
}

impl SceneVisibility {
    /// Writes to a temporary file beside `path` and renames it. The same visibility gives the same bytes.
    ///
    /// Counts of a patch above 65535 are halved, unblocked and all, until they fit.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut cells: Vec<usize> = (0..self.cells()).collect();
        cells.sort_unstable_by_key(|&cell| self.counts.key(cell));
        let keys: Vec<u8> = cells.iter().flat_map(|&cell| self.counts.key(cell).0.to_le_bytes()).collect();
        let rays: Vec<u8> = cells.iter().flat_map(|&cell| self.counts.rays(cell)).flat_map(halved).collect();
        let (eye, angle) = self.cells.parts();
        let description = Description {
            format_version: FORMAT_VERSION,
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            scene_hash: self.scene_hash.clone(),
            environment: self.environment.clone(),
            environment_hash: self.environment_hash.clone(),
            eye: eye.to_array(),
            angle,
            seconds: self.seconds,
        };
        let invalid = |reason: String| Error::invalid(path, "tensors", reason);
        let text = serde_json::to_string(&description).map_err(|error| invalid(error.to_string()))?;
        let view = |dtype, shape: &[usize], bytes| {
            TensorView::new(dtype, shape.to_vec(), bytes).map_err(|error| invalid(error.to_string()))
        };
        let tensors = [
            ("keys", view(Dtype::U64, &[cells.len()], &keys)?),
            ("rays", view(Dtype::U16, &[cells.len(), PATCHES, 2], &rays)?),
        ];
        let metadata = HashMap::from([(ENTRY.to_owned(), text)]);
        let bytes = serialize(tensors, Some(metadata)).map_err(|error| invalid(error.to_string()))?;
        file::replace(path, &bytes)
    }

    /// Reads a safetensors file with `keys` `[cells]` (u64, the bits of cells, ascending), `rays`
    /// `[cells, 512, 2]` (u16: for each patch the unblocked shadow rays, and all), and one entry of metadata.
    ///
    /// # Errors
    /// The file cannot be read, is not of this format or is damaged. The error names the file and the field.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = file::read(path, LARGEST_FILE).map_err(|error| Error::io(path, error))?;
        let invalid = |field: &str, reason: String| Error::invalid(path, field, reason);
        let foreign = |reason: String| invalid("header", format!("not visibility written by headtail ({reason})"));
        let (metadata, tensors) = tensor_file::open(&bytes).map_err(foreign)?;
        let text = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
        let text = text.ok_or_else(|| foreign(format!("metadata '{ENTRY}' is missing")))?;
        let description: Description = serde_json::from_str(text).map_err(|error| invalid(ENTRY, error.to_string()))?;
        if description.format_version != FORMAT_VERSION {
            let reason = format!("is {}; this program reads version {FORMAT_VERSION}", description.format_version);
            return Err(invalid("format_version", reason));
        }
        let (eye, angle) = (Vec3A::from(description.eye), description.angle);
        if !(eye.is_finite() && angle > 0.0 && angle.is_finite()) {
            return Err(invalid("eye and angle", "are not a position and a positive angle".to_owned()));
        }
        let take = |name: &str, dtype, rest: &[usize]| {
            let view = tensors.tensor(name).map_err(|error| invalid(&format!("tensor '{name}'"), error.to_string()))?;
            if view.dtype() != dtype || view.shape().get(1..) != Some(rest) {
                let reason = format!("is {:?} {:?}, not {dtype:?} [cells, ...]", view.dtype(), view.shape());
                return Err(invalid(&format!("tensor '{name}'"), reason));
            }
            Ok((view.shape()[0], view.data()))
        };
        let (cells, keys) = take("keys", Dtype::U64, &[])?;
        let (rays_length, rays) = take("rays", Dtype::U16, &[PATCHES, 2])?;
        if rays_length != cells {
            return Err(invalid("tensor 'rays'", format!("is of {rays_length} cells, and there are {cells} keys")));
        }
        let key_of = |bytes: &[u8]| CellKey(bytes.iter().rev().fold(0, |key, &byte| key << 8 | u64::from(byte)));
        let keys: Vec<CellKey> = keys.chunks_exact(8).map(key_of).collect();
        if !keys.is_sorted_by(|a, b| a < b) || keys.last().is_some_and(|key| !key.is_valid()) {
            return Err(invalid("tensor 'keys'", "are not ascending keys of cells".to_owned()));
        }
        let mut counts = Counts::default();
        // Largest cells first, because they contain others.
        for (&key, rays) in keys.iter().zip(rays.chunks_exact(PATCHES * 4)).rev() {
            let rays = rays.chunks_exact(4).map(|rays| [[rays[0], rays[1]], [rays[2], rays[3]]]);
            let rays = rays.map(|rays| rays.map(|count| u32::from(u16::from_le_bytes(count))));
            if rays.clone().any(|[seen, all]| seen > all) {
                return Err(invalid("tensor 'rays'", "more rays came through than were sent".to_owned()));
            }
            counts.restore(key, rays);
        }
        Ok(Self {
            scene_hash: description.scene_hash,
            environment: description.environment,
            environment_hash: description.environment_hash,
            seconds: description.seconds.filter(|seconds| seconds.is_finite()),
            cells: Cells::new(eye, angle),
            counts,
        })
    }
}

/// Converts the counts of a patch to bytes, halved until they fit.
fn halved([mut seen, mut all]: [u32; 2]) -> [u8; 4] {
    while all > u32::from(u16::MAX) {
        (seen, all) = (seen / 2, all / 2);
    }
    let [[a, b], [c, d]] = [seen as u16, all as u16].map(u16::to_le_bytes);
    [a, b, c, d]
}
