//! The comparison report: `results.csv` with every number, and `report.html`, one self-contained page to read them by.

mod chart;
mod csv;
mod html;
pub mod number;
mod overview;
pub mod picture;
mod reading;
mod summary;
#[cfg(test)]
mod synthetic;

use std::path::Path;

use anyhow::{Context, Result, ensure};
use glam::Vec3A;
use headtail_render::color::luminance;
use headtail_render::file;
use headtail_render::image::Image;

/// Everything that a comparison of samplers measured on one scene under one environment map.
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
    /// What it ran on.
    pub machine: String,
    /// The version of headtail.
    pub version: String,
    /// The image that errors are measured against.
    pub reference: Image,
    /// `[height * width]` the pixels over which errors and luminance of the rows are measured; empty for all pixels.
    pub measured: Vec<bool>,
    /// How the reference was made, in a sentence.
    pub reference_note: String,
    /// The measured runs, in the order in which samplers and budgets are to be shown.
    ///
    /// Rows of means (`run` is `None`) may be among them; they are computed anew from the runs.
    pub rows: Vec<Row>,
    /// The first run of each (sampler, budget).
    pub images: Vec<RenderedImage>,
    /// What had to be done before the first sample.
    pub preparation: Vec<Preparation>,
}

/// One run of a sampler at a budget, or the mean of its runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The name of the scene.
    pub scene: String,
    /// The name of the environment map.
    pub env: String,
    /// The name of the sampler; `mis` is the one-sample MIS that others are measured by.
    pub sampler: String,
    /// What the run was allowed, `16spp` or `2s`.
    pub budget: String,
    /// Number of the run; `None` is the mean of all runs.
    pub run: Option<u32>,
    /// Samples per pixel taken.
    pub spp: f64,
    /// Rays (camera rays not counted) per sample.
    pub rays_per_sample: f64,
    /// Rendering time in seconds, without preparation.
    pub seconds: f64,
    /// Mean squared error.
    pub mse: f64,
    /// Mean relative squared error.
    pub relmse: f64,
    /// The same without the worst pixels.
    pub relmse_trimmed: f64,
    /// `mse * seconds`.
    pub ttuv: f64,
    /// Mean luminance of the image.
    pub mean_luminance: f64,
    /// The largest weight of a sample (its contribution over its density); over all runs in the row of means.
    pub max_weight: f64,
    /// Seed of the run; of the first in the row of means.
    pub seed: u64,
    /// The version of headtail.
    pub version: String,
}

/// A rendering to be looked at.
pub struct RenderedImage {
    /// The name of the sampler, as in the rows.
    pub sampler: String,
    /// The budget, as in the rows.
    pub budget: String,
    /// The rendering, of the size of the reference.
    pub image: Image,
}

/// Work that a sampler needs once, before it renders.
pub struct Preparation {
    /// The name of the sampler, as in the rows.
    pub sampler: String,
    /// How long it took.
    pub seconds: f64,
    /// What was done, in a few words: "trained for 1000 steps".
    pub text: String,
}

impl Comparison {
    /// Whether errors are measured at the pixel of an index.
    fn is_measured(&self, index: usize) -> bool {
        self.measured.get(index).copied().unwrap_or(true)
    }

    /// The mean luminance of the reference over the measured pixels.
    fn reference_luminance(&self) -> f64 {
        let measured = self.reference.pixels.iter().enumerate().filter(|(index, _)| self.is_measured(*index));
        let luminances: Vec<f64> = measured.map(|(_, &pixel)| f64::from(luminance(Vec3A::from_array(pixel)))).collect();
        luminances.iter().sum::<f64>() / luminances.len() as f64
    }
}

/// Writes a page with a chart of speed and accuracy for each of the given folders of results, and one over all.
///
/// # Errors
/// If a folder has no readable `results.csv`, or the page cannot be written.
pub fn write_overview(page: &Path, folders: &[std::path::PathBuf]) -> Result<()> {
    let mut scenes = Vec::new();
    for folder in folders {
        let path = folder.join("results.csv");
        let bytes = std::fs::read(&path).with_context(|| format!("{}", path.display()))?;
        scenes.push(csv::decode(&bytes).with_context(|| format!("{}", path.display()))?);
    }
    file::replace(page, overview::page(&scenes)?.as_bytes())?;
    Ok(())
}

/// Writes `results.csv` and `report.html` into an existing folder.
///
/// # Errors
/// If there are no runs, if the size of an image or of `measured` is not that of the reference, or if a file cannot be
/// written.
pub fn write(folder: &Path, comparison: &Comparison) -> Result<()> {
    ensure!(
        comparison.measured.is_empty() || comparison.measured.len() == comparison.reference.pixels.len(),
        "measured: {} pixels, the reference has {}",
        comparison.measured.len(),
        comparison.reference.pixels.len()
    );
    let summary = summary::Summary::of(&comparison.rows)?;
    file::replace(&folder.join("results.csv"), &csv::encode(&comparison.rows, &summary)?)?;
    file::replace(&folder.join("report.html"), html::page(comparison, &summary)?.as_bytes())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_files_are_written_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &synthetic::comparison()).unwrap();
        let mut names: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["report.html", "results.csv"]);
        assert!(write(&folder.path().join("missing"), &synthetic::comparison()).is_err());
    }

    #[test]
    fn the_same_comparison_gives_the_same_bytes() {
        let page = || {
            let comparison = synthetic::comparison();
            html::page(&comparison, &summary::Summary::of(&comparison.rows).unwrap()).unwrap()
        };
        assert_eq!(page(), page());
    }
}
