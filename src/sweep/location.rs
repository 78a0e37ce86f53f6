//! The sweep of a command, and the frequency of its checkpoints.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use super::{Sweep, folder::SweepFolder};

/// A space and its folder.
#[derive(Args, Clone, Debug)]
pub struct SweepLocation {
    /// File that describes the space.
    #[arg(value_name = "SPACE.toml")]
    pub space: PathBuf,
    /// Folder of the sweep. Default: space.sweep beside space.toml.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl SweepLocation {
    /// Returns the folder.
    pub fn folder(&self) -> SweepFolder {
        SweepFolder::new(self.out.clone().unwrap_or_else(|| self.space.with_extension("sweep")))
    }

    /// Opens the sweep.
    ///
    /// # Errors
    /// As [`Sweep::open`].
    pub fn open(&self) -> Result<Sweep> {
        Sweep::open(&self.space, self.folder())
    }
}

/// Frequency of checkpoints.
#[derive(Args, Clone, Copy, Debug)]
pub struct Checkpoints {
    /// Steps between checkpoints: the most that a kill can lose.
    #[arg(long, value_name = "STEPS", default_value_t = 250, value_parser = clap::value_parser!(u32).range(1..))]
    pub checkpoint_every: u32,
}
