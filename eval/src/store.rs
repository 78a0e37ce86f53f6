//! Measurements of experiments as files: one CSV per experiment, and one for the machines and sources of
//! measurement.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use headtail_render::file;
use serde::{Deserialize, Serialize};

use crate::{Error, Measurement, MeasurementEnvironment, Result, ViewKey};

/// File of machines and sources.
const ENVIRONMENTS: &str = "environments.csv";
/// File of sources that render the same as earlier ones.
const VERIFIED: &str = "verified.csv";
/// Maximum size of a file in bytes.
const MOST: u64 = 1 << 28;

/// A folder of measurements.
pub struct Store {
    folder: PathBuf,
}

/// One stored run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Scene.
    pub scene: String,
    /// Map.
    pub map: String,
    /// Material.
    pub material: String,
    /// Sampler.
    pub sampler: String,
    /// Budget.
    pub budget: String,
    /// Index of the run.
    pub run: u32,
    /// Seed.
    pub seed: u64,
    /// Samples per pixel.
    pub spp: f64,
    /// Wall-clock seconds of rendering.
    pub seconds: f64,
    /// Processor seconds of rendering.
    pub processor_seconds: f64,
    /// Seconds of preparation.
    pub preparation: f64,
    /// Rays per sample.
    pub rays_per_sample: f64,
    /// Mean squared error.
    pub mse: f64,
    /// Mean relative squared error.
    pub relmse: f64,
    /// `relmse` without the worst 0.1 % of the pixels.
    pub relmse_trimmed: f64,
    /// Mean luminance.
    pub mean_luminance: f64,
    /// Mean luminance of the reference.
    pub reference_luminance: f64,
    /// MSE of the reference.
    pub reference_mse: f64,
    /// Largest contribution.
    pub max_weight: f64,
    /// Smallest corrected p-value of a tile's mean.
    pub tile_p: f64,
    /// Id of the row in `environments.csv`.
    pub environment: String,
}

impl Record {
    fn of(own: &Measurement, environment: &str) -> Self {
        Self {
            scene: own.scene.clone(),
            map: own.env.clone(),
            material: own.material.clone(),
            sampler: own.sampler.clone(),
            budget: own.budget.clone(),
            run: own.run,
            seed: own.seed,
            spp: own.spp,
            seconds: rounded(own.seconds),
            processor_seconds: rounded(own.processor_seconds),
            preparation: rounded(own.preparation),
            rays_per_sample: rounded(own.rays_per_sample),
            mse: rounded(own.mse),
            relmse: rounded(own.relmse),
            relmse_trimmed: rounded(own.relmse_trimmed),
            mean_luminance: rounded(own.mean_luminance),
            reference_luminance: rounded(own.reference_luminance),
            reference_mse: rounded(own.reference_mse),
            max_weight: rounded(own.max_weight),
            tile_p: rounded(own.tile_p),
            environment: environment.to_owned(),
        }
    }

    /// Returns the names of its view.
    pub fn view(&self) -> ViewKey {
        let [scene, map, material] = [&self.scene, &self.map, &self.material].map(Clone::clone);
        ViewKey { scene, map, material }
    }
}

/// Rounds to seven significant digits: files stay small, and no figure needs more.
pub(crate) fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}

/// A row of the file of machines and sources.
#[derive(Serialize, Deserialize)]
struct EnvironmentRow {
    id: String,
    version: String,
    sources: String,
    machine: String,
    instruction_set: String,
    threads: usize,
}

/// Sources whose pictures equal those of earlier sources.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VerifiedSources {
    /// Sources of the measurements.
    pub measured: String,
    /// Sources that render the same pictures.
    pub verified: String,
    /// Number of compared pictures.
    pub pictures: usize,
}

impl Store {
    /// Returns the store of a folder, which need not exist.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, experiment: &str) -> PathBuf {
        self.folder.join(format!("{experiment}.csv"))
    }

    /// Returns the measurements of an experiment, in the order of the file.
    ///
    /// # Errors
    /// If the file exists and cannot be read.
    pub fn records(&self, experiment: &str) -> Result<Vec<Record>> {
        read_rows(&self.path(experiment))
    }

    /// Adds measurements in sorted order; those with the same (view, sampler, budget, run) are replaced.
    ///
    /// # Errors
    /// If a file cannot be read or written.
    pub fn add(
        &self,
        experiment: &str,
        measurements: &[Measurement],
        environment: &MeasurementEnvironment,
    ) -> Result<()> {
        let id = self.id_of(environment)?;
        let added: Vec<Record> = measurements.iter().map(|own| Record::of(own, &id)).collect();
        let key = |own: &Record| (own.view(), own.sampler.clone(), own.budget.clone(), own.run);
        let replaced: HashSet<_> = added.iter().map(key).collect();
        let mut records = self.records(experiment)?;
        records.retain(|own| !replaced.contains(&key(own)));
        records.extend(added);
        self.write(experiment, &mut records)
    }

    /// Removes the records for which `is_wanted` is false.
    ///
    /// # Errors
    /// If the file cannot be read or written.
    pub fn retain(&self, experiment: &str, is_wanted: impl Fn(&Record) -> bool) -> Result<()> {
        let mut records = self.records(experiment)?;
        let count = records.len();
        records.retain(is_wanted);
        if records.len() < count { self.write(experiment, &mut records) } else { Ok(()) }
    }

    /// Changes the records of an experiment.
    ///
    /// # Errors
    /// If the file cannot be read or written.
    pub fn update(&self, experiment: &str, change: impl FnMut(&mut Record)) -> Result<()> {
        let mut records = self.records(experiment)?;
        records.iter_mut().for_each(change);
        self.write(experiment, &mut records)
    }

    fn write(&self, experiment: &str, records: &mut [Record]) -> Result<()> {
        records.sort_by(|a, b| {
            let key = |own: &Record| (own.view(), own.sampler.clone(), own.budget.clone(), own.run);
            key(a).cmp(&key(b))
        });
        write_rows(&self.path(experiment), records)
    }

    /// Returns the machines and sources of records, by id.
    ///
    /// # Errors
    /// If the file exists and cannot be read.
    pub fn environments(&self) -> Result<Vec<(String, MeasurementEnvironment)>> {
        let rows: Vec<EnvironmentRow> = read_rows(&self.folder.join(ENVIRONMENTS))?;
        let environment = |row: EnvironmentRow| {
            let EnvironmentRow { id, version, sources, machine, instruction_set, threads } = row;
            (id, MeasurementEnvironment { version, sources, machine, instruction_set, threads })
        };
        Ok(rows.into_iter().map(environment).collect())
    }

    /// Returns the sources that were found to render the same as earlier ones.
    ///
    /// # Errors
    /// If the file exists and cannot be read.
    pub fn verified(&self) -> Result<Vec<VerifiedSources>> {
        read_rows(&self.folder.join(VERIFIED))
    }

    /// Stores verified sources; rows with the same measured sources are replaced.
    ///
    /// # Errors
    /// If the file cannot be read or written.
    pub fn add_verified(&self, rows: &[VerifiedSources]) -> Result<()> {
        let mut known = self.verified()?;
        known.retain(|own| rows.iter().all(|row| row.measured != own.measured));
        known.extend_from_slice(rows);
        write_rows(&self.folder.join(VERIFIED), &known)
    }

    /// Returns the id of a machine and its sources, which are added to the file if they are new.
    pub(crate) fn id_of(&self, environment: &MeasurementEnvironment) -> Result<String> {
        let mut known = self.environments()?;
        if let Some((id, _)) = known.iter().find(|(_, own)| own == environment) {
            return Ok(id.clone());
        }
        let id = format!("e{}", known.len() + 1);
        known.push((id.clone(), environment.clone()));
        let row = |(id, own): (String, MeasurementEnvironment)| EnvironmentRow {
            id,
            version: own.version,
            sources: own.sources,
            machine: own.machine,
            instruction_set: own.instruction_set,
            threads: own.threads,
        };
        write_rows(&self.folder.join(ENVIRONMENTS), &known.into_iter().map(row).collect::<Vec<_>>())?;
        Ok(id)
    }
}

fn read_rows<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<Vec<T>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let bytes = file::read(path, MOST).map_err(|error| Error::file(path, error))?;
    csv::Reader::from_reader(&*bytes)
        .into_deserialize()
        .collect::<std::result::Result<_, _>>()
        .map_err(|error| Error::file(path, error))
}

fn write_rows<T: Serialize>(path: &Path, rows: &[T]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.iter().try_for_each(|row| writer.serialize(row)).map_err(|error| Error::file(path, error))?;
    let bytes = writer.into_inner().map_err(|error| Error::file(path, error.to_string()))?;
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
    }
    Ok(file::replace(path, &bytes)?)
}
