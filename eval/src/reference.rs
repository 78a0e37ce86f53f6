//! Reference pictures, and their own noise.
//!
//! A reference is rendered by `patches` with Sobol points in two independent halves, whose difference gives
//! its noise. If the noise exceeds a given fraction of the smallest error measured against it, more samples
//! are taken ([`Reference::refine`]).

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use headtail_render::{
    image::{Attribute, Image, read_radiance, text_attributes, write_exr},
    integrator::Rendering,
    points::{PointSet, Points},
    spec::SamplerSpec,
    statistics::ErrorMetrics,
};

use crate::{Budget, Error, OpenedView, Result, view::part_text};

/// Part of every cache name; increase it if the renderer changes what its pictures converge to, or how fast.
const CACHE_VERSION: u32 = 5;
/// Points of references, independent of those of the runs.
const POINTS: PointSet = PointSet::Sobol;
/// Sampler of references: among those without a file, the one with the smallest error under these points.
pub const SAMPLER: &str = "patches";
/// Attributes of a reference file: its noise and its samples per pixel.
const NAMES: [&str; 3] = ["reference.mse", "reference.relmse", "reference.spp"];
/// Lower bound of an error after subtraction of noise, as a fraction of the noise: keeps it positive, so that
/// it has a logarithm.
const LEAST: f64 = 0.05;

/// Convergence of references.
#[derive(Clone, Copy, Debug)]
pub struct ReferencePolicy {
    /// Initial samples per pixel.
    pub samples: u32,
    /// Maximum samples per pixel.
    pub most_samples: u32,
    /// Target noise as a fraction of the smallest mean squared error.
    pub fraction: f64,
    /// Seed; far from those of the runs.
    pub seed: u64,
}

impl ReferencePolicy {
    /// Returns the policy of at least `samples` and up to 4x as many, until the noise is 5 % of the smallest
    /// error.
    pub fn new(samples: u32, seed: u64) -> Self {
        Self { samples, most_samples: samples.saturating_mul(4), fraction: 0.05, seed: seed ^ 0x5eed_0000_0000 }
    }
}

/// Expected errors of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Mean squared error.
    pub mse: f64,
    /// Mean relative squared error.
    pub relmse: f64,
}

impl Noise {
    /// Returns the noise of the mean of two independent renderings with equal numbers of samples: if `a` and
    /// `b` have variance `v`, the mean has `v / 2`, and `(a - b)^2 / 4`, the squared distance of a half to
    /// it, has that expectation.
    fn of(half: &Image, mean: &Image, covered: &[bool]) -> Result<Self> {
        let metrics = ErrorMetrics::of(&select(half, covered), &select(mean, covered))?;
        Ok(Self { mse: metrics.mse, relmse: metrics.relmse })
    }

    /// Subtracts a reference's noise from a measured error.
    pub fn without(measured: f64, noise: f64) -> f64 {
        (measured - noise).max(LEAST * noise)
    }
}

/// A reference picture.
#[derive(Clone)]
pub struct Reference {
    /// The whole picture, background included.
    pub image: Image,
    /// `[height * width]` the pixels that surfaces cover entirely, over which errors are measured.
    pub covered: Vec<bool>,
    /// Errors of the reference, if known.
    pub noise: Option<Noise>,
    /// Samples per pixel; 0 for a picture read from a file.
    pub samples: u32,
    /// Seconds of rendering in this process.
    pub seconds: f64,
    policy: ReferencePolicy,
}

impl Reference {
    /// Reads the reference of a view from a cache, or renders and stores it.
    ///
    /// # Errors
    /// If no pixel is covered by a surface, or a file cannot be written; [`Error::Interrupted`] if the stop flag is set.
    pub fn obtain(
        view: &OpenedView,
        policy: ReferencePolicy,
        cache: Option<&Path>,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Self> {
        let files = cache.map(|folder| files(folder, view, policy));
        if let Some([image, coverage]) = &files
            && let Some(known) = Self::read_cached(image, coverage, view, policy)
        {
            return Ok(known);
        }
        let rendered = Self::render(view, policy, stop, progress)?;
        if let Some(files) = &files {
            rendered.keep(files)?;
        }
        Ok(rendered)
    }

    /// Renders the reference of a view.
    ///
    /// # Errors
    /// As [`Self::obtain`].
    pub fn render(
        view: &OpenedView,
        policy: ReferencePolicy,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Self> {
        let (rendering, half) = two_halves(view, policy.samples, policy.seed, stop, progress)?;
        let covered = covered(&rendering.coverage)?;
        let noise = Some(Noise::of(&half, &rendering.surfaces, &covered)?);
        let (samples, seconds) = (rendering.spp, rendering.seconds);
        Ok(Self { image: rendering.composite(), covered, noise, samples, seconds, policy })
    }

    /// Reads a picture and the noise that its file records; a short rendering finds the covered pixels.
    ///
    /// # Errors
    /// If the file cannot be read or has another size, or no pixel is covered by a surface.
    pub fn read(file: &Path, view: &OpenedView, stop: &AtomicBool, progress: &dyn Fn(f64)) -> Result<Self> {
        let image = read_sized(file, view)?;
        let policy = ReferencePolicy::new(64, 0);
        let covered = covered(&two_halves(view, policy.samples, policy.seed, stop, progress)?.0.coverage)?;
        Ok(Self { image, covered, noise: read_noise(file).map(|(noise, _)| noise), samples: 0, seconds: 0.0, policy })
    }

    /// Takes more samples until the noise is the policy's fraction of `smallest`, the smallest mean squared
    /// error measured, or the policy's samples are spent. Returns whether the picture changed; pictures read
    /// from a file do not.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the stop flag is set.
    pub fn refine(
        &mut self,
        view: &OpenedView,
        smallest: f64,
        cache: Option<&Path>,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<bool> {
        let Some(noise) = self.noise.filter(|_| self.samples > 0) else { return Ok(false) };
        let factor = noise.mse / (self.policy.fraction * smallest.max(f64::MIN_POSITIVE));
        let left = self.policy.most_samples.saturating_sub(self.samples);
        if factor <= 1.0 || !factor.is_finite() || left < 2 {
            return Ok(false);
        }
        // Conservative: Sobol points converge at least as fast as independent ones.
        let more = (f64::from(self.samples) * (factor - 1.0)).ceil().min(f64::from(left)) as u32;
        let seed = self.policy.seed ^ (u64::from(self.samples) << 4);
        let (rendering, half) = two_halves(view, more, seed, stop, progress)?;
        let own = Noise::of(&half, &rendering.surfaces, &self.covered)?;
        let (a, b) = (f64::from(self.samples), f64::from(rendering.spp));
        let (a, b) = (a / (a + b), b / (a + b));
        for (to, from) in self.image.pixels.iter_mut().zip(rendering.composite().pixels) {
            *to = std::array::from_fn(|c| (a * f64::from(to[c]) + b * f64::from(from[c])) as f32);
        }
        let both = |x: f64, y: f64| a * a * x + b * b * y;
        self.noise = Some(Noise { mse: both(noise.mse, own.mse), relmse: both(noise.relmse, own.relmse) });
        self.samples += rendering.spp;
        self.seconds += rendering.seconds;
        if let Some(folder) = cache {
            self.keep(&files(folder, view, self.policy))?;
        }
        Ok(true)
    }

    /// Returns the measured pixels as a picture of one row.
    pub fn selected(&self) -> Image {
        select(&self.image, &self.covered)
    }

    /// Describes in a sentence how the reference was made.
    pub fn note(&self) -> String {
        match self.samples {
            0 => "Read from a file.".to_owned(),
            samples => {
                let cached = if self.seconds == 0.0 { " before, and found in the cache," } else { "" };
                format!("Rendered{cached} with {SAMPLER} at {samples} samples per pixel ({POINTS} points).")
            }
        }
    }

    /// Returns noise and samples as attributes of a file.
    pub fn attributes(&self) -> Vec<Attribute> {
        let Some(noise) = self.noise else { return Vec::new() };
        vec![
            Attribute::new(NAMES[0], noise.mse),
            Attribute::new(NAMES[1], noise.relmse),
            Attribute::new(NAMES[2], self.samples.to_string()),
        ]
    }

    fn read_cached(image: &Path, coverage: &Path, view: &OpenedView, policy: ReferencePolicy) -> Option<Self> {
        let (noise, samples) = read_noise(image)?;
        let (image, coverage) = (read_sized(image, view).ok()?, read_sized(coverage, view).ok()?);
        let coverage: Vec<f32> = coverage.pixels.iter().map(|pixel| pixel[0]).collect();
        let covered = covered(&coverage).ok()?;
        Some(Self { image, covered, noise: Some(noise), samples, seconds: 0.0, policy })
    }

    fn keep(&self, [image, coverage]: &[PathBuf; 2]) -> Result<()> {
        let folder = image.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        let pixels = self.covered.iter().map(|&covered| [f32::from(u8::from(covered)); 3]).collect();
        write_exr(coverage, &Image { pixels, ..self.image }, &[])?;
        Ok(write_exr(image, &self.image, &self.attributes())?)
    }
}

/// Renders two independent halves of at least one sample each; returns their mean and the surfaces of one
/// half.
fn two_halves(
    view: &OpenedView,
    samples: u32,
    seed: u64,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Result<(Rendering, Image)> {
    let spec = SAMPLER.parse::<SamplerSpec>()?;
    let estimator = spec.build(&view.environment)?;
    let half = |number: u32| {
        let points = Points::new(POINTS, seed ^ u64::from(number));
        let show = |done: f64| progress(0.5 * (f64::from(number) + done));
        let rendering = view.render(&*estimator, Budget::Samples(samples.div_ceil(2)), points, stop, &show);
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted("while the reference was rendered"));
        }
        Ok(rendering)
    };
    let (mut mean, second) = (half(0)?, half(1)?);
    let surfaces = mean.surfaces.clone();
    let pixels = mean.surfaces.pixels.iter_mut().chain(&mut mean.background.pixels);
    for (to, from) in pixels.zip(second.surfaces.pixels.iter().chain(&second.background.pixels)) {
        *to = std::array::from_fn(|channel| 0.5 * (to[channel] + from[channel]));
    }
    mean.coverage.iter_mut().zip(&second.coverage).for_each(|(to, from)| *to = 0.5 * (*to + from));
    (mean.spp, mean.seconds) = (mean.spp + second.spp, mean.seconds + second.seconds);
    Ok((mean, surfaces))
}

/// Returns the pixels that surfaces cover entirely.
///
/// # Errors
/// If there is none, so that nothing could be measured.
pub fn covered(coverage: &[f32]) -> Result<Vec<bool>> {
    let covered: Vec<bool> = coverage.iter().map(|&fraction| fraction == 1.0).collect();
    if covered.contains(&true) {
        Ok(covered)
    } else {
        Err(Error::argument("camera", "no pixel is covered by a surface: move the camera"))
    }
}

/// Returns the chosen pixels as a picture of one row.
pub fn select(image: &Image, chosen: &[bool]) -> Image {
    let pixels: Vec<_> =
        image.pixels.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(pixel, _)| *pixel).collect();
    Image { width: pixels.len(), height: 1, pixels }
}

fn read_noise(path: &Path) -> Option<(Noise, u32)> {
    let known = text_attributes(path).ok()?;
    let number = |name: &str| known.iter().find(|(found, _)| found == name)?.1.parse::<f64>().ok();
    let noise = Noise { mse: number(NAMES[0])?, relmse: number(NAMES[1])? };
    let samples = number(NAMES[2]).unwrap_or(0.0) as u32;
    (noise.mse >= 0.0 && noise.relmse >= 0.0).then_some((noise, samples))
}

fn read_sized(file: &Path, view: &OpenedView) -> Result<Image> {
    let (width, height) = (view.part().width, view.part().height);
    let image = read_radiance(file)?;
    if (image.width, image.height) != (width, height) {
        let reason = format!("the image is {} x {}; the comparison is {width} x {height}", image.width, image.height);
        return Err(Error::file(file, reason));
    }
    Ok(image)
}

/// Returns the picture and coverage files of a cache entry, named by a hash of everything that the reference
/// depends on.
fn files(folder: &Path, opened: &OpenedView, policy: ReferencePolicy) -> [PathBuf; 2] {
    let view = opened.view();
    let content = format!(
        "{CACHE_VERSION} {POINTS} {} {} {:?} {} x {} {} {} {} {} {} {:?}",
        view.scene.content_hash(),
        view.environment.hash(),
        view.camera,
        view.width,
        view.height,
        view.unshadowed,
        view.depth,
        policy.samples,
        policy.seed,
        part_text(opened.part()),
        opened.scale()
    );
    let stem = folder.join(blake3::hash(content.as_bytes()).to_hex().as_str());
    [stem.with_extension("exr"), stem.with_extension("coverage.exr")]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CameraSettings, ViewSettings};

    #[test]
    fn halves_give_the_variance_of_their_mean() {
        // Two values with errors of +3 and -1: the error of the mean is 1, and half the distance is 2.
        let image = |value: f32| Image { width: 2, height: 1, pixels: vec![[value; 3], [100.0; 3]] };
        let noise = Noise::of(&image(13.0), &image(11.0), &[true, false]).unwrap();
        assert!((noise.mse - 4.0).abs() < 1e-6 && noise.relmse > 0.0);
        assert_eq!((Noise::without(10.0, 4.0), Noise::without(1.0, 4.0), Noise::without(3.0, 0.0)), (6.0, 0.2, 3.0));
    }

    #[test]
    fn references_are_refined_to_a_fraction_of_the_smallest_error_and_kept() {
        let view = ViewSettings::new("sphere", "studio", CameraSettings::of_size(24, 18)).open().unwrap();
        let (folder, stop) = (tempfile::tempdir().unwrap(), AtomicBool::new(false));
        let cache = Some(folder.path());
        let policy = ReferencePolicy { samples: 4, most_samples: 256, fraction: 0.1, seed: 3 };
        let mut reference = Reference::obtain(&view, policy, cache, &stop, &|_| {}).unwrap();
        let before = reference.noise.unwrap().mse;
        assert!(!reference.refine(&view, 20.0 * before, cache, &stop, &|_| {}).unwrap(), "it is converged");
        assert!(reference.refine(&view, before, cache, &stop, &|_| {}).unwrap());
        let after = reference.noise.unwrap().mse;
        assert!(reference.samples >= 40 && after < 0.3 * before, "{after} of {before}");
        let again = Reference::obtain(&view, policy, cache, &stop, &|_| {}).unwrap();
        assert_eq!(
            (again.samples, &again.image, &again.covered),
            (reference.samples, &reference.image, &reference.covered)
        );
        assert!((again.noise.unwrap().mse / after - 1.0).abs() < 1e-5);
        assert!(reference.refine(&view, 1e-30, cache, &stop, &|_| {}).unwrap());
        assert_eq!(reference.samples, 256);
    }
}
