//! `headtail bake`: tabulates a head, the target itself, or the visibility of the sky in a scene.

mod visibility;

use std::{path::PathBuf, sync::OnceLock, time::Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake_watched},
    environment::Environment,
    export::{ExportedSampler, Intermediate, TrainingSummary},
    tail::{Tail, TailKind},
};
use headtail_train::learned_bake_watched;

use crate::arguments::{Grid, MapArguments, TAILS, open_environment};
use crate::given::{given, one_of};
use crate::output::OutputFile;
use crate::progress;
use crate::terminal::say;

/// Tabulate a trained head or light x cosine over a grid of normals, or the visibility of a scene.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail bake --direct --env studio --out out/studio-direct.safetensors
  headtail bake --direct --env room.hdr --cells 64x64 --out out/room-direct.safetensors
  headtail bake --from out/room/sampler.safetensors --normals 16x32 --cells 8x8 --out out/room-baked.safetensors
  headtail bake --visibility --scene bedroom --env room.hdr --out out/bedroom-visibility.safetensors

The paper's table has 16x32 normals of 8x8 cells; the default has 32x32 cells (2 MB, to which the map's luminance is \
added). Between normals the tables are interpolated. Visibility is for \
render --sampler patches+vis:FILE: it holds for all materials and viewpoints of the scene, under the same map.")]
#[command(group = clap::ArgGroup::new("source").required(true).args(["from", "direct", "visibility"]))]
pub struct Arguments {
    /// Bake the head in this file.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Bake light x cosine itself; needs --env.
    #[arg(long, requires = "env")]
    direct: bool,
    /// Precompute sky visibility in a scene; needs --env and --scene.
    #[arg(long, requires = "env", requires = "scene")]
    visibility: bool,
    /// Map for --direct and --visibility.
    /// A built-in environment (overcast, window, studio, sunset) or a .hdr or .exr file.
    #[arg(long, value_name = "MAP", conflicts_with = "from", value_parser = given::<String>())]
    env: Option<String>,
    #[command(flatten)]
    map: MapArguments,
    /// The tail warp for --direct.
    #[arg(long, default_value = "hierarchical", conflicts_with = "from", value_parser = one_of(&TAILS))]
    tail: TailKind,
    /// Grid of normals: polar x azimuth.
    #[arg(long, value_name = "ROWSxCOLUMNS", default_value = "16x32")]
    normals: Grid,
    /// Cells of the intermediate square, elevation x azimuth.
    #[arg(long, value_name = "ROWSxCOLUMNS", default_value = "32x32")]
    cells: Grid,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    view: visibility::Arguments,
}

/// Bakes and writes the table.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let output = OutputFile::take(&arguments.out)?;
    let env = arguments.env.as_ref().map(|env| arguments.map.of(env));
    if let (true, Some(map)) = (arguments.visibility, &env) {
        let learned = arguments.view.bake(map)?;
        output.write(|path| learned.write(path))?;
        say!("{} written after {:.2} s", arguments.out.display(), start.elapsed().as_secs_f64());
        return Ok(());
    }
    let normals = NormalGrid::new(arguments.normals.0, arguments.normals.1).context("--normals")?;
    let cells = CellGrid::new(arguments.cells.0, arguments.cells.1).context("--cells")?;
    let baked = match (&arguments.from, &env) {
        (Some(file), _) => {
            let exported = ExportedSampler::read(file)?;
            let head = exported.head_over_tail().map_err(|error| error.in_file(file))?;
            let run = exported.run.as_ref().map(|run| format!("{run}\n{}", settings(false, normals, cells)));
            let tabulating = Instant::now();
            let table = with_bar(|show| learned_bake_watched(head, &exported.tail, normals, cells, show))?;
            let seconds = tabulating.elapsed().as_secs_f64();
            // A file without a training time must not depend on the clock.
            let training = exported
                .training
                .clone()
                .map(|training| TrainingSummary { tabulated_seconds: training.seconds.map(|_| seconds), ..training });
            ExportedSampler { intermediate: Intermediate::Bake(table), run, training, ..exported }
        }
        (None, Some(map)) => {
            let environment = open_environment(map)?;
            direct(map, &environment, arguments.tail, normals, cells)?
        }
        (None, None) => bail!("give --from FILE, or --direct with --env MAP"),
    };
    output.write(|path| baked.write(path))?;
    say!("{} written after {:.2} s", arguments.out.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Bakes with a bar that starts at the first report, so that earlier work does not count.
fn with_bar<T>(bake: impl FnOnce(&(dyn Fn(f64) + Sync)) -> T) -> T {
    let bar = OnceLock::new();
    let show = |fraction: f64| {
        bar.get_or_init(|| progress::bar(progress::FRACTION_UNITS, "baking")).fraction_setter()(fraction);
    };
    let table = bake(&show);
    bar.into_inner().iter().for_each(progress::Bar::finish_and_clear);
    table
}

/// Formats the grid sizes for the settings that the file records.
fn settings(direct: bool, normals: NormalGrid, cells: CellGrid) -> String {
    let ((polar, azimuth), (rows, columns)) = (normals.shape(), cells.shape());
    format!("[bake]\ndirect = {direct}\nnormals = [{polar}, {azimuth}]\ncells = [{rows}, {columns}]\n")
}

/// Formats the settings of a direct bake.
fn direct_settings(name: &str, tail: TailKind, normals: NormalGrid, cells: CellGrid) -> Result<String> {
    let [map, tail] = [toml::Value::from(name), toml::Value::try_from(tail)?];
    Ok(format!("env = {map}\ntail = {tail}\n\n{}", settings(true, normals, cells)))
}

/// Bakes light x cosine for a map; `name` is the map as the user gave it.
pub fn direct(
    name: &str,
    environment: &Environment,
    tail: TailKind,
    normals: NormalGrid,
    cells: CellGrid,
) -> Result<ExportedSampler> {
    let warp = Tail::new(tail, environment.width(), environment.height(), &environment.luminance())?;
    let table = with_bar(|show| direct_bake_watched(&warp, normals, cells, show))?;
    let run = direct_settings(name, tail, normals, cells)?;
    Ok(ExportedSampler::new(Intermediate::DirectBake(table), tail, environment, None)?.with_run(run))
}
