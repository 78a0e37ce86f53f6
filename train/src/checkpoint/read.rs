//! Reading checkpoints; nothing in them is trusted before its checksum.

use std::path::Path;

use safetensors::{Dtype, SafeTensors};

use super::{
    CHECKSUMS, FORMAT_VERSION, KeptManifest, MANIFEST, Manifest, STATE, SavedRun, config_hash, failed, refuse,
};
use crate::{
    Result,
    optimizer::OptimizerState,
    state::{Kept, TrainingState},
};

/// Largest file that is read: eight lists of more weights than a head can have, and their names.
const MAX_BYTES: u64 = 1 << 32;

/// Reads a checkpoint of a head of `weights` weights.
pub(super) fn read(path: &Path, weights: usize) -> Result<(Manifest, SavedRun)> {
    let load = |name: &str| {
        let file = path.join(name);
        headtail_render::file::read(&file, MAX_BYTES).map_err(|error| failed(&file, &error))
    };
    let checksums = load(CHECKSUMS)?;
    let [manifest, state] = [MANIFEST, STATE].map(|name| {
        let bytes = load(name)?;
        let line = format!("{}  {name}\n", blake3::hash(&bytes).to_hex());
        let known = checksums.split_inclusive(|&byte| byte == b'\n').any(|other| other == line.as_bytes());
        if known {
            Ok(bytes)
        } else {
            Err(refuse(&path.join(name), "does not have the checksum that was written with it"))
        }
    });
    let manifest: Manifest = serde_json::from_slice(&manifest?).map_err(|error| refuse(path, &error.to_string()))?;
    if manifest.format_version != FORMAT_VERSION {
        let reason = format!("format_version {} is not {FORMAT_VERSION}", manifest.format_version);
        return Err(refuse(&path.join(MANIFEST), &reason));
    }
    if manifest.config_hash != config_hash(&manifest.config) {
        return Err(refuse(&path.join(MANIFEST), "config_hash does not belong to config"));
    }
    let state = tensors(&path.join(STATE), &state?, &manifest, weights)?;
    let seconds = manifest.seconds;
    Ok((manifest, SavedRun { state, seconds }))
}

fn tensors(path: &Path, bytes: &[u8], manifest: &Manifest, weights: usize) -> Result<TrainingState> {
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| refuse(path, &error.to_string()))?;
    let list = |name: &str, length: usize| {
        let tensor = tensors.tensor(name).map_err(|error| refuse(path, &format!("{name}: {error}")))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != [length] {
            let reason = format!("{name}: {:?} {:?}, expected F32 [{length}]", tensor.dtype(), tensor.shape());
            return Err(refuse(path, &reason));
        }
        let numbers =
            tensor.data().chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        Ok(numbers.collect::<Vec<f32>>())
    };
    let averaged = if manifest.config.ema_decay > 0.0 { weights } else { 0 };
    let kept = |kept: &KeptManifest| -> Result<Kept> {
        Ok(Kept {
            divergence: kept.divergence,
            weights: list("kept_weights", weights)?,
            average: list("kept_average", averaged)?,
            optimizer: OptimizerState {
                moves: kept.moves,
                first_moments: list("kept_first_moments", weights)?,
                second_moments: list("kept_second_moments", weights)?,
            },
        })
    };
    Ok(TrainingState {
        step: manifest.step,
        skipped: manifest.skipped,
        loss: manifest.loss.unwrap_or(f32::NAN),
        weights: list("weights", weights)?,
        average: list("average", averaged)?,
        optimizer: OptimizerState {
            moves: manifest.moves,
            first_moments: list("first_moments", weights)?,
            second_moments: list("second_moments", weights)?,
        },
        rate_factor: manifest.rate_factor,
        kept: manifest.kept.as_ref().map(kept).transpose()?,
    })
}
