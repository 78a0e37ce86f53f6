//! Allows failed trials to run again.

use anyhow::Result;

use super::{
    Sweep,
    journal::{Event, Journal},
};

use crate::terminal::say;

/// Records that every failed trial may run again.
pub fn run(sweep: &Sweep) -> Result<()> {
    let has_failed = |id: &str| sweep.ledger.record(id).is_some_and(|record| record.failure().is_some());
    let failed: Vec<&str> =
        sweep.plan.trials.iter().map(|trial| trial.id.as_str()).filter(|id| has_failed(id)).collect();
    if !failed.is_empty() {
        let mut journal = Journal::create(&sweep.folder.journals())?;
        failed.iter().try_for_each(|id| journal.add(Event::Retry { trial: (*id).to_owned() }))?;
    }
    say!("{} trials will be tried again by the next run", failed.len());
    Ok(())
}
