//! `headtail render`: one picture with one sampler.

use std::{
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
    time::Instant,
};

use anyhow::{Result, ensure};
use clap::Args;
use glam::{Affine3A, Vec3A};
use headtail_eval::{Budget, Choice, GraphicsDevice, OpenedView, Renderer, Trial, part_text};
use headtail_render::{
    file,
    image::{Attribute, Channel, encode_layered_exr, latin_1, write_exr, write_png},
    integrator::{self, Features, Rendering, View},
    memory,
    spec::{SamplerSpec, Source},
    timings::Timings,
};

use crate::terminal::{self, say};
use crate::{
    arguments::{ViewArguments, budget, note_surfaces, note_use, samplers_help},
    crop::Crop,
    device::{DEVICES, Device},
    exposure,
    given::{given, one_of},
    light::LightArguments,
    output::OutputFile,
    progress,
};

/// Render with one sampler.
/// Writes FILE.exr (linear) and FILE.png (tone-mapped).
#[derive(Args)]
#[command(after_help = "Examples:
  headtail render --scene temple --env studio --spp 64 --out out/temple.exr
  headtail render --scene spot.glb --ground --material lambert --env room.hdr --sampler direct:out/room-direct.safetensors --seconds 10 --out out/spot.exr
  headtail render --scene dishes --env studio --material ggx:alpha=0.2..0.8 --sampler mis --spp 64 --out out/glossy.exr
  headtail render --scene dishes --env studio --env-rotate 90 --env-scale 1,0.9,0.7 --sampler patches --spp 64 --crop 200,150,240,180 --aovs --out out/crop.exr
  headtail render --scene dishes --env sunset --sampler head+mis:out/sunset/sampler.safetensors --spp 16 --unshadowed --out out/dishes.exr
  headtail render --scene temple --env sunset --sampler split:4:patches --device gpu --spp 64 --out out/temple.exr

Ctrl-C writes the picture so far.")]
pub struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    #[arg(long, value_name = "SPEC", default_value = "auto", value_parser = given::<SamplerSpec>())]
    #[arg(help = "Sampler of directions; --help lists them", long_help = samplers_help("Sampler of directions; fit says which one its file is."))]
    sampler: SamplerSpec,
    /// Samples per pixel.
    #[arg(long, conflicts_with = "seconds", required_unless_present = "seconds")]
    spp: Option<u32>,
    /// Render for this many seconds instead.
    #[arg(long)]
    seconds: Option<f64>,
    /// What renders.
    #[arg(long, default_value = "cpu", value_parser = one_of(&DEVICES))]
    device: Device,
    /// Seed of the samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Stops added to the automatic exposure of the PNG.
    /// The automatic exposure brings the mean of the surfaces, without their brightest 5 %, to a middle
    /// brightness.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    exposure: f32,
    /// Print the thread-seconds of each stage.
    /// Reading the clock slows rendering down by a few per cent.
    #[arg(long, conflicts_with = "device")]
    timings: bool,
    #[command(flatten)]
    light: LightArguments,
    /// Render only a part: first column, first row, width and height.
    /// In pixels of the whole picture.
    #[arg(long, value_name = "X,Y,W,H")]
    crop: Option<Crop>,
    /// Also write albedo, shading normals and depth.
    /// As layers of FILE.aovs.exr.
    #[arg(long)]
    aovs: bool,
    /// Print what was rendered as a JSON object.
    #[arg(long)]
    json: bool,
    /// Linear OpenEXR file; the PNG is written beside it.
    #[arg(long, value_name = "FILE.exr")]
    out: PathBuf,
}

/// Renders and writes both files.
pub fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")),
        "--out {}: the file's name must end in .exr",
        arguments.out.display()
    );
    let budget = budget(arguments.spp, arguments.seconds)?;
    let stop = progress::stop_flag()?;
    let png = arguments.out.with_extension("png");
    let (exr_file, png_file) = (OutputFile::take(&arguments.out)?, OutputFile::take(&png)?);
    let aovs_file = arguments.aovs.then(|| OutputFile::take(&aovs(&arguments.out))).transpose()?;
    if arguments.json {
        terminal::only_data();
    }
    let opened = arguments.view.open_part(arguments.light, arguments.crop)?;
    memory::require_pictures(opened.part().width, opened.part().height, 0)?;
    let busy = progress::busy("sampler");
    let device = arguments.device.open(&opened)?;
    let start = Instant::now();
    let Prepared { sampler, renderer, choice } = match &device {
        // `auto` is chosen on the CPU, by the costs of samples there.
        Some(device) if *arguments.sampler.source() == Source::Auto => {
            let chosen = prepared(&arguments.sampler, &opened, budget, &stop)?;
            Prepared { renderer: device.renderer(&chosen.sampler)?, ..chosen }
        }
        Some(device) => {
            let (sampler, choice) = (arguments.sampler.clone(), None);
            Prepared { renderer: device.renderer(&sampler)?, sampler, choice }
        }
        None => prepared(&arguments.sampler, &opened, budget, &stop)?,
    };
    let preparation = start.elapsed().as_secs_f64();
    drop(busy);
    if let Some(choice) = &choice {
        say!("{choice}");
    }
    note_use(&sampler)?;
    note_surfaces(&sampler, &opened)?;
    let bar = progress::bar(progress::FRACTION_UNITS, "rendering");
    if arguments.timings {
        Timings::start();
    }
    let points = opened.points(arguments.seed);
    let rendering = opened.render_by(&*renderer, budget, points, &stop, &bar.fraction_setter())?;
    bar.finish_and_clear();

    let image = rendering.composite();
    let sampler = sampler.to_string();
    let mut attributes = attributes(&opened, &sampler, &rendering, arguments.seed);
    attributes.extend(device.iter().map(|device| Attribute::new("device", latin_1(&device.name()))));
    attributes.extend(choice.iter().map(|choice| Attribute::new("auto", latin_1(choice))));
    let stops = exposure::of_rendering(&rendering) + arguments.exposure;
    attributes.push(Attribute::new("png.exposure", stops));
    exr_file.write(|path| write_exr(path, &image, &attributes))?;
    png_file.write(|path| write_png(path, &image, stops))?;
    say!(
        "{sampler}: {} spp of {} points in {:.2} s, {:.2} shadow rays per sample, largest weight {:.3}",
        rendering.spp,
        rendering.points,
        rendering.seconds,
        rendering.rays_per_sample,
        rendering.max_weight
    );
    if let Some(device) = &device {
        say!("rendered on {}", device.name());
    }
    if let Some(learned) = rendering.learned {
        let (megabytes, unknown) = (learned.bytes as f64 / 1e6, 100.0 * learned.unknown);
        say!(
            "visibility: {} cells, {megabytes:.1} MB, {}",
            learned.cells,
            if learned.pays {
                format!("predicted gain {:.2}, {unknown:.1} % of samples outside of cells", learned.gain)
            } else {
                format!("not used: the predicted gain of {:.2} is below the cost", learned.gain)
            }
        );
    }
    if arguments.timings {
        let threads = rayon::current_num_threads();
        say!("thread-seconds by stage, of {threads} threads:\n{}", Timings::take(rendering.seconds, threads));
    }
    say!("{} and {} (exposed by {stops:+.1} stops) written", arguments.out.display(), png.display());
    if let Some(file) = aovs_file {
        let features = integrator::features(opened.view(), opened.part());
        file.write(|path| write_features(path, &features, arguments.light.env_rotate, &attributes))?;
        say!("{} written", aovs(&arguments.out).display());
    }
    if arguments.json {
        terminal::print_json(&serde_json::json!({
            "file": arguments.out.display().to_string(),
            "sampler": sampler,
            "auto": choice,
            "device": device.as_ref().map(GraphicsDevice::name),
            "spp": rendering.spp,
            "points": rendering.points.to_string(),
            "preparation_seconds": preparation,
            "seconds": rendering.seconds,
            "rays_per_sample": rendering.rays_per_sample,
            "max_weight": rendering.max_weight,
            "seed": arguments.seed,
        }))?;
    }
    Ok(())
}

/// A sampler that is ready to render.
struct Prepared {
    sampler: SamplerSpec,
    renderer: Box<dyn Renderer>,
    /// What explains the choice of `auto`.
    choice: Option<String>,
}

/// Opens the sampler of a SPEC on the CPU.
fn prepared(spec: &SamplerSpec, opened: &OpenedView, budget: Budget, stop: &AtomicBool) -> Result<Prepared> {
    if *spec.source() != Source::Auto {
        return Ok(Prepared { sampler: spec.clone(), renderer: Box::new(opened.estimator(spec)?), choice: None });
    }
    let Choice { spec, estimator, trials, reason, seconds } = headtail_eval::choose(opened, budget, stop)?;
    let efficiency = |trial: &Trial| match trial.efficiency(&trials) {
        Some(efficiency) => format!("{} {efficiency:.2}", trial.spec),
        None => format!("{} missed light", trial.spec),
    };
    let trials: Vec<String> = trials.iter().map(efficiency).collect();
    let why = match trials.is_empty() {
        true => reason.to_owned(),
        false => format!("relative {reason} of {seconds:.2} s: {}", trials.join(", ")),
    };
    let choice = Some(format!("auto: {spec} ({why})"));
    Ok(Prepared { sampler: spec, renderer: Box::new(estimator), choice })
}

/// Returns the path of the features of a picture.
fn aovs(out: &Path) -> PathBuf {
    out.with_extension("aovs.exr")
}

/// Writes features as layers; normals are turned back from the map to the scene.
fn write_features(path: &Path, features: &Features, turned: f32, attributes: &[Attribute]) -> Result<()> {
    let back = Affine3A::from_rotation_y(turned.to_radians());
    let normal = |pixel: &[f32; 3]| back.transform_vector3a(Vec3A::from_array(*pixel)).to_array();
    let normals: Vec<[f32; 3]> = features.normal.pixels.iter().map(normal).collect();
    let layer = |layer: &str, channels: [&str; 3], pixels: &[[f32; 3]]| {
        let channel = |k: usize| Channel {
            name: format!("{layer}.{}", channels[k]),
            values: pixels.iter().map(|pixel| pixel[k]).collect(),
        };
        [channel(0), channel(1), channel(2)]
    };
    let mut channels = Vec::from(layer("albedo", ["R", "G", "B"], &features.albedo.pixels));
    channels.extend(layer("normal", ["X", "Y", "Z"], &normals));
    channels.push(Channel { name: "depth.Z".into(), values: features.depth.clone() });
    let (width, height) = (features.albedo.width, features.albedo.height);
    Ok(file::replace(path, &encode_layered_exr(width, height, channels, attributes)?)?)
}

/// Returns the attributes of an OpenEXR result.
pub fn attributes(opened: &OpenedView, sampler: &str, rendering: &Rendering, seed: u64) -> Vec<Attribute> {
    let View { environment, depth, width, height, .. } = opened.view();
    let (camera, part) = (opened.own_camera(), opened.part());
    let triple = |v: glam::Vec3A| format!("{},{},{}", v.x, v.y, v.z);
    let mut attributes = vec![
        Attribute::new("scene", latin_1(&opened.scene_name())),
        Attribute::new("environment", latin_1(environment.name())),
        Attribute::new("environment.hash", environment.hash()),
        Attribute::new("environment.rotated", opened.rotation()),
        Attribute::new("environment.scale", triple(opened.scale())),
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
    ];
    if (part.width, part.height) != (width, height) {
        attributes.push(Attribute::new("crop", part_text(part)));
    }
    attributes
}
