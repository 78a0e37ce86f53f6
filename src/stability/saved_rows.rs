//! Finished regimes, one file each, so that an interrupted suite continues with the missing ones.

use std::{fs, path::PathBuf};

use anyhow::Result;
use headtail_eval::{DirectionEffort, DirectionStatistics};
use headtail_render::file;
use headtail_train::FitConfig;
use serde::{Deserialize, Serialize};

use super::{
    method::{METHODS, Row},
    regime::Regime,
};
use crate::output::make_folder;

/// A folder with the rows of finished regimes.
pub struct SavedRows(PathBuf);

/// The content of a file. TOML, since JSON cannot represent infinity.
#[derive(Serialize, Deserialize)]
struct Record {
    /// Hash of its inputs.
    key: String,
    rows: Vec<SavedRow>,
}

#[derive(Serialize, Deserialize)]
struct SavedRow {
    method: String,
    figures: Option<DirectionStatistics>,
    /// The error if there are no figures.
    stopped: Option<String>,
    skipped: usize,
    note: String,
}

impl SavedRows {
    /// Opens a folder, creating it if missing.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn open(folder: PathBuf) -> Result<Self> {
        make_folder(&folder)?;
        Ok(Self(folder))
    }

    /// Reads a regime that was measured with the same settings; `None` also if the file is damaged.
    pub fn read(&self, regime: &Regime, config: &FitConfig, effort: DirectionEffort) -> Option<Vec<Row>> {
        let record: Record = toml::from_str(&fs::read_to_string(self.path(regime)).ok()?).ok()?;
        let row = |saved: SavedRow| {
            Some(Row {
                regime: regime.name.clone(),
                method: METHODS.iter().find(|method| method.0 == saved.method)?.0,
                outcome: saved.figures.ok_or(saved.stopped.unwrap_or_default()),
                skipped: saved.skipped,
                note: saved.note,
            })
        };
        let rows: Option<Vec<Row>> = record.rows.into_iter().map(row).collect();
        (record.key == key(regime, config, effort)).then_some(rows?)
    }

    /// Writes the measurements of a regime.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, regime: &Regime, config: &FitConfig, effort: DirectionEffort, rows: &[Row]) -> Result<()> {
        let saved = |row: &Row| SavedRow {
            method: row.method.to_owned(),
            figures: row.outcome.clone().ok(),
            stopped: row.outcome.clone().err(),
            skipped: row.skipped,
            note: row.note.clone(),
        };
        let record = Record { key: key(regime, config, effort), rows: rows.iter().map(saved).collect() };
        Ok(file::replace(&self.path(regime), toml::to_string(&record)?.as_bytes())?)
    }

    fn path(&self, regime: &Regime) -> PathBuf {
        let name: String = regime.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        self.0.join(name + ".toml")
    }
}

/// Hashes all inputs of a regime's figures.
fn key(regime: &Regime, config: &FitConfig, effort: DirectionEffort) -> String {
    let settings = serde_json::to_string(config).unwrap_or_default();
    let (version, map) = (env!("CARGO_PKG_VERSION"), regime.environment.hash());
    let content = format!(
        "{version} {} {map} {:?} {:?} {:?} {effort:?} {settings}",
        regime.name, regime.material, regime.directions, regime.change
    );
    blake3::hash(content.as_bytes()).to_hex().to_string()
}
