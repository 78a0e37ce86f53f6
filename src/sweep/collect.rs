//! All trials as rows of one table.

use std::collections::BTreeSet;

use anyhow::{Context, Result};
use serde::Serialize;
use toml::Value;

use super::{Sweep, plan::Trial, record::Record, status::State};
use crate::run::Measures;

/// A trial with its state and results.
pub struct Row<'a> {
    /// Trial.
    pub trial: &'a Trial,
    /// State.
    pub state: State,
    /// Final figures, else those at the last rung.
    pub measures: Option<&'a Measures>,
    /// Seconds of work.
    pub seconds: f64,
    /// Reason of a failure.
    pub error: String,
}

/// A row as an object for JSON.
#[derive(Serialize)]
pub struct JsonRow<'a> {
    #[serde(flatten)]
    trial: &'a Trial,
    state: State,
    measures: Option<&'a Measures>,
    work_seconds: f64,
    folder: String,
    error: &'a str,
}

impl Row<'_> {
    /// Returns the row as an object for JSON.
    pub fn record(&self, sweep: &Sweep) -> JsonRow<'_> {
        let Self { trial, state, measures, seconds, error } = self;
        let folder = sweep.folder.trial(&trial.id).display().to_string();
        JsonRow { trial, state: *state, measures: *measures, work_seconds: *seconds, folder, error }
    }
}

/// Returns the rows of all trials, in the order of the plan.
pub fn rows(sweep: &Sweep) -> Vec<Row<'_>> {
    fn row<'a>(sweep: &'a Sweep, trial: &'a Trial) -> Row<'a> {
        let id = &trial.id;
        let record = sweep.ledger.record(id);
        let measures = record.and_then(|record| record.done.as_ref().or_else(|| record.rungs.values().last()));
        Row {
            trial,
            state: State::of(sweep, id),
            measures,
            seconds: record.map_or(0.0, |record| record.seconds),
            error: record.and_then(Record::failure).unwrap_or_default(),
        }
    }
    sweep.plan.trials.iter().map(|trial| row(sweep, trial)).collect()
}

/// Formats the table: identity, state, a column per axis, one per figure, seconds of work, folder, error.
pub fn csv(sweep: &Sweep, rows: &[Row<'_>]) -> Result<String> {
    let axes: Vec<&str> = sweep.space.axes.iter().map(|axis| axis.key.as_str()).collect();
    let figures: BTreeSet<&str> =
        rows.iter().filter_map(|row| row.measures).flat_map(|measures| measures.keys().map(String::as_str)).collect();
    let mut writer = csv::Writer::from_writer(Vec::new());
    let head = ["trial", "configuration", "state"].into_iter().chain(axes.iter().copied());
    writer.write_record(head.chain(figures.iter().copied()).chain(["work_seconds", "folder", "error"]))?;
    for row in rows {
        let Row { trial, state, measures, seconds, error } = row;
        let mut record = vec![trial.id.clone(), trial.configuration.to_string(), state.to_string()];
        record.extend(axes.iter().map(|key| trial.assignment.get(*key).map_or(String::new(), plain)));
        let figure =
            |name: &&str| measures.and_then(|measures| measures.get(*name)).map_or(String::new(), f64::to_string);
        record.extend(figures.iter().map(figure));
        let folder = sweep.folder.trial(&trial.id).display().to_string();
        record.extend([format!("{seconds:.3}"), folder, error.clone()]);
        writer.write_record(record)?;
    }
    String::from_utf8(writer.into_inner().context("the table")?).context("the table")
}

/// Formats a value without the quotes of TOML.
pub fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}
