//! `headtail sweep`: many runs from one file, each trial once, whatever is killed meanwhile.

mod arguments;
mod axis;
mod collect;
mod effect;
mod estimate;
mod folder;
mod forest;
mod halving;
mod jobs;
mod journal;
mod local;
mod place;
mod plan;
mod queue;
mod report;
mod retry;
mod search;
mod slurm;
mod space;
mod status;
mod worker;

use std::path::Path;

use anyhow::Result;

use self::{folder::SweepFolder, journal::Ledger, plan::Plan, space::Space};
use crate::run::Contents;
pub use arguments::{Arguments, run};

/// A space, its folder, and what is known of its trials.
pub struct Sweep {
    /// The space.
    pub space: Space,
    /// The folder.
    pub folder: SweepFolder,
    /// The trials.
    pub plan: Plan,
    /// What happened so far.
    pub ledger: Ledger,
    /// What is in the files that runs name.
    contents: Contents,
    /// Configurations that adaptive search has made.
    suggested: usize,
}

impl Sweep {
    /// Opens a space with its folder, which need not be there yet.
    ///
    /// # Errors
    /// If the space or a trial of it is wrong, or a journal cannot be read.
    pub fn open(file: &Path, folder: SweepFolder) -> Result<Self> {
        let space = Space::open(file)?;
        let ledger = Ledger::open(&folder.journals())?;
        let suggested = ledger.suggested();
        let contents = Contents::default();
        let plan = Plan::new(&space, &suggested, &contents)?;
        Ok(Self { space, folder, plan, ledger, contents, suggested: suggested.len() })
    }

    /// Reads what others wrote down meanwhile, and plans what they suggested.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn refresh(&mut self) -> Result<()> {
        self.ledger.refresh()?;
        let suggested = self.ledger.suggested();
        if suggested.len() != self.suggested {
            self.suggested = suggested.len();
            self.plan = Plan::new(&self.space, &suggested, &self.contents)?;
        }
        Ok(())
    }
}
