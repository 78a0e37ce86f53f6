//! Recordings: commands whose output is data, such as benches, `headtail stability` and other renderers.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Instant,
};

use headtail_render::file;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Error, MeasurementEnvironment, Result, Store};

/// Commands that are run once and whose output is kept.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// Name: the stem of its file.
    #[serde(skip)]
    pub name: String,
    /// The question that it answers.
    pub question: String,
    /// The commands.
    pub commands: Vec<RecordedCommand>,
}

/// A command. `{data}` is the folder of maps and scenes, `{out}` a folder that is kept between runs.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedCommand {
    /// Stem of the output file.
    pub name: String,
    /// Arguments of `headtail`; of `cargo` if they begin with `bench`; of `python3` if they begin with a
    /// `.py` file.
    pub run: String,
    /// Arguments of the miniature; empty if there is none.
    #[serde(default)]
    pub quick: String,
    /// Whether the output is JSON.
    #[serde(default)]
    pub json: bool,
}

/// Output of a command.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Output {
    /// Id of the row in `environments.csv`.
    pub environment: String,
    /// Command without folders.
    pub command: String,
    /// Seconds that the command took.
    pub seconds: f64,
    /// Text, or the parsed JSON.
    pub output: Value,
}

impl Recording {
    /// Reads a recording from a file; the stem is its name.
    ///
    /// # Errors
    /// If it cannot be read, or a key is unknown.
    pub fn open(path: &Path) -> Result<Self> {
        let text = file::read_text(path).map_err(|error| Error::file(path, error))?;
        let mut recording: Self = toml::from_str(&text).map_err(|error| Error::file(path, error.to_string()))?;
        recording.name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(recording)
    }

    /// Returns the file of a command's output in a store.
    pub fn path(&self, store: &Store, command: &RecordedCommand) -> PathBuf {
        store.folder().join(&self.name).join(format!("{}.json", command.name))
    }

    /// Returns the output of a command, if it was run.
    ///
    /// # Errors
    /// If its file exists and cannot be read.
    pub fn output(&self, store: &Store, command: &RecordedCommand) -> Result<Option<Output>> {
        let path = self.path(store, command);
        if !path.exists() {
            return Ok(None);
        }
        let text = file::read_text(&path).map_err(|error| Error::file(&path, error))?;
        serde_json::from_str(&text).map(Some).map_err(|error| Error::file(&path, error))
    }

    /// Runs a command and stores its output.
    ///
    /// # Errors
    /// If the program cannot be started or fails, or its output is invalid.
    pub fn run(
        &self,
        store: &Store,
        command: &RecordedCommand,
        is_quick: bool,
        [program, data, out]: [&Path; 3],
    ) -> Result<()> {
        let words = if is_quick { &command.quick } else { &command.run };
        let first = words.split_whitespace().next().unwrap_or_default();
        let is_script = Path::new(first).extension().is_some_and(|extension| extension == "py");
        let program = match first {
            "bench" => Path::new("cargo"),
            _ if is_script => Path::new("python3"),
            _ => program,
        };
        let out = out.join(&self.name).join(&command.name);
        std::fs::create_dir_all(&out).map_err(|error| Error::file(&out, error))?;
        let place = |word: &str| {
            word.replace("{data}", &data.display().to_string()).replace("{out}", &out.display().to_string())
        };
        let arguments: Vec<String> = words.split_whitespace().map(place).collect();
        let start = Instant::now();
        let done = Command::new(program).args(&arguments).stdin(Stdio::null()).stderr(Stdio::inherit()).output();
        let done = done.map_err(|error| Error::file(program, error))?;
        if !done.status.success() {
            return Err(Error::argument(format!("{} {words}", program.display()), "the command failed"));
        }
        let text = String::from_utf8_lossy(&done.stdout).into_owned();
        let output = if command.json {
            serde_json::from_str(&text).map_err(|error| Error::argument(words.clone(), error.to_string()))?
        } else {
            Value::String(text)
        };
        let seconds = start.elapsed().as_secs_f64().round();
        let environment = store.id_of(&MeasurementEnvironment::current())?;
        let kept = Output { environment, command: words.clone(), seconds, output };
        let path = self.path(store, command);
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        let text = serde_json::to_string(&kept).map_err(|error| Error::file(&path, error))?;
        Ok(file::replace(&path, (text + "\n").as_bytes())?)
    }
}
