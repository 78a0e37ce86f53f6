//! `headtail scenes`: lists the built-in scenes and environments and renders pictures of them.

use std::{path::PathBuf, sync::atomic::AtomicBool};

use anyhow::Result;
use clap::Args;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    estimator::Ris,
    image::write_png,
    integrator::{self, Budget, View},
    points::{PointSet, Points},
    sampler::{BrdfSampler, Covering, EnvironmentLight, ProductSampler},
    scene::{Scene, built_in_names},
    tail::TailKind,
};

use crate::given::given;
use crate::terminal::{self, note, out};
use crate::{arguments::open_environment, exposure::of_rendering, output::OutputFolder, progress};

/// List the built-in scenes; with --out, write a picture of each.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail scenes
  headtail scenes --out previews --env studio --spp 64")]
pub struct Arguments {
    /// Print the list as an array of JSON objects.
    #[arg(long)]
    json: bool,
    /// Folder for the pictures, NAME.png.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Built-in environment (overcast, window, studio, sunset) or map.
    #[arg(long, value_name = "NAME|FILE", default_value = "window", value_parser = given::<String>())]
    env: String,
    /// Samples per pixel.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    spp: u32,
    /// Maximum number of surfaces on a light path: 1 is direct light only.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    depth: u32,
    /// Image width in pixels; the height is 3/4 of it.
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(4..=4096))]
    width: u32,
}

/// Lists the scenes, then renders them.
pub fn run(arguments: &Arguments) -> Result<()> {
    let names: Vec<String> = built_in_names().map(picture_name).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let output = arguments.out.as_deref().map(|folder| OutputFolder::take(folder, &names)).transpose()?;
    let scenes: Vec<Scene> = built_in_names().filter_map(Scene::built_in).collect();
    match arguments.json {
        true => print_json(&scenes)?,
        false => print(&scenes),
    }
    output.map_or(Ok(()), |output| write_pictures(arguments, &scenes, &output))
}

fn picture_name(scene: &str) -> String {
    format!("{scene}.png")
}

fn print_json(scenes: &[Scene]) -> Result<()> {
    let object = |scene: &Scene| {
        serde_json::json!({
            "scene": scene.name(),
            "triangles": scene.triangle_count(),
            "size": scene.bounds().extent().to_array(),
            "diffuse": scene.is_diffuse(),
        })
    };
    terminal::print_json(&scenes.iter().map(object).collect::<Vec<_>>())
}

fn print(scenes: &[Scene]) {
    out!("{:10} {:>9}  {:16} surfaces", "scene", "triangles", "size in metres");
    for scene in scenes {
        let [x, y, z] = scene.bounds().extent().to_array();
        let surfaces = if scene.is_diffuse() { "diffuse" } else { "diffuse and glossy" };
        out!(
            "{:10} {:>9}  {:16} {surfaces}",
            scene.name(),
            scene.triangle_count(),
            format!("{x:.1} x {y:.1} x {z:.1}")
        );
    }
}

fn write_pictures(arguments: &Arguments, scenes: &[Scene], output: &OutputFolder) -> Result<()> {
    let environment = open_environment(&arguments.env)?;
    output.begin()?;
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?;
    let product = Covering::new(ProductSampler::new(light, table))?;
    let estimator = Ris::new(product, Covering::new(BrdfSampler)?, 4, environment.clone())?;
    let bar = progress::bar(progress::FRACTION_UNITS, "rendering");
    let show = bar.fraction_setter();
    let (stop, count) = (AtomicBool::new(false), scenes.len() as f64);
    for (number, scene) in scenes.iter().enumerate() {
        let (width, height) = (arguments.width as usize, (arguments.width * 3 / 4) as usize);
        let (camera, environment) = (&scene.camera(), &*environment);
        let view = View { scene, camera, environment, width, height, unshadowed: false, depth: arguments.depth };
        let (budget, points) = (Budget::Spp(arguments.spp), Points::new(PointSet::Sobol, 1));
        let show = |fraction: f64| show((number as f64 + fraction) / count);
        let rendering = integrator::render(view, &estimator, budget, points, &stop, &show);
        write_png(&output.file(&picture_name(scene.name()))?, &rendering.composite(), of_rendering(&rendering))?;
    }
    bar.finish_and_clear();
    note!("{} pictures written to {}", scenes.len(), output.path().display());
    Ok(())
}
