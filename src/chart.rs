//! `headtail chart`: the results of several comparisons on one page.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use crate::terminal::say;
use crate::{output::OutputFile, report};

/// Chart speed against accuracy of several comparisons.
/// One chart for each and one over all.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail chart out/temple out/dishes out/droid --out out/chart.html

Samplers of different folders are the same if their kind and the last name of their file are: keep the files of each map in a \
folder of its own, under equal names. Over all comparisons, time and error are geometric means of the ratios to one-sample MIS (mis), \
over the samplers that every comparison has.")]
pub struct Arguments {
    /// Folders written by `headtail compare`.
    #[arg(required = true, value_name = "DIR")]
    results: Vec<PathBuf>,
    /// Page to write.
    #[arg(long, value_name = "FILE.html")]
    out: PathBuf,
}

/// Reads the results and writes the page.
pub fn run(arguments: &Arguments) -> Result<()> {
    let output = OutputFile::take(&arguments.out)?;
    output.write(|path| report::write_overview(path, &arguments.results))?;
    say!("open {}", arguments.out.display());
    Ok(())
}
