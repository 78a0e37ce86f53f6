//! `headtail inspect`: the densities of an exported sampler as a picture.

mod tails;

use std::path::PathBuf;

use anyhow::{Result, anyhow, bail, ensure};
use clap::Args;
use glam::{Vec2, Vec3A};
use headtail_render::{
    export::{ExportedSampler, Intermediate},
    file,
    image::encode_png_rgb8,
    latlong,
    tail::TailWarp,
};
use plotters::{
    prelude::*,
    style::{FontStyle, colors::colormaps::ColorMap, register_font, text_anchor},
};

use crate::arguments::{Triple, make_folder, open_environment};

/// Draw target, intermediate and final density of an exported sampler side by side, on a log scale.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail inspect out/studio/sampler.safetensors --out out/studio-up.png
  headtail inspect out/room-direct.safetensors --normal 1,0.5,0 --out out/room-side.png
  headtail inspect --tail --env room.hdr out/flow/sampler.safetensors --out out/room-tails.png

The target and the final density are lat-long pictures of the sphere per unit of solid angle; the intermediate density is \
over the intermediate square Y (azimuth across, elevation down). Each has a colour scale of its own, of six powers of ten.")]
pub struct Arguments {
    /// A file written by fit or bake.
    #[arg(required_unless_present = "tail")]
    file: Option<PathBuf>,
    /// Show what the tails of --env (and the flow tail of the file, if it has one) make of the square, with a table.
    #[arg(long, requires = "env")]
    tail: bool,
    /// The map for --tail: a built-in environment (overcast, window, studio, sunset) or a .hdr or .exr file.
    #[arg(long, value_name = "MAP", requires = "tail")]
    env: Option<String>,
    /// The shading normal; it need not have unit length.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,1,0", allow_hyphen_values = true)]
    normal: Triple,
    /// PNG file to write.
    #[arg(long, value_name = "FILE.png")]
    out: PathBuf,
}

const WIDTH: usize = 512;
const HEIGHT: usize = 256;
const MARGIN: i32 = 24;
const HEADER: i32 = 64;
const FOOTER: i32 = 64;
/// Powers of ten that the colour scale spans below the brightest value.
const DECADES: f32 = 6.0;

/// A density over a lat-long picture or the intermediate square, `[HEIGHT * WIDTH]`.
struct Panel {
    title: &'static str,
    values: Vec<f32>,
}

/// What the picture's header says.
struct Figures {
    kl: f64,
    relative_variance: f64,
    integral: f64,
}

/// Draws the picture.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let (true, Some(map)) = (arguments.tail, &arguments.env) {
        let file = arguments.file.as_deref().map(ExportedSampler::read).transpose()?;
        let (picture, table) = tails::inspect(&*open_environment(map)?, file.as_ref())?;
        write(arguments, &picture)?;
        println!("{table}{} written", arguments.out.display());
        return Ok(());
    }
    let normal = arguments.normal.0;
    ensure!(normal.length() > 1e-6, "--normal: the vector has no length");
    // The parser of arguments asks for it.
    let Some(file) = &arguments.file else { bail!("name a file") };
    let exported = ExportedSampler::read(file)?;
    let (panels, figures) = tabulate(&exported, normal.normalize())?;
    let title = format!(
        "{} of '{}', {} tail, normal {:.3} {:.3} {:.3}",
        kind(&exported.intermediate),
        exported.environment,
        exported.tail.kind().name(),
        normal.normalize().x,
        normal.normalize().y,
        normal.normalize().z
    );
    let facts = format!(
        "KL(target || sampler) {:.4} nats, relative variance {:.4}, integral of the pdf {:.5}",
        figures.kl, figures.relative_variance, figures.integral
    );
    write(arguments, &draw(&panels, &title, &facts)?)?;
    println!("{title}\n{facts}\n{} written", arguments.out.display());
    Ok(())
}

fn write(arguments: &Arguments, picture: &[u8]) -> Result<()> {
    if let Some(folder) = arguments.out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        make_folder(folder)?;
    }
    Ok(file::replace(&arguments.out, picture)?)
}

fn kind(intermediate: &Intermediate) -> &'static str {
    match intermediate {
        Intermediate::Head(_) => "Head",
        Intermediate::Bake(_) => "Bake of a head",
        Intermediate::DirectBake(_) => "Direct bake",
    }
}

/// The density over Y at a normal.
fn intermediate_density(exported: &ExportedSampler, normal: Vec3A) -> Box<dyn Fn(Vec2) -> f32 + '_> {
    match &exported.intermediate {
        Intermediate::Head(head) => {
            let prepared = head.prepare_normal(normal);
            Box::new(move |y| head.inverse_at(&prepared, y).1)
        }
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
            let prepared = table.prepare_normal(normal);
            Box::new(move |y| table.density_at(&prepared, y))
        }
    }
}

fn tabulate(exported: &ExportedSampler, normal: Vec3A) -> Result<([Panel; 3], Figures)> {
    let density = intermediate_density(exported, normal);
    let points = |k: usize| {
        Vec2::new((k % WIDTH) as f32 + 0.5, (k / WIDTH) as f32 + 0.5) / Vec2::new(WIDTH as f32, HEIGHT as f32)
    };
    let count = (WIDTH * HEIGHT) as f64;

    // Through an exact tail the target over Y is the cosine alone; another tail leaves some light over.
    let (mut intermediate, mut cosines) = (Vec::new(), Vec::new());
    for y in (0..WIDTH * HEIGHT).map(points) {
        intermediate.push(density(y));
        let (x, direction, _) = exported.tail.forward_direction(y);
        cosines.push(normal.dot(direction).max(0.0) * exported.tail.light_ratio(x));
    }
    let mean = cosines.iter().map(|&g| f64::from(g)).sum::<f64>() / count;
    ensure!(mean > 0.0, "a surface with this normal sees no light at all");
    let (mut kl, mut squares, mut integral) = (0.0, 0.0, 0.0);
    for (&q, &g) in intermediate.iter().zip(&cosines) {
        let (q, g) = (f64::from(q), f64::from(g) / mean);
        integral += q / count;
        if g > 0.0 {
            kl += g * (g / q).ln() / count;
            squares += g * g / q / count;
        }
    }

    let (mut target, mut last) = (Vec::new(), Vec::new());
    for x in (0..WIDTH * HEIGHT).map(points) {
        let (y, slope) = exported.tail.inverse(x);
        let light = slope * latlong::solid_angle_factor(x.y);
        let target_light = exported.tail.light().density(x) * latlong::solid_angle_factor(x.y);
        target.push(target_light * normal.dot(latlong::direction(x)).max(0.0) / mean as f32);
        last.push(light * if slope > 0.0 { density(y) } else { 0.0 });
    }
    let panels = [
        Panel { title: "target: light x cosine", values: target },
        Panel { title: "intermediate: q(y), over the square Y", values: intermediate },
        Panel { title: "final: pdf of the sampler", values: last },
    ];
    Ok((panels, Figures { kl, relative_variance: squares - 1.0, integral }))
}

/// The picture as PNG bytes.
fn draw(panels: &[Panel; 3], title: &str, facts: &str) -> Result<Vec<u8>> {
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| anyhow!("the font of the labels cannot be read"))?;
    let width = panels.len() as i32 * (WIDTH as i32 + MARGIN) + MARGIN;
    let height = HEADER + 24 + HEIGHT as i32 + FOOTER;
    let mut buffer = vec![255_u8; (width * height * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut buffer, (width as u32, height as u32)).into_drawing_area();
        let text = |x: i32, y: i32, size: i32, words: &str| {
            let style = ("sans-serif", size).into_font().color(&RGBColor(30, 30, 30));
            area.draw(&Text::new(words.to_owned(), (x, y), style)).map_err(|error| anyhow!("{error}"))
        };
        text(MARGIN, 12, 22, title)?;
        text(MARGIN, 40, 16, facts)?;
        for (index, panel) in panels.iter().enumerate() {
            let left = MARGIN + index as i32 * (WIDTH as i32 + MARGIN);
            text(left, HEADER + 2, 17, panel.title)?;
            // A pixel that holds a sun would leave nothing else to be seen: the scale ends at the 99.9th percentile.
            let top = percentile(&panel.values, 0.999);
            for (k, &value) in panel.values.iter().enumerate() {
                let level = if value > 0.0 { 1.0 + (value / top).log10() / DECADES } else { 0.0 };
                let place = (left + (k % WIDTH) as i32, HEADER + 24 + (k / WIDTH) as i32);
                area.draw_pixel(place, &ViridisRGB.get_color(level.clamp(0.0, 1.0)))
                    .map_err(|error| anyhow!("{error}"))?;
            }
            let below = HEADER + 24 + HEIGHT as i32 + 10;
            for x in 0..WIDTH as i32 {
                for y in 0..10 {
                    let color = ViridisRGB.get_color(x as f32 / (WIDTH - 1) as f32);
                    area.draw_pixel((left + x, below + y), &color).map_err(|error| anyhow!("{error}"))?;
                }
            }
            text(left, below + 14, 15, &format!("{:.1e}", top * 10.0_f32.powf(-DECADES)))?;
            let style = ("sans-serif", 15).into_font().color(&RGBColor(30, 30, 30));
            let right = style.pos(text_anchor::Pos::new(text_anchor::HPos::Right, text_anchor::VPos::Top));
            let unit = if index == 1 { "per unit of Y" } else { "1/sr" };
            area.draw(&Text::new(format!("{top:.1e} {unit}"), (left + WIDTH as i32, below + 14), right))
                .map_err(|error| anyhow!("{error}"))?;
        }
        area.present().map_err(|error| anyhow!("{error}"))?;
    }
    let (pixels, _) = buffer.as_chunks::<3>();
    Ok(encode_png_rgb8(width as usize, height as usize, pixels)?)
}

fn percentile(values: &[f32], share: f64) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share) as usize].max(f32::MIN_POSITIVE)
}
