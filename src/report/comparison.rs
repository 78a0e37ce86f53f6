//! A comparison of samplers in one view: measurements, pictures, preparation.

use glam::Vec3A;
use headtail_eval::Measurement;
use headtail_render::color::luminance;
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
    pub fn mean_of_measured(&self, values: &[f64]) -> f64 {
        let measured = || (0..values.len()).filter(|&k| self.is_measured(k));
        measured().map(|k| values[k]).sum::<f64>() / measured().count() as f64
    }

    /// Returns whether errors are measured at a pixel index.
    pub fn is_measured(&self, index: usize) -> bool {
        self.measured.get(index).copied().unwrap_or(true)
    }

    /// Returns the mean luminance of the reference over the measured pixels.
    pub fn reference_luminance(&self) -> f64 {
        let measured = self.reference.pixels.iter().enumerate().filter(|(index, _)| self.is_measured(*index));
        let luminances = measured.map(|(_, &pixel)| f64::from(luminance(Vec3A::from_array(pixel))));
        let (sum, count) = luminances.fold((0.0, 0.0), |(sum, count), luminance| (sum + luminance, count + 1.0));
        sum / count
    }
}
