//! Records of runs: what was rendered, its time and its error.

use std::{fs, sync::LazyLock};

use headtail_render::{
    color::luminance,
    image::Image,
    integrator::Rendering,
    simd::instruction_set,
    statistics::{ErrorMetrics, ttuv},
};
use serde::{Deserialize, Serialize};

use crate::Result;

/// One run of a sampler on a view at a budget.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Scene.
    pub scene: String,
    /// Map.
    pub env: String,
    /// Material of every surface; empty for the scene's own.
    #[serde(default)]
    pub material: String,
    /// Sampler.
    pub sampler: String,
    /// Budget of the run, `16spp` or `2s`.
    pub budget: String,
    /// Index of the run, from 0.
    pub run: u32,
    /// Samples per pixel.
    pub spp: f64,
    /// Rays (camera rays not counted) per sample.
    pub rays_per_sample: f64,
    /// Wall-clock seconds of rendering, without preparation.
    pub seconds: f64,
    /// Mean squared error over the measured pixels and channels, without the noise of the reference.
    pub mse: f64,
    /// Mean relative squared error, `(x - r)^2 / (r^2 + 0.01)`, without the noise of the reference.
    pub relmse: f64,
    /// `relmse` without the worst 0.1 % of the pixels.
    pub relmse_trimmed: f64,
    /// `mse * seconds`.
    pub ttuv: f64,
    /// Mean luminance of the measured pixels.
    pub mean_luminance: f64,
    /// Largest luminance of one contribution before its shadow ray.
    pub max_weight: f64,
    /// Seed.
    pub seed: u64,
    /// The version of headtail.
    pub version: String,
    /// The points of samples.
    pub points: String,
    /// Seconds of preparation: files of the sampler, and work before the first sample.
    pub preparation: f64,
    /// Processor seconds of rendering; NaN if the system does not report them.
    pub processor_seconds: f64,
    /// MSE of the reference itself; NaN if it is unknown.
    pub reference_mse: f64,
    /// Mean luminance of the reference over the measured pixels.
    pub reference_luminance: f64,
    /// Smallest p-value of the hypothesis that a tile has the reference's mean, corrected for the number of
    /// tiles; NaN where the test does not apply, as below 64 samples per pixel.
    pub tile_p: f64,
}

impl Measurement {
    /// Compares the measured `pixels` of a rendering with those of a reference. Names are left empty.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn of(rendering: &Rendering, pixels: &Image, reference: &Image) -> Result<Self> {
        let metrics = ErrorMetrics::of(pixels, reference)?;
        Ok(Self {
            spp: f64::from(rendering.spp),
            rays_per_sample: rendering.rays_per_sample,
            seconds: rendering.seconds,
            mse: metrics.mse,
            relmse: metrics.relmse,
            relmse_trimmed: metrics.relmse_trimmed,
            ttuv: ttuv(metrics.mse, rendering.seconds),
            mean_luminance: mean_luminance(pixels),
            max_weight: f64::from(rendering.max_weight),
            points: rendering.points.to_string(),
            reference_luminance: mean_luminance(reference),
            ..Self::unknown()
        })
    }

    /// Returns a record without names, whose numbers are NaN or 0.
    pub fn unknown() -> Self {
        Self {
            scene: String::new(),
            env: String::new(),
            material: String::new(),
            sampler: String::new(),
            budget: String::new(),
            run: 0,
            spp: f64::NAN,
            rays_per_sample: f64::NAN,
            seconds: f64::NAN,
            mse: f64::NAN,
            relmse: f64::NAN,
            relmse_trimmed: f64::NAN,
            ttuv: f64::NAN,
            mean_luminance: f64::NAN,
            max_weight: f64::NAN,
            seed: 0,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            points: String::new(),
            preparation: f64::NAN,
            processor_seconds: f64::NAN,
            reference_mse: f64::NAN,
            reference_luminance: f64::NAN,
            tile_p: f64::NAN,
        }
    }
}

/// Returns the mean luminance of a picture.
pub fn mean_luminance(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|&pixel| f64::from(luminance(glam::Vec3A::from_array(pixel)))).sum();
    sum / image.pixels.len() as f64
}

/// The instruction set of graphics devices.
const SHADERS: &str = "wgsl";

/// Machine and sources of measurements.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Environment {
    /// The version of headtail.
    pub version: String,
    /// Hash of the sources of samplers and integrator.
    pub sources: String,
    /// The processor.
    pub machine: String,
    /// The instruction set of the kernels.
    pub instruction_set: String,
    /// Threads that render.
    pub threads: usize,
}

impl Environment {
    /// Returns the environment of this process.
    pub fn current() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sources: source_hash().to_owned(),
            machine: processor().to_owned(),
            instruction_set: instruction_set().unwrap_or("unknown").to_owned(),
            threads: rayon::current_num_threads(),
        }
    }

    /// Returns the environment of this process where a graphics device of this name renders.
    pub fn of_device(name: String) -> Self {
        let (sources, instruction_set) = (device_source_hash().to_owned(), SHADERS.to_owned());
        Self { sources, machine: name, instruction_set, ..Self::current() }
    }

    /// Returns whether a graphics device rendered.
    pub fn is_of_device(&self) -> bool {
        self.instruction_set == SHADERS
    }
}

/// Returns the hash of the sources that affect samples, pictures and their time, in 16 hexadecimal digits;
/// comments, white space and tests do not count.
pub fn source_hash() -> &'static str {
    env!("HEADTAIL_SOURCES")
}

/// Returns [`source_hash`] with the shaders, for pictures of graphics devices.
pub fn device_source_hash() -> &'static str {
    env!("HEADTAIL_DEVICE_SOURCES")
}

fn processor() -> &'static str {
    static MODEL: LazyLock<String> = LazyLock::new(|| {
        let model = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("model name"))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        });
        model.unwrap_or_else(|| std::env::consts::ARCH.to_owned())
    });
    &MODEL
}

/// Returns processor and threads as in reports.
pub fn machine() -> String {
    format!("{}, {} threads", processor(), rayon::current_num_threads())
}
