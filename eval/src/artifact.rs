//! Files that samplers read: written by commands of `headtail`, whose time counts as preparation.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Instant,
};

use headtail_render::file;
use serde::{Deserialize, Serialize};

use crate::{Error, Result, ViewSettings};

/// Recipe for a file.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Artifact {
    /// Name, which samplers write in braces.
    pub name: String,
    /// Arguments of `headtail`, in which `{env}`, `{view}` (scene, camera, size, material) and `{out}` are replaced.
    pub command: String,
    /// The file below `{out}`; empty if `{out}` is the file itself.
    #[serde(default)]
    pub file: String,
}

impl Artifact {
    /// Returns the file for a view and the seconds that it took; it is made unless an earlier run of the same
    /// command left it.
    ///
    /// # Errors
    /// If the program cannot be started or fails.
    pub fn obtain(&self, view: &ViewSettings, program: &Path, folder: &Path) -> Result<(PathBuf, f64)> {
        let command = self.command.replace("{env}", &view.env);
        let view = if command.contains("{view}") { view_arguments(view) } else { Vec::new() };
        let key = blake3::hash(format!("{command} {view:?}").as_bytes()).to_hex();
        let out = folder.join(format!("{}-{}", self.name, &key[..16]));
        let made = if self.file.is_empty() { out.clone() } else { out.join(&self.file) };
        let time = out.with_extension("seconds");
        if let Ok(text) = std::fs::read_to_string(&time)
            && let Ok(seconds) = text.trim().parse()
            && made.exists()
        {
            return Ok((made, seconds));
        }
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        let mut arguments = Vec::new();
        for word in command.split_whitespace() {
            match word {
                "{view}" => arguments.extend(view.iter().cloned()),
                _ => arguments.push(word.replace("{out}", &out.display().to_string())),
            }
        }
        let start = Instant::now();
        let threads = rayon::current_num_threads().to_string();
        let output =
            Command::new(program).args(&arguments).env("RAYON_NUM_THREADS", threads).stdin(Stdio::null()).output();
        let output = output.map_err(|error| Error::file(program, error))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(Error::argument(format!("headtail {}", arguments.join(" ")), said.trim().to_owned()));
        }
        let seconds = start.elapsed().as_secs_f64();
        file::replace(&time, format!("{seconds}\n").as_bytes())?;
        Ok((made, seconds))
    }
}

/// The arguments that name a view on the command line.
fn view_arguments(view: &ViewSettings) -> Vec<String> {
    let triple = |[x, y, z]: [f32; 3]| format!("{x},{y},{z}");
    let camera = &view.camera;
    let mut arguments = vec!["--scene".to_owned(), view.scene.clone(), "--env".to_owned(), view.env.clone()];
    let mut add = |name: &str, value: String| arguments.extend([name.to_owned(), value]);
    add("--width", camera.width.to_string());
    add("--height", camera.height.to_string());
    camera.look_from.into_iter().for_each(|from| add("--look-from", triple(from)));
    camera.look_at.into_iter().for_each(|at| add("--look-at", triple(at)));
    camera.fov.into_iter().for_each(|fov| add("--fov", fov.to_string()));
    view.material.iter().for_each(|material| add("--material", material.to_string()));
    if view.ground {
        arguments.push("--ground".to_owned());
    }
    arguments
}
