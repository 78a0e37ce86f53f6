//! `headtail conformance`: a kit that checks other implementations of the samplers.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use headtail_eval::conformance::{check, kit_files, write_kit};

use crate::{
    output::OutputFolder,
    terminal::{out, print_json, say},
};

/// Write a kit of cases for other implementations of the samplers, or check their answers.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail conformance --out out/kit
  headtail conformance --check out/kit

DIR/kit.json describes the map, the cases, and the columns of DIR/NAME.f32: a shading point, a uniform point and a given direction, then \
the drawn direction, its pdf, and the pdf of the given direction. An implementation writes these results as DIR/NAME.answers.f32, for the \
cases that it has. The check names common faults: a map that is mirrored, turned or shifted by half a texel, a missing sine, wrong poles. \
Other directions from the same points are right if they follow the pdf. Exit status 1: an answer is wrong.")]
pub struct Arguments {
    /// Folder for the kit.
    #[arg(long, value_name = "DIR", required_unless_present = "check")]
    out: Option<PathBuf>,
    /// Folder with answers to check.
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    check: Option<PathBuf>,
    /// Print the results of the check as JSON.
    #[arg(long, requires = "check")]
    json: bool,
}

/// Writes the kit, or checks answers.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(folder) = &arguments.out {
        let names = kit_files()?;
        let output = OutputFolder::take(folder, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
        output.begin()?;
        write_kit(folder)?;
        say!("wrote {} and {} files of cases", folder.join("kit.json").display(), names.len() - 1);
    }
    let Some(folder) = &arguments.check else { return Ok(()) };
    let verdicts = check(folder)?;
    if arguments.json {
        print_json(&verdicts)?;
    } else {
        verdicts.iter().for_each(|verdict| out!("{verdict}"));
    }
    let wrong: Vec<&str> = verdicts.iter().filter(|verdict| !verdict.passed()).map(|verdict| verdict.name).collect();
    if !wrong.is_empty() {
        bail!("{}: wrong answers to {}", folder.display(), wrong.join(", "));
    }
    Ok(())
}
