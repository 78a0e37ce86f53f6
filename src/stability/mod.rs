//! `headtail stability`: samplers in the regimes in which importance sampling is known to fail.

mod method;
mod page;
mod picture;
mod regime;
mod table;

use std::{path::PathBuf, sync::atomic::Ordering};

use anyhow::{Result, bail, ensure};
use clap::Args;
use headtail_render::{file, statistics::Effort};
use headtail_train::{Backend, GradientForm};

use crate::terminal::{self, out};
use crate::{arguments::make_folder, backends::parse, compare::machine, progress};
use method::{DEFAULT, Laboratory};

/// Train and measure every sampler in the regimes in which importance sampling is known to fail, and write DIR/stability.csv and
/// DIR/stability.html.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail stability --out out/stability --quick
  headtail stability --maps maps --out out/stability

--quick takes about two minutes on two cores, the whole suite about ten. Regimes of real maps need spiaggia_di_mondello_1k.hdr \
and noon_grass_1k.hdr (from polyhaven.com) in the folder of --maps; all others are made by code.")]
pub struct Arguments {
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Shorter training, fewer points.
    #[arg(long)]
    quick: bool,
    /// Folder of real maps.
    #[arg(long, value_name = "DIR")]
    maps: Option<PathBuf>,
    /// Train with the networks of this backend of the tensor library (flex, ndarray, wgpu) instead of the fused form; slower.
    #[arg(long, value_parser = parse::<Backend>)]
    backend: Option<Backend>,
    /// Run only regimes whose name contains this text; may be repeated.
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
}

/// Runs all regimes.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(folder) = &arguments.maps {
        ensure!(folder.is_dir(), "--maps: {}: there is no such folder", folder.display());
    }
    make_folder(&arguments.out)?;
    let stop = progress::stop_flag()?;
    let effort = if arguments.quick {
        Effort { conditions: 10, strata: (72, 40), draws: 2_000 }
    } else {
        Effort { conditions: 40, strata: (128, 80), draws: 10_000 }
    };
    let (mut regimes, mut missing) = regime::regimes(arguments.maps.as_deref())?;
    let wanted = |name: &str| arguments.only.is_empty() || arguments.only.iter().any(|text| name.contains(&**text));
    regimes.retain(|regime| wanted(&regime.name));
    missing.retain(|(name, _)| wanted(name));
    ensure!(!regimes.is_empty(), "--only: no regime that can be run has such a name");
    let bar = progress::bar(regimes.len() as u64, "regimes");
    let (mut rows, mut pictured) = (Vec::new(), Vec::new());
    for regime in regimes {
        if stop.load(Ordering::Relaxed) {
            bail!(progress::Interrupted::new("nothing was written"));
        }
        bar.set_message(&regime.name);
        let mut config = regime.config(arguments.quick);
        if let Some(backend) = arguments.backend {
            (config.backend, config.gradient) = (backend, GradientForm::Injected);
        }
        let (own, pictures) = Laboratory::run(&regime, config, effort)?;
        rows.extend(own);
        pictured.push((regime, pictures));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let (command, machine) = (terminal::command(), machine());
    let page = page::Page { regimes: &pictured, rows: &rows, missing: &missing, command: &command, machine: &machine };
    let (csv, html) = (arguments.out.join("stability.csv"), arguments.out.join("stability.html"));
    file::replace(&csv, &table::encode(&rows, &missing, &machine, &command)?)?;
    file::replace(&html, page.encode()?.as_bytes())?;
    let worse = rows.iter().filter(|row| row.method == DEFAULT && !page::is_no_worse(&rows, row));
    for row in worse {
        out!("{}: {DEFAULT} is worse than one-sample MIS, or stopped", row.regime);
    }
    for (regime, file) in &missing {
        out!("{regime}: not run; give --maps DIR with {file}");
    }
    out!("{} and {} written", csv.display(), html.display());
    Ok(())
}
