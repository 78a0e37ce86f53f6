//! Tables of the data of experiments, as Markdown.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use headtail_eval::{
    Experiment, MeasurementEnvironment, Output, RAYS, Record, Store, VerifiedSources, ViewKey, source_hash,
    summary::{Comparison, Interval, Ratios, ViewRuns, views_of},
};
use headtail_render::statistics::{MeanInterval, sidak};

use crate::{Plans, block::Block, forest, recorded};

/// Data of all experiments.
pub struct Data {
    experiments: Vec<(Experiment, Vec<Record>)>,
    /// Output by recording and command.
    recorded: Vec<(String, String, Option<Output>)>,
    environments: Vec<(String, MeasurementEnvironment)>,
    verified: Vec<VerifiedSources>,
}

/// State of data relative to the current sources.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Measured with the current sources.
    Current,
    /// Measured with other sources that render the same; holds the number of compared pictures.
    Verified(usize),
    /// Measured with other sources.
    Stale,
}

/// Describes data of other sources that render the same.
fn same_since(pictures: usize) -> String {
    format!("Measured before sources changed; {pictures} pictures are the same since, within {RAYS:e} rays per sample.")
}

/// Text of a block without data.
const NOT_MEASURED: &str = "*Not measured yet.*";

/// Placeholder for the chart's file in the text of a block.
pub const CHART: &str = "{chart}";

/// Content of a block.
pub struct Filled {
    /// Text between its lines.
    pub markdown: String,
    /// Chart: its file, relative to the root of the repository, and its content.
    pub chart: Option<(String, String)>,
}

impl From<String> for Filled {
    fn from(markdown: String) -> Self {
        Self { markdown, chart: None }
    }
}

/// An experiment and its views with data.
pub struct Shown<'a> {
    pub experiment: &'a Experiment,
    pub views: Vec<ViewRuns>,
}

impl Data {
    /// Reads the data of experiments.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn open(store: &Store, plans: &Plans) -> Result<Self> {
        let read = |own: &Experiment| Ok((own.clone(), store.records(&own.name)?));
        let experiments = plans.experiments.iter().map(read).collect::<Result<_>>()?;
        let mut recorded = Vec::new();
        for recording in &plans.recordings {
            for command in &recording.commands {
                recorded.push((recording.name.clone(), command.name.clone(), recording.output(store, command)?));
            }
        }
        let (environments, verified) = (store.environments()?, store.verified()?);
        Ok(Self { experiments, recorded, environments, verified })
    }

    /// Fills a block.
    ///
    /// # Errors
    /// If the experiment or the kind is unknown, or a setting is missing.
    pub fn fill(&self, block: &Block) -> Result<Filled> {
        if let Some(command) = block.get("command") {
            let is_it = |(name, own, _): &&(String, String, _)| *name == block.experiment && own == command;
            let (.., output) =
                self.recorded.iter().find(is_it).with_context(|| format!("there is no command '{command}'"))?;
            let Some(output) = output else { return Ok(NOT_MEASURED.to_owned().into()) };
            let mut filled = recorded::fill(output, block)?;
            filled.markdown += &self.provenance(output);
            return Ok(filled);
        }
        let found = self.experiments.iter().find(|(own, _)| own.name == block.experiment);
        let (experiment, records) = found.with_context(|| format!("there is no experiment '{}'", block.experiment))?;
        let keys = experiment.view_keys();
        let is_wanted =
            |own: &Record| keys.contains(&own.view()) && block.get("only").is_none_or(|only| own.material == only);
        let records: Vec<Record> = records.iter().filter(|own| is_wanted(own)).cloned().collect();
        if records.is_empty() {
            return Ok(NOT_MEASURED.to_owned().into());
        }
        let shown = Shown { experiment, views: views_of(&records) };
        Ok(match &*block.kind {
            "conditions" => self.conditions(experiment, &records).into(),
            "ratios" => ratios(&shown, block)?.into(),
            "views" => views(&shown, block)?.into(),
            "forest" => forest::of_experiment(&shown, block)?,
            "cost" => cost(&shown, block)?.into(),
            "bias" => bias(&shown).into(),
            "weights" => weights(&shown).into(),
            "inputs" => inputs(&shown).into(),
            other => bail!("there is no kind of block '{other}'"),
        })
    }

    /// Returns the state of data measured with some sources.
    fn state(&self, sources: &str) -> State {
        let same = self.verified.iter().find(|own| own.measured == sources && own.verified == source_hash());
        match same {
            _ if sources == source_hash() => State::Current,
            Some(own) => State::Verified(own.pictures),
            None => State::Stale,
        }
    }

    /// Describes the command, machine and state of an output.
    fn provenance(&self, output: &Output) -> String {
        let found = self.environments.iter().find(|(id, _)| *id == output.environment);
        let machine = found.map_or("an unknown machine".to_owned(), |(_, own)| {
            format!("{} ({}), {} threads", own.machine, own.instruction_set, own.threads)
        });
        let state = found.map_or(State::Stale, |(_, own)| self.state(&own.sources));
        let state = match state {
            State::Current => String::new(),
            State::Verified(pictures) => format!(" {}", same_since(pictures)),
            State::Stale => " **Stale:** samplers or integrator have changed since.".to_owned(),
        };
        format!("\n\n*`{}`, {machine}.*{state}", output.command)
    }

    /// Describes where and how the data were measured, and whether they are stale.
    fn conditions(&self, experiment: &Experiment, records: &[Record]) -> String {
        let views = views_of(records);
        let runs = match records.iter().map(|own| own.run).max().unwrap_or(0) + 1 {
            1 => "one run".to_owned(),
            runs => format!("{runs} runs"),
        };
        let untuned = views.iter().filter(|view| !experiment.is_tuned(&view.key)).count();
        let mut machines: Vec<String> = self
            .environments
            .iter()
            .filter(|(id, _)| records.iter().any(|own| own.environment == *id))
            .map(|(_, own)| {
                format!("{} ({}), {} threads, version {}", own.machine, own.instruction_set, own.threads, own.version)
            })
            .collect();
        machines.sort();
        machines.dedup();
        let noise: Vec<f64> =
            records.iter().map(|own| own.reference_mse / own.mse).filter(|noise| noise.is_finite()).collect();
        let limited = noise.iter().filter(|noise| **noise > 0.25).count();
        let budgets: Vec<String> = experiment.budgets.iter().map(|entry| entry.0.to_string()).collect();
        let mut text = format!(
            "*{} views ({untuned} with an untuned map or scene), {} x {} pixels, {} points, budgets {}, {runs} each; {}. \
             The reference's own error is more than a quarter of the sampler's in {limited} of {} runs. Data: `results/{}.csv`.*",
            views.len(),
            experiment.width,
            experiment.height,
            experiment.points,
            budgets.join(", "),
            machines.join("; "),
            records.len(),
            experiment.name,
        );
        let state = |own: &Record| {
            let found = self.environments.iter().find(|(id, _)| *id == own.environment);
            found.map_or(State::Stale, |(_, with)| self.state(&with.sources))
        };
        let states: Vec<State> = records.iter().map(state).collect();
        let stale = states.iter().filter(|state| **state == State::Stale).count();
        let verified = states
            .iter()
            .filter_map(|state| if let State::Verified(pictures) = state { Some(*pictures) } else { None });
        if let Some(pictures) = verified.max() {
            text += &format!("\n\n{}", same_since(pictures));
        }
        if stale > 0 {
            text += &format!(
                "\n\n**Stale:** samplers or integrator have changed since {stale} of {} runs were measured.",
                records.len()
            );
        }
        text
    }
}

/// Returns the groups of views in columns: by the block's `columns` key (material, scene, light or tuned), and all views.
fn groups<'a>(shown: &'a Shown<'_>, block: &Block) -> Result<Vec<(String, Vec<&'a ViewRuns>)>> {
    let name = |view: &ViewRuns| -> Result<String> {
        let map = shown.experiment.map(&view.key.map);
        let is_interior = shown.experiment.scene(&view.key.scene).is_some_and(|scene| scene.interior);
        Ok(match block.get("columns").unwrap_or("material") {
            "material" => view.key.material.clone(),
            "scene" => view.key.scene.clone(),
            "light" if is_interior => "interiors".into(),
            "light" => map.map(|map| map.kind.clone()).unwrap_or_default(),
            "tuned" if shown.experiment.is_tuned(&view.key) => "tuned".into(),
            "tuned" => "untuned".into(),
            other => bail!("columns: there is no grouping '{other}'"),
        })
    };
    let mut groups: Vec<(String, Vec<&ViewRuns>)> = Vec::new();
    // In the order of the experiment.
    let mut views: Vec<&ViewRuns> = shown.views.iter().collect();
    let keys = shown.experiment.view_keys();
    views.sort_by_key(|view| keys.iter().position(|key| *key == view.key));
    for view in &views {
        let name = name(view)?;
        match groups.iter_mut().find(|group| group.0 == name) {
            Some(group) => group.1.push(view),
            None => groups.push((name, vec![view])),
        }
    }
    if groups.len() > 1 {
        groups.push(("all".into(), views));
    }
    Ok(groups)
}

/// Table of error ratios: a row per sampler, a column per group of views.
fn ratios(shown: &Shown<'_>, block: &Block) -> Result<String> {
    let (at, baselines) = (block.comparison()?, block.names("baselines"));
    ensure!(!baselines.is_empty(), "baselines: name at least one");
    let groups = groups(shown, block)?;
    let head = groups.iter().map(|(name, views)| format!("{name} ({})", views.len()));
    let rows = block.sampler_sets().into_iter().map(|set| {
        let cells = groups.iter().map(|(_, views)| {
            let ratios = Ratios::of(views, &set.samplers, &baselines, &at);
            ratios.map_or("\u{2013}".to_owned(), |ratios| ratio_cell(&ratios))
        });
        std::iter::once(set.label.clone()).chain(cells).collect()
    });
    let what = match &at {
        Comparison::Samples(samples) => format!("after {samples}"),
        Comparison::Time { seconds, counts_preparation: true } => format!("after {seconds} s, preparation included"),
        Comparison::Time { seconds, counts_preparation: false } => {
            format!("after {seconds} s, preparation not counted")
        }
    };
    let named: Vec<String> = baselines.iter().map(|name| format!("`{name}`")).collect();
    let baseline = if named.len() == 1 { named[0].clone() } else { format!("the best of {}", named.join(", ")) };
    let title = format!("MSE of {baseline} over MSE {what}");
    Ok(table(&std::iter::once(title).chain(head).collect::<Vec<_>>(), &rows.collect::<Vec<_>>()))
}

/// Formats a geometric mean with its interval and the number of views below 1.
fn ratio_cell(ratios: &Ratios) -> String {
    let Ratios { mean, below_one, count, without, .. } = ratios;
    let mut cell = interval_cell(mean);
    if *below_one > 0 {
        cell += &format!(", {below_one} of {count} below 1");
    }
    if *without > 0 {
        cell += &format!(", {without} without");
    }
    cell
}

fn interval_cell(interval: &Interval) -> String {
    format!("{} [{}, {}]", digits(interval.value), digits(interval.low), digits(interval.high))
}

/// Formats two or three significant digits.
pub fn digits(value: f64) -> String {
    match value.abs() {
        x if !x.is_finite() => "\u{2013}".into(),
        0.0 => "0".into(),
        x if x >= 100.0 => format!("{value:.0}"),
        x if x >= 10.0 => format!("{value:.1}"),
        x if x >= 0.1 => format!("{value:.2}"),
        x if x >= 0.001 => format!("{value:.4}"),
        _ => format!("{value:.1e}"),
    }
}

/// Table of one sampler: a row per view.
fn views(shown: &Shown<'_>, block: &Block) -> Result<String> {
    let (at, baselines) = (block.comparison()?, block.names("baselines"));
    let sets = block.sampler_sets();
    let head =
        ["scene", "map", "material"].map(str::to_owned).into_iter().chain(sets.iter().map(|set| set.label.clone()));
    let rows = shown.views.iter().map(|view| {
        let ViewKey { scene, map, material } = view.key.clone();
        let cell = |samplers: &[String]| {
            view.interval(samplers, &baselines, &at).map_or("\u{2013}".to_owned(), |interval| interval_cell(&interval))
        };
        [scene, map, material].into_iter().chain(sets.iter().map(|set| cell(&set.samplers))).collect()
    });
    Ok(table(&head.collect::<Vec<_>>(), &rows.collect::<Vec<_>>()))
}

/// Table of sample times relative to a baseline, by group, and of seconds of preparation.
fn cost(shown: &Shown<'_>, block: &Block) -> Result<String> {
    let baseline = block.need("baseline")?;
    let groups = groups(shown, block)?;
    let time = |view: &ViewRuns, sampler: &str| {
        let runs: Vec<f64> =
            view.samplers.get(sampler)?.values().flatten().map(|run| (run.seconds / run.spp).ln()).collect();
        Some((runs.iter().sum::<f64>() / runs.len() as f64).exp())
    };
    let head = groups.iter().map(|(name, _)| name.clone());
    let head =
        std::iter::once(format!("time of a sample over `{baseline}`")).chain(head).chain(["preparation, s".to_owned()]);
    let rows = samplers_of(shown).into_iter().map(|sampler| {
        let cells = groups.iter().map(|(_, views)| {
            let ratios = views.iter().filter_map(|view| Some((time(view, &sampler)? / time(view, baseline)?).ln()));
            let ratios: Vec<f64> = ratios.collect();
            match ratios.len() {
                0 => "\u{2013}".to_owned(),
                count => digits((ratios.iter().sum::<f64>() / count as f64).exp()),
            }
        });
        let mut prepared: Vec<f64> = shown
            .views
            .iter()
            .filter_map(|view| view.samplers.get(&sampler))
            .map(|budgets| budgets.values().flatten().map(|run| run.preparation).fold(f64::INFINITY, f64::min))
            .collect();
        prepared.sort_by(f64::total_cmp);
        let ends = match prepared[..] {
            [] => "\u{2013}".to_owned(),
            [one] => digits(one),
            _ => format!("{} to {}", digits(prepared[0]), digits(prepared[prepared.len() - 1])),
        };
        std::iter::once(format!("`{sampler}`")).chain(cells).chain([ends]).collect()
    });
    Ok(table(&head.collect::<Vec<_>>(), &rows.collect::<Vec<_>>()))
}

/// Returns the samplers in the order of the experiment.
fn samplers_of(shown: &Shown<'_>) -> Vec<String> {
    let is_there = |name: &&String| shown.views.iter().any(|view| view.samplers.contains_key(*name));
    let mut names: Vec<String> = Vec::new();
    for name in shown.experiment.samplers.iter().map(|own| &own.name).filter(is_there) {
        // Several files for different materials may have the same name.
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// Relative errors of mean luminances: the number of 95 % intervals over runs that exclude 0, and the largest
/// error.
fn bias(shown: &Shown<'_>) -> String {
    let rows = samplers_of(shown).into_iter().map(|sampler| {
        let (mut count, mut excluded, mut largest, mut narrowest, mut widest, mut tiles) =
            (0, 0, 0.0_f64, f64::MAX, 0.0_f64, 0);
        let mut least_p = 1.0_f64;
        for budgets in shown.views.iter().filter_map(|view| view.samplers.get(&sampler)) {
            let Some(runs) = budgets.values().max_by(|a, b| a[0].spp.total_cmp(&b[0].spp)) else { continue };
            let off: Vec<f64> = runs.iter().map(|run| run.mean_luminance / run.reference_luminance - 1.0).collect();
            let Some(interval) = MeanInterval::of(&off) else { continue };
            count += 1;
            excluded += usize::from(interval.low() > 0.0 || interval.high() < 0.0);
            largest = if interval.mean.abs() > largest.abs() { interval.mean } else { largest };
            narrowest = narrowest.min(interval.half_width);
            widest = widest.max(interval.half_width);
            tiles += runs.iter().filter(|run| run.tile_p.is_finite()).count();
            least_p = runs.iter().map(|run| run.tile_p).filter(|p| p.is_finite()).fold(least_p, f64::min);
        }
        vec![
            format!("`{sampler}`"),
            format!("{excluded} of {count}"),
            format!("{:+.1e}", largest),
            format!("{:.1e} to {:.1e}", narrowest, widest),
            format!("{least_p:.1e} (1 % level {:.1e})", sidak(0.01, tiles)),
        ]
    });
    let head = [
        "sampler",
        "95 % intervals that exclude 0",
        "largest difference",
        "half widths",
        "smallest p-value of a picture's tiles",
    ];
    table(&head.map(str::to_owned), &rows.collect::<Vec<_>>())
}

/// Largest contribution of a sample relative to the mean luminance of its picture: median over views and
/// maximum, by material.
fn weights(shown: &Shown<'_>) -> String {
    let mut materials: Vec<String> = Vec::new();
    for view in &shown.views {
        if !materials.contains(&view.key.material) {
            materials.push(view.key.material.clone());
        }
    }
    let rows = samplers_of(shown).into_iter().map(|sampler| {
        let cells = materials.iter().map(|material| {
            let mut largest: Vec<f64> = shown
                .views
                .iter()
                .filter(|view| view.key.material == *material)
                .filter_map(|view| view.samplers.get(&sampler))
                .map(|budgets| {
                    budgets.values().flatten().map(|run| run.max_weight / run.reference_luminance).fold(0.0, f64::max)
                })
                .collect();
            largest.sort_by(f64::total_cmp);
            match largest.len() {
                0 => "\u{2013}".to_owned(),
                count => format!("{}, {}", digits(largest[count / 2]), digits(largest[count - 1])),
            }
        });
        std::iter::once(format!("`{sampler}`")).chain(cells).collect()
    });
    let head = materials.iter().map(|material| format!("{material}: median, largest"));
    table(&std::iter::once("sampler".to_owned()).chain(head).collect::<Vec<_>>(), &rows.collect::<Vec<_>>())
}

/// Scenes and maps of an experiment, and whether settings were tuned on them.
fn inputs(shown: &Shown<'_>) -> String {
    let words = |tuned: bool| if tuned { "tuned" } else { "untuned" }.to_owned();
    let mut used: BTreeMap<(&str, String), [String; 2]> = BTreeMap::new();
    for view in &shown.views {
        if let Some(scene) = shown.experiment.scene(&view.key.scene) {
            let kind = if scene.interior { "interior" } else { "object" }.to_owned();
            used.insert(("scene", scene.name.clone()), [kind, words(scene.tuned)]);
        }
        if let Some(map) = shown.experiment.map(&view.key.map) {
            used.insert(("map", map.name.clone()), [map.kind.clone(), words(map.tuned)]);
        }
    }
    let rows: Vec<Vec<String>> =
        used.into_iter().map(|((what, name), [kind, tuned])| vec![what.to_owned(), name, kind, tuned]).collect();
    table(&["", "name", "kind", "settings"].map(str::to_owned), &rows)
}

/// Returns a Markdown table.
pub fn table(head: &[String], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let rule = vec!["---".to_owned(); head.len()];
    line(head) + &line(&rule) + &rows.iter().map(|row| line(row)).collect::<String>()
}
