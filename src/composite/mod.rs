//! `headtail composite`: a virtual object in a photograph.

mod arguments;
mod page;
mod setting;

pub use arguments::Arguments;

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail, ensure};
use headtail_render::{
    composite::{Composition, Film, Layers, Mask, Settings, compose},
    file,
    image::{Attribute, Image, encode_png_rgb8, srgb_code, write_exr},
};

use crate::terminal::{self, note, say, warning};
use crate::{
    arguments::note_use,
    exposure,
    output::OutputFolder,
    progress,
    report::{number::duration, picture},
};
pub use setting::Setting;

/// Names of the result files.
const RESULTS: [&str; 5] = ["composite.png", "composite.exr", "layers.exr", "mask.png", "composite.html"];

/// Composites and writes everything.
pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.json {
        terminal::only_data();
    }
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
    }
    let stop = progress::stop_flag()?;
    let output = OutputFolder::take(&arguments.out, &RESULTS)?;
    let setting = Setting::open(arguments)?;
    let estimator = arguments.sampler.build(&setting.environment)?;
    note_use(&arguments.sampler)?;
    output.begin()?;
    let backdrop = setting.backdrop();
    let composition =
        Composition { stage: &setting.stage, backdrop: &backdrop, camera: &setting.camera, estimator: &*estimator };
    let settings = Settings {
        width: setting.photograph.image.width,
        height: setting.photograph.image.height,
        spp: arguments.spp.unwrap_or(if arguments.preview { 8 } else { 64 }),
        depth: arguments.depth,
        seed: arguments.seed,
        mask_only: false,
    };
    announce(composition, settings);
    let bar = progress::bar(progress::FRACTION_UNITS, "compositing");
    let film = compose(composition, settings, &stop, &bar.fraction_setter());
    bar.finish_and_clear();
    check_sight(&film)?;
    let mask = Mask::of(&film, arguments.mask);
    let layers = Layers::new(&film, &mask, &setting.photograph, setting.to_map, !arguments.grey_mask);
    write(arguments, &output, &setting, &film, &layers)?;
    if arguments.json {
        terminal::print_json(&facts(arguments, &setting, &film, &mask))?;
    }
    if stop.load(Ordering::Relaxed) {
        bail!(progress::Interrupted::new(format!(
            "{} of {} samples per pixel were done and are written",
            film.spp, settings.spp
        )));
    }
    Ok(())
}

/// Minimum duration, in seconds, of work that is announced.
const LONG: f64 = 10.0;
/// Side, in pixels, of the squares that have one sample each in the trial.
const TRIAL: usize = 8;

/// Announces the expected duration, after a trial at a small size.
fn announce(composition: Composition<'_>, settings: Settings) {
    let (width, height) = ((settings.width / TRIAL).max(1), (settings.height / TRIAL).max(1));
    let trial = compose(composition, Settings { width, height, spp: 1, ..settings }, &AtomicBool::new(false), &|_| {});
    let samples = |width: usize, height: usize, spp: u32| (width * height) as f64 * f64::from(spp);
    let ratio = samples(settings.width, settings.height, settings.spp) / samples(width, height, 1);
    let seconds = trial.seconds * ratio;
    if seconds >= LONG {
        note!("compositing will take about {}", duration(seconds));
    }
}

/// Returns the object that `--json` prints.
fn facts(arguments: &Arguments, setting: &Setting, film: &Film, mask: &Mask) -> serde_json::Value {
    let caught = film.catcher.iter().zip(&mask.values).filter(|(sums, _)| sums.hits == film.spp);
    let (sum, count) = caught.fold((0.0, 0.0), |(sum, count), (_, value)| (sum + f64::from(value[3]), count + 1.0));
    let spp = f64::from(film.spp.max(1));
    serde_json::json!({
        "folder": arguments.out.display().to_string(),
        "width": film.width,
        "height": film.height,
        "spp": film.spp,
        "seconds": film.seconds,
        "sampler": arguments.sampler.resolved(false).to_string(),
        "mask": arguments.mask.to_string(),
        "gain": setting.gain,
        "env_rotate": arguments.light.env_rotate,
        "env_scale": arguments.light.env_scale.0.to_array(),
        "catcher": arguments.catcher,
        "mask_rays": film.mask_rays,
        "other_rays": film.other_rays,
        "object_pixels": film.object.iter().map(|object| f64::from(object.0) / spp).sum::<f64>(),
        "mean_mask": if count > 0.0 { Some(sum / count) } else { None },
        "seed": arguments.seed,
    })
}

/// Returns an error if the view shows nothing.
fn check_sight(film: &Film) -> Result<()> {
    ensure!(
        film.object.iter().any(|object| object.0 > 0),
        "the camera does not see the object: try --move, --size, or --up y"
    );
    if film.catcher.iter().all(|sums| sums.hits == 0) {
        warning!("the camera does not see the catcher; there will be no shadow");
    }
    Ok(())
}

/// Conversion of pictures to 8 bits: photographs of sRGB codes keep them, those of radiance get an exposure
/// and a tone curve.
#[derive(Clone, Copy)]
pub struct Development {
    /// Stops before the tone curve; `None` for sRGB codes.
    exposure: Option<f32>,
}

impl Development {
    /// Returns the conversion for composites into this photograph.
    pub fn of(setting: &Setting) -> Self {
        let photograph = &setting.photograph;
        Self { exposure: photograph.is_radiance.then(|| exposure::of_photograph(&photograph.image) + 0.5) }
    }

    /// Encodes a picture as PNG.
    pub fn png(self, image: &Image) -> Result<Vec<u8>> {
        Ok(match self.exposure {
            Some(stops) => headtail_render::image::encode_png(image, stops)?,
            None => codes(image)?,
        })
    }
}

/// Encodes values in `[0, 1]` as an sRGB PNG.
fn codes(image: &Image) -> Result<Vec<u8>> {
    let codes: Vec<[u8; 3]> = image.pixels.iter().map(|pixel| pixel.map(srgb_code)).collect();
    Ok(encode_png_rgb8(image.width, image.height, &codes)?)
}

fn write(arguments: &Arguments, output: &OutputFolder, setting: &Setting, film: &Film, layers: &Layers) -> Result<()> {
    let composite = layers.composite();
    let attributes = [
        Attribute::new("sampler", arguments.sampler.resolved(false).to_string()),
        Attribute::new("mask", arguments.mask.to_string()),
        Attribute::new("spp", film.spp as i32),
        Attribute::new("gain", setting.gain),
        Attribute::new("environment.rotated", arguments.light.env_rotate),
        Attribute::new(
            "environment.scale",
            arguments.light.env_scale.0.to_array().map(|factor| factor.to_string()).join(","),
        ),
        Attribute::new("headtail.version", env!("CARGO_PKG_VERSION")),
    ];
    let development = Development::of(setting);
    let out = |name: &str| output.file(name);
    let composite_png = development.png(&composite)?;
    file::replace(&out("composite.png")?, &composite_png)?;
    write_exr(&out("composite.exr")?, &composite, &attributes)?;
    file::replace(&out("layers.exr")?, &layers.encode_exr(&attributes)?)?;
    let mask_png = codes(&layers.shadow)?;
    file::replace(&out("mask.png")?, &mask_png)?;
    let pictures = page::Pictures {
        photograph: picture::data_address(&development.png(&layers.photograph)?),
        composite: picture::data_address(&composite_png),
        object: picture::data_address(&development.png(&layers.object)?),
        mask: picture::data_address(&mask_png),
        light: picture::data_address(&development.png(&layers.light)?),
    };
    let page = page::page(arguments, setting, film, &pictures);
    file::replace(&out("composite.html")?, page.as_bytes())?;
    say!(
        "{} spp in {:.2} s: {} shadow rays of the mask, {} others",
        film.spp,
        film.seconds,
        film.mask_rays,
        film.other_rays
    );
    say!("{} written; the page to open is {}", out("composite.png")?.display(), out("composite.html")?.display());
    Ok(())
}
