//! The comparison report: `results.csv` with all measurements, `report.html`, a self-contained page, and
//! `figures/`, its charts and tables as files. The parts of other pages are here, too.
//!
//! | file | concept |
//! | --- | --- |
//! | `comparison.rs` | measurements and pictures of a comparison |
//! | `html/`, `overview.rs` | the page of a comparison; the page over several |
//! | `shell.rs`, `style/`, `script/` | head, style and script of all pages |
//! | `chart/`, `vector.rs` | charts; drawings on a page and as SVG |
//! | `kind.rs`, `colours.rs` | colours of samplers, and of values |
//! | `table.rs`, `number.rs` | tables as HTML, LaTeX and CSV; printed numbers |
//! | `stage.rs`, `gallery.rs`, `picture.rs`, `radiance.rs`, `crop.rs` | pictures of a page |
//! | `teaser.rs` | a paper's first figure |
//! | `summary.rs`, `reading.rs` | runs by sampler and budget; sentences about them |
//! | `terminal.rs`, `csv.rs` | the same as text and as a file |
//! | `synthetic.rs` | a comparison for tests |

pub mod chart;
pub mod colours;
mod comparison;
pub mod crop;
mod csv;
mod gallery;
mod html;
pub mod kind;
pub mod number;
mod overview;
pub mod picture;
mod radiance;
mod reading;
pub mod shell;
pub mod stage;
mod summary;
#[cfg(test)]
mod synthetic;
pub mod table;
mod teaser;
mod terminal;
pub mod vector;

pub use comparison::{Comparison, Preparation, RenderedImage, State};
pub use terminal::lines;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use headtail_render::file;

/// Writes a page with a chart of speed and accuracy per folder of results, and one over all.
///
/// # Errors
/// If a folder has no readable `results.csv`, or the page cannot be written.
pub fn write_overview(page: &Path, folders: &[std::path::PathBuf]) -> Result<()> {
    let mut scenes = Vec::new();
    for folder in folders {
        let path = folder.join("results.csv");
        let bytes = file::read(&path, 1 << 30).with_context(|| format!("{}", path.display()))?;
        scenes.push(csv::decode(&bytes).with_context(|| format!("{}", path.display()))?);
    }
    file::replace(page, overview::page(&scenes)?.as_bytes())?;
    Ok(())
}

/// `results.csv` and `report.html` in an existing folder, updated while a comparison runs.
pub struct Report {
    folder: PathBuf,
    gallery: gallery::Gallery,
    table: Pace,
    page: Pace,
}

impl Report {
    /// The report of a folder; writes nothing yet.
    pub fn new(folder: &Path) -> Self {
        let gallery = gallery::Gallery::default();
        Self { folder: folder.to_owned(), gallery, table: Pace::default(), page: Pace::default() }
    }

    /// Updates `results.csv`, unless writing is slow and the last write was recent (see [`Pace`]).
    ///
    /// # Errors
    /// See [`Self::finish`].
    pub fn update_table(&mut self, comparison: &Comparison) -> Result<()> {
        if self.table.is_due() {
            self.write_table(comparison, &summary::Summary::of(&comparison.rows)?)?;
        }
        Ok(())
    }

    /// Updates `report.html` at the same pace.
    ///
    /// # Errors
    /// See [`Self::finish`].
    pub fn update_page(&mut self, comparison: &Comparison) -> Result<()> {
        if self.page.is_due() {
            self.write_page(comparison, &summary::Summary::of(&comparison.rows)?)?;
        }
        Ok(())
    }

    /// Writes both files, and the page's charts and tables to `figures/` as SVG, LaTeX and CSV.
    ///
    /// # Errors
    /// If there are no runs, if an image or `measured` differs in size from the reference, or if a file
    /// cannot be written.
    pub fn finish(&mut self, comparison: &Comparison) -> Result<()> {
        let summary = summary::Summary::of(&comparison.rows)?;
        self.write_table(comparison, &summary)?;
        self.write_page(comparison, &summary)?;
        let (charts, tables) = html::figures(comparison, &summary, &self.gallery);
        let folder = self.folder.join("figures");
        fs::create_dir_all(&folder).with_context(|| format!("{}", folder.display()))?;
        charts.iter().try_for_each(|chart| chart.write(&folder))?;
        teaser::teaser(comparison, &summary, self.gallery.exposure)?.write(&folder)?;
        tables.iter().try_for_each(|table| table.write(&folder))
    }

    fn write_table(&mut self, comparison: &Comparison, summary: &summary::Summary) -> Result<()> {
        let start = Instant::now();
        file::replace(&self.folder.join("results.csv"), &csv::encode(&comparison.rows, summary)?)?;
        self.table.wrote(start.elapsed());
        Ok(())
    }

    fn write_page(&mut self, comparison: &Comparison, summary: &summary::Summary) -> Result<()> {
        ensure!(
            comparison.measured.is_empty() || comparison.measured.len() == comparison.reference.pixels.len(),
            "measured: {} pixels, the reference has {}",
            comparison.measured.len(),
            comparison.reference.pixels.len()
        );
        let start = Instant::now();
        let page = html::page(comparison, summary, &mut self.gallery)?;
        file::replace(&self.folder.join("report.html"), page.as_bytes())?;
        self.page.wrote(start.elapsed());
        Ok(())
    }
}

/// Limits how often a growing file is rewritten: always if writing is quick, else for at most 10 % of the
/// time.
#[derive(Default)]
struct Pace {
    due: Option<Instant>,
}

impl Pace {
    /// Files that are written within this time are rewritten after every run.
    const QUICK: Duration = Duration::from_millis(50);

    fn is_due(&self) -> bool {
        self.due.is_none_or(|due| Instant::now() >= due)
    }

    fn wrote(&mut self, took: Duration) {
        self.due = (took > Self::QUICK).then(|| Instant::now() + 9 * took);
    }
}

#[cfg(test)]
mod tests;
