//! Neural materials on surfaces: `neural:FILE[,repeat=N][,on=NAME]`.

use std::{fmt, path::PathBuf, str::FromStr, sync::Arc};

use super::{Material, Scene, SurfacePoint};
use crate::{
    brdf::{NeuralTexture, Surface, neural_texture::Seen},
    error::{Error, Result},
    path_text::{path_of, text_of},
};

/// Name of the meshes that take a neural material by default.
const FABRIC: &str = "fabric";

/// Maximum number of names that an error lists.
const LISTED: usize = 12;

/// A neural material on surfaces with texture coordinates.
#[derive(Clone, Debug)]
pub struct NeuralMaterial {
    texture: Arc<NeuralTexture>,
    /// Tiles per unit of the texture coordinates.
    repeat: f32,
    /// Its index in the scene's table.
    brdf: u32,
}

impl NeuralMaterial {
    /// Returns the BRDF at a point.
    pub(super) fn at(&self, at: &SurfacePoint) -> Surface {
        let uv = self.repeat * at.color_uv.unwrap_or_default();
        let seen = Seen { uv, width: self.repeat * at.view.width, ..at.view };
        Surface { brdf: self.brdf, parameters: self.texture.parameters(&seen) }
    }

    /// Returns its index in the scene's table.
    pub fn brdf(&self) -> u32 {
        self.brdf
    }

    /// Returns the tiles per unit of the texture coordinates.
    pub fn repeat(&self) -> f32 {
        self.repeat
    }

    /// Returns the material with its table index increased by `later`.
    pub(super) fn renumbered(&self, later: u32) -> Self {
        Self { brdf: self.brdf + later, ..self.clone() }
    }
}

/// The specification after `neural:`.
#[derive(Clone, Debug, PartialEq)]
pub struct NeuralSpec {
    /// A file of [`NeuralTexture`].
    pub file: PathBuf,
    /// Tiles per unit of the texture coordinates; 1 by default.
    pub repeat: f32,
    /// The name of the meshes that take it. By default those called `fabric`, or if there are none, all with
    /// texture coordinates.
    pub on: Option<String>,
}

impl NeuralSpec {
    /// Returns the scene with the material on the meshes that take it.
    ///
    /// # Errors
    /// When the file cannot be read, or no mesh can take it.
    pub(super) fn dress(&self, mut scene: Scene) -> Result<Scene> {
        let texture = Arc::new(NeuralTexture::read(&self.file)?);
        let name = self.on.as_deref().unwrap_or(FABRIC);
        let mut chosen: Vec<usize> = (0..scene.meshes.len()).filter(|&m| scene.meshes[m].name == name).collect();
        if chosen.is_empty() && self.on.is_none() {
            chosen = (0..scene.meshes.len()).filter(|&m| !scene.meshes[m].texcoords.is_empty()).collect();
        }
        let wrong = |reason: String| Err(Error::argument(format!("material 'neural:{self}'"), reason));
        if chosen.is_empty() {
            let names: Vec<&str> = scene.mesh_names().into_iter().take(LISTED).collect();
            return match (&self.on, names.is_empty()) {
                (None, _) => wrong("no mesh of the scene has texture coordinates".into()),
                (Some(on), true) => wrong(format!("no mesh is called {on}: none has a name")),
                (Some(on), false) => wrong(format!("no mesh is called {on}; meshes are {}", names.join(", "))),
            };
        }
        if chosen.iter().any(|&m| scene.meshes[m].texcoords.is_empty()) {
            return wrong(format!("the meshes called {name} have no texture coordinates"));
        }
        let (table, brdf) = scene.brdfs.with(texture.clone());
        scene.brdfs = table;
        let material = scene.materials.len();
        scene.materials.push(Material::Neural(NeuralMaterial { texture, repeat: self.repeat, brdf }));
        chosen.into_iter().for_each(|m| scene.meshes[m].material = material);
        Ok(scene)
    }
}

impl FromStr for NeuralSpec {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (mut file, mut repeat, mut on) = (text, None, None);
        while let Some((before, setting)) = file.rsplit_once(',').filter(|(_, setting)| setting.contains('=')) {
            let is_new = match setting.split_once('=') {
                Some(("repeat", value)) => repeat.replace(value).is_none(),
                Some(("on", value)) => on.replace(value).is_none(),
                _ => return Err(format!("'{setting}' is not one of repeat=, on=")),
            };
            if !is_new {
                return Err(format!("'{setting}' is given twice"));
            }
            file = before;
        }
        if file.is_empty() {
            return Err("name a file, as in neural:FILE,repeat=24".into());
        }
        let repeat = match repeat.map(|text| (text, text.parse::<f32>())) {
            None => 1.0,
            Some((_, Ok(repeat))) if (1e-3..=1e6).contains(&repeat) => repeat,
            Some((text, _)) => return Err(format!("repeat '{text}' is not a number in 0.001..=1000000")),
        };
        Ok(Self { file: path_of(file), repeat, on: on.map(str::to_owned) })
    }
}

impl fmt::Display for NeuralSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text_of(&self.file))?;
        if self.repeat != 1.0 {
            write!(f, ",repeat={}", self.repeat)?;
        }
        self.on.as_ref().map_or(Ok(()), |on| write!(f, ",on={on}"))
    }
}
