//! The image that errors are measured against: read, rendered, or found among those rendered before.

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Result, bail, ensure};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    estimator::{Estimator, Ris, SingleSample},
    image::{Image, read_radiance, write_exr},
    integrator::{Budget, Rendering, render},
    points::{PointSet, Points},
    sampler::{BrdfSampler, Covering, EnvironmentLight, ProductSampler},
    tail::TailKind,
};

use super::Arguments;
use crate::{
    arguments::{OpenedView, ViewArguments, make_folder},
    output::OutputFolder,
    progress::{self, Interrupted},
    render::attributes,
};

/// Part of every name in a cache; to be raised when the renderer changes what its images converge to.
const CACHE_VERSION: u32 = 1;

/// The points of references, whatever those of the runs are: the error of `sobol` is the smallest.
const POINTS: PointSet = PointSet::Sobol;

/// The reference of a comparison.
pub struct Reference {
    /// The whole image, background included.
    pub image: Image,
    /// `[height * width]` the pixels that surfaces cover entirely, over which errors are measured.
    pub covered: Vec<bool>,
    /// How it came about.
    pub note: String,
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
        let size = (arguments.view.camera.width as usize, arguments.view.camera.height as usize);
        if let Some(file) = &arguments.reference {
            let image = read_sized(file, size)?;
            let covered = covered(&converged(arguments, opened, 64, stop)?.0.coverage);
            return Ok(Self { image, covered, note: format!("Read from {}.", file.display()) });
        }
        let cached = arguments.reference_cache.as_ref().map(|folder| folder.join(key(arguments, opened)));
        if let Some(stem) = &cached
            && let [image, coverage] = files(stem)
            && image.exists()
            && coverage.exists()
        {
            let (image, coverage) = (read_sized(&image, size)?, read_sized(&coverage, size)?);
            let coverage: Vec<f32> = coverage.pixels.iter().map(|pixel| pixel[0]).collect();
            copy.map_or(Ok(()), |copy| write_exr(copy, &image, &[]))?;
            let note = format!(
                "Rendered before at {} samples per pixel ({POINTS} points), and found in the cache.",
                arguments.reference_spp
            );
            return Ok(Self { image, covered: covered(&coverage), note });
        }
        let (rendering, by) = converged(arguments, opened, arguments.reference_spp, stop)?;
        let image = rendering.composite();
        copy.map_or(Ok(()), |copy| write_exr(copy, &image, &attributes(opened, by, &rendering, seed(arguments))))?;
        if let Some(stem) = &cached {
            make_folder(stem.parent().unwrap_or(Path::new(".")))?;
            let [image_file, coverage_file] = files(stem);
            let coverage = Image { pixels: rendering.coverage.iter().map(|&c| [c; 3]).collect(), ..image };
            write_exr(&coverage_file, &coverage, &[])?;
            write_exr(&image_file, &image, &attributes(opened, by, &rendering, seed(arguments)))?;
        }
        let note = format!("Rendered with {by} at {} samples per pixel ({POINTS} points).", rendering.spp);
        Ok(Self { image, covered: covered(&rendering.coverage), note })
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

/// Renders with the best sampler that needs no training; it and its name. An interrupted rendering is an error.
fn converged<'a>(
    arguments: &Arguments,
    opened: &OpenedView,
    spp: u32,
    stop: &AtomicBool,
) -> Result<(Rendering, &'a str)> {
    let environment = &opened.environment;
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(64, 64)?)?;
    let product = Covering::new(ProductSampler::new(light, table))?;
    // The table knows the cosine, not the lobes of glossy surfaces: they are left to BRDF samples.
    let (estimator, by): (Box<dyn Estimator>, &str) = if opened.is_diffuse() {
        (Box::new(SingleSample::new(product, environment.clone())), "the direct bake (64 x 64 cells)")
    } else {
        let resampled = Ris::new(product, Covering::new(BrdfSampler)?, 8, environment.clone())?;
        (Box::new(resampled), "RIS of 8 candidates, from the direct bake (64 x 64 cells) and the BRDF,")
    };
    let bar = progress::bar(1000, "reference");
    let points = Points::new(POINTS, seed(arguments));
    let rendering = render(opened.view(), &*estimator, Budget::Spp(spp), points, stop, &bar.shares());
    bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) {
        bail!(Interrupted::new("while the reference was rendered; no run is done"));
    }
    Ok((rendering, by))
}

/// A seed far from those of the runs.
fn seed(arguments: &Arguments) -> u64 {
    arguments.seed ^ 0x5eed_0000_0000
}

fn covered(coverage: &[f32]) -> Vec<bool> {
    coverage.iter().map(|&share| share == 1.0).collect()
}

/// The hash of all that the reference depends on.
fn key(arguments: &Arguments, opened: &OpenedView) -> String {
    let view = opened.view();
    let content = format!(
        "{CACHE_VERSION} {POINTS} {} {} {:?} {} x {} {} {} {} {}",
        view.scene.content_hash(),
        view.environment.hash(),
        view.camera,
        view.width,
        view.height,
        view.unshadowed,
        view.depth,
        arguments.reference_spp,
        seed(arguments)
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
