//! Trained heads, each trained once and cached in a file.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, Result, bail};
use headtail_render::{
    brdf::NeuralTexture,
    environment::Environment,
    export::{ExportedSampler, Intermediate},
    file::open_regular,
    head::{Condition, Head},
    rival::{RivalFile, RivalKind},
    scene::MaterialSpec,
    tail::{Tail, TailKind},
};
use headtail_train::{
    FitConfig, Loss, Preset, Run, Summary, Target, Viewpoints, build_target, condition_of, exported_sampler, fit,
    fit_tail, native_head,
    rival::{RivalMaterial, RivalSettings, fit_rival},
};

use super::{data::View, effort::Effort, fits::short_name};
use crate::output::make_folder;

/// The heads of a page.
pub struct Heads {
    folder: PathBuf,
    effort: Effort,
    stop: Arc<AtomicBool>,
    /// Heads without a tail, which have no files, by map and material.
    naive: Mutex<Vec<(String, Head)>>,
    /// Flow tails, by map.
    flows: Mutex<Vec<(String, Arc<Tail>)>>,
}

/// A trained head.
pub struct Trained {
    /// For rendering.
    pub head: Head,
    /// Its file.
    pub file: PathBuf,
    /// Seconds of its training.
    pub seconds: f64,
}

impl Heads {
    /// Heads in `folder`.
    pub fn new(folder: &Path, effort: Effort, stop: Arc<AtomicBool>) -> Result<Self> {
        make_folder(folder)?;
        Ok(Self { folder: folder.to_owned(), effort, stop, naive: Mutex::default(), flows: Mutex::default() })
    }

    /// Returns the training configuration of a head: the fast preset, with a learned mixture weight for BRDF
    /// sampling only for neural materials over surfaces.
    pub fn config(&self, material: &MaterialSpec) -> FitConfig {
        let mut config = Preset::fast_for(material).config().for_material(material.clone());
        config.head.share &= condition_of(material) == Condition::Texture;
        config.fall_back = false;
        config.validate_every = 0;
        config.steps = if material.is_lambert() { self.effort.cosine_steps } else { self.effort.ggx_steps };
        config
    }

    /// Returns the head of a material for a map, from its file or newly trained.
    ///
    /// # Errors
    /// See [`fit()`]; an interrupted training is an error.
    pub fn of(&self, environment: &Environment, material: &MaterialSpec) -> Result<Trained> {
        let name = format!("{}-{}", environment.name(), short_name(material));
        self.seen(environment, material, &name, || Ok(Viewpoints::Sphere))
    }

    /// Returns the head of a neural material for the surfaces that a camera sees under a map.
    ///
    /// # Errors
    /// As [`Self::of`], and if the camera sees nothing.
    pub fn of_view(&self, environment: &Environment, material: &MaterialSpec, view: &View) -> Result<Trained> {
        let (width, height) = (self.effort.width, self.effort.width * 3 / 4);
        let viewpoints = || Ok(Viewpoints::of_scene(&view.scene, &view.camera, width, height, 0)?);
        let name = format!("{}-{}-{}-{width}", environment.name(), view.name, short_name(material));
        self.seen(environment, material, &name, viewpoints)
    }

    /// Returns the file of NeuSample's flow for a neural material, training it if needed.
    ///
    /// # Errors
    /// See [`fit_rival`]; an interrupted training is an error.
    pub fn neusample(&self, texture: &Arc<NeuralTexture>) -> Result<PathBuf> {
        let steps = self.effort.rival_steps;
        let material = RivalMaterial::textured(texture.clone());
        let file = self.file(&format!("neusample-{}{}-{steps}", material.name, short(&material.identity)));
        if RivalFile::read(&file).is_ok_and(|known| known.rivals[0].1 == material.identity) {
            return Ok(file);
        }
        let start = Instant::now();
        let kind = RivalKind::Flow;
        let settings = RivalSettings { steps, ..RivalSettings::new(kind) };
        let run = Run { progress: &mut |_| Ok(()), interrupt: &self.stop, checkpoints: None, warn: &mut |_| {} };
        let (rival, state) = fit_rival(&settings, &material, run)?;
        if state.step < steps {
            bail!(crate::progress::Interrupted::new("while a flow of NeuSample's was trained"));
        }
        let rivals = vec![(material.name.clone(), material.identity, rival)];
        RivalFile { kind, rivals, seconds: Some(start.elapsed().as_secs_f64()) }.write(&file)?;
        Ok(file)
    }

    fn file(&self, name: &str) -> PathBuf {
        let name: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        self.folder.join(name).with_extension("safetensors")
    }

    fn seen(
        &self,
        environment: &Environment,
        material: &MaterialSpec,
        name: &str,
        viewpoints: impl FnOnce() -> Result<Viewpoints>,
    ) -> Result<Trained> {
        let config = self.config(material);
        let file = self.file(&format!("{name}{}-{}", identity(material)?, config.steps));
        if let Ok(exported) = ExportedSampler::read(&file)
            && exported.check_environment(environment).is_ok()
            && let Intermediate::Head(head) = exported.intermediate
        {
            let seconds = exported.training.and_then(|training| training.seconds).unwrap_or(f64::NAN);
            return Ok(Trained { head, file, seconds });
        }
        let tail = Arc::new(Tail::of_environment(config.tail, environment)?);
        let target = build_target(&config, &tail, viewpoints()?)?;
        let fitted = fit(&config, &*target, &mut |_| {}, &self.stop)?;
        self.check(&fitted.summary)?;
        exported_sampler(&fitted.head, &config, &fitted.summary, environment, &tail, true)?.write(&file)?;
        Ok(Trained { head: native_head(&fitted.head)?, file, seconds: fitted.summary.seconds })
    }

    /// Returns a head without a tail, cached in memory by map and material.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn naive_of(&self, environment: &Environment, material: &MaterialSpec) -> Result<Head> {
        let name = format!("{} {material}", environment.name());
        let known = || self.naive.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, head)) = known().iter().find(|(own, _)| *own == name) {
            return Ok(head.clone());
        }
        let config = self.naive(material);
        let tail = Tail::of_environment(config.tail, environment)?;
        let (head, _) = self.train(&config, &*build_target(&config, &tail, Viewpoints::Sphere)?)?;
        known().push((name, head.clone()));
        Ok(head)
    }

    /// Trains a head that has no file: without a tail, or for a custom target.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn train(&self, config: &FitConfig, target: &dyn Target) -> Result<(Head, Summary)> {
        let fitted = fit(config, target, &mut |_| {}, &self.stop)?;
        self.check(&fitted.summary)?;
        Ok((native_head(&fitted.head)?, fitted.summary))
    }

    /// Returns the tail of a configuration. Flow tails are cached in memory by map.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn tail(&self, config: &FitConfig, environment: &Environment) -> Result<Arc<Tail>> {
        if config.tail != TailKind::Flow {
            return Ok(Arc::new(Tail::of_environment(config.tail, environment)?));
        }
        let known = || self.flows.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, tail)) = known().iter().find(|(name, _)| name == environment.name()) {
            return Ok(tail.clone());
        }
        let run = Run { progress: &mut |_| Ok(()), interrupt: &self.stop, checkpoints: None, warn: &mut |_| {} };
        let (tail, _) = fit_tail(config, environment, run)?;
        if self.stop.load(Ordering::Relaxed) {
            bail!(crate::progress::Interrupted::new("while a flow tail was fitted"));
        }
        known().push((environment.name().to_owned(), tail.clone()));
        Ok(tail)
    }

    /// The configuration of a head of the same size without a tail.
    pub fn naive(&self, material: &MaterialSpec) -> FitConfig {
        FitConfig { naive: true, loss: Loss::ForwardKl, learning_rate: 4e-3, ..self.config(material) }
    }

    fn check(&self, summary: &Summary) -> Result<()> {
        if summary.interrupted {
            bail!(crate::progress::Interrupted::new("while a head was trained; heads that were done are kept"));
        }
        Ok(())
    }
}

/// Distinguishes materials of one name: the first eight digits of their file's hash; empty for analytic ones.
fn identity(material: &MaterialSpec) -> Result<String> {
    let file = match material {
        MaterialSpec::Lambert { .. } | MaterialSpec::Ggx { .. } => return Ok(String::new()),
        MaterialSpec::Measured { file, .. } => file,
        MaterialSpec::Neural(spec) => &spec.file,
    };
    let mut hasher = blake3::Hasher::new();
    let opened = open_regular(file).and_then(|(file, _)| hasher.update_reader(file).map(|_| ()));
    opened.with_context(|| file.display().to_string())?;
    Ok(short(&hasher.finalize()))
}

fn short(hash: &blake3::Hash) -> String {
    format!("-{}", &hash.to_hex()[..8])
}
