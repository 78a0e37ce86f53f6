//! Neural materials on surfaces: `neural:FILE[,repeat=N][,on=NAME]`, tangent frames, and pixel footprints on
//! textures.

use std::{fmt, path::PathBuf, str::FromStr, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};

use super::{Material, Scene, SurfacePoint};
use crate::{
    brdf::{NeuralTexture, Surface, neural_texture::Seen},
    error::{Error, Result},
    frame::Frame,
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
        let TangentView { wo, width, tangent } = at.view;
        let uv = self.repeat * at.color_uv.unwrap_or_default();
        let seen = Seen { uv, width: self.repeat * width, wo, tangent };
        Surface { brdf: self.brdf, parameters: self.texture.parameters(&seen) }
    }

    /// Returns the material with its table index increased by `later`.
    pub(super) fn renumbered(&self, later: u32) -> Self {
        Self { brdf: self.brdf + later, ..self.clone() }
    }
}

/// A point of a surface in its tangent frame: x along growing u, y along growing v, z along the shading normal.
#[derive(Clone, Copy, Debug)]
pub struct TangentView {
    /// Direction to the viewer.
    pub wo: Vec3,
    /// Standard deviation of a pixel's footprint, in units of the texture coordinates.
    pub width: f32,
    /// See [`Seen::tangent`].
    pub tangent: [f32; 3],
}

impl Default for TangentView {
    fn default() -> Self {
        Self { wo: Vec3::Z, width: 0.0, tangent: [1.0, 0.0, 1.0] }
    }
}

impl TangentView {
    /// Returns the view of a triangle with coordinates `uv`, where the shading normal is `n`, by a pixel that
    /// is `pixel` metres wide at that distance.
    ///
    /// Coordinates that do not span the triangle give an arbitrary tangent and the finest detail. The
    /// footprint is assumed to be round: its variance is that of a square pixel, enlarged by the obliquity
    /// (one over the cosine, in area).
    pub(super) fn new(corners: [Vec3; 3], uv: [Vec2; 3], n: Vec3A, wo: Vec3A, pixel: f32) -> Self {
        let (n, wo) = (Vec3::from(n), Vec3::from(wo));
        let [a, b] = [corners[1] - corners[0], corners[2] - corners[0]];
        let [s, t] = [uv[1] - uv[0], uv[2] - uv[0]];
        let area = s.perp_dot(t);
        // Cramer's rule without the determinant's magnitude: only its sign affects directions.
        let along_u = area.signum() * (a * t.y - b * s.y);
        let along_v = area.signum() * (b * s.x - a * t.x);
        let frame = Frame::from_normal(n);
        let tangent = along_u.reject_from_normalized(n).try_normalize().unwrap_or(frame.s);
        let across = n.cross(tangent);
        let hand = 1.0_f32.copysign(across.dot(along_v));
        let cos_o = n.dot(wo);
        let per_metre = (area.abs() / a.cross(b).length()).sqrt();
        let width = pixel * per_metre / (12.0 * cos_o.max(1e-2)).sqrt();
        Self {
            wo: Vec3::new(wo.dot(tangent), hand * wo.dot(across), cos_o),
            width: if width.is_finite() { width } else { 0.0 },
            tangent: [tangent.dot(frame.s), tangent.dot(frame.t), hand],
        }
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
