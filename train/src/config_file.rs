//! Configurations from presets, TOML files and single values.

use std::{path::Path, sync::OnceLock};

use headtail_render::scene::MaterialSpec;
use toml::{Table, Value};

use crate::{Error, FitConfig, Preset, Result, config::name_of, flow::FlowSize, material::condition_of};

/// A configuration under construction: a preset, overridden by files and single values.
#[derive(Clone, Debug)]
pub struct ConfigBuilder {
    table: Table,
}

impl ConfigBuilder {
    /// Starts from a preset.
    pub fn new(preset: Preset) -> Self {
        // Cached: a sweep starts from the same few presets thousands of times.
        static TABLES: OnceLock<Vec<(Preset, Table)>> = OnceLock::new();
        let tables = TABLES.get_or_init(|| Preset::ALL.map(|preset| (preset, table_of(&preset.config()))).into());
        let known = tables.iter().find(|(known, _)| *known == preset);
        Self { table: known.map_or_else(|| table_of(&preset.config()), |(_, table)| table.clone()) }
    }

    /// Overrides with the keys of a TOML file.
    ///
    /// # Errors
    /// [`Error::ConfigFile`] naming the file, and the key that is unknown or has a wrong value.
    pub fn file(&mut self, path: &Path) -> Result<()> {
        let name = path.display().to_string();
        let text = headtail_render::file::read_text(path).map_err(|error| refuse(&name, &error.to_string()))?;
        self.overlay(&name, &text)
    }

    /// Overrides with `key.of.field = value`, in TOML. A value that is not TOML is read as a string.
    ///
    /// # Errors
    /// [`Error::ConfigFile`] naming the assignment.
    pub fn assignment(&mut self, text: &str) -> Result<()> {
        let name = format!("--set {text}");
        let Some((key, value)) = text.split_once('=') else {
            return Err(refuse(&name, "write KEY=VALUE, as in head.bins=8"));
        };
        let as_text = format!("{key} = {}", Value::String(value.trim().to_owned()));
        if text.parse::<Table>().is_ok() { self.overlay(&name, text) } else { self.overlay(&name, &as_text) }
    }

    /// Overrides with all flow tail settings of a size.
    pub fn flow(&mut self, size: FlowSize) {
        let of_size = table_of(&FitConfig { flow: size.settings(), ..Preset::FastCosine.config() });
        self.table.extend(of_size.into_iter().filter(|(key, _)| key == "flow"));
    }

    /// Returns the configuration so far.
    ///
    /// # Errors
    /// [`Error::ConfigFile`] if a value has a wrong type; [`FitConfig::validate`] checks ranges.
    pub fn build(&self) -> Result<FitConfig> {
        self.parse("the configuration")
    }

    fn overlay(&mut self, name: &str, text: &str) -> Result<()> {
        let overlay: Table = text.parse().map_err(|error: toml::de::Error| refuse(name, &error.to_string()))?;
        self.table(name, overlay)
    }

    /// Overrides with the keys of a table; `name` is the table's source, for errors.
    ///
    /// # Errors
    /// [`Error::ConfigFile`] naming the key that is unknown or has a wrong value.
    pub fn table(&mut self, name: &str, mut overlay: Table) -> Result<()> {
        take_older_names(&mut overlay);
        check_keys(name, "", &self.table, &overlay)?;
        let names_condition = overlay.get("head").is_some_and(|head| head.get("condition").is_some());
        let material =
            overlay.get("material").and_then(Value::as_str).and_then(|text| text.parse::<MaterialSpec>().ok());
        merge(&mut self.table, overlay);
        if let (Some(material), false) = (material, names_condition) {
            self.take_condition_of(&material);
        }
        self.parse(name).map(|_| ())
    }

    /// Sets the head's condition to that of the material.
    fn take_condition_of(&mut self, material: &MaterialSpec) {
        let condition = Value::String(name_of(condition_of(material)));
        if let Some(Value::Table(head)) = self.table.get_mut("head") {
            head.insert("condition".into(), condition);
        }
    }

    fn parse(&self, name: &str) -> Result<FitConfig> {
        FitConfig::deserialize_table(&self.table).map_err(|error| refuse(name, &error.to_string()))
    }
}

impl FitConfig {
    fn deserialize_table(table: &Table) -> std::result::Result<Self, toml::de::Error> {
        table.clone().try_into()
    }

    /// Returns the configuration as TOML that can be read back.
    ///
    /// # Errors
    /// [`Error::ConfigFile`] for a seed above 2^63 - 1, which TOML cannot represent.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|error| refuse("the configuration", &error.to_string()))
    }

    /// Returns the configuration as a table.
    ///
    /// # Errors
    /// As [`Self::to_toml`].
    pub fn to_table(&self) -> Result<Table> {
        // Via text, which keeps the short form of f32 values.
        Ok(self.to_toml()?.parse().expect("what was written as TOML can be read"))
    }

    /// Sets the material and its head's condition.
    #[must_use]
    pub fn for_material(mut self, material: MaterialSpec) -> Self {
        self.head.condition = condition_of(&material);
        self.material = material;
        let over = self.over;
        self.over(over)
    }
}

/// Renames deprecated keys: `head.selection` to `head.share`.
fn take_older_names(table: &mut Table) {
    if let Some(Value::Table(head)) = table.get_mut("head")
        && !head.contains_key("share")
        && let Some(share) = head.remove("selection")
    {
        head.insert("share".into(), share);
    }
}

fn table_of(config: &FitConfig) -> Table {
    config.to_table().expect("a preset can be written as TOML")
}

/// Joins the parser's lines into one sentence.
fn refuse(name: &str, reason: &str) -> Error {
    let lines: Vec<&str> = reason.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    Error::ConfigFile { name: name.to_owned(), reason: lines.join(" ") }
}

/// Checks that all keys of `overlay` are in `known`, a table with every key of the configuration.
fn check_keys(name: &str, path: &str, known: &Table, overlay: &Table) -> Result<()> {
    for (key, value) in overlay {
        let full = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match (known.get(key), value) {
            (None, _) => {
                let keys: Vec<&str> = known.keys().map(String::as_str).collect();
                return Err(refuse(name, &format!("the key `{full}` is unknown; there are {}", keys.join(", "))));
            }
            (Some(Value::Table(known)), Value::Table(overlay)) => check_keys(name, &full, known, overlay)?,
            _ => {}
        }
    }
    Ok(())
}

fn merge(table: &mut Table, overlay: Table) {
    for (key, value) in overlay {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use headtail_model::{Condition, EncoderConfig};

    use super::*;
    use crate::{Loss, flow::FlowSettings};

    fn built(preset: Preset, assignments: &[&str]) -> FitConfig {
        let mut builder = ConfigBuilder::new(preset);
        assignments.iter().for_each(|text| builder.assignment(text).unwrap());
        builder.build().unwrap()
    }

    #[test]
    fn presets_round_trip_through_toml() {
        for preset in Preset::ALL {
            assert_eq!(built(preset, &[]), preset.config());
            let text = preset.config().to_toml().unwrap();
            let mut builder = ConfigBuilder::new(Preset::FastCosine);
            builder.overlay("file", &text).unwrap();
            assert_eq!(builder.build().unwrap(), preset.config(), "{text}");
        }
    }

    #[test]
    fn single_values_override_the_size_of_a_flow() {
        let mut builder = ConfigBuilder::new(Preset::FastGgx);
        builder.assignment("flow.cells=64").unwrap();
        builder.flow(FlowSize::Paper);
        builder.assignment("flow.steps=7").unwrap();
        let flow = FlowSettings { steps: 7, ..FlowSize::Paper.settings() };
        assert_eq!(builder.build().unwrap(), FitConfig { flow, ..Preset::FastGgx.config() });
    }

    #[test]
    fn single_values_override_a_preset() {
        let config = built(
            Preset::PaperGgx,
            &["steps=7", "loss = reverse-kl", "head.bins=8", "head.encoder.output=16", "learning_rate=2e-3"],
        );
        assert_eq!((config.steps, config.loss, config.learning_rate), (7, Loss::ReverseKl, 2e-3));
        assert_eq!((config.head.bins, config.head.encoder), (8, Some(EncoderConfig { hidden: 64, output: 16 })));
        assert_eq!(built(Preset::PaperGgx, &["head.encoder=none"]).head.encoder, None);
        let encoder = built(Preset::FastCosine, &["head.encoder={hidden=8, output=4}"]).head.encoder;
        assert_eq!(encoder, Some(EncoderConfig { hidden: 8, output: 4 }));
    }

    #[test]
    fn the_share_accepts_its_deprecated_name() {
        assert!(built(Preset::FastCosine, &[]).head.share);
        assert!(!built(Preset::FastCosine, &["head.selection=false"]).head.share);
        let config = FitConfig::default();
        let older = serde_json::to_string(&config).unwrap().replace("\"share\"", "\"selection\"");
        assert_eq!(serde_json::from_str::<FitConfig>(&older).unwrap(), config);
        let both =
            ConfigBuilder::new(Preset::FastCosine).overlay("run.toml", "head = { share = true, selection = true }");
        assert!(both.unwrap_err().to_string().contains("head.selection"));
    }

    #[test]
    fn a_material_sets_its_condition() {
        let config = built(Preset::FastGgx, &["material=ggx:alpha=0.2..0.8"]);
        assert_eq!(config.head.condition, Condition::GgxRoughness);
        config.validate().unwrap();
        let config = built(Preset::FastGgx, &["head.condition=normal"]);
        assert!(config.validate().unwrap_err().to_string().contains("head.condition = normal"));
    }

    #[test]
    fn mistakes_name_the_file_and_the_key() {
        let folder = std::env::temp_dir().join(format!("headtail-config-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("run.toml");
        for (text, named) in [
            ("stepz = 3", "`stepz`"),
            ("[head]\nbinz = 3", "`head.binz`"),
            ("[head.encoder]\nwidth = 3", "`head.encoder.width`"),
            ("steps = \"many\"", "steps"),
            ("steps = -1", "steps"),
            ("[head]\nbins = 1.5", "bins"),
            ("head = 3", "head"),
            ("[head]\nencoder = \"some\"", "head.encoder"),
            ("material = \"wood\"", "'wood'"),
            ("loss = \"l2\"", "log-chi-square"),
            ("steps = ", "TOML"),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = ConfigBuilder::new(Preset::PaperGgx).file(&file).unwrap_err().to_string();
            assert!(error.contains("run.toml") && error.contains(named), "{text}: {error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
        let error = ConfigBuilder::new(Preset::PaperGgx).file(&file).unwrap_err().to_string();
        assert!(error.contains("run.toml"), "{error}");
    }
}
