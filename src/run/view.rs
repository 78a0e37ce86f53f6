//! Views in a run's table: for conditions and for measured pictures.

use anyhow::{Result, ensure};
use headtail_eval::{CameraSettings, ViewSettings};
use headtail_render::scene::MaterialSpec;
use serde::{Deserialize, Serialize};

/// A scene and a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Picture {
    /// Built-in scene or glTF file.
    pub scene: String,
    /// Whether a grey diffuse plane is put under it.
    #[serde(default)]
    pub ground: bool,
    /// Width in pixels.
    #[serde(default = "Picture::default_width")]
    pub width: u32,
    /// Height in pixels.
    #[serde(default = "Picture::default_height")]
    pub height: u32,
    /// Position of the camera, with `look_at`; by default, the scene's own camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look_from: Option<[f32; 3]>,
    /// The point that the camera looks at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look_at: Option<[f32; 3]>,
    /// Vertical field of view in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov: Option<f32>,
}

impl Picture {
    fn default_width() -> u32 {
        96
    }

    fn default_height() -> u32 {
        72
    }

    /// Returns a scene's picture.
    pub fn new(scene: String, camera: CameraSettings) -> Self {
        let CameraSettings { width, height, look_from, look_at, fov } = camera;
        Self { scene, ground: false, width, height, look_from, look_at, fov }
    }

    /// Returns the camera.
    pub fn camera(&self) -> CameraSettings {
        let Self { width, height, look_from, look_at, fov, .. } = *self;
        CameraSettings { width, height, look_from, look_at, fov }
    }

    /// Checks that its numbers can be rendered.
    ///
    /// # Errors
    /// If a number is wrong, which the error names.
    pub fn validate(&self, key: &str) -> Result<()> {
        ensure!((1..=16384).contains(&self.width), "{key}.width = {}, but it must be in 1..=16384", self.width);
        ensure!((1..=16384).contains(&self.height), "{key}.height = {}, but it must be in 1..=16384", self.height);
        ensure!(self.look_from.is_some() == self.look_at.is_some(), "{key}: look_from and look_at come together");
        let numbers = [self.look_from, self.look_at].into_iter().flatten().flatten();
        ensure!(numbers.chain(self.fov).all(f32::is_finite), "{key}: the camera's numbers must be finite");
        Ok(())
    }
}

/// Measurements of the exported sampler. Weights, bytes, training seconds and validation figures are always
/// included.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Measure {
    /// Whether the time of a light estimate is measured.
    pub time: bool,
    /// Pictures whose error is measured.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<MeasuredView>,
}

/// A picture whose mean squared error is measured.
// Without `deny_unknown_fields`, which serde does not support with `flatten`; [`RunTable::new`] checks the
// keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredView {
    /// Name in results; by default, the scene's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Scene and camera.
    #[serde(flatten)]
    pub picture: Picture,
    /// Material of every surface; by default, the one that the head is trained for. `"scene"` keeps the
    /// scene's materials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// Samples per pixel, for the error at equal samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Seconds of rendering, for the error at equal time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Number of pictures over which the error is averaged.
    #[serde(default = "MeasuredView::default_runs")]
    pub runs: u32,
    /// Samples per pixel of the reference.
    #[serde(default = "MeasuredView::default_reference_spp")]
    pub reference_spp: u32,
}

/// Keys of a [`MeasuredView`].
pub const VIEW_KEYS: [&str; 13] = [
    "name",
    "scene",
    "ground",
    "width",
    "height",
    "look_from",
    "look_at",
    "fov",
    "material",
    "spp",
    "seconds",
    "runs",
    "reference_spp",
];

impl MeasuredView {
    fn default_runs() -> u32 {
        2
    }

    fn default_reference_spp() -> u32 {
        1024
    }

    /// Returns the name in results.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.picture.scene)
    }

    /// Returns the view to render, for a head for this material under this map.
    pub fn view(&self, env: &str, material: &MaterialSpec) -> Result<ViewSettings> {
        let parse = |text: &str| text.parse::<MaterialSpec>().map_err(anyhow::Error::from);
        let material = match self.material.as_deref() {
            Some("scene") => None,
            Some(text) => Some(parse(text)?),
            None => Some(material.clone()),
        };
        let Picture { scene, ground, .. } = &self.picture;
        Ok(ViewSettings { ground: *ground, material, ..ViewSettings::new(scene, env, self.picture.camera()) })
    }

    /// Checks that its numbers can be rendered.
    ///
    /// # Errors
    /// If a number is wrong, which the error names.
    pub fn validate(&self) -> Result<()> {
        self.picture.validate("measure.views")?;
        ensure!(self.spp.is_some() || self.seconds.is_some(), "measure.views: give spp or seconds");
        ensure!(self.spp != Some(0), "measure.views.spp = 0, but it must be at least 1");
        let seconds = self.seconds.unwrap_or(1.0);
        ensure!(seconds > 0.0 && seconds <= 1e6, "measure.views.seconds = {seconds}, but it must be in (0, 1e6]");
        ensure!((1..=10_000).contains(&self.runs), "measure.views.runs = {}, but it must be in 1..=10000", self.runs);
        ensure!(self.reference_spp > 0, "measure.views.reference_spp = 0, but it must be at least 1");
        Ok(())
    }
}
