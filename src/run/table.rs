//! The table of a run: its keys in addition to those of [`FitConfig`], and the resolved table with every key.

use std::{fmt::Display, path::PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use headtail_render::scene::MaterialSpec;
use headtail_train::{ConfigBuilder, FitConfig, Preset};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{
    contents::Contents,
    view::{Measure, MeasuredView, Picture, VIEW_KEYS},
};

/// A run as read from a file, with any subset of the keys.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunTable {
    keys: Keys,
    /// Keys of [`FitConfig`].
    fit: Table,
    /// Origin of the table, for errors.
    name: String,
}

/// Keys of a run that are not in [`FitConfig`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Keys {
    #[serde(skip_serializing_if = "Option::is_none")]
    env: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    preset: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    checkpoints: Option<Checkpoints>,
    export: Export,
    #[serde(skip_serializing_if = "Option::is_none")]
    viewpoints: Option<Picture>,
    measure: Measure,
}

/// Names of [`Keys`].
const KEYS: [&str; 7] = ["env", "preset", "out", "checkpoints", "export", "viewpoints", "measure"];

/// Settings of the exported file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Export {
    /// Whether a file is written.
    pub file: bool,
    /// Whether the file omits the training time, so that the same run writes the same bytes.
    pub reproducible: bool,
}

impl Default for Export {
    fn default() -> Self {
        Self { file: true, reproducible: false }
    }
}

/// Location and frequency of checkpoints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoints {
    /// Folder for checkpoints.
    pub folder: PathBuf,
    /// Steps between checkpoints.
    #[serde(default = "Checkpoints::steps_between")]
    pub every: usize,
    /// Whether to continue from the last one, or begin if there is none.
    #[serde(default)]
    pub resume: bool,
}

impl Checkpoints {
    fn steps_between() -> usize {
        250
    }
}

/// A run with every setting.
#[derive(Clone, Debug, PartialEq)]
pub struct RunConfig {
    /// Map.
    pub env: String,
    /// Folder for results; not a setting of the run.
    pub out: Option<PathBuf>,
    /// Checkpoints; not a setting of the run.
    pub checkpoints: Option<Checkpoints>,
    /// Training.
    pub fit: FitConfig,
    /// View whose visible surfaces are the conditions; by default, conditions from everywhere.
    pub viewpoints: Option<Picture>,
    /// Export.
    pub export: Export,
    /// Measurements.
    pub measure: Measure,
}

impl RunTable {
    /// Splits a table into keys of the run and of the training. `name` is its origin.
    ///
    /// # Errors
    /// If a key of the run has a wrong value or an unknown part; other keys are checked by [`Self::resolve`].
    pub fn new(name: &str, table: Table) -> Result<Self> {
        let (mut keys, mut fit) = (Table::new(), Table::new());
        for (key, value) in table {
            let of_run = KEYS.contains(&key.as_str());
            if of_run { &mut keys } else { &mut fit }.insert(key, value);
        }
        let views = keys.get("measure").and_then(|measure| measure.get("views")).and_then(Value::as_array);
        for view in views.into_iter().flatten().filter_map(Value::as_table) {
            if let Some(key) = view.keys().find(|key| !VIEW_KEYS.contains(&key.as_str())) {
                bail!("{name}: the key `measure.views.{key}` is unknown; there are {}", VIEW_KEYS.join(", "));
            }
        }
        let keys = keys.try_into().map_err(|error| anyhow!("{name}: {}", one_line(&error)))?;
        Ok(Self { keys, fit, name: name.to_owned() })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, and those of [`Self::new`].
    pub fn open(path: &std::path::Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = headtail_render::file::read_text(path).with_context(|| name.clone())?;
        Self::new(&name, text.parse().map_err(|error| anyhow!("{name}: {}", one_line(&error)))?)
    }

    /// Returns the preset that the table names, if there is one.
    ///
    /// # Errors
    /// If there is not a preset of that name.
    pub fn preset(&self) -> Result<Option<Preset>> {
        let preset = self.keys.preset.as_deref().map(str::parse).transpose();
        preset.map_err(|reason: String| anyhow!("{}: {reason}", self.name))
    }

    /// Returns the material that the table names, if there is one.
    pub fn material(&self) -> Option<MaterialSpec> {
        self.fit.get("material").and_then(Value::as_str).and_then(|text| text.parse().ok())
    }

    /// Applies the training settings to a builder.
    ///
    /// # Errors
    /// If a key is unknown or has a wrong value.
    pub fn lay_over(&self, builder: &mut ConfigBuilder) -> Result<()> {
        Ok(builder.table(&self.name, self.fit.clone())?)
    }

    /// Returns the run with training settings that were made from this table and from flags.
    ///
    /// # Errors
    /// If the map is missing, or a value is out of range.
    pub fn with_fit(self, fit: FitConfig) -> Result<RunConfig> {
        let Keys { env, out, checkpoints, export, viewpoints, measure, preset: _ } = self.keys;
        fit.validate()?;
        viewpoints.as_ref().map_or(Ok(()), |picture| picture.validate("viewpoints"))?;
        measure.views.iter().try_for_each(MeasuredView::validate)?;
        let env = env.with_context(|| format!("{}: name the map, as in env = \"studio\"", self.name))?;
        Ok(RunConfig { env, out, checkpoints, fit, viewpoints, export, measure })
    }

    /// Returns the run of this table alone: its preset, or the fast one for its material, and its keys.
    ///
    /// # Errors
    /// As [`Self::lay_over`] and [`Self::with_fit`].
    pub fn resolve(self) -> Result<RunConfig> {
        let material = self.material().unwrap_or(MaterialSpec::LAMBERT);
        let mut builder = ConfigBuilder::new(self.preset()?.unwrap_or(Preset::fast_for(&material)));
        self.lay_over(&mut builder)?;
        let fit = builder.build()?;
        self.with_fit(fit)
    }

    /// Sets the map.
    pub fn set_env(&mut self, env: String) {
        self.keys.env = Some(env);
    }

    /// Sets the view whose visible surfaces are the conditions.
    pub fn set_viewpoints(&mut self, picture: Picture) {
        self.keys.viewpoints = Some(picture);
    }

    /// Sets the checkpoints.
    pub fn set_checkpoints(&mut self, checkpoints: Checkpoints) {
        self.keys.checkpoints = Some(checkpoints);
    }

    /// Omits the exported file, or the time in it.
    pub fn change_export(&mut self, no_file: bool, reproducible: bool) {
        self.keys.export.file &= !no_file;
        self.keys.export.reproducible |= reproducible;
    }

    /// Whether the table names a map.
    pub fn has_env(&self) -> bool {
        self.keys.env.is_some()
    }
}

impl RunConfig {
    /// Returns every setting as TOML that [`RunTable`] reads, without the locations of results and
    /// checkpoints.
    ///
    /// # Errors
    /// For a seed above 2^63 - 1, which TOML cannot write.
    pub fn to_toml(&self) -> Result<String> {
        let keys = self.keys();
        // Via text, so that single-precision numbers keep their short form.
        let mut table: Table = toml::to_string(&keys)?.parse()?;
        table.extend(self.fit.to_table()?);
        Ok(toml::to_string(&table)?)
    }

    /// Returns the BLAKE3 hash, in hexadecimal digits, of every setting in [`Self::to_toml`] and of the
    /// program's version. Maps, scenes and materials count by the content of their files.
    ///
    /// # Errors
    /// If a setting cannot be written as JSON.
    pub fn hash(&self, contents: &Contents) -> Result<String> {
        self.hash_of_version(env!("CARGO_PKG_VERSION"), contents)
    }

    fn hash_of_version(&self, version: &str, contents: &Contents) -> Result<String> {
        let mut keys = self.keys();
        keys.env = Some(contents.map(&self.env));
        let views = keys.measure.views.iter_mut().map(|view| {
            // Figures are named after it.
            view.name = Some(view.name().to_owned());
            view.material = view.material.as_deref().map(|text| contents.material(text));
            &mut view.picture
        });
        for picture in keys.viewpoints.iter_mut().chain(views) {
            picture.scene = contents.scene(&picture.scene);
        }
        let material = contents.material(&self.fit.material.to_string());
        let fit = FitConfig { material: MaterialSpec::LAMBERT, ..self.fit.clone() };
        // JSON, because it is many times faster to write.
        let content = serde_json::to_string(&(version, keys, material, fit))?;
        Ok(blake3::hash(content.as_bytes()).to_hex().to_string())
    }

    fn keys(&self) -> Keys {
        let Self { env, export, viewpoints, measure, .. } = self.clone();
        Keys { env: Some(env), export, viewpoints, measure, ..Keys::default() }
    }
}

/// Joins the lines of a parser's message.
pub fn one_line(error: &impl Display) -> String {
    let text = error.to_string();
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    lines.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Result<RunTable> {
        RunTable::new("run.toml", text.parse().unwrap())
    }

    const WHOLE: &str = r#"
        env = "studio"
        out = "out/run"
        preset = "fast-ggx"
        material = "ggx:alpha=0.3"
        steps = 70
        head.bins = 16
        [checkpoints]
        folder = "out/ck"
        [export]
        reproducible = true
        [viewpoints]
        scene = "temple"
        look_from = [0.0, 1.5, 4.0]
        look_at = [0.0, 1.0, 0.0]
        [measure]
        time = true
        [[measure.views]]
        scene = "sphere"
        spp = 4
    "#;

    #[test]
    fn a_resolved_table_round_trips_through_toml() {
        let run = table(WHOLE).unwrap().resolve().unwrap();
        assert_eq!((run.env.as_str(), run.fit.steps, run.fit.head.bins), ("studio", 70, 16));
        assert_eq!(run.fit.material.to_string(), "ggx:alpha=0.3");
        assert_eq!(run.checkpoints.as_ref().unwrap().every, 250);
        assert_eq!(run.measure.views[0].name(), "sphere");
        let again = table(&run.to_toml().unwrap()).unwrap().resolve().unwrap();
        assert_eq!(again, RunConfig { out: None, checkpoints: None, ..run.clone() });
        assert_eq!(again.to_toml().unwrap(), run.to_toml().unwrap());
    }

    #[test]
    fn the_hash_depends_on_the_version() {
        let run = table(WHOLE).unwrap().resolve().unwrap();
        let contents = Contents::default();
        let of = |version: &str| run.hash_of_version(version, &contents).unwrap();
        assert_eq!(run.hash(&contents).unwrap(), of(env!("CARGO_PKG_VERSION")));
        assert_ne!(of("0.1.0"), of("0.1.1"));
    }

    #[test]
    fn errors_name_the_wrong_key_or_value() {
        for (text, named) in [
            ("env = 'studio'\nstep = 7", "`step`"),
            ("steps = 7", "name the map"),
            ("env = 'studio'\n[[measure.views]]\nscene = 'sphere'", "spp or seconds"),
            ("env = 'studio'\n[[measure.views]]\nscene = 'sphere'\nsp = 4", "`measure.views.sp`"),
            ("env = 'studio'\n[export]\nfiles = true", "files"),
            ("env = 'studio'\npreset = 'best'", "'best' is not a preset"),
            ("env = 'studio'\n[viewpoints]\nscene = 'sphere'\nlook_at = [0.0, 0.0, 0.0]", "come together"),
            ("env = 'studio'\n[viewpoints]\nscene = 'sphere'\nwidth = 0", "viewpoints.width = 0"),
        ] {
            let error = table(text).and_then(RunTable::resolve).unwrap_err();
            assert!(format!("{error:#}").contains(named), "{text}: {error:#}");
        }
    }
}
