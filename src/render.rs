//! `headtail render`: one picture with one sampler.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use headtail_render::{
    color::luminance,
    estimator::Estimator,
    image::{Attribute, Image, latin_1, write_exr, write_png},
    integrator::{self, Budget, Rendering, View},
    points::Points,
    spec::SamplerSpec,
    timings::Timings,
};

use crate::terminal::{self, say};
use crate::{
    arguments::{OpenedView, ViewArguments, budget, note_use},
    output::{self, OutputFile},
    progress,
};

/// Render with one sampler; writes FILE.exr (linear) and FILE.png (tone-mapped).
#[derive(Args)]
#[command(after_help = "Examples:
  headtail render --scene temple --env studio --sampler mis --spp 64 --out out/temple.exr
  headtail render --scene spot.glb --ground --material lambert --env room.hdr --sampler direct:out/room-direct.safetensors --seconds 10 --out out/spot.exr
  headtail render --scene dishes --env studio --material ggx:alpha=0.2..0.8 --sampler mis --spp 64 --out out/glossy.exr
  headtail render --scene dishes --env sunset --sampler head+mis:out/sunset/sampler.safetensors --spp 16 --unshadowed --out out/dishes.exr

Ctrl-C writes what there is.")]
pub struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    /// brdf (or cosine), emitter, mis, mis2, mis-comp, ris:M, head+mis:FILE, head:FILE, baked:FILE, direct:FILE, ris:M:direct:FILE or oracle (the
    /// exact product of light, BRDF and cosine, without visibility; slow); fit says which one its file is.
    #[arg(long, value_name = "SPEC")]
    sampler: SamplerSpec,
    /// Samples per pixel.
    #[arg(long, conflicts_with = "seconds", required_unless_present = "seconds")]
    spp: Option<u32>,
    /// Render for this long instead.
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of the samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Stops by which the PNG is made brighter than its automatic exposure.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    exposure: f32,
    /// Print where the time went, in thread-seconds by stage. Reading the clock slows rendering down by a few per cent.
    #[arg(long)]
    timings: bool,
    /// Linear OpenEXR file; the PNG lies beside it.
    #[arg(long, value_name = "FILE.exr")]
    out: PathBuf,
}

/// Luminance that the mean of a picture's surfaces is shown with.
const MIDDLE_GREY: f32 = 0.35;

/// Renders and writes both files.
pub fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")),
        "--out {}: the file's name must end in .exr",
        arguments.out.display()
    );
    let budget = budget(arguments.spp, arguments.seconds)?;
    let stop = progress::stop_flag()?;
    let _output = [arguments.out.clone(), arguments.out.with_extension("png")]
        .iter()
        .map(|file| if file == &arguments.out { OutputFile::take_exr(file) } else { OutputFile::take(file, |_| true) })
        .collect::<Result<Vec<_>>>()?;
    let opened = arguments.view.open()?;
    let estimator = arguments.sampler.build(&opened.environment)?;
    note_use(&arguments.sampler)?;
    let bar = progress::bar(1000, "rendering");
    if arguments.timings {
        Timings::start();
    }
    let points = opened.points(budget, arguments.seed);
    let rendering = integrator::render(opened.view(), &*estimator, budget, points, &stop, &bar.shares());
    bar.finish_and_clear();

    let image = rendering.composite();
    let sampler = arguments.sampler.to_string();
    write_exr(&arguments.out, &image, &attributes(&opened, &sampler, &rendering, arguments.seed))?;
    let png = arguments.out.with_extension("png");
    write_png(&png, &image, exposure(&rendering) + arguments.exposure)?;
    say!(
        "{sampler}: {} spp of {} points in {:.2} s, {:.2} shadow rays per sample, largest weight {:.3}",
        rendering.spp,
        rendering.points,
        rendering.seconds,
        rendering.rays_per_sample,
        rendering.max_weight
    );
    if let Some(learned) = rendering.learned {
        let (megabytes, unknown) = (learned.bytes as f64 / 1e6, 100.0 * learned.unknown);
        say!(
            "visibility: {} cells, {megabytes:.1} MB, {unknown:.1} % of samples where nothing was known",
            learned.cells
        );
    }
    if arguments.timings {
        let threads = rayon::current_num_threads();
        say!("thread-seconds by stage, of {threads} threads:\n{}", Timings::take(rendering.seconds, threads));
    }
    say!("{} and {} written", arguments.out.display(), png.display());
    Ok(())
}

/// What an OpenEXR result says of itself.
pub fn attributes(opened: &OpenedView, sampler: &str, rendering: &Rendering, seed: u64) -> Vec<Attribute> {
    let View { camera, environment, depth, .. } = opened.view();
    let triple = |v: glam::Vec3A| format!("{},{},{}", v.x, v.y, v.z);
    vec![
        Attribute::new("scene", latin_1(&opened.scene_name())),
        Attribute::new("environment", latin_1(environment.name())),
        Attribute::new("environment.hash", environment.hash()),
        Attribute::new("camera.look_from", triple(camera.look_from())),
        Attribute::new("camera.look_at", triple(camera.look_at())),
        Attribute::new("camera.fov", camera.vertical_fov()),
        Attribute::new("depth", depth as i32),
        Attribute::new("sampler", latin_1(sampler)),
        Attribute::new("spp", rendering.spp as i32),
        Attribute::new("points", rendering.points.to_string()),
        // OpenEXR has no 64-bit integers.
        Attribute::new("seed", seed.to_string()),
        Attribute::new("seconds", rendering.seconds),
        Attribute::new("headtail.version", env!("CARGO_PKG_VERSION")),
        Attribute::new("headtail.command", latin_1(&terminal::command())),
        Attribute::new(output::REQUEST, output::request()),
    ]
}

/// The exposure in stops that puts the mean luminance of the surfaces (of the whole picture, where there is none) at a middle
/// grey. The mean does not depend on noise, so pictures of one view by different samplers are equally bright.
pub fn exposure(rendering: &Rendering) -> f32 {
    let mean = |image: &Image, area: f32| {
        image.pixels.iter().map(|&pixel| luminance(pixel.into())).sum::<f32>() / area.max(1.0)
    };
    let surfaces = mean(&rendering.surfaces, rendering.coverage.iter().sum());
    let shown = if surfaces > 0.0 { surfaces } else { mean(&rendering.background, rendering.coverage.len() as f32) };
    if shown > 0.0 && shown.is_finite() { (MIDDLE_GREY / shown).log2() } else { 0.0 }
}

/// Renders without a progress bar, and to the end.
pub fn quietly(view: View<'_>, estimator: &dyn Estimator, budget: Budget, points: Points) -> Rendering {
    integrator::render(view, estimator, budget, points, &std::sync::atomic::AtomicBool::new(false), &|_| {})
}
