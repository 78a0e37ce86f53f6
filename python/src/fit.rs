//! Training.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
};

use headtail_render::{
    bake::{CellGrid, NormalGrid},
    export::{ExportedSampler, Intermediate},
    scene::MaterialSpec,
};
use headtail_train::{
    CheckpointFolder, Checkpoints, ConfigBuilder, FitConfig, Fitted, Preset, Progress, Run, Viewpoints, build_target,
    exported_sampler, fit_tail, fit_with,
};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    environment::Environment,
    error::{of_render, of_train, refused},
    sampler::Sampler,
};

/// Returns the configuration of a preset with a material and assignments.
fn configuration(material: Option<&str>, preset: Option<&str>, assignments: &[String]) -> PyResult<FitConfig> {
    let material: Option<MaterialSpec> = material.map(str::parse).transpose().map_err(of_render)?;
    let preset = match preset {
        Some(name) => name.parse().map_err(|error: String| refused(error))?,
        None => Preset::fast_for(material.as_ref().unwrap_or(&MaterialSpec::LAMBERT)),
    };
    let mut builder = ConfigBuilder::new(preset);
    for assignment in assignments {
        builder.assignment(assignment).map_err(of_train)?;
    }
    let config = builder.build().map_err(of_train)?;
    let config = material.map_or(config.clone(), |material| config.for_material(material));
    let over = config.over;
    let config = config.over(over);
    config.validate().map_err(of_train)?;
    Ok(config)
}

/// Returns all settings of a run as TOML.
#[pyfunction]
pub fn settings(material: Option<&str>, preset: Option<&str>, assignments: Vec<String>) -> PyResult<String> {
    configuration(material, preset, &assignments)?.to_toml().map_err(of_train)
}

/// Trains a head. Ctrl-C or an exception in `progress` ends the run, with a checkpoint if there is a folder.
#[pyfunction]
#[pyo3(signature = (environment, material, preset, assignments, checkpoints, reproducible, progress))]
#[expect(clippy::too_many_arguments, reason = "the settings of one run")]
pub fn fit(
    py: Python<'_>,
    environment: &Environment,
    material: Option<&str>,
    preset: Option<&str>,
    assignments: Vec<String>,
    checkpoints: Option<(PathBuf, usize, bool)>,
    reproducible: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Sampler> {
    let config = configuration(material, preset, &assignments)?;
    let map = environment.0.clone();
    let checkpoints = checkpoints.map(|(folder, every, resume)| CheckpointFolder {
        folder,
        every,
        resume,
        target: format!("environment {}, conditions from everywhere", map.hash()),
    });
    let (stop, mut raised) = (AtomicBool::new(false), None);
    let mut watch = |now: &Progress| {
        if let Err(error) = Python::attach(|py| tell(py, progress.as_ref(), now)) {
            raised.get_or_insert(error);
            stop.store(true, Ordering::Relaxed);
        }
        Ok(())
    };
    let exported = py.detach(|| {
        let of_tail = checkpoints.as_ref().map(CheckpointFolder::of_tail);
        let [of_tail, of_head] =
            [&of_tail, &checkpoints].map(|folder| folder.as_ref().map(|folder| folder as &dyn Checkpoints));
        let mut warn = |error: &headtail_train::Error| eprintln!("warning: {error}");
        let run = Run { progress: &mut watch, interrupt: &stop, checkpoints: of_tail, warn: &mut warn };
        let (tail, _) = fit_tail(&config, &map, run)?;
        let target = build_target(&config, &tail, Viewpoints::Sphere)?;
        let run = Run { progress: &mut watch, interrupt: &stop, checkpoints: of_head, warn: &mut warn };
        let Fitted { head, summary } = fit_with(&config, &*target, run)?;
        exported_sampler(&head, &config, &summary, &map, &tail, !reproducible)
    });
    if let Some(error) = raised {
        return Err(error);
    }
    let exported = exported.map_err(of_train)?;
    Sampler::of_exported("head".into(), exported, Some(map)).map_err(of_render)
}

/// Tabulates a trained head.
#[pyfunction]
pub fn bake_head(py: Python<'_>, source: &Sampler, normals: [usize; 2], cells: [usize; 2]) -> PyResult<Sampler> {
    let Some(exported) = &source.exported else {
        return Err(refused(format!("{}: holds no trained head", source.name)));
    };
    let head = exported.head_over_tail().map_err(|error| refused(format!("{}: {error}", source.name)))?;
    py.detach(|| {
        let normals = NormalGrid::new(normals[0], normals[1]).map_err(of_render)?;
        let cells = CellGrid::new(cells[0], cells[1]).map_err(of_render)?;
        let table = headtail_train::learned_bake(head, &exported.tail, normals, cells).map_err(of_train)?;
        let exported = ExportedSampler { intermediate: Intermediate::Bake(table), ..exported.clone() };
        let map = source.has_map.then(|| source.map.clone());
        Sampler::of_exported("baked".into(), exported, map).map_err(of_render)
    })
}

/// Handles Ctrl-C and calls back after a step.
fn tell(py: Python<'_>, callback: Option<&Py<PyAny>>, now: &Progress) -> PyResult<()> {
    py.check_signals()?;
    let Some(callback) = callback else { return Ok(()) };
    let known = PyDict::new(py);
    known.set_item("step", now.step)?;
    known.set_item("steps", now.steps)?;
    known.set_item("loss", now.loss)?;
    known.set_item("kl", now.divergence.map(|divergence| divergence.kl))?;
    known.set_item("relative_variance", now.divergence.map(|divergence| divergence.relative_variance))?;
    known.set_item("seconds", now.seconds)?;
    callback.call1(py, (known,)).map(|_| ())
}
