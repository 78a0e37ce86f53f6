//! Writing checkpoints so that a kill at any moment leaves whole ones.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
};

use safetensors::{Dtype, serialize, tensor::TensorView};

use super::{CHECKSUMS, FORMAT_VERSION, KeptManifest, MANIFEST, Manifest, STATE, SavedRun, config_hash, failed};
use crate::{FitConfig, Result};

/// What a folder is called while it is written or removed.
const UNFINISHED: &str = ".unfinished-";

/// Writes the checkpoint `path`, in place of one of the same name.
pub(super) fn write(path: &Path, config: &FitConfig, target: &str, run: &SavedRun) -> Result<()> {
    let state = &run.state;
    let manifest = Manifest {
        format_version: FORMAT_VERSION,
        program_version: env!("CARGO_PKG_VERSION").into(),
        step: state.step,
        skipped: state.skipped,
        loss: state.loss.is_finite().then_some(state.loss),
        moves: state.optimizer.moves,
        rate_factor: state.rate_factor,
        kept: state.kept.as_ref().map(|kept| KeptManifest { divergence: kept.divergence, moves: kept.optimizer.moves }),
        seconds: run.seconds,
        config_hash: config_hash(config),
        config: config.clone(),
        target: target.to_owned(),
    };
    let manifest = serde_json::to_vec_pretty(&manifest).expect("a manifest can be written as JSON");
    let mut lists = vec![
        ("weights", &state.weights),
        ("average", &state.average),
        ("first_moments", &state.optimizer.first_moments),
        ("second_moments", &state.optimizer.second_moments),
    ];
    if let Some(kept) = &state.kept {
        lists.push(("kept_weights", &kept.weights));
        lists.push(("kept_average", &kept.average));
        lists.push(("kept_first_moments", &kept.optimizer.first_moments));
        lists.push(("kept_second_moments", &kept.optimizer.second_moments));
    }
    let bytes: Vec<Vec<u8>> =
        lists.iter().map(|(_, list)| list.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
    let tensor = |((name, list), bytes): ((&'static str, &Vec<f32>), _)| {
        (name, TensorView::new(Dtype::F32, vec![list.len()], bytes).expect("four bytes a number"))
    };
    let tensors = lists.into_iter().zip(bytes.iter().map(Vec::as_slice)).map(tensor);
    let tensors = serialize(tensors, None).expect("lists of numbers make a safetensors file");
    let sum = |name: &str, bytes: &[u8]| format!("{}  {name}\n", blake3::hash(bytes).to_hex());
    let checksums = sum(MANIFEST, &manifest) + &sum(STATE, &tensors);

    let unfinished = aside(path, UNFINISHED);
    remove_if_there(&unfinished)?;
    fs::create_dir_all(&unfinished).map_err(|error| failed(&unfinished, &error))?;
    for (name, bytes) in [(MANIFEST, &manifest[..]), (STATE, &tensors), (CHECKSUMS, checksums.as_bytes())] {
        let file = unfinished.join(name);
        let write = || {
            let mut file = File::create(&file)?;
            file.write_all(bytes)?;
            file.sync_all()
        };
        write().map_err(|error| failed(&file, &error))?;
    }
    sync_folder(&unfinished)?;
    if path.exists() {
        remove(path)?;
    }
    fs::rename(&unfinished, path).map_err(|error| failed(path, &error))?;
    sync_folder(path.parent().unwrap_or(Path::new(".")))
}

/// Removes a checkpoint; a kill in between leaves none under its name.
pub(super) fn remove(path: &Path) -> Result<()> {
    let removed = aside(path, &format!("{UNFINISHED}removed-"));
    remove_if_there(&removed)?;
    fs::rename(path, &removed).map_err(|error| failed(path, &error))?;
    fs::remove_dir_all(&removed).map_err(|error| failed(&removed, &error))
}

/// Removes what kills have left half done.
pub(super) fn remove_unfinished(folder: &Path) -> Result<()> {
    let entries = fs::read_dir(folder).map_err(|error| failed(folder, &error))?;
    for entry in entries.filter_map(std::result::Result::ok) {
        if entry.file_name().to_string_lossy().starts_with(UNFINISHED) {
            remove_if_there(&entry.path())?;
        }
    }
    Ok(())
}

/// Renames a checkpoint that is damaged, so that it is neither used nor counted.
pub(super) fn set_aside(path: &Path) -> Result<()> {
    let refused = aside(path, "refused-");
    remove_if_there(&refused)?;
    fs::rename(path, &refused).map_err(|error| failed(path, &error))
}

fn remove_if_there(path: &Path) -> Result<()> {
    if path.exists() { fs::remove_dir_all(path).map_err(|error| failed(path, &error)) } else { Ok(()) }
}

/// The neighbour of `path` whose name has the prefix.
fn aside(path: &Path, prefix: &str) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{prefix}{name}"))
}

/// Flushes names to the disk: a rename that is not flushed can come before the files that it names.
fn sync_folder(folder: &Path) -> Result<()> {
    let sync = || File::open(folder)?.sync_all();
    sync().map_err(|error| failed(folder, &error))
}
