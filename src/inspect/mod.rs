//! `headtail inspect`: the densities of an exported sampler as a picture.
//!
//! | file | concept |
//! | --- | --- |
//! | `tails.rs`, `discontinuities.rs` | `--tail`; discontinuities of a tail |
//! | `visibility.rs` | `--visibility` |
//! | `lights.rs`, `portals.rs` | `--lights`, `--portals` |
//! | `light_files.rs` | their files |
//! | `cloth.rs` | `--place`: a point of a neural material |

mod cloth;
mod discontinuities;
mod light_files;
mod lights;
mod portals;
pub mod tails;
mod visibility;

use std::{path::PathBuf, sync::Arc};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{BrdfTable, Ggx, Lambert, MAX_PARAMETERS, NeuralTexture, Surface, neural::open_measured},
    color::luminance,
    export::{ExportedSampler, Intermediate},
    file,
    head::Condition,
    latlong,
    scene::MaterialSpec,
    tail::TailWarp,
    tile::ShadingPoint,
};

use crate::arguments::{Triple, open_environment};
use crate::given::given;
use crate::output::OutputFile;
use crate::report::{
    chart::{Panel, Scale, Sides, densities},
    number,
    vector::Chart,
};
use crate::terminal::{self, out};

/// Draw target, intermediate and final density of a sampler.
/// Side by side, on a log scale.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail inspect out/studio/sampler.safetensors --out out/studio-up.svg
  headtail inspect out/room-direct.safetensors --normal 1,0.5,0 --out out/room-side.svg
  headtail inspect out/room-ggx/sampler.safetensors --material ggx:alpha=0.4 --view 1,1,0 --out out/room-glossy.svg
  headtail inspect out/cloth/sampler.safetensors --material neural:checkpoints/welt.safetensors --place 0.3,0.7 --out out/cloth.svg
  headtail inspect --visibility --scene bedroom --env room.hdr out/bedroom-visibility.safetensors --out out/bedroom-cells.svg
  headtail inspect --tail --env room.hdr out/flow/sampler.safetensors --out out/room-tails.svg
  headtail inspect --portals --scene bedroom --out out/portals.py
  headtail inspect --lights --env sky.exr --out out/suns.gltf --rest out/sky-without-suns.exr

A head that has learned how often to draw from BRDF sampling instead is shown in that mixture, as `head+mis` draws. The target \
and the final density are lat-long pictures of the sphere per unit of solid angle; the intermediate density is \
over the intermediate square Y (azimuth across, elevation down). Each has a colour scale of its own, of six powers of ten.")]
pub struct Arguments {
    /// File written by fit or bake.
    #[arg(required_unless_present_any = ["tail", "portals", "lights"])]
    file: Option<PathBuf>,
    /// Draw and measure the tails of --env.
    /// Includes the flow tail of the file, if it has one.
    #[arg(long, requires = "env")]
    tail: bool,
    /// Draw a file of bake --visibility.
    /// Its cells in false colours and, for one pixel, the map by learned and by traced visibility.
    #[arg(long, requires = "env", requires = "file", requires = "scene", conflicts_with = "tail", group = "of_scene")]
    visibility: bool,
    /// Find the windows and doors of --scene.
    /// Rectangles through which the light of the environment enters the room of the camera: for --sampler
    /// mis2:portals:FILE, as glTF nodes, as USD portal lights or as a script for Blender.
    #[arg(long, requires = "scene", conflicts_with_all = ["tail", "visibility", "file"], group = "of_scene")]
    portals: bool,
    /// Find the sun and the lamps of --env.
    /// As JSON, CSV, directional lights of glTF (KHR_lights_punctual) or a script for Blender: direction,
    /// irradiance of a surface that faces the light, solid angle.
    #[arg(long, requires = "env", conflicts_with_all = ["tail", "visibility", "portals", "file"])]
    lights: bool,
    /// Write the map without the lights of --lights.
    #[arg(long, value_name = "FILE.exr", requires = "lights")]
    rest: Option<PathBuf>,
    /// Map for --tail, --visibility and --lights.
    /// A built-in environment (overcast, window, studio, sunset) or a .hdr or .exr file.
    #[arg(long, value_name = "MAP", value_parser = given::<String>())]
    env: Option<String>,
    /// Shading normal, of any length.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,1,0", allow_hyphen_values = true)]
    normal: Triple,
    /// Direction to the viewer, of any length. Default: the normal.
    /// It must be on the normal's side.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    view: Option<Triple>,
    /// Surface: lambert, ggx:alpha=A, nbrdf:FILE#NAME or neural:FILE.
    /// Default: lambert; heads for glossy surfaces require it.
    #[arg(long, value_name = "MATERIAL", value_parser = given::<MaterialSpec>())]
    material: Option<MaterialSpec>,
    /// Print the figures as a JSON object.
    #[arg(long, conflicts_with = "visibility")]
    json: bool,
    /// SVG file to write; for --portals a .json, .gltf, .usda or .py file, for --lights .json, .csv, .gltf or .py.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    cloth: cloth::Arguments,
    #[command(flatten)]
    scene: visibility::Arguments,
}

const WIDTH: usize = 512;
const HEIGHT: usize = 256;
/// Powers of ten in the colour scale below the brightest value.
const DECADES: f64 = 6.0;

/// Figures in the picture's header.
struct Figures {
    kl: f64,
    relative_variance: f64,
    integral: f64,
    /// Learned weight of the head in the mixture with BRDF sampling, if there is one.
    mixture_weight: Option<f32>,
}

/// Draws the picture.
pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.portals {
        let (scene, camera) = arguments.scene.open()?;
        return portals::inspect(&scene, &camera, &arguments.out, arguments.json);
    }
    if let (true, Some(map)) = (arguments.lights, &arguments.env) {
        return lights::inspect(&*open_environment(map)?, &arguments.out, arguments.rest.as_deref(), arguments.json);
    }
    let is_drawing = arguments.out.extension().is_some_and(|extension| extension == "svg");
    ensure!(is_drawing, "--out {}: the picture is a drawing; name a .svg file", arguments.out.display());
    let output = OutputFile::take(&arguments.out)?;
    if let (true, Some(map)) = (arguments.tail, &arguments.env) {
        let file = arguments.file.as_deref().map(ExportedSampler::read).transpose()?;
        let environment = open_environment(map)?;
        let flow = file.as_ref().map(|file| tails::flow_of(file, &environment)).transpose()?.flatten();
        let tails::Found { picture, table, objects } = tails::inspect(&environment, flow)?;
        write(&output, &picture)?;
        if arguments.json {
            return terminal::print_json(&objects);
        }
        out!("{table}{} written", arguments.out.display());
        return Ok(());
    }
    if let (true, Some(map), Some(file)) = (arguments.visibility, &arguments.env, &arguments.file) {
        let (picture, said) = visibility::inspect(&arguments.scene, file, map)?;
        write(&output, &picture)?;
        out!("{said}\n{} written", arguments.out.display());
        return Ok(());
    }
    // The argument parser requires it.
    let Some(file) = &arguments.file else { bail!("name a file") };
    let exported = ExportedSampler::read(file)?;
    let (at, table) = shading_point(arguments, &exported.intermediate)?;
    let (panels, figures) = tabulate(&exported, &at, &table)?;
    let mut title = format!(
        "{} of '{}', {} tail, normal {}",
        kind(&exported.intermediate),
        exported.environment,
        exported.tail.kind().name(),
        number::vector(at.ns)
    );
    if let Some(material @ (MaterialSpec::Measured { .. } | MaterialSpec::Neural(_))) = &arguments.material {
        title += &format!(", {material}, view {}", number::vector(at.wo));
    } else if at.surface.brdf == BrdfTable::GGX {
        title += &format!(", alpha {}, view {}", at.lobe_width(), number::vector(at.wo));
    }
    let mut facts = format!(
        "KL(target || sampler) {:.4} nats, relative variance {:.4}, integral of q {:.5}",
        figures.kl, figures.relative_variance, figures.integral
    );
    if let Some(mixture_weight) = figures.mixture_weight {
        facts += &format!(", {:.0} % of samples from the head", 100.0 * mixture_weight);
    }
    write(&output, &densities("densities", &[title.clone(), facts.clone()], &panels, panels.len())?)?;
    if arguments.json {
        terminal::print_json(&serde_json::json!({
            "title": title,
            "kl": figures.kl,
            "relative_variance": figures.relative_variance,
            "integral": figures.integral,
            "share": figures.mixture_weight,
            "picture": arguments.out.display().to_string(),
        }))?;
    } else {
        out!("{title}\n{facts}\n{} written", arguments.out.display());
    }
    Ok(())
}

fn write(output: &OutputFile, picture: &Chart) -> Result<()> {
    let drawing = picture.widest().context("there is nothing to draw")?;
    output.write(|path| file::replace(path, drawing.file().as_bytes()))
}

/// Returns the surface that the arguments describe, if it suits the sampler.
fn shading_point(arguments: &Arguments, intermediate: &Intermediate) -> Result<(ShadingPoint, BrdfTable)> {
    let normal = arguments.normal.0;
    ensure!(normal.length() > 1e-6, "--normal: the vector has no length");
    let view = arguments.view.map_or(normal, |view| view.0);
    ensure!(view.dot(normal) > 1e-6, "--view: the direction is not on the normal's side");
    let glossy = matches!(intermediate, Intermediate::Head(head) if head.condition() != Condition::Normal);
    let is_texture = matches!(intermediate, Intermediate::Head(head) if head.condition() == Condition::Texture);
    let (n, wo) = (normal.normalize(), view.normalize());
    let mut table = BrdfTable::default();
    if let Some(MaterialSpec::Neural(spec)) = &arguments.material {
        let texture = Arc::new(NeuralTexture::read(&spec.file)?);
        let (table, surface) = cloth::surface(&arguments.cloth, &texture, n, wo);
        return Ok((ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, table));
    }
    let surface = match &arguments.material {
        _ if is_texture => bail!("the head is for a neural material over a surface: give --material neural:FILE"),
        None if glossy => bail!("the head is for glossy surfaces: give --material ggx:alpha=A or nbrdf:FILE#NAME"),
        None | Some(MaterialSpec::Lambert { .. }) => Lambert { albedo: Vec3::ONE }.into(),
        Some(MaterialSpec::Ggx { alpha, .. }) if alpha.fixed().is_some() => Ggx::new(alpha.low, Vec3::ONE).into(),
        Some(MaterialSpec::Measured { file, names }) => {
            let materials = open_measured(file, names)?;
            let [brdf] = &materials[..] else {
                bail!("--material: name one measured material, as in nbrdf:FILE#NAME");
            };
            let (with, brdf) = table.with(brdf.clone());
            table = with;
            Surface { brdf, parameters: [0.0; MAX_PARAMETERS] }
        }
        Some(material) => bail!("--material {material}: name one width, as in ggx:alpha=0.4"),
    };
    Ok((ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, table))
}

fn kind(intermediate: &Intermediate) -> &'static str {
    match intermediate {
        Intermediate::Head(_) => "Head",
        Intermediate::Bake(_) => "Bake of a head",
        Intermediate::DirectBake(_) => "Direct bake",
    }
}

/// Densities at points of Y.
type Density<'a> = Box<dyn Fn(&[Vec2]) -> Vec<f32> + 'a>;

/// Returns a sampler's density over Y at a shading point, and its mixture weight, if that was learned.
fn intermediate_density<'a>(
    exported: &'a ExportedSampler,
    at: &ShadingPoint,
    table: &BrdfTable,
) -> Result<(Density<'a>, Option<f32>)> {
    let normal = at.ns;
    Ok(match &exported.intermediate {
        Intermediate::Head(_) if exported.patches.is_some() => {
            bail!("the file holds a head over patches of sky, which gives no density over Y alone")
        }
        Intermediate::Head(head) => {
            let condition = match head.condition() {
                Condition::Texture => cloth::condition(at),
                Condition::Family => {
                    Condition::encode_family(at.wo.into(), normal.into(), &table.get(at.surface.brdf).latent())
                }
                condition => condition.encode(at.wo.into(), normal.into(), at.one_of(table).lobe_width()),
            };
            let head_at = head.at(&condition[..head.condition().length()])?;
            let mixture_weight = head.has_mixture_weight().then(|| head_at.mixture_weight());
            (Box::new(move |y| head_at.invert(y).into_iter().map(|(_, density)| density).collect()), mixture_weight)
        }
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
            (Box::new(move |y| table.density_at(normal, y)), None)
        }
    })
}

fn tabulate(exported: &ExportedSampler, at: &ShadingPoint, table: &BrdfTable) -> Result<([Panel; 3], Figures)> {
    let (density, mixture_weight) = intermediate_density(exported, at, table)?;
    let surface = at.one_of(table);
    let points: Vec<Vec2> = (0..WIDTH * HEIGHT)
        .map(|k| Vec2::new((k % WIDTH) as f32 + 0.5, (k / WIDTH) as f32 + 0.5) / Vec2::new(WIDTH as f32, HEIGHT as f32))
        .collect();
    let count = points.len() as f64;
    let reflected = |wi: &[Vec3A]| surface.brdf_cosines(wi).into_iter().map(luminance);
    // PDF of the sampler: `q` is the density over Y, `light` the emitter's pdf and `brdf` that of BRDF
    // sampling.
    let mixed = |q: f32, light: f32, brdf: f32| {
        let pdf = q * light;
        mixture_weight.map_or(pdf, |mixture_weight| mixture_weight * pdf + (1.0 - mixture_weight) * brdf)
    };

    // Through an exact tail, the target over Y is BRDF x cosine alone; with another tail, some light remains.
    let intermediate = density(&points);
    let seen: Vec<(Vec2, Vec3A, f32)> = exported.tail.forward_directions(&points).collect();
    let directions: Vec<Vec3A> = seen.iter().map(|&(_, wi, _)| wi).collect();
    let products: Vec<f32> =
        reflected(&directions).zip(&seen).map(|(f, &(x, ..))| f * exported.tail.light_ratio(x)).collect();
    let mean = products.iter().map(|&g| f64::from(g)).sum::<f64>() / count;
    ensure!(mean > 0.0, "a surface with this normal sees no light at all");
    let (mut kl, mut squares, mut integral) = (0.0, 0.0, 0.0);
    let brdf_pdfs = surface.brdf_pdfs(&directions);
    for (((&q, &g), &(_, _, light)), brdf) in intermediate.iter().zip(&products).zip(&seen).zip(brdf_pdfs) {
        integral += f64::from(q) / count;
        let (q, g) = (f64::from(mixed(q, light, brdf) / light), f64::from(g) / mean);
        if g > 0.0 {
            kl += g * (g / q).ln() / count;
            squares += g * g / q / count;
        }
    }

    let (y, slopes): (Vec<Vec2>, Vec<f32>) = exported.tail.inverse_points(&points).into_iter().unzip();
    let directions: Vec<Vec3A> = points.iter().map(|&x| latlong::direction(x)).collect();
    let own = slopes.into_iter().zip(density(&y)).zip(surface.brdf_pdfs(&directions));
    let (mut target, mut last) = (Vec::new(), Vec::new());
    for ((&x, f), ((slope, q), brdf)) in points.iter().zip(reflected(&directions)).zip(own) {
        let factor = latlong::solid_angle_factor(x.y);
        target.push(exported.tail.light().density(x) * factor * f / mean as f32);
        last.push(mixed(if slope > 0.0 { q } else { 0.0 }, slope * factor, brdf));
    }
    let title = if mixture_weight.is_some() {
        "final: pdf of the mixture with BRDF sampling"
    } else {
        "final: pdf of the sampler"
    };
    let panel = |title, values: &[f32], sides, unit| {
        // Densities over Y are near 1, however bright the lamps.
        let scale = if sides == Sides::Square { Scale::linear(values) } else { Scale::of(values, DECADES) };
        Panel::density(title, (values, WIDTH), sides, (scale, unit))
    };
    let panels = [
        panel("target: light \u{d7} BRDF \u{d7} cosine", &target, Sides::Sphere, "per sr")?,
        panel("intermediate: q(y), over the square Y", &intermediate, Sides::Square, "per unit of Y")?,
        panel(title, &last, Sides::Sphere, "per sr")?,
    ];
    Ok((panels, Figures { kl, relative_variance: squares - 1.0, integral, mixture_weight }))
}
