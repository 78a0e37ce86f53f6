//! `headtail material`: properties of measured materials, and their conversion to this project's format.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use headtail_render::brdf::neural::{self, Network, NeuralBrdf, VIEWS};
use rayon::prelude::*;

use crate::{
    output::OutputFile,
    terminal::{self, note, out, say},
};

const EXAMPLES: &str = "Examples:
  headtail material nbrdf_all.f32
  headtail material nbrdf_all.f32 --names merl/chrome,merl/teflon --out out/two.safetensors";

/// Show and convert measured materials: energy, reciprocity, lobes.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Neural BRDFs: .safetensors, or raw rows (.f32 with .names.txt).
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// Show only the materials with these names. Default: all.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    names: Vec<String>,

    /// Print the figures as an array of JSON objects.
    #[arg(long)]
    json: bool,

    /// Write the materials to a file of this project's format.
    #[arg(long, value_name = "FILE.safetensors")]
    out: Option<PathBuf>,
}

/// Prints one line per material and converts them.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut networks = neural::read_networks(&arguments.file)?;
    if let Some(name) = arguments.names.iter().find(|name| !networks.iter().any(|(known, _)| known == *name)) {
        bail!("{}: material '{name}' is not there", arguments.file.display());
    }
    networks.retain(|(name, _)| arguments.names.is_empty() || arguments.names.contains(name));
    let brdfs: Vec<NeuralBrdf> = networks
        .par_iter()
        .map(|(name, network)| NeuralBrdf::new(name, network.clone()).map_err(|error| error.in_file(&arguments.file)))
        .collect::<Result<_, _>>()?;
    if arguments.json {
        terminal::only_data();
        terminal::print_json(&brdfs.iter().map(object).collect::<Vec<_>>())?;
    } else {
        out!("{}", table(&brdfs).trim_end());
    }
    let shining = brdfs.iter().filter(|brdf| brdf.check().largest_albedo() > 1.0).count();
    if shining > 0 {
        note!("{shining} of {} reflect more than they receive at some view", brdfs.len());
    }
    match &arguments.out {
        Some(out) => write(out, &networks),
        None => Ok(()),
    }
}

fn write(out: &std::path::Path, networks: &[(String, Network)]) -> Result<()> {
    if out.extension().is_none_or(|extension| extension != "safetensors") {
        bail!("--out {}: materials are written as .safetensors", out.display());
    }
    OutputFile::take(out)?.write(|path| neural::write_networks(path, networks))?;
    say!("{} written, {} materials", out.display(), networks.len());
    Ok(())
}

/// Returns the numbers of a line of [`table`] as JSON, with albedos of all channels and views.
fn object(brdf: &NeuralBrdf) -> serde_json::Value {
    let check = brdf.check();
    serde_json::json!({
        "material": brdf.name(),
        "view_cosines": VIEWS,
        "albedos": check.albedos.iter().map(glam::Vec3::to_array).collect::<Vec<_>>(),
        "largest_albedo": check.largest_albedo(),
        "reciprocity_error": check.reciprocity_error,
        "alpha": check.alpha,
        "mirror_peak": check.mirror_peak,
        "own_variance": check.own_variance,
    })
}

fn table(brdfs: &[NeuralBrdf]) -> String {
    let width = brdfs.iter().map(|brdf| brdf.name().len()).max().unwrap_or(0).max(8);
    let grazing = VIEWS[VIEWS.len() - 1];
    let mut text = format!(
        "{:width$}  {:>7} {:>7} {:>7} {:>8} {:>7} {:>9} {:>8}\n",
        "material",
        "albedo",
        format!("at {grazing}"),
        "largest",
        "recipr.",
        "width",
        "peak",
        "variance"
    );
    for brdf in brdfs {
        let check = brdf.check();
        let green = |view: usize| check.albedos[view].y;
        text += &format!(
            "{:width$}  {:7.3} {:7.3} {:7.3} {:7.1}% {:7.4} {:9.2} {:8.3}\n",
            brdf.name(),
            green(0),
            green(VIEWS.len() - 1),
            check.largest_albedo(),
            100.0 * check.reciprocity_error,
            check.alpha,
            check.mirror_peak,
            check.own_variance
        );
    }
    text
}
