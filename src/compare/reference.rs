//! The image that errors are measured against: read, rendered, or found among those rendered before.

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Result, bail, ensure};
use headtail_render::{
    image::{Image, read_radiance, write_exr},
    integrator::{Budget, Rendering},
    points::{PointSet, Points},
    spec::SamplerSpec,
};

use super::{Arguments, noise::Noise};
use crate::{
    arguments::{OpenedView, ViewArguments},
    crop,
    output::{OutputFolder, make_folder},
    progress::{self, Interrupted},
    render::attributes,
};

/// Part of every name in a cache; to be raised when the renderer changes what its images converge to, or how near they come.
const CACHE_VERSION: u32 = 4;

/// The points of references, whatever those of the runs are: the error of `sobol` is the smallest.
const POINTS: PointSet = PointSet::Sobol;

/// The sampler of references: of those without a file, the one with the least error under such points.
const SAMPLER: &str = "patches";

/// The reference of a comparison.
pub struct Reference {
    /// The whole image, background included.
    pub image: Image,
    /// `[height * width]` the pixels that surfaces cover entirely, over which errors are measured.
    pub covered: Vec<bool>,
    /// How it came about.
    pub note: String,
    /// Its own errors, where they are known.
    pub noise: Option<Noise>,
}

impl Reference {
    /// Takes the image named by `--reference`, else one from the cache, else renders one (and keeps it in the cache).
    ///
    /// # Errors
    /// If an image cannot be read or written or has another size; [`Interrupted`] if the stop flag ends a rendering, of which
    /// nothing is written.
    pub fn obtain(
        arguments: &Arguments,
        opened: &OpenedView,
        output: &OutputFolder,
        stop: &AtomicBool,
    ) -> Result<Self> {
        Self::copied(arguments, opened, stop, Some(&output.file("reference.exr")?))
    }

    /// [`Self::obtain`], with a copy of an image that was not read from a file.
    fn copied(arguments: &Arguments, opened: &OpenedView, stop: &AtomicBool, copy: Option<&Path>) -> Result<Self> {
        let size = (opened.part().width, opened.part().height);
        if let Some(file) = &arguments.reference {
            let image = read_sized(file, size)?;
            let covered = covered(&converged(arguments, opened, 64, stop)?.0.coverage)?;
            let noise = Noise::read(file);
            let unknown = if noise.is_none() { " Its own noise is not known, and not subtracted." } else { "" };
            return Ok(Self { image, covered, note: format!("Read from {}.{unknown}", file.display()), noise });
        }
        let cached = arguments.reference_cache.as_ref().map(|folder| folder.join(key(arguments, opened)));
        if let Some(stem) = &cached
            && let [image, coverage] = files(stem)
            && image.exists()
            && coverage.exists()
        {
            let noise = Noise::read(&image);
            let (image, coverage) = (read_sized(&image, size)?, read_sized(&coverage, size)?);
            let coverage: Vec<f32> = coverage.pixels.iter().map(|pixel| pixel[0]).collect();
            copy.map_or(Ok(()), |copy| {
                write_exr(copy, &image, &noise.map_or(Vec::new(), |noise| noise.attributes().into()))
            })?;
            let note = format!(
                "Rendered before at {} samples per pixel ({POINTS} points), and found in the cache.",
                arguments.reference_spp
            );
            return Ok(Self { image, covered: covered(&coverage)?, note, noise });
        }
        let (rendering, half) = converged(arguments, opened, arguments.reference_spp, stop)?;
        let image = rendering.composite();
        let covered = covered(&rendering.coverage)?;
        let noise = Noise::of(&half, &rendering.surfaces, &covered)?;
        let mut attributes = attributes(opened, SAMPLER, &rendering, seed(arguments));
        attributes.extend(noise.attributes());
        copy.map_or(Ok(()), |copy| write_exr(copy, &image, &attributes))?;
        if let Some(stem) = &cached {
            make_folder(stem.parent().unwrap_or(Path::new(".")))?;
            let [image_file, coverage_file] = files(stem);
            let coverage = Image { pixels: rendering.coverage.iter().map(|&c| [c; 3]).collect(), ..image };
            write_exr(&coverage_file, &coverage, &[])?;
            write_exr(&image_file, &image, &attributes)?;
        }
        let note = format!("Rendered with {SAMPLER} at {} samples per pixel ({POINTS} points).", rendering.spp);
        Ok(Self { image, covered, note, noise: Some(noise) })
    }

    /// Takes a reference from a folder that several processes share, or renders one and puts it there.
    ///
    /// # Errors
    /// As [`Self::obtain`].
    pub fn shared(view: &ViewArguments, opened: &OpenedView, spp: u32, cache: &Path) -> Result<Self> {
        let mut arguments = Arguments::new(view.clone(), Vec::new(), cache.to_owned());
        arguments.reference_spp = spp;
        arguments.reference_cache = Some(cache.to_owned());
        let stop = AtomicBool::new(false);
        Self::copied(&arguments, opened, &stop, None)
    }
}

/// Renders with the best sampler that needs no training, in two independent halves of at least one sample: the mean of
/// both, and the surfaces of one half. An interrupted rendering is an error.
fn converged(arguments: &Arguments, opened: &OpenedView, spp: u32, stop: &AtomicBool) -> Result<(Rendering, Image)> {
    let busy = progress::busy("reference");
    let estimator = SAMPLER.parse::<SamplerSpec>()?.build(&opened.environment)?;
    drop(busy);
    let bar = progress::bar(progress::SHARES, "reference");
    let show = bar.shares();
    let half = |number: u32| {
        let points = Points::new(POINTS, seed(arguments) ^ u64::from(number));
        let show = |share: f64| show(0.5 * (f64::from(number) + share));
        opened.render(&*estimator, Budget::Spp(spp.div_ceil(2)), points, stop, &show)
    };
    let first = half(0);
    let second = if stop.load(Ordering::Relaxed) { first.clone() } else { half(1) };
    bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) {
        bail!(Interrupted::new("while the reference was rendered; no run is done"));
    }
    let surfaces = first.surfaces.clone();
    Ok((mean_of(first, &second), surfaces))
}

/// The mean of two renderings of equally many samples.
fn mean_of(mut a: Rendering, b: &Rendering) -> Rendering {
    let pixels = a.surfaces.pixels.iter_mut().chain(&mut a.background.pixels);
    for (to, from) in pixels.zip(b.surfaces.pixels.iter().chain(&b.background.pixels)) {
        *to = std::array::from_fn(|channel| 0.5 * (to[channel] + from[channel]));
    }
    a.coverage.iter_mut().zip(&b.coverage).for_each(|(to, from)| *to = 0.5 * (*to + from));
    (a.spp, a.seconds) = (a.spp + b.spp, a.seconds + b.seconds);
    a
}

/// A seed far from those of the runs.
fn seed(arguments: &Arguments) -> u64 {
    arguments.seed ^ 0x5eed_0000_0000
}

/// The pixels that surfaces cover entirely.
///
/// # Errors
/// If there is none: nothing could be measured.
fn covered(coverage: &[f32]) -> Result<Vec<bool>> {
    let covered: Vec<bool> = coverage.iter().map(|&share| share == 1.0).collect();
    ensure!(covered.contains(&true), "no pixel is covered by a surface: move the camera");
    Ok(covered)
}

/// The hash of all that the reference depends on.
fn key(arguments: &Arguments, opened: &OpenedView) -> String {
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
        arguments.reference_spp,
        seed(arguments),
        crop::text(opened.part()),
        opened.light().env_scale
    );
    blake3::hash(content.as_bytes()).to_hex().to_string()
}

/// The image and the coverage of an entry of the cache.
fn files(stem: &Path) -> [std::path::PathBuf; 2] {
    [stem.with_extension("exr"), stem.with_extension("coverage.exr")]
}

fn read_sized(file: &Path, (width, height): (usize, usize)) -> Result<Image> {
    let image = read_radiance(file)?;
    ensure!(
        (image.width, image.height) == (width, height),
        "{}: the image is {} x {}; the comparison is {width} x {height}",
        file.display(),
        image.width,
        image.height
    );
    Ok(image)
}
