//! `headtail sweep`: many runs from one file; each trial runs once, even if processes are killed.
//!
//! | file | concept |
//! | --- | --- |
//! | `space.rs`, `axis.rs` | the space; the values of one setting |
//! | `plan.rs` | trials and their identities |
//! | `journal.rs`, `record.rs` | what workers write; the events of a trial |
//! | `folder.rs` | the folder and its locks |
//! | `jobs.rs`, `halving.rs`, `search.rs` | the next work; successive halving; Parzen estimators |
//! | `worker.rs`, `local.rs` | a worker; worker processes on this machine |
//! | `slurm.rs`, `queue.rs` | array jobs; the state of jobs |
//! | `status.rs`, `estimate.rs` | progress; expected work |
//! | `collect.rs`, `retry.rs` | one table of all trials; failed trials |
//! | `report.rs`, `report/` | the page |
//! | `effect.rs` | effects of a setting's values |
//! | `arguments.rs`, `location.rs` | the command line; the sweep of a command |

mod arguments;
mod axis;
mod collect;
mod effect;
mod estimate;
mod folder;
mod halving;
mod jobs;
mod journal;
mod local;
mod location;
mod plan;
mod queue;
mod record;
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

/// A space, its folder, and its trials.
pub struct Sweep {
    /// Space.
    pub space: Space,
    /// Folder.
    pub folder: SweepFolder,
    /// Trials.
    pub plan: Plan,
    /// Events so far.
    pub ledger: Ledger,
    /// Hashes of the files that runs name.
    contents: Contents,
    /// Number of configurations that adaptive search has made.
    suggested: usize,
}

impl Sweep {
    /// Opens a space with its folder, which need not exist yet.
    ///
    /// # Errors
    /// If the space or one of its trials is invalid, or a journal cannot be read.
    pub fn open(file: &Path, folder: SweepFolder) -> Result<Self> {
        let space = Space::open(file)?;
        let ledger = Ledger::open(&folder.journals())?;
        let suggested = ledger.suggested();
        let contents = Contents::default();
        let plan = Plan::new(&space, &suggested, &contents)?;
        Ok(Self { space, folder, plan, ledger, contents, suggested: suggested.len() })
    }

    /// Reads what other workers have written since, and plans the configurations that they suggested.
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
