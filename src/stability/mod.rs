//! `headtail stability`: samplers in the regimes in which importance sampling is known to fail.
//!
//! | file | concept |
//! | --- | --- |
//! | `regime.rs`, `method.rs` | light, surfaces and training; samplers trained in them |
//! | `saved_rows.rs` | finished regimes as files |
//! | `table.rs` | `stability.csv`, and its chart |

mod method;
mod regime;
mod saved_rows;
mod table;

use std::{path::PathBuf, sync::atomic::Ordering};

use anyhow::{Result, bail, ensure};
use clap::Args;
use headtail_eval::{DirectionEffort, machine};
use headtail_render::file;
use headtail_train::Backend;

use crate::terminal::{self, out};
use crate::{backends::parse, cost, output::OutputFolder, progress};
use method::{DEFAULT, Row, StabilityContext};
use regime::Regime;
use saved_rows::SavedRows;

/// Train and measure samplers where importance sampling tends to fail.
/// Writes DIR/stability.csv and DIR/regimes.svg, a matrix of all methods in all regimes.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail stability --out out/stability --quick
  headtail stability --quick --only sun --json --out out/sun
  headtail stability --maps maps --out out/stability

After an interruption, the same command continues with the missing regimes. --quick takes about two minutes on two cores, the whole suite about ten. Regimes of real maps need spiaggia_di_mondello_1k.hdr \
and noon_grass_1k.hdr (from polyhaven.com) in the folder of --maps; all others are made by code.")]
pub struct Arguments {
    /// Write the results to this folder.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Use shorter training and fewer points.
    #[arg(long)]
    quick: bool,
    /// Read measured maps from this folder.
    #[arg(long, value_name = "DIR")]
    maps: Option<PathBuf>,
    /// Train with this backend of the tensor library.
    /// One of ndarray (the default), flex and wgpu; gradients are not fused on wgpu.
    #[arg(long, value_parser = parse::<Backend>)]
    backend: Option<Backend>,
    /// Print the rows of stability.csv as an array of JSON objects.
    #[arg(long)]
    json: bool,
    /// Run only regimes whose name contains this text; repeatable.
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
}

/// Runs all regimes.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(folder) = &arguments.maps {
        ensure!(folder.is_dir(), "--maps: {}: there is no such folder", folder.display());
    }
    if arguments.json {
        terminal::only_data();
    }
    let stop = progress::stop_flag()?;
    let output = OutputFolder::take(&arguments.out, &["stability.csv", "regimes.svg"])?;
    let effort = if arguments.quick {
        DirectionEffort { conditions: 10, strata: (72, 40), draws: 2_000 }
    } else {
        DirectionEffort { conditions: 40, strata: (128, 80), draws: 10_000 }
    };
    let (mut regimes, mut missing) = regime::regimes(arguments.maps.as_deref())?;
    let wanted = |name: &str| arguments.only.is_empty() || arguments.only.iter().any(|text| name.contains(&**text));
    regimes.retain(|regime| wanted(&regime.name));
    missing.retain(|(name, _)| wanted(name));
    ensure!(!regimes.is_empty(), "--only: no regime that can be run has such a name");
    output.begin()?;
    let saved = SavedRows::open(arguments.out.join("regimes"))?;
    let (command, machine) = (terminal::command(), machine());
    let (csv, svg) = (output.file("stability.csv")?, output.file("regimes.svg")?);
    let write = |rows: &[Row]| -> Result<()> {
        file::replace(&csv, &table::encode(rows, &missing, &machine, &command)?)?;
        Ok(file::replace(&svg, table::chart(rows).file().as_bytes())?)
    };
    let configure = |regime: Regime| {
        let mut config = regime.config(arguments.quick);
        if let Some(backend) = arguments.backend {
            config.backend = backend;
        }
        let known = saved.read(&regime, &config, effort);
        let seconds = if known.is_some() { 0.0 } else { cost::regime(&config, effort) };
        (regime, config, known, seconds)
    };
    let regimes: Vec<_> = regimes.into_iter().map(configure).collect();
    let count = regimes.len();
    let bar = progress::announced_bar(regimes.iter().map(|regime| regime.3).sum(), "regimes");
    let mut done = 0.0;
    let mut rows = Vec::new();
    for (index, (regime, config, known, seconds)) in regimes.into_iter().enumerate() {
        bar.set_message(format!("{}: {}", regime.name, regime.why));
        rows.extend(match known {
            Some(known) => known,
            None => {
                let own = StabilityContext::run(&regime, config.clone(), effort, &stop)?;
                if stop.load(Ordering::Relaxed) {
                    let done = format!("{index} of {count} regimes are done; the same command goes on");
                    bail!(progress::Interrupted::new(done));
                }
                saved.write(&regime, &config, effort, &own)?;
                own
            }
        });
        write(&rows)?;
        done += seconds;
        bar.set_position(progress::thousandths(done));
    }
    bar.finish_and_clear();
    if arguments.json {
        return terminal::print_json(&table::objects(&table::encode(&rows, &missing, &machine, &command)?)?);
    }
    let worse = rows.iter().filter(|row| row.method == DEFAULT && !table::is_no_worse(&rows, row));
    for row in worse {
        let why = row
            .outcome
            .as_ref()
            .err()
            .map_or("is worse than one-sample MIS".into(), |error| format!("stopped: {error}"));
        out!("{}: {DEFAULT} {why}", row.regime);
    }
    for (regime, file) in &missing {
        out!("{regime}: not run; give --maps DIR with {file}");
    }
    out!("{} and {} written", csv.display(), svg.display());
    Ok(())
}
