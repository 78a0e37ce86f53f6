//! headtail: neural product importance sampling by warp composition. The command line.
//!
//! | file | concept |
//! | --- | --- |
//! | `arguments.rs`, `given.rs` | arguments that commands share, and their parsers |
//! | `light.rs`, `crop.rs`, `exposure.rs` | turned and tinted maps, parts of pictures, exposure |
//! | `output.rs`, `output/` | ownership of output files |
//! | `terminal.rs`, `progress.rs`, `cost.rs` | messages; progress and signals; expected time |
//! | `report/` | tables, charts and pages |
//! | `run/` | a training run as one table, for `fit` and `sweep` |
//! | `demo.rs`, `fit/`, `bake.rs`, `bake/`, `export.rs` | making samplers |
//! | `fit_material.rs`, `check_material.rs`, `material.rs`, `fit_rival.rs` | materials |
//! | `device.rs` | pictures by the CPU or a graphics device |
//! | `render.rs`, `compare.rs`, `compare/`, `chart.rs`, `scenes.rs` | pictures and comparisons |
//! | `live/` | a page that renders by WebGPU |
//! | `composite/`, `view.rs` | photographs |
//! | `inspect/`, `info.rs` | the contents of files |
//! | `autosize/`, `sweep/`, `stability/`, `backends.rs` | measuring many samplers |
//! | `conformance.rs` | a kit that checks other implementations |
//! | `completions.rs` | shell completions |

mod arguments;
mod autosize;
mod backends;
mod bake;
mod chart;
mod check_material;
mod compare;
mod completions;
mod composite;
mod conformance;
mod cost;
mod crop;
mod demo;
mod device;
mod export;
mod exposure;
mod fit;
mod fit_material;
mod fit_rival;
mod given;
mod info;
mod inspect;
mod light;
mod live;
mod material;
mod output;
mod progress;
mod render;
mod report;
mod run;
mod scenes;
mod stability;
mod sweep;
mod terminal;
mod view;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Neural product importance sampling by warp composition.
/// Draws directions in proportion to light x BRDF x cosine.
#[derive(Parser)]
#[command(version, long_version = terminal::long_version(), propagate_version = true, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    voice: terminal::Voice,
    /// Replace results of another command.
    #[arg(long, global = true)]
    force: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Fit(fit::Arguments),
    FitMaterial(fit_material::Arguments),
    FitRival(fit_rival::Arguments),
    CheckMaterial(check_material::Arguments),
    Bake(bake::Arguments),
    Render(render::Arguments),
    Compare(compare::Arguments),
    Chart(chart::Arguments),
    Export(export::Arguments),
    Conformance(conformance::Arguments),
    Inspect(inspect::Arguments),
    Material(material::Arguments),
    Autosize(autosize::Arguments),
    Sweep(sweep::Arguments),
    Stability(stability::Arguments),
    Composite(composite::Arguments),
    View(view::Arguments),
    Live(live::Arguments),
    Scenes(scenes::Arguments),
    Backends(backends::Arguments),
    Info(info::Arguments),
    Completions(completions::Arguments),
}

fn main() -> ExitCode {
    let Cli { voice, force, command } = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return ExitCode::from(terminal::usage(&error)),
    };
    output::force(force);
    output::watch();
    // Checked first, since dispatched work cannot report an invalid HEADTAIL_SIMD.
    let done = voice
        .begin()
        .and_then(|()| Ok(headtail_render::simd::instruction_set()?))
        .and_then(|_| run(command))
        .and_then(|()| terminal::finish());
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => match error.downcast_ref::<progress::Interrupted>() {
            Some(interrupted) => {
                terminal::error("interrupted", &interrupted.to_string());
                ExitCode::from(interrupted.status)
            }
            None => {
                terminal::error("error", &format!("{error:#}"));
                ExitCode::FAILURE
            }
        },
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Fit(arguments) => fit::run(&arguments),
        Command::FitMaterial(arguments) => fit_material::run(&arguments),
        Command::FitRival(arguments) => fit_rival::run(&arguments),
        Command::CheckMaterial(arguments) => check_material::run(&arguments),
        Command::Bake(arguments) => bake::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Chart(arguments) => chart::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Conformance(arguments) => conformance::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Material(arguments) => material::run(&arguments),
        Command::Autosize(arguments) => autosize::run(&arguments),
        Command::Sweep(arguments) => sweep::run(&arguments),
        Command::Stability(arguments) => stability::run(&arguments),
        Command::Composite(arguments) => composite::run(&arguments),
        Command::View(arguments) => view::run(&arguments),
        Command::Live(arguments) => live::run(&arguments),
        Command::Scenes(arguments) => scenes::run(&arguments),
        Command::Backends(arguments) => backends::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Completions(arguments) => completions::run::<Cli>(&arguments),
    }
}
