//! Data of experiments, and the blocks that show them.

use anyhow::{Context, Result, bail};
use headtail_eval::{
    Budget, Experiment, MeasurementEnvironment, Output, RAYS, Record, Store, VerifiedSources, source_hash,
    summary::views_of,
};

use crate::{Plans, block::Block, forest, markdown::Filled, recorded, shown::Shown, tables};

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

/// Describes data of other sources that render the same pictures, which says nothing about their times.
fn same_since(pictures: usize, is_timed: bool) -> String {
    let times = if is_timed { " Times may have changed." } else { "" };
    format!(
        "Measured before sources changed; {pictures} pictures of all experiments are the same since, within {RAYS:e} rays per \
         sample.{times}"
    )
}

/// Text of a block without data.
const NOT_MEASURED: &str = "*Not measured yet.*";

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
            "ratios" => tables::ratios(&shown, block)?.into(),
            "forest" => forest::of_experiment(&shown, block)?,
            "cost" => tables::cost(&shown, block)?.into(),
            "bias" => tables::bias(&shown).into(),
            "weights" => tables::weights(&shown).into(),
            "inputs" => tables::inputs(&shown).into(),
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
            format!("{} ({}), {} threads, version {}", own.machine, own.instruction_set, own.threads, own.version)
        });
        let state = found.map_or(State::Stale, |(_, own)| self.state(&own.sources));
        let state = match state {
            State::Current => String::new(),
            // Most of its figures are times, which pictures cannot verify.
            State::Verified(_) => " Measured before sources changed; times may have changed.".to_owned(),
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
            let is_timed = experiment.budgets.iter().any(|entry| matches!(entry.0, Budget::Seconds(_)));
            text += &format!("\n\n{}", same_since(pictures, is_timed));
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
