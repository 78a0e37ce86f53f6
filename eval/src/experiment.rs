//! What is measured: views, samplers, budgets. Read from TOML files, or built as data.

use std::path::Path;

use headtail_render::file;
use serde::{Deserialize, Serialize};

use crate::{Artifact, Budget, CameraSettings, Error, Result, ViewSettings};

/// An experiment: every sampler on every view at every budget.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Its name: the stem of its file.
    #[serde(skip)]
    pub name: String,
    /// What it answers, as a question.
    pub question: String,
    /// Width of pictures in pixels.
    pub width: u32,
    /// Height of pictures in pixels.
    pub height: u32,
    /// What each run may take: `16spp` or `0.25s`.
    pub budgets: Vec<BudgetEntry>,
    /// Runs of each sampler at each budget.
    pub runs: u32,
    /// Seed of the first run.
    #[serde(default = "Experiment::first_seed")]
    pub seed: u64,
    /// Threads that render.
    pub threads: usize,
    /// The points of samples.
    #[serde(default = "Experiment::sobol")]
    pub points: String,
    /// Surfaces that light may visit; 1 is direct light.
    #[serde(default = "Experiment::direct_light")]
    pub depth: u32,
    /// Whether shadow rays are left out.
    #[serde(default)]
    pub unshadowed: bool,
    /// Samples per pixel that references have at least.
    pub reference_samples: u32,
    /// Scenes by name.
    pub scenes: Vec<SceneEntry>,
    /// Maps by name.
    pub maps: Vec<MapEntry>,
    /// Materials by name.
    pub materials: Vec<MaterialEntry>,
    /// Which of them are combined.
    pub views: Vec<ViewGroup>,
    /// Samplers by name.
    pub samplers: Vec<SamplerEntry>,
    /// Files that samplers read, and how they are made.
    #[serde(default)]
    pub artifacts: Vec<Artifact>,
    /// What `run --quick` changes.
    pub quick: Quick,
}

/// A budget in its written form.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct BudgetEntry(pub Budget);

impl TryFrom<String> for BudgetEntry {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<Self, String> {
        text.parse().map(Self)
    }
}

impl From<BudgetEntry> for String {
    fn from(entry: BudgetEntry) -> Self {
        entry.0.to_string()
    }
}

/// The miniature of an experiment.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Quick {
    /// Views that are measured; the first ones whose files are there.
    pub views: usize,
    /// Width of pictures.
    pub width: u32,
    /// Height of pictures.
    pub height: u32,
    /// Budgets.
    pub budgets: Vec<BudgetEntry>,
    /// Runs.
    pub runs: u32,
}

/// A scene.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEntry {
    /// Its name in measurements.
    pub name: String,
    /// A built-in scene, or a file below the data folder.
    pub file: String,
    /// Whether a grey plane is put under it.
    #[serde(default)]
    pub ground: bool,
    /// Whether it is an interior.
    #[serde(default)]
    pub interior: bool,
    /// Whether a setting of the project was chosen by pictures of it.
    pub tuned: bool,
    /// The camera's position, with `look_at`.
    #[serde(default)]
    pub look_from: Option<[f32; 3]>,
    /// What it looks at.
    #[serde(default)]
    pub look_at: Option<[f32; 3]>,
    /// Vertical field of view in degrees.
    #[serde(default)]
    pub fov: Option<f32>,
}

/// A map.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct MapEntry {
    /// Its name in measurements.
    pub name: String,
    /// A built-in map, or a file below the data folder.
    pub file: String,
    /// What kind of light it is, in a word or two.
    pub kind: String,
    /// Whether a setting of the project was chosen by pictures under it.
    pub tuned: bool,
}

/// A material.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialEntry {
    /// Its name in measurements.
    pub name: String,
    /// As `--material` takes it; empty for the scene's own.
    #[serde(default)]
    pub spec: String,
}

/// Views: every scene under every map of every material named.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ViewGroup {
    /// Names of scenes.
    pub scenes: Vec<String>,
    /// Names of maps.
    pub maps: Vec<String>,
    /// Names of materials.
    pub materials: Vec<String>,
}

/// A sampler.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SamplerEntry {
    /// Its name in measurements.
    pub name: String,
    /// As `--sampler` takes it; `{NAME}` is the file of an artifact.
    pub spec: String,
    /// The only materials that it is measured on; empty for all.
    #[serde(default)]
    pub materials: Vec<String>,
}

/// The names of a view.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ViewKey {
    /// Of the scene.
    pub scene: String,
    /// Of the map.
    pub map: String,
    /// Of the material.
    pub material: String,
}

impl Experiment {
    fn first_seed() -> u64 {
        1
    }

    fn sobol() -> String {
        "sobol".into()
    }

    fn direct_light() -> u32 {
        1
    }

    /// Reads a file; its stem is the experiment's name.
    ///
    /// # Errors
    /// If it cannot be read, a key is unknown, or a name is not that of an entry.
    pub fn open(path: &Path) -> Result<Self> {
        let text = file::read_text(path).map_err(|error| Error::file(path, error))?;
        let mut experiment: Self = toml::from_str(&text).map_err(|error| Error::file(path, error.to_string()))?;
        experiment.name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        experiment.check().map_err(|reason| Error::file(path, reason))?;
        Ok(experiment)
    }

    fn check(&self) -> std::result::Result<(), String> {
        for group in &self.views {
            let names = |known: Vec<&str>, used: &[String], what: &str| {
                let unknown = used.iter().find(|name| !known.contains(&name.as_str()));
                unknown.map_or(Ok(()), |name| Err(format!("views: there is no {what} '{name}'")))
            };
            names(self.scenes.iter().map(|entry| entry.name.as_str()).collect(), &group.scenes, "scene")?;
            names(self.maps.iter().map(|entry| entry.name.as_str()).collect(), &group.maps, "map")?;
            names(self.materials.iter().map(|entry| entry.name.as_str()).collect(), &group.materials, "material")?;
        }
        if self.runs == 0 || self.quick.runs == 0 || self.threads == 0 {
            return Err("runs and threads must be at least 1".into());
        }
        Ok(())
    }

    /// The miniature, which takes seconds.
    #[must_use]
    pub fn quickly(mut self) -> Self {
        let Quick { width, height, budgets, runs, .. } = self.quick.clone();
        (self.width, self.height, self.budgets, self.runs) = (width, height, budgets, runs);
        self.reference_samples = 64;
        self
    }

    /// The views, each once, in the order of the file.
    pub fn view_keys(&self) -> Vec<ViewKey> {
        let mut keys = Vec::new();
        for group in &self.views {
            for scene in &group.scenes {
                for map in &group.maps {
                    for material in &group.materials {
                        let [scene, map, material] = [scene, map, material].map(Clone::clone);
                        let key = ViewKey { scene, map, material };
                        if !keys.contains(&key) {
                            keys.push(key);
                        }
                    }
                }
            }
        }
        keys
    }

    /// The scene of a name.
    pub fn scene(&self, name: &str) -> Option<&SceneEntry> {
        self.scenes.iter().find(|entry| entry.name == name)
    }

    /// The map of a name.
    pub fn map(&self, name: &str) -> Option<&MapEntry> {
        self.maps.iter().find(|entry| entry.name == name)
    }

    /// Whether scene or map of a view was used to choose settings.
    pub fn is_tuned(&self, key: &ViewKey) -> bool {
        let scene = self.scene(&key.scene).is_some_and(|entry| entry.tuned);
        scene && self.map(&key.map).is_some_and(|entry| entry.tuned)
    }

    /// The samplers that are measured on a material.
    pub fn samplers_for(&self, material: &str) -> impl Iterator<Item = &SamplerEntry> {
        self.samplers
            .iter()
            .filter(move |own| own.materials.is_empty() || own.materials.iter().any(|one| one == material))
    }

    /// A view with its files in a data folder.
    ///
    /// # Errors
    /// If the material or the points cannot be parsed, or a name is unknown.
    pub fn view(&self, key: &ViewKey, data: &Path) -> Result<ViewSettings> {
        let unknown = |what: &str| Error::argument(format!("{}: {what}", self.name), "unknown name");
        let scene = self.scene(&key.scene).ok_or_else(|| unknown(&key.scene))?;
        let map = self.map(&key.map).ok_or_else(|| unknown(&key.map))?;
        let material = self.materials.iter().find(|entry| entry.name == key.material);
        let material = &material.ok_or_else(|| unknown(&key.material))?.spec;
        let camera = CameraSettings {
            look_from: scene.look_from,
            look_at: scene.look_at,
            fov: scene.fov,
            ..CameraSettings::of_size(self.width, self.height)
        };
        let points = self.points.parse().map_err(|reason: String| Error::argument("points", reason))?;
        let material = material.replace("{data}", &data.display().to_string());
        Ok(ViewSettings {
            ground: scene.ground,
            material: (!material.is_empty()).then(|| material.parse()).transpose()?,
            unshadowed: self.unshadowed,
            depth: self.depth,
            points,
            ..ViewSettings::new(&located(&scene.file, data), &located(&map.file, data), camera)
        })
    }
}

/// A built-in name as it is, a file below the data folder.
pub(crate) fn located(name: &str, data: &Path) -> String {
    if name.contains('/') { data.join(name).display().to_string() } else { name.to_owned() }
}

/// Whether a built-in name or a file is there.
pub(crate) fn is_there(name: &str, data: &Path) -> bool {
    !name.contains('/') || data.join(name).exists()
}
