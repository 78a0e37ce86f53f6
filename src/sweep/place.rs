//! Which sweep a command is about, and how often its workers save.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use super::{Sweep, folder::SweepFolder};

/// A space and its folder.
#[derive(Args, Clone, Debug)]
pub struct Place {
    /// The file that describes the space.
    #[arg(value_name = "SPACE.toml")]
    pub space: PathBuf,
    /// The folder of the sweep. Default: space.sweep beside space.toml.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl Place {
    /// The folder.
    pub fn folder(&self) -> SweepFolder {
        SweepFolder::new(self.out.clone().unwrap_or_else(|| self.space.with_extension("sweep")))
    }

    /// The sweep.
    ///
    /// # Errors
    /// As [`Sweep::open`].
    pub fn open(&self) -> Result<Sweep> {
        Sweep::open(&self.space, self.folder())
    }
}

/// How often workers save.
#[derive(Args, Clone, Copy, Debug)]
pub struct Checkpoints {
    /// Steps between checkpoints: what a kill can cost.
    #[arg(long, value_name = "STEPS", default_value_t = 250, value_parser = clap::value_parser!(u32).range(1..))]
    pub checkpoint_every: u32,
}
