//! Experiments: views, samplers and budgets. Read from TOML files, or built as data.

use std::path::Path;

use headtail_render::{file, points::PointSet};
use serde::{Deserialize, Serialize};

use crate::{Artifact, Budget, CameraSettings, Error, Result, ViewSettings};

/// An experiment: every sampler on every view at every budget.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Name: the stem of its file.
    #[serde(skip)]
    pub name: String,
    /// Whether a graphics device renders, see [`Self::on_device`].
    #[serde(skip)]
    pub is_on_device: bool,
    /// The question that it answers.
    pub question: String,
    /// Width of pictures in pixels.
    pub width: u32,
    /// Height of pictures in pixels.
    pub height: u32,
    /// Budgets of the runs: `16spp` or `0.25s`.
    pub budgets: Vec<BudgetEntry>,
    /// Runs of each sampler at each budget.
    pub runs: u32,
    /// Seed of the first run.
    #[serde(default = "Experiment::first_seed")]
    pub seed: u64,
    /// Threads that render.
    pub threads: usize,
    /// The points of samples.
    #[serde(default = "Experiment::lattice")]
    pub points: String,
    /// Maximum number of surfaces on a light path; 1 is direct light.
    #[serde(default = "Experiment::direct_light")]
    pub depth: u32,
    /// Whether shadow rays are left out.
    #[serde(default)]
    pub unshadowed: bool,
    /// Minimum samples per pixel of references.
    pub reference_samples: u32,
    /// Scenes by name.
    pub scenes: Vec<SceneEntry>,
    /// Maps by name.
    pub maps: Vec<MapEntry>,
    /// Materials by name.
    pub materials: Vec<MaterialEntry>,
    /// Combinations of scenes, maps and materials.
    pub views: Vec<ViewGroup>,
    /// Samplers by name.
    pub samplers: Vec<SamplerEntry>,
    /// Files that samplers read, and the commands that make them.
    #[serde(default)]
    pub artifacts: Vec<Artifact>,
    /// Changes for `run --quick`.
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

/// Miniature of an experiment.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Quick {
    /// Number of views; the first ones whose files exist.
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
    /// Name in measurements.
    pub name: String,
    /// A built-in scene, or a file below the data folder.
    pub file: String,
    /// Whether a grey plane is put under it.
    #[serde(default)]
    pub ground: bool,
    /// Whether it is an interior.
    #[serde(default)]
    pub interior: bool,
    /// Whether a setting of the project was tuned on pictures of it.
    pub tuned: bool,
    /// The camera's position, with `look_at`.
    #[serde(default)]
    pub look_from: Option<[f32; 3]>,
    /// The point that it looks at.
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
    /// Name in measurements.
    pub name: String,
    /// A built-in map, or a file below the data folder.
    pub file: String,
    /// Kind of light, in a word or two.
    pub kind: String,
    /// Whether a setting of the project was tuned on pictures under it.
    pub tuned: bool,
}

/// A material.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialEntry {
    /// Name in measurements.
    pub name: String,
    /// Material as in `--material`; empty for the scene's own.
    #[serde(default)]
    pub spec: String,
}

/// Views: every combination of the named scenes, maps and materials.
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
    /// Name in measurements.
    pub name: String,
    /// SPEC as in `--sampler`; `{NAME}` is the file of an artifact.
    pub spec: String,
    /// Materials that it is measured on; empty for all.
    #[serde(default)]
    pub materials: Vec<String>,
    /// Scenes that it is measured in; empty for all.
    #[serde(default)]
    pub scenes: Vec<String>,
}

/// Names that identify a view.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ViewKey {
    /// Scene.
    pub scene: String,
    /// Map.
    pub map: String,
    /// Material.
    pub material: String,
}

impl Experiment {
    fn first_seed() -> u64 {
        1
    }

    fn lattice() -> String {
        PointSet::LATTICE.to_string()
    }

    fn direct_light() -> u32 {
        1
    }

    /// Reads an experiment from a file; the stem is its name.
    ///
    /// # Errors
    /// If it cannot be read, a key is unknown, or a name does not refer to an entry.
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

    /// Returns the name of the measurements of the same experiment on a graphics device.
    pub fn name_on_device(&self) -> String {
        format!("{}-gpu", self.name)
    }

    /// Returns the same experiment on a graphics device, whose measurements have a name of their own. The reference is the CPU's.
    #[must_use]
    pub fn on_device(&self) -> Self {
        Self { name: self.name_on_device(), is_on_device: true, ..self.clone() }
    }

    /// Returns the miniature, which takes seconds.
    #[must_use]
    pub fn quickly(mut self) -> Self {
        let Quick { width, height, budgets, runs, .. } = self.quick.clone();
        (self.width, self.height, self.budgets, self.runs) = (width, height, budgets, runs);
        self.reference_samples = 64;
        self
    }

    /// Returns the views, each once, in the order of the file.
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

    /// Returns the scene with a name.
    pub fn scene(&self, name: &str) -> Option<&SceneEntry> {
        self.scenes.iter().find(|entry| entry.name == name)
    }

    /// Returns the map with a name.
    pub fn map(&self, name: &str) -> Option<&MapEntry> {
        self.maps.iter().find(|entry| entry.name == name)
    }

    /// Whether settings were tuned on both the scene and the map of a view.
    pub fn is_tuned(&self, key: &ViewKey) -> bool {
        let scene = self.scene(&key.scene).is_some_and(|entry| entry.tuned);
        scene && self.map(&key.map).is_some_and(|entry| entry.tuned)
    }

    /// Returns the samplers that are measured in a view.
    pub fn samplers_for(&self, key: &ViewKey) -> impl Iterator<Item = &SamplerEntry> {
        let is_in = |names: &[String], name: &String| names.is_empty() || names.contains(name);
        self.samplers.iter().filter(move |own| is_in(&own.materials, &key.material) && is_in(&own.scenes, &key.scene))
    }

    /// Returns the settings of a view with its files in a data folder.
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
        let points = self.points.parse()?;
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

/// Returns a built-in name unchanged, and other names as files below the data folder.
pub(crate) fn located(name: &str, data: &Path) -> String {
    if name.contains('/') { data.join(name).display().to_string() } else { name.to_owned() }
}

/// Whether a name is built in or its file exists.
pub(crate) fn is_there(name: &str, data: &Path) -> bool {
    !name.contains('/') || data.join(name).exists()
}
