//! `headtail autosize`: the smallest sampler that is good enough for a scene, a map and a material.
//!
//! | file | concept |
//! | --- | --- |
//! | `candidates.rs`, `lineup.rs` | candidate samplers, and preparing one |
//! | `contest.rs`, `stages.rs` | measuring and dropping candidates; progress |
//! | `training.rs` | which heads are trained, and how far |
//! | `score.rs`, `choice.rs` | error at the end of the time; the choice |
//! | `page.rs` | `autosize.html` |

mod candidates;
mod choice;
mod contest;
mod lineup;
mod page;
mod score;
mod stages;
mod training;

use std::{path::PathBuf, time::Instant};

use anyhow::{Result, bail, ensure};
use clap::Args;

use self::{candidates::HeadMaterial, contest::Contest};
use crate::terminal::{self, say};
use crate::{
    arguments::{CameraArguments, ViewArguments},
    given::given,
    output::OutputFolder,
    progress,
};
use headtail_render::scene::MaterialSpec;

/// Find the smallest sampler that is good enough for a scene under a map.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail autosize --env room.hdr --scene temple --out out/room
  headtail autosize --env sky.exr --scene spot.glb --ground --material ggx:alpha=0.2 --prepare-seconds 60 --render-seconds 600 --out out/sky

Candidates, in the order of their cost, are BRDF sampling, MIS in its forms, resampling, patches, tables of several sizes, trained heads of several sizes, one of them over patches; \
the best are also tried with several directions per point or learned visibility. Each is measured until it is decided. Errors are those after --render-seconds, preparation included. \
A head is trained only if a perfect head with its sampling time would win. DIR/autosize.html shows the choice; \
DIR/winner and DIR/cheapest name the samplers as --sampler takes them, with their files beside them.")]
pub struct Arguments {
    /// Built-in environment (overcast, window, studio, sunset) or map.
    /// Maps are Radiance .hdr or OpenEXR files.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    env: String,
    /// Built-in scene or glTF 2.0 file.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    scene: String,
    /// Give every surface one material, as `render` does.
    /// Default: the scene's materials.
    #[arg(long, value_name = "SPEC", value_parser = given::<MaterialSpec>())]
    material: Option<MaterialSpec>,
    /// Put a grey diffuse plane under the scene.
    #[arg(long)]
    ground: bool,
    /// Width of the trial pictures in pixels.
    #[arg(long, default_value_t = 96, value_parser = clap::value_parser!(u32).range(8..=4096))]
    width: u32,
    /// Height of the trial pictures in pixels.
    #[arg(long, default_value_t = 72, value_parser = clap::value_parser!(u32).range(8..=4096))]
    height: u32,
    /// Maximum time to prepare a sampler.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    prepare_seconds: f64,
    /// Time for preparation and rendering together.
    /// The error after this time counts.
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0)]
    render_seconds: f64,
    /// Measure every candidate to the end and drop none.
    /// Shows the cost of the usual shortcuts.
    #[arg(long)]
    exhaustive: bool,
    /// Print the figures of all candidates as an array of JSON objects.
    /// The best comes first.
    #[arg(long)]
    json: bool,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs the contest, writes its results and reports the choice.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    if arguments.json {
        terminal::only_data();
    }
    for (name, seconds) in
        [("--prepare-seconds", arguments.prepare_seconds), ("--render-seconds", arguments.render_seconds)]
    {
        ensure!(seconds > 0.0 && seconds <= 1e7, "{name}: {seconds} is not between 0 and 1e7");
    }
    let stop = progress::stop_flag()?;
    let output = OutputFolder::take(&arguments.out, &["autosize.html"])?;
    let others = ["autosize.json", "winner", "winner.safetensors", "cheapest", "cheapest.safetensors"];
    output.plan(&others.map(String::from))?;
    let camera = CameraArguments::of_size(arguments.width, arguments.height);
    let view = ViewArguments {
        ground: arguments.ground,
        material: arguments.material.clone(),
        ..ViewArguments::of(&arguments.scene, &arguments.env, camera)
    };
    let opened = view.open()?;
    output.begin()?;
    output.file("autosize.html")?;
    let material = HeadMaterial::of(arguments.material.as_ref(), opened.is_diffuse());
    let mut contest = Contest::new(arguments, &view, &opened, material)?;
    contest.run(&stop)?;
    if stop.load(std::sync::atomic::Ordering::Relaxed) {
        bail!(progress::Interrupted::new("nothing was chosen"));
    }
    let choice = contest.choose()?;
    let (winner, cheapest) = (&contest.entries[choice.winner], &contest.entries[choice.cheapest]);
    contest.write_choice("winner", winner)?;
    contest.write_choice("cheapest", cheapest)?;
    let seconds = start.elapsed().as_secs_f64();
    let records = page::write(&contest, &choice, seconds)?;
    if arguments.json {
        terminal::print_json(&records)?;
    }
    say!("the best: {} ({})", winner.name, contest.place("winner", winner).display());
    if choice.cheapest == choice.winner {
        say!("nothing cheaper is within 5 % of it");
    } else {
        let ratio = contest.behind(choice.cheapest, choice.winner);
        let behind =
            ratio.and_then(|ratio| Some((ratio.ratio, ratio.ends()?))).map_or(String::new(), |(ratio, ends)| {
                format!(": {ratio:.2} times its error, 95 % interval {:.2} to {:.2}", ends.0, ends.1)
            });
        let place = contest.place("cheapest", cheapest);
        say!("the cheapest within 5 % of it: {} ({}){behind}", cheapest.name, place.display());
    }
    if !winner.recipe.is_prepared() {
        say!("no preparation pays within {} s of rendering: {}", arguments.render_seconds, contest.why_not());
    }
    say!("{seconds:.1} s; open {}", arguments.out.join("autosize.html").display());
    Ok(())
}
