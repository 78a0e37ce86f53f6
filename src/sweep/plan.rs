//! Plans the trials of a space.

use std::collections::{BTreeMap, HashMap};

use anyhow::{Context, Result, ensure};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use toml::Value;

use super::{
    axis::Axis,
    space::{Assignment, Method, Space},
};
use crate::run::{Contents, RunConfig, RunTable};

/// Maximum number of trials; more are a mistake.
const MOST_TRIALS: usize = 1_000_000;

/// One run of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// Hash of the resolved settings, of the content of the files that they name, and of the program's
    /// version.
    pub id: String,
    /// Values that it sets.
    pub assignment: Assignment,
    /// Index of its configuration in [`Plan::configurations`].
    pub configuration: usize,
}

/// A configuration and its trials, one per seed, map, ...
#[derive(Clone, Debug, PartialEq)]
pub struct Configuration {
    /// Values that it sets.
    pub assignment: Assignment,
    /// Indices into [`Plan::trials`].
    pub trials: Vec<usize>,
}

/// All trials of a space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// In the order in which they are started.
    pub trials: Vec<Trial>,
    /// In the same order.
    pub configurations: Vec<Configuration>,
}

impl Plan {
    /// Plans a space; `suggested` are the configurations of adaptive search so far.
    ///
    /// # Errors
    /// If there are too many trials, or the settings of one are invalid.
    pub fn new(space: &Space, suggested: &[Assignment], contents: &Contents) -> Result<Self> {
        let searched: Vec<&Axis> = space.searched().collect();
        let configurations = match space.search.method {
            Method::Product => product(&searched)?,
            Method::Zip => zip(&searched)?,
            Method::Random => (0..space.search.n).map(|number| drawn(space, number as u64)).collect(),
            Method::Tpe => suggested.to_vec(),
        };
        let replicates = product(&space.replicated().collect::<Vec<_>>())?;
        let count = configurations.len().saturating_mul(replicates.len());
        ensure!(count <= MOST_TRIALS, "the space has {count} trials; at most {MOST_TRIALS} are planned");

        let mut plan = Self::default();
        // A configuration can occur twice: by draws, or if a condition drops the difference.
        let mut known: HashMap<String, ()> = HashMap::new();
        for assignment in configurations {
            let assignment = space.active(assignment);
            if known.insert(text(&assignment), ()).is_none() {
                plan.configurations.push(Configuration { assignment, trials: Vec::new() });
            }
        }
        read_maps(space, contents);
        let of_configuration = |(index, configuration): (usize, &Configuration)| {
            let trial = |replicate: &Assignment| {
                let mut assignment = configuration.assignment.clone();
                assignment.extend(replicate.clone());
                let run = resolve(space, &assignment)?;
                Ok(Trial { id: identity(&run, contents)?, assignment, configuration: index })
            };
            replicates.iter().map(trial).collect::<Result<Vec<_>>>()
        };
        let trials: Vec<Vec<Trial>> =
            plan.configurations.par_iter().enumerate().map(of_configuration).collect::<Result<_>>()?;
        // Equal settings in different notation (0.5 and 5e-1) give one trial.
        let mut ids: HashMap<String, usize> = HashMap::new();
        for trial in trials.into_iter().flatten() {
            let next = plan.trials.len();
            let index = *ids.entry(trial.id.clone()).or_insert(next);
            plan.configurations[trial.configuration].trials.push(index);
            if index == next {
                plan.trials.push(trial);
            }
        }
        Ok(plan)
    }
}

/// Reads the maps once, before all threads request them at the same time.
fn read_maps(space: &Space, contents: &Contents) {
    let axis = space.axes.iter().find(|axis| axis.key == "env").and_then(|axis| axis.grid().ok());
    let maps = axis.unwrap_or_default().into_iter().chain(space.run.get("env").cloned());
    maps.filter_map(|map| map.as_str().map(str::to_owned)).for_each(|map| drop(contents.map(&map)));
}

/// Returns the run of a trial.
///
/// # Errors
/// If the settings are invalid; the error names the values of the assignment.
pub fn resolve(space: &Space, assignment: &Assignment) -> Result<RunConfig> {
    let run = space.table(assignment).and_then(|table| RunTable::new("run", table)?.resolve());
    run.with_context(|| format!("the trial {{{}}}", text(assignment)))
}

/// Returns the first 64 bits of the hash of a run.
fn identity(run: &RunConfig, contents: &Contents) -> Result<String> {
    Ok(run.hash(contents)?[..16].to_owned())
}

/// Formats an assignment: `head.bins = 8, learning_rate = 0.004`.
pub fn text(assignment: &Assignment) -> String {
    assignment.iter().map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ")
}

/// Returns draw `number` of random search.
pub fn drawn(space: &Space, number: u64) -> Assignment {
    let mut random = stream(space.search.seed, number);
    space.searched().map(|axis| (axis.key.clone(), axis.draw(&mut random))).collect()
}

/// Returns the random numbers of a draw.
pub fn stream(seed: u64, number: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    random
}

fn product(axes: &[&Axis]) -> Result<Vec<Assignment>> {
    let grids = axes.iter().map(|axis| Ok((&axis.key, axis.grid()?))).collect::<Result<Vec<_>>>()?;
    let count = grids.iter().fold(1_usize, |count, (_, values)| count.saturating_mul(values.len()));
    ensure!(count <= MOST_TRIALS, "the product has {count} configurations; at most {MOST_TRIALS} are planned");
    let mut all = vec![Assignment::new()];
    for (key, values) in grids {
        let with = |assignment: &Assignment, value: &Value| {
            let mut assignment = assignment.clone();
            assignment.insert(key.clone(), value.clone());
            assignment
        };
        all = all.iter().flat_map(|assignment| values.iter().map(|value| with(assignment, value))).collect();
    }
    Ok(all)
}

fn zip(axes: &[&Axis]) -> Result<Vec<Assignment>> {
    let grids: BTreeMap<&String, Vec<Value>> =
        axes.iter().map(|axis| Ok((&axis.key, axis.grid()?))).collect::<Result<_>>()?;
    let Some(count) = grids.values().map(Vec::len).next() else { return Ok(vec![Assignment::new()]) };
    for (key, values) in &grids {
        ensure!(values.len() == count, "zip: `{key}` has {} values, another axis {count}", values.len());
    }
    let row = |index: usize| grids.iter().map(|(key, values)| ((*key).clone(), values[index].clone())).collect();
    Ok((0..count).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(axes: &str) -> Result<Plan> {
        let text = format!("objectives = ['relative_variance']\n[run]\nenv = 'studio'\n[axes]\n{axes}");
        Plan::new(&Space::parse(&text)?, &[], &Contents::default())
    }

    #[test]
    fn products_zips_and_draws_have_the_expected_number_of_trials() {
        let axes = "steps = [1, 2, 3]\nseed = [0, 1, 2]\n";
        assert_eq!(plan(axes).unwrap().trials.len(), 9);
        assert_eq!(plan(&format!("{axes}[search]\nmethod = 'zip'")).unwrap().trials.len(), 3);
        let over = plan(&format!("{axes}[aggregate]\nover = ['seed']")).unwrap();
        assert_eq!((over.configurations.len(), over.trials.len()), (3, 9));
        let random = plan("learning_rate = { log = [1e-3, 1e-1] }\n[search]\nmethod = 'random'\nn = 20").unwrap();
        assert_eq!(random.trials.len(), 20);
        let error = plan("steps = [1, 2]\nseed = [0]\n[search]\nmethod = 'zip'").unwrap_err();
        assert!(error.to_string().contains("zip"), "{error}");
    }

    #[test]
    fn inapplicable_settings_make_no_trials() {
        let axes = "loss = ['forward-kl', 'log-chi-square']\nentropic = { values = [0.0, 1e-4], when = { loss = 'forward-kl' } }";
        assert_eq!(plan(axes).unwrap().trials.len(), 3);
    }

    #[test]
    fn a_changed_space_keeps_common_trials() {
        let ids = |axes: &str| plan(axes).unwrap().trials.into_iter().map(|trial| trial.id).collect::<Vec<_>>();
        let (small, large) = (ids("head.bins = [4, 8]"), ids("head.bins = [8, 4, 16]\nseed = [0]"));
        assert_eq!((&small[0], &small[1]), (&large[1], &large[0]));
        assert_ne!(ids("head.bins = [4]"), ids("head.bins = [4]\nseed = [1]"));
    }

    #[test]
    fn errors_name_the_invalid_value() {
        let error = format!("{:#}", plan("head.bins = [4, -1]").unwrap_err());
        assert!(error.contains("head.bins = -1"), "{error}");
        let error = format!("{:#}", plan("head.bin = [4]").unwrap_err());
        assert!(error.contains("`head.bin`"), "{error}");
    }
}
