//! Measured materials by name: `FILE`, `FILE#NAME,NAME,...`.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use super::{NeuralBrdf, read_networks};
use crate::{
    error::{Error, Result},
    parallel::*,
    path_text::path_of,
};

/// Maximum number of names that an error lists.
const LISTED: usize = 8;

/// Splits the text after `nbrdf:` into file and names, which follow the last `#`.
///
/// # Errors
/// What is missing.
pub fn parse_measured(text: &str) -> std::result::Result<(PathBuf, Vec<String>), String> {
    let (file, names) = text.rsplit_once('#').map_or((text, None), |(file, names)| (file, Some(names)));
    if file.is_empty() {
        return Err("name a file, as in nbrdf:FILE#NAME".into());
    }
    let names: Vec<String> = names.into_iter().flat_map(|names| names.split(',')).map(str::to_owned).collect();
    if names.iter().any(String::is_empty) {
        return Err("'' is not the name of a material".into());
    }
    Ok((path_of(file), names))
}

/// Opens the materials of these names, in this order; without names, the only one of the file.
///
/// # Errors
/// When the file cannot be read, or does not hold the requested materials.
pub fn open_measured(file: &Path, names: &[String]) -> Result<Vec<Arc<NeuralBrdf>>> {
    let networks = read_networks(file)?;
    let known = || {
        let some = networks.iter().take(LISTED).map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
        some + if networks.len() > LISTED { ", ..." } else { "" }
    };
    let wanted = match names {
        [] if networks.len() == 1 => vec![&networks[0]],
        [] => {
            let reason = format!("there are {}; choose some, as in nbrdf:FILE#NAME ({})", networks.len(), known());
            return Err(Error::invalid(file, "materials", reason));
        }
        names => {
            let found = |name: &String| {
                networks.iter().find(|(known, _)| known == name).ok_or_else(|| {
                    Error::invalid(file, format!("material '{name}'"), format!("is not there; there are {}", known()))
                })
            };
            names.iter().map(found).collect::<Result<_>>()?
        }
    };
    let open = |(name, network): &(String, _)| -> Result<Arc<NeuralBrdf>> {
        Ok(Arc::new(NeuralBrdf::new(name, Clone::clone(network)).map_err(|error| error.in_file(file))?))
    };
    wanted.into_par_iter().map(open).collect()
}
