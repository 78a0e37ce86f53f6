//! Preparation of candidates: files, and the time that they take.

use std::{path::Path, sync::atomic::AtomicBool, time::Instant};

use anyhow::{Context, Result, bail};
use headtail_eval::OpenedView;
use headtail_render::{
    bake::{CellGrid, NormalGrid},
    estimator::Estimator,
    export::{ExportedSampler, Intermediate},
    spec::{FileKind, SamplerSpec},
    tail::TailKind,
};
use headtail_train::learned_bake;

use super::candidates::{Candidate, HeadMaterial, HeadShape, Recipe};
use crate::{
    bake,
    run::{self, RunContext, RunTable},
};

/// A sampler, built and ready to render.
pub struct BuiltSampler {
    /// SPEC for `--sampler`.
    pub spec: SamplerSpec,
    /// Estimator of the SPEC.
    pub estimator: Box<dyn Estimator>,
    /// Seconds before the first sample: training, tables.
    pub prepared: f64,
    /// Bytes of its file; 0 without one.
    pub bytes: u64,
}

/// Prepares a candidate; its file, if there is one, is written to `folder`.
///
/// # Errors
/// If it cannot be trained, baked, written or opened.
pub fn build(
    candidate: &Candidate,
    env: &str,
    opened: &OpenedView,
    material: &HeadMaterial,
    folder: &Path,
    stop: &AtomicBool,
) -> Result<BuiltSampler> {
    let start = Instant::now();
    let spec = match &candidate.recipe {
        Recipe::Plain(spec) => spec.parse()?,
        Recipe::Form(spec, _) => spec.clone(),
        Recipe::Direct(normals, cells) => {
            let (normals, cells) = (NormalGrid::new(normals.0, normals.1)?, CellGrid::new(cells.0, cells.1)?);
            let file = folder.join(file_name(&candidate.name));
            bake::direct(env, &opened.environment, TailKind::Hierarchical, normals, cells)?.write(&file)?;
            SamplerSpec::file(FileKind::Direct, file)
        }
        Recipe::Head(shape, steps) => {
            trained(shape.settings, *steps, env, material, &folder.join(file_stem(&candidate.name)), stop)?
        }
        Recipe::Baked(shape, steps) => {
            let head = folder.join(file_stem(&format!("{}, {steps} steps", shape.name))).join(run::SAMPLER);
            let exported = ExportedSampler::read(&head)?;
            let Intermediate::Head(native) = &exported.intermediate else { bail!("{}: no head", head.display()) };
            let table = learned_bake(native, &exported.tail, NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?;
            let file = folder.join(file_name(&candidate.name));
            ExportedSampler { intermediate: Intermediate::Bake(table), ..exported }.write(&file)?;
            SamplerSpec::file(FileKind::Baked, file)
        }
    };
    let estimator = opened.estimator(&spec)?;
    let prepared = start.elapsed().as_secs_f64();
    let bytes = spec.path().map_or(Ok(0), |(_, file)| std::fs::metadata(file).map(|data| data.len()));
    Ok(BuiltSampler { bytes: bytes.with_context(|| candidate.name.clone())?, spec, estimator, prepared })
}

/// Returns an untrained head, for timing its samples.
///
/// # Errors
/// As [`build`].
pub fn untrained(
    shape: &HeadShape,
    env: &str,
    opened: &OpenedView,
    material: &HeadMaterial,
    out: &Path,
    stop: &AtomicBool,
) -> Result<BuiltSampler> {
    let start = Instant::now();
    let settings = format!("{}\nvalidation_conditions = 1\nvalidation_strata = 2", shape.settings);
    let spec = trained(&settings, 1, env, material, &out.join("untrained").join(file_stem(shape.name)), stop)?;
    let estimator = opened.estimator(&spec)?;
    Ok(BuiltSampler { spec, estimator, prepared: start.elapsed().as_secs_f64(), bytes: 0 })
}

/// Trains a head with these settings over the fast preset.
fn trained(
    settings: &str,
    steps: usize,
    env: &str,
    material: &HeadMaterial,
    out: &Path,
    stop: &AtomicBool,
) -> Result<SamplerSpec> {
    let mut table: toml::Table = settings.parse().context("the settings of a head")?;
    table.insert("material".into(), material.0.to_string().into());
    table.insert("steps".into(), (steps as i64).into());
    let mut table = RunTable::new("the settings of a head", table)?;
    table.set_env(env.to_owned());
    let context = RunContext {
        out: out.to_owned(),
        references: out.join("references"),
        tensorboard: None,
        pictures: None,
        until: None,
        stop,
        watch: &mut |_| {},
    };
    let finished = run::perform(&table.resolve()?, context)?;
    finished.sampler.context("a head without a file")
}

/// Converts a name for use in a file name.
fn file_stem(name: &str) -> String {
    name.chars().filter(|c| *c != ',').map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

fn file_name(name: &str) -> String {
    file_stem(name) + ".safetensors"
}
