//! The comparison report: `results.csv` with all measurements, `report.html`, a self-contained page, and
//! `figures/`, its charts and tables as files. The parts of other pages are here, too.
//!
//! | file | concept |
//! | --- | --- |
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

pub use headtail_eval::Measurement;
pub use terminal::lines;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use glam::Vec3A;
use headtail_render::color::luminance;
use headtail_render::file;
use headtail_render::image::Image;

/// All measurements of samplers on one scene under one environment map.
pub struct Comparison {
    /// The name of the scene.
    pub scene: String,
    /// The name of the environment map.
    pub env: String,
    /// Columns of pixels.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// The command line that made this comparison.
    pub command: String,
    /// The machine it ran on.
    pub machine: String,
    /// The version of headtail.
    pub version: String,
    /// The image that errors are measured against.
    pub reference: Image,
    /// `[height * width]` pixels over which errors and luminance are measured; empty for all pixels.
    pub measured: Vec<bool>,
    /// How the reference was rendered, in a sentence.
    pub reference_note: String,
    /// The measured runs, in display order of samplers and budgets.
    pub rows: Vec<Measurement>,
    /// The first run of each (sampler, budget).
    pub images: Vec<RenderedImage>,
    /// Work before the first sample.
    pub preparation: Vec<Preparation>,
    /// Whether runs are missing.
    pub state: State,
}

/// Whether a comparison has all of its runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum State {
    /// All runs are done.
    Complete,
    /// More runs follow.
    Running {
        /// The number of planned runs.
        planned: usize,
    },
    /// A signal ended the comparison before the last run.
    Interrupted {
        /// The number of planned runs.
        planned: usize,
    },
}

impl State {
    /// The number of planned runs; `None` if all are done.
    pub fn planned(self) -> Option<usize> {
        match self {
            Self::Complete => None,
            Self::Running { planned } | Self::Interrupted { planned } => Some(planned),
        }
    }
}

/// A rendering that the page shows.
pub struct RenderedImage {
    /// The name of the sampler, as in the rows.
    pub sampler: String,
    /// The budget, as in the rows.
    pub budget: String,
    /// The rendering, in the size of the reference.
    pub image: Image,
}

/// Work that a sampler needs once before rendering.
#[derive(Clone)]
pub struct Preparation {
    /// The name of the sampler, as in the rows.
    pub sampler: String,
    /// Its duration.
    pub seconds: f64,
    /// A short description: "trained for 1000 steps".
    pub text: String,
}

impl Comparison {
    /// Returns the mean of `[height * width]` values over the measured pixels.
    fn mean_of_measured(&self, values: &[f64]) -> f64 {
        let measured = || (0..values.len()).filter(|&k| self.is_measured(k));
        measured().map(|k| values[k]).sum::<f64>() / measured().count() as f64
    }

    /// Returns whether errors are measured at a pixel index.
    fn is_measured(&self, index: usize) -> bool {
        self.measured.get(index).copied().unwrap_or(true)
    }

    /// Returns the mean luminance of the reference over the measured pixels.
    fn reference_luminance(&self) -> f64 {
        let measured = self.reference.pixels.iter().enumerate().filter(|(index, _)| self.is_measured(*index));
        let luminances = measured.map(|(_, &pixel)| f64::from(luminance(Vec3A::from_array(pixel))));
        let (sum, count) = luminances.fold((0.0, 0.0), |(sum, count), luminance| (sum + luminance, count + 1.0));
        sum / count
    }
}

/// Returns two charts: MSE against time, and bars of the MSE ratio to the baseline.
///
/// # Errors
/// If there are no runs.
pub fn charts(rows: &[Measurement]) -> Result<[vector::Chart; 2]> {
    let summary = summary::Summary::of(rows)?;
    Ok([chart::error_over_time(&summary), chart::ratio_bars(&summary)])
}

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
