//! Files of lights and portals for other programs, by the extension of their names.

use std::path::Path;

use anyhow::{Context, Result};
use glam::Vec3A;
use headtail_render::file;
use serde_json::{Value, json};

use crate::output::OutputFile;

/// A format of a list of lights or portals.
pub struct Format<T> {
    /// Extension of its files.
    pub extension: &'static str,
    /// Returns the content of a file.
    pub text: fn(&[T]) -> String,
}

/// A file that is written in the format of its extension.
pub struct LightFile<'a, T> {
    output: OutputFile,
    format: &'a Format<T>,
}

impl<'a, T> LightFile<'a, T> {
    /// Takes a file for writing; `known` lists the extensions in words.
    ///
    /// # Errors
    /// If no format has the extension, and as [`OutputFile::take`].
    pub fn take(path: &Path, formats: &'a [Format<T>], known: &str) -> Result<Self> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        let format = formats.iter().find(|format| Some(format.extension) == extension);
        let format = format.with_context(|| format!("--out {}: name a {known} file", path.display()))?;
        Ok(Self { output: OutputFile::take(path)?, format })
    }

    /// Writes a list.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, list: &[T]) -> Result<()> {
        let text = (self.format.text)(list);
        self.output.write(|path| file::replace(path, text.as_bytes()))
    }
}

/// Returns a glTF document whose nodes are those of its scene, and which has nothing else.
pub fn gltf_of_nodes(name: &str, nodes: Vec<Value>) -> Value {
    let mut file =
        json!({"asset": {"version": "2.0", "generator": "headtail"}, "scene": 0, "scenes": [{"name": name}]});
    // Lists of glTF must not be empty.
    if !nodes.is_empty() {
        file["scenes"][0]["nodes"] = (0..nodes.len()).collect();
        file["nodes"] = nodes.into();
    }
    file
}

/// Returns a vector as Python with Blender's axes, which are those of an imported glTF file: Z is up.
pub fn blender_vector(v: Vec3A) -> String {
    format!("({}, {}, {})", v.x, -v.z, v.y)
}
