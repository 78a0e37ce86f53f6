//! Allows failed trials to run again.

use anyhow::Result;

use super::{
    Sweep,
    journal::{Event, Journal},
    record::Record,
};

use crate::terminal::say;

/// Records that every failed trial may run again.
pub fn run(sweep: &Sweep) -> Result<()> {
    let attempt = |id: &str| sweep.ledger.record(id).filter(|record| record.failure().is_some()).map(Record::attempt);
    let ids = sweep.plan.trials.iter().map(|trial| &trial.id);
    let failed: Vec<(&String, u64)> = ids.filter_map(|id| Some((id, attempt(id)?))).collect();
    if !failed.is_empty() {
        let mut journal = Journal::create(&sweep.folder.journals())?;
        failed.iter().try_for_each(|&(id, attempt)| journal.add(Event::Retry { trial: id.clone(), attempt }))?;
    }
    say!("{} trials will be tried again by the next run", failed.len());
    Ok(())
}
