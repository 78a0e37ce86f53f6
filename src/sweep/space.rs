//! The space of a sweep: fixed settings, axes, search method and objectives.

use std::{collections::BTreeMap, fmt, path::Path};

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::axis::{Axis, axes_of};
use crate::run::one_line;

/// Values by dotted keys of a run, which a trial sets over the fixed settings.
pub type Assignment = BTreeMap<String, Value>;

/// A space, as described by its file.
#[derive(Clone, Debug)]
pub struct Space {
    /// Objectives, all to be minimised; the first one decides where a single number is needed.
    pub objectives: Vec<Objective>,
    /// Settings common to all trials.
    pub run: Table,
    /// Varied settings, in the order of the keys.
    pub axes: Vec<Axis>,
    /// Search method.
    pub search: Search,
    /// Early stopping of poor trials.
    pub halving: Option<Halving>,
    /// Axes over which a configuration is aggregated.
    pub aggregate: Aggregate,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    objectives: Vec<Objective>,
    run: Table,
    axes: Table,
    #[serde(default)]
    search: Search,
    halving: Option<Halving>,
    #[serde(default)]
    aggregate: Aggregate,
}

/// A figure that a run measures.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Objective(String);

impl Objective {
    const PLAIN: [&str; 6] = ["relative_variance", "kl", "ns_per_sample", "weights", "bytes", "training_seconds"];

    /// Returns the name, that of the figure in `measures.json`.
    pub fn name(&self) -> &str {
        &self.0
    }

    /// Whether it is a validation figure, which is known after any step.
    pub fn is_of_validation(&self) -> bool {
        ["relative_variance", "kl"].contains(&self.name())
    }
}

impl TryFrom<String> for Objective {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let known = Self::PLAIN.contains(&text.as_str())
            || text
                .split_once(':')
                .is_some_and(|(kind, view)| ["mse", "mse_at_time"].contains(&kind) && !view.is_empty());
        if known {
            return Ok(Self(text));
        }
        let plain = Self::PLAIN.join(", ");
        Err(format!("'{text}' is not an objective; choose {plain}, mse:VIEW or mse_at_time:VIEW"))
    }
}

impl From<Objective> for String {
    fn from(objective: Objective) -> Self {
        objective.0
    }
}

impl fmt::Display for Objective {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Search over the axes.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Search {
    /// Method.
    pub method: Method,
    /// Configurations of `random` and `tpe`.
    pub n: usize,
    /// Seed of `random` and `tpe`.
    pub seed: u64,
}

impl Default for Search {
    fn default() -> Self {
        Self { method: Method::Product, n: 0, seed: 0 }
    }
}

/// How configurations are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Every combination.
    Product,
    /// The first values of all axes, then the second ones, and so on.
    Zip,
    /// Independent draws.
    Random,
    /// Tree-structured Parzen estimators (Bergstra et al. 2011), one per axis.
    Tpe,
}

/// Asynchronous successive halving (Li et al. 2018) over steps.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Halving {
    /// Steps after which configurations are compared; the last is the length of a whole run.
    pub rungs: Vec<usize>,
    /// One of this many is promoted.
    #[serde(default = "Halving::one_of_three")]
    pub keep: usize,
}

impl Halving {
    fn one_of_three() -> usize {
        3
    }

    /// Returns the steps of a whole run.
    pub fn last(&self) -> usize {
        self.rungs.last().copied().unwrap_or(0)
    }
}

/// Aggregation of the trials of a configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Aggregate {
    /// Axes that every configuration covers, such as seeds and maps.
    pub over: Vec<String>,
    /// Aggregation of their figures.
    pub by: By,
}

/// Aggregation of several numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// Arithmetic mean.
    Mean,
    /// Geometric mean, for figures of different magnitudes, such as those of different maps.
    #[default]
    GeometricMean,
    /// Largest.
    Worst,
}

impl By {
    /// Returns the aggregate; NaN without values.
    pub fn of(self, values: &[f64]) -> f64 {
        let count = values.len() as f64;
        match self {
            Self::Mean => values.iter().sum::<f64>() / count,
            Self::GeometricMean => (values.iter().map(|value| value.ln()).sum::<f64>() / count).exp(),
            Self::Worst => values.iter().copied().fold(f64::NAN, f64::max),
        }
    }
}

impl Space {
    /// Reads a space from a file.
    ///
    /// # Errors
    /// If the file is invalid; the error names the file and the key.
    pub fn open(path: &Path) -> Result<Self> {
        let text = headtail_render::file::read_text(path).with_context(|| path.display().to_string())?;
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// If the text is invalid; the error names the key.
    pub fn parse(text: &str) -> Result<Self> {
        let File { objectives, mut run, axes, search, halving, aggregate } =
            toml::from_str(text).map_err(|error| anyhow!("{}", one_line(&error)))?;
        let axes = axes_of(&axes)?;
        ensure!(!objectives.is_empty(), "objectives: name at least one");
        for name in &aggregate.over {
            let axis = axes.iter().find(|axis| axis.key == *name);
            let axis = axis.with_context(|| format!("aggregate.over: '{name}' is not an axis"))?;
            ensure!(
                axis.grid().is_ok() && axis.when.is_empty(),
                "aggregate.over: '{name}' must be a list without `when`"
            );
        }
        let drawn = matches!(search.method, Method::Random | Method::Tpe);
        ensure!(!drawn || (1..=1_000_000).contains(&search.n), "search.n: give the number of configurations, 1 to 1e6");
        if !drawn {
            axes.iter().try_for_each(|axis| axis.grid().map(|_| ()))?;
        }
        if let Some(halving) = &halving {
            let rungs = &halving.rungs;
            ensure!(
                rungs.len() >= 2 && rungs[0] > 0 && rungs.is_sorted_by(|a, b| a < b),
                "halving.rungs: give at least two steps, ascending"
            );
            ensure!(halving.keep >= 2, "halving.keep = {}, but it must be at least 2", halving.keep);
            ensure!(
                objectives[0].is_of_validation(),
                "halving compares configurations by the first objective, which must be relative_variance or kl"
            );
            ensure!(!axes.iter().any(|axis| axis.key == "steps"), "halving.rungs take the place of the axis `steps`");
            run.insert("steps".into(), Value::Integer(i64::try_from(halving.last()).context("halving.rungs")?));
        }
        if objectives.iter().any(|objective| objective.name() == "ns_per_sample") {
            set(&mut run, "measure.time", Value::Boolean(true))?;
        }
        // Equal settings give equal bytes.
        set(&mut run, "export.reproducible", Value::Boolean(true))?;
        let space = Self { objectives, run, axes, search, halving, aggregate };
        space.check_views()?;
        Ok(space)
    }

    /// Returns the axes of which configurations are made.
    pub fn searched(&self) -> impl Iterator<Item = &Axis> {
        self.axes.iter().filter(|axis| !self.aggregate.over.contains(&axis.key))
    }

    /// Returns the axes that every configuration covers.
    pub fn replicated(&self) -> impl Iterator<Item = &Axis> {
        self.axes.iter().filter(|axis| self.aggregate.over.contains(&axis.key))
    }

    /// Returns the table of a run with the values of an assignment.
    ///
    /// # Errors
    /// If a key leads through a value that is not a table.
    pub fn table(&self, assignment: &Assignment) -> Result<Table> {
        let mut table = self.run.clone();
        for (key, value) in assignment {
            set(&mut table, key, value.clone())?;
        }
        Ok(table)
    }

    /// Returns the assignment without the axes whose condition does not hold.
    pub fn active(&self, mut assignment: Assignment) -> Assignment {
        // Dropping an axis can drop others; no chain is longer than the number of axes.
        for _ in 0..self.axes.len() {
            let holds = |key: &str, value: &Value| {
                let found = assignment.get(key).or_else(|| get(&self.run, key));
                found.is_some_and(|found| match value {
                    Value::Array(values) => values.contains(found),
                    value => value == found,
                })
            };
            let off = |axis: &&Axis| !axis.when.iter().all(|(key, value)| holds(key, value));
            let off: Vec<&str> = self.axes.iter().filter(off).map(|axis| axis.key.as_str()).collect();
            let before = assignment.len();
            assignment.retain(|key, _| !off.contains(&key.as_str()));
            if assignment.len() == before {
                break;
            }
        }
        assignment
    }

    /// Checks that the views of objectives are measured.
    fn check_views(&self) -> Result<()> {
        let views = get(&self.run, "measure.views").and_then(Value::as_array).cloned().unwrap_or_default();
        for objective in &self.objectives {
            let Some((kind, name)) = objective.name().split_once(':') else { continue };
            let budget = if kind == "mse" { "spp" } else { "seconds" };
            let named = |view: &&Value| {
                let of = |key: &str| view.get(key).and_then(Value::as_str);
                of("name").or(of("scene")) == Some(name)
            };
            match views.iter().find(named) {
                None => bail!("objectives: '{objective}' needs a view '{name}' in [[run.measure.views]]"),
                Some(view) if view.get(budget).is_none() => {
                    bail!("objectives: '{objective}' needs `{budget}` of the view '{name}'")
                }
                Some(_) => {}
            }
        }
        Ok(())
    }
}

/// Returns the value at a dotted key.
pub fn get<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    match key.split_once('.') {
        Some((first, rest)) => get(table.get(first)?.as_table()?, rest),
        None => table.get(key),
    }
}

/// Sets the value at a dotted key.
fn set(table: &mut Table, key: &str, value: Value) -> Result<()> {
    match key.split_once('.') {
        None => {
            table.insert(key.to_owned(), value);
            Ok(())
        }
        Some((first, rest)) => {
            let inner = table.entry(first).or_insert_with(|| Value::Table(Table::new()));
            let inner = inner.as_table_mut().with_context(|| format!("the key `{key}`: `{first}` is not a table"))?;
            set(inner, rest, value)
        }
    }
}

#[cfg(test)]
#[path = "../../tests/fuzz/mutation.rs"]
mod mutation;

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "objectives = ['relative_variance']\n[run]\nenv = 'studio'\n";

    #[test]
    fn errors_name_the_wrong_key_or_value() {
        for (text, named) in [
            ("objectives = ['speed']\n[run]\n[axes]\n", "'speed' is not an objective"),
            ("objectives = []\n[run]\n[axes]\n", "at least one"),
            ("objectives = ['mse:ball']\n[run]\n[axes]\n", "'ball'"),
            (&format!("{SMALL}[axes]\nsteps = {{ log = [1, 9] }}\n"), "points"),
            (&format!("{SMALL}[axes]\nsteps = []\n"), "`steps`"),
            (&format!("{SMALL}[axes]\nsteps = {{ log = [0, 9] }}\n"), "`steps`"),
            (&format!("{SMALL}[axes]\n[aggregate]\nover = ['seed']\n"), "'seed' is not an axis"),
            (&format!("{SMALL}[axes]\n[search]\nmethod = 'random'\n"), "search.n"),
            (&format!("{SMALL}[axes]\n[halving]\nrungs = [9, 3]\n"), "ascending"),
            (&format!("{SMALL}[axes]\nsteps = [1]\n[halving]\nrungs = [3, 9]\n"), "`steps`"),
        ] {
            let error = format!("{:#}", Space::parse(text).unwrap_err());
            assert!(error.contains(named), "{text}: {error}");
        }
    }

    #[test]
    fn chains_of_conditions_drop_inapplicable_axes() {
        let text = format!(
            "{SMALL}[axes]\na = [1, 2]\nb = {{ values = [1], when = {{ a = 2 }} }}\nc = {{ values = [1], when = {{ b = [1, 7] }} }}\n"
        );
        let space = Space::parse(&text).unwrap();
        let all = |a: i64| ["a", "b", "c"].map(|key| (key.to_owned(), Value::Integer(if key == "a" { a } else { 1 })));
        let keys = |a| space.active(all(a).into()).into_keys().collect::<Vec<_>>();
        assert_eq!(keys(1), ["a"]);
        assert_eq!(keys(2), ["a", "b", "c"]);
    }

    /// Like the readers in `tests/fuzz`; `HEADTAIL_FUZZ_INPUTS` sets the number of inputs.
    #[test]
    fn nearly_valid_spaces_are_accepted_or_rejected() {
        let rest = "[axes]\nlearning_rate = { log = [0.001, 0.1], points = 3 }\nseed = [1, 2]\n\
                    'head.bins' = [8, 16]\nb = { values = [0.5], when = { 'head.bins' = 16 } }\n[aggregate]\nover = ['seed']\nby = 'worst'\n\
                    [search]\nmethod = 'random'\nn = 4\nseed = 7\n[halving]\nrungs = [3, 9]\n";
        let corpus = [SMALL.to_owned() + rest, format!("{SMALL}[axes]\nsteps = [1]\n")].map(String::into_bytes);
        let inputs = std::env::var("HEADTAIL_FUZZ_INPUTS").map_or(2000, |text| text.parse().unwrap());
        let first = std::env::var("HEADTAIL_FUZZ_FIRST").map_or(0, |text| text.parse::<u64>().unwrap());
        let texts = (first..first + inputs)
            .filter_map(|input| String::from_utf8(super::mutation::Mutation::new(0x5eed, input).of(&corpus)).ok());
        let (taken, refused): (Vec<String>, Vec<String>) = texts.partition(|text| Space::parse(text).is_ok());
        // Both outcomes must occur.
        assert!(taken.len() > 10 && refused.len() > 10, "{} taken, {} refused", taken.len(), refused.len());
    }

    #[test]
    fn aggregates_of_several_numbers() {
        assert_eq!(By::Mean.of(&[1.0, 3.0]), 2.0);
        assert!((By::GeometricMean.of(&[1.0, 4.0]) - 2.0).abs() < 1e-12);
        assert_eq!(By::Worst.of(&[1.0, 3.0, 2.0]), 3.0);
    }
}
