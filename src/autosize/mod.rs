//! `headtail autosize`: the smallest sampler that is good enough for a scene, a map and a material.
//!
//! | file | concept |
//! | --- | --- |
//! | `arguments.rs` | the command line |
//! | `candidates.rs`, `lineup.rs` | candidate samplers, and preparing one |
//! | `contest.rs`, `stages.rs` | measuring and dropping candidates; progress |
//! | `training.rs` | which heads are trained, and how far |
//! | `score.rs`, `choice.rs` | error at the end of the time; the choice |
//! | `page.rs` | `autosize.html` |

mod arguments;
mod candidates;
mod choice;
mod contest;
mod lineup;
mod page;
mod score;
mod stages;
mod training;

pub use arguments::Arguments;

use std::time::Instant;

use anyhow::{Result, bail, ensure};

use self::{candidates::HeadMaterial, contest::Contest};
use crate::terminal::{self, say};
use crate::{
    arguments::{CameraArguments, ViewArguments},
    output::OutputFolder,
    progress,
};

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
