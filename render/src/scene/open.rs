//! Opening scenes by name or file.

use super::{
    Scene,
    built_in::{self, built_in_names},
    gltf::LoadOptions,
};
use crate::{
    error::{Error, Result},
    path_text::path_of,
};

impl Scene {
    /// Returns the built-in scene called `name`; see [`built_in_names`].
    pub fn built_in(name: &str) -> Option<Self> {
        built_in::build(name)
    }

    /// Opens a built-in scene by name, or else a glTF 2.0 file; `FILE#SCENE` selects a scene of the file by
    /// name or number.
    ///
    /// # Errors
    /// As [`Self::load`]; if there is neither such a file nor such a scene, the error lists the built-in
    /// names.
    pub fn open(name_or_path: &str) -> Result<Self> {
        Self::open_dressed(name_or_path, true)
    }

    /// Opens a scene as [`Self::open`] does; without `materials`, the file's materials are not read, because
    /// others will replace them. Alpha masks are read in any case; see [`LoadOptions::materials`].
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_dressed(name_or_path: &str, materials: bool) -> Result<Self> {
        if let Some(scene) = Self::built_in(name_or_path) {
            return Ok(scene);
        }
        let whole = path_of(name_or_path);
        let (path, scene) = match name_or_path.rsplit_once('#') {
            Some((file, scene)) if !whole.exists() => (&path_of(file), Some(scene)),
            _ => (&whole, None),
        };
        if !path.exists() {
            let names = built_in_names().collect::<Vec<_>>().join(", ");
            let reason = format!("'{name_or_path}' is neither a file nor a built-in scene ({names})");
            return Err(Error::argument("scene", reason));
        }
        Self::load_with(path, &LoadOptions { scene, materials })
    }
}
