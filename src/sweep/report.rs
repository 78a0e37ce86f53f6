//! The page of a sweep: one self-contained file. Its script draws the table of trials and the parallel
//! coordinates, which are brushed and filtered together; all other charts and tables are shared with other
//! pages.

mod charts;
mod configuration;

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use maud::{PreEscaped, html};
use serde::Serialize;
use toml::Value;

use configuration::Configuration;

use super::{
    Sweep,
    axis::{Axis, Values},
    collect::{self, Row, plain},
    effect::{effects, is_map},
    slurm::quoted,
    status::State,
};
use headtail_eval::machine;

use crate::{
    report::{chart::Curve, shell::Page},
    run,
};

const STYLE: &str = include_str!("report/page.css");
const SCRIPT: &str = include_str!("report/page.js");

/// Number of learning curves: those of the best trials.
const CURVES: usize = 40;

/// Data for the script.
#[derive(Serialize)]
struct Data {
    /// Link from the page to the trials' folders.
    trials_at: String,
    /// Command of a trial, for a shell in the folder where the page was made; `{id}` stands for the trial.
    fit: String,
    objectives: Vec<String>,
    axes: Vec<AxisData>,
    trials: Vec<TrialData>,
    configurations: Vec<Configuration>,
}

#[derive(Serialize)]
struct AxisData {
    key: String,
    log: bool,
    /// Values as text, if they are not numbers.
    words: Option<Vec<String>>,
}

#[derive(Serialize)]
struct TrialData {
    id: String,
    state: String,
    configuration: usize,
    /// One per axis: a number, an index into `words`, or nothing.
    at: Vec<Option<f64>>,
    /// One per objective.
    figures: Vec<Option<f64>>,
    seconds: f64,
    error: String,
}

/// Returns the whole page, which is to be written to `file`.
///
/// # Errors
/// If the path from the file to the trials cannot be determined.
pub fn page(sweep: &Sweep, command: &str, file: &Path) -> Result<String> {
    let rows = collect::rows(sweep);
    let data = data(sweep, &rows, file)?;
    let count = |state: State| rows.iter().filter(|row| row.state == state).count();
    let name = sweep.folder.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let facts = [
        format!("{} of {} trials done", count(State::Done), rows.len()),
        format!("{} configurations", sweep.plan.configurations.len()),
        format!("{} failed", count(State::Failed)),
        machine(),
        format!("headtail {}", env!("CARGO_PKG_VERSION")),
    ];
    let first = &data.objectives[0];
    let settings = sweep.space.axes.iter().filter(|axis| !is_map(sweep, axis));
    let effects = settings.map(|axis| (axis.key.clone(), effects(sweep, &rows, axis, first)));
    let effects: Vec<_> = effects.filter(|(_, effects)| !effects.is_empty()).collect();
    let has_seeds = sweep.space.axes.iter().any(|axis| axis.key == "seed");
    // Within a script element, only `<` could end it.
    let json = serde_json::to_string(&data)?.replace('<', "\\u003c");
    let main = html! {
        (charts::to_be_had(&data.objectives, &data.configurations))
        (charts::interactive())
        (charts::effects(first, &effects, has_seeds))
        (charts::learning(first, &curves(sweep, &data)))
        (charts::trials())
        script #data type="application/json" { (PreEscaped(json)) }
    };
    let page = Page {
        kicker: "sweep",
        heading: html! { (name) },
        title: name,
        facts: facts.into(),
        command,
        version: env!("CARGO_PKG_VERSION"),
        style: STYLE,
        script: SCRIPT,
    };
    Ok(page.encode(&main))
}

fn data(sweep: &Sweep, rows: &[Row<'_>], file: &Path) -> Result<Data> {
    let objectives: Vec<String> = sweep.space.objectives.iter().map(ToString::to_string).collect();
    let axes: Vec<AxisData> = sweep.space.axes.iter().map(|axis| AxisData::of(axis, rows)).collect();
    let places = |row: &Row<'_>| -> Vec<Option<f64>> {
        let values = sweep.space.axes.iter().map(|axis| row.trial.assignment.get(&axis.key));
        values.zip(&axes).map(|(value, axis)| axis.place(value?)).collect()
    };
    let trials: Vec<TrialData> = rows
        .iter()
        .map(|row| TrialData {
            id: row.trial.id.clone(),
            state: row.state.to_string(),
            configuration: row.trial.configuration,
            at: places(row),
            figures: objectives
                .iter()
                .map(|name| row.measures?.get(name).copied().filter(|value| value.is_finite()))
                .collect(),
            seconds: row.seconds,
            error: row.error.clone(),
        })
        .collect();
    let folder = sweep.folder.trials();
    let configurations = configurations(sweep, rows, &objectives);
    let fit =
        format!("headtail fit --config {}/{{id}}/resolved.toml --out {{id}}", quoted(&folder.display().to_string()));
    let trials_at =
        way(file.parent().unwrap_or(Path::new("")), &folder).with_context(|| folder.display().to_string())?;
    Ok(Data { trials_at, fit, objectives, axes, trials, configurations })
}

/// Returns the path from one folder to another as a link; the whole path if they have nothing in common.
fn way(from: &Path, to: &Path) -> io::Result<String> {
    // A path that does not exist yet has no symbolic links.
    let whole = |path: &Path| -> io::Result<PathBuf> {
        let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        fs::canonicalize(path).or_else(|_| std::path::absolute(path))
    };
    let (from, to) = (whole(from)?, whole(to)?);
    let common = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = if common == 0 { 0 } else { from.components().count() - common };
    let down = to.components().skip(common).map(|part| part.as_os_str().to_string_lossy().into_owned());
    Ok(std::iter::repeat_n("..".to_owned(), up).chain(down).collect::<Vec<_>>().join("/"))
}

impl AxisData {
    fn of(axis: &Axis, rows: &[Row<'_>]) -> Self {
        let seen = || rows.iter().filter_map(|row| row.trial.assignment.get(&axis.key));
        let is_number = seen().all(|value| number(value).is_some());
        let log = match &axis.values {
            Values::Range { log, .. } => *log,
            // Values that span a factor of at least 10 need a logarithmic axis.
            Values::List(_) => {
                let numbers: Vec<f64> = seen().filter_map(number).collect();
                let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
                low > 0.0 && numbers.iter().any(|&value| value >= 10.0 * low)
            }
        };
        let words = match &axis.values {
            Values::List(values) if !is_number => Some(values.iter().map(plain).collect()),
            _ => None,
        };
        Self { key: axis.key.clone(), log: log && words.is_none(), words }
    }

    fn place(&self, value: &Value) -> Option<f64> {
        match &self.words {
            Some(words) => words.iter().position(|word| *word == plain(value)).map(|index| index as f64),
            None => number(value),
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// Returns the configurations whose trials are all done, with their membership of the Pareto front.
fn configurations(sweep: &Sweep, rows: &[Row<'_>], objectives: &[String]) -> Vec<Configuration> {
    let by_id: BTreeMap<&str, usize> =
        rows.iter().enumerate().map(|(index, row)| (row.trial.id.as_str(), index)).collect();
    let mut found = Vec::new();
    for configuration in &sweep.plan.configurations {
        let trials: Vec<usize> = configuration
            .trials
            .iter()
            .filter_map(|&trial| by_id.get(sweep.plan.trials[trial].id.as_str()).copied())
            .collect();
        let figure = |name: &String| {
            let of = |&row: &usize| rows[row].measures.filter(|_| rows[row].state == State::Done)?.get(name).copied();
            let figures: Option<Vec<f64>> = trials.iter().map(of).collect();
            figures.map(|figures| sweep.space.aggregate.by.of(&figures)).filter(|figure| figure.is_finite())
        };
        let figures: Option<Vec<f64>> = objectives.iter().map(figure).collect();
        let Some(figures) = figures else { continue };
        let name = super::plan::text(&configuration.assignment);
        let seconds = trials.iter().map(|&row| rows[row].seconds).sum();
        found.push(Configuration { name, figures, seconds, front: false, trials });
    }
    let front: Vec<bool> =
        found.iter().map(|own| !found.iter().any(|other| dominates(&other.figures, &own.figures))).collect();
    found.iter_mut().zip(front).for_each(|(own, front)| own.front = front);
    found
}

fn dominates(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a <= b) && a.iter().zip(b).any(|(a, b)| a < b)
}

/// Returns relative variance over steps of the best trials, with their settings as names.
fn curves(sweep: &Sweep, data: &Data) -> Vec<Curve> {
    let trials = &data.trials;
    let mut order: Vec<usize> = (0..trials.len()).filter(|&trial| trials[trial].figures[0].is_some()).collect();
    order
        .sort_by(|&a, &b| trials[a].figures[0].partial_cmp(&trials[b].figures[0]).unwrap_or(std::cmp::Ordering::Equal));
    let read = |trial: usize| {
        let text = std::fs::read_to_string(sweep.folder.trial(&trials[trial].id).join(run::METRICS)).ok()?;
        let point = |line: &str| {
            let row: serde_json::Value = serde_json::from_str(line).ok()?;
            Some((row["step"].as_f64()?, row["relative_variance"].as_f64()?))
        };
        let points: Vec<(f64, f64)> = text.lines().filter_map(point).collect();
        let name = super::plan::text(&sweep.plan.trials[trial].assignment);
        (points.len() > 1).then_some(Curve { name, points })
    };
    order.into_iter().take(CURVES).filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_lead_from_the_page_to_the_trials() {
        let folder = tempfile::tempdir().unwrap();
        let of = |from: &str, to: &str| {
            let [from, to] = [from, to].map(|name| folder.path().join(name));
            [&from, &to].into_iter().for_each(|path| fs::create_dir_all(path).unwrap());
            way(&from, &to).unwrap()
        };
        assert_eq!(of("a.sweep", "a.sweep/trials"), "trials");
        assert_eq!(of("pages/of", "a.sweep/trials"), "../../a.sweep/trials");
        assert_eq!(of("a.sweep/trials/x", "a.sweep/trials"), "..");
        assert!(way(Path::new(""), Path::new("src")).unwrap().ends_with("src"));
    }
}
