//! Views: a scene seen by a camera under a map.

use std::sync::{Arc, atomic::AtomicBool};

use glam::{Affine3A, Vec3A};
use headtail_render::{
    environment::Environment,
    estimator::{Estimator, LearnedVisibility},
    integrator::{self, Part, Rendering, View},
    patches::Detail,
    points::{PointSet, Points},
    portals::{Portal, Portals},
    remark::Remark,
    scene::{Camera, MaterialSpec, Scene},
    spec::{BuildContext, SamplerSpec, Source},
};
use serde::{Deserialize, Serialize};

use crate::{Budget, Error, Renderer, Result};

/// A camera and the size of its picture; missing values are those of the scene's own camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Position in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look_from: Option<[f32; 3]>,
    /// The point that it looks at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look_at: Option<[f32; 3]>,
    /// Vertical field of view in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov: Option<f32>,
}

impl CameraSettings {
    /// Returns the scene's own camera with this image size.
    pub fn of_size(width: u32, height: u32) -> Self {
        Self { width, height, look_from: None, look_at: None, fov: None }
    }

    /// Opens the camera in a scene.
    ///
    /// # Errors
    /// If the values do not define a camera.
    pub fn open(&self, scene: &Scene) -> Result<Camera> {
        let own = scene.camera_for(self.width as f32 / self.height as f32);
        if (self.look_from, self.look_at, self.fov) == (None, None, None) {
            return Ok(own);
        }
        let from = self.look_from.map_or(own.look_from(), Vec3A::from_array);
        let at = self.look_at.map_or(own.look_at(), Vec3A::from_array);
        Ok(Camera::new(from, at, self.fov.unwrap_or(own.vertical_fov()))?)
    }
}

/// Everything that a picture depends on, except its sampler and its samples.
#[derive(Clone, Debug)]
pub struct ViewSettings {
    /// A built-in scene or a glTF file.
    pub scene: String,
    /// A built-in map or a file.
    pub env: String,
    /// Camera and size.
    pub camera: CameraSettings,
    /// Name or number of the camera in the scene's file; `None` is its first.
    pub own_camera: Option<String>,
    /// Whether a grey diffuse plane is put under the scene.
    pub ground: bool,
    /// Material of every surface; `None` keeps the scene's materials.
    pub material: Option<MaterialSpec>,
    /// Whether shadow rays are left out.
    pub unshadowed: bool,
    /// Maximum number of surfaces on a light path; 1 is direct light.
    pub depth: u32,
    /// The points of samples.
    pub points: PointSet,
    /// Memory for precomputed visibility, in bytes.
    pub visibility_bytes: usize,
    /// Whether visibility is used even if its predicted gain is below its cost.
    pub visibility_always: bool,
}

impl ViewSettings {
    /// Returns direct light on a scene with its own materials and the default points.
    pub fn new(scene: &str, env: &str, camera: CameraSettings) -> Self {
        Self {
            scene: scene.to_owned(),
            env: env.to_owned(),
            camera,
            own_camera: None,
            ground: false,
            material: None,
            unshadowed: false,
            depth: 1,
            points: PointSet::default(),
            visibility_bytes: LearnedVisibility::MEMORY,
            visibility_always: false,
        }
    }

    /// Opens scene and map.
    ///
    /// # Errors
    /// If one of them cannot be read, or the camera or the material does not fit the scene.
    pub fn open(&self) -> Result<OpenedView> {
        self.open_under(Arc::new(Environment::open(&self.env)?))
    }

    /// Opens the scene under a map that is already open.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_under(&self, environment: Arc<Environment>) -> Result<OpenedView> {
        // A material for all surfaces makes those of the file unnecessary.
        let is_dressed = self.material.as_ref().is_some_and(MaterialSpec::is_for_all);
        let mut scene = Scene::open_dressed(&self.scene, !is_dressed)?;
        let remarks = scene.remarks().to_vec();
        if let Some(name) = &self.own_camera {
            scene.use_camera(name)?;
        }
        // The camera frames the scene without the plane below it.
        let camera = self.camera.open(&scene)?;
        let bounds = scene.bounds();
        if self.ground {
            scene.add_ground();
        }
        if let Some(material) = &self.material {
            scene = material.dress(scene, &bounds)?;
        }
        scene.prepare_materials();
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        Ok(OpenedView {
            material: self.material.clone(),
            unshadowed: self.unshadowed,
            depth: self.depth,
            points: self.points,
            visibility_bytes: self.visibility_bytes,
            visibility_always: self.visibility_always,
            remarks,
            ..OpenedView::new(Arc::new(scene), camera, environment, (width, height))
        })
    }
}

/// Scene, camera and map, opened.
#[derive(Clone)]
pub struct OpenedView {
    scene: Arc<Scene>,
    material: Option<MaterialSpec>,
    camera: Camera,
    /// The map.
    pub environment: Arc<Environment>,
    width: usize,
    height: usize,
    /// Whether shadow rays are left out.
    pub unshadowed: bool,
    /// Maximum number of surfaces on a light path.
    pub depth: u32,
    /// The points of samples.
    pub points: PointSet,
    visibility_bytes: usize,
    visibility_always: bool,
    rotation: f32,
    scale: Vec3A,
    part: Option<Part>,
    remarks: Vec<Remark>,
}

impl OpenedView {
    /// Returns a view of direct light on a scene, with the default points.
    pub fn new(
        scene: Arc<Scene>,
        camera: Camera,
        environment: Arc<Environment>,
        (width, height): (usize, usize),
    ) -> Self {
        Self {
            scene,
            material: None,
            camera,
            environment,
            width,
            height,
            unshadowed: false,
            depth: 1,
            points: PointSet::default(),
            visibility_bytes: LearnedVisibility::MEMORY,
            visibility_always: false,
            rotation: 0.0,
            scale: Vec3A::ONE,
            part: None,
            remarks: Vec::new(),
        }
    }

    /// Returns the view for the integrator.
    pub fn view(&self) -> View<'_> {
        View {
            scene: &self.scene,
            camera: &self.camera,
            environment: &self.environment,
            width: self.width,
            height: self.height,
            unshadowed: self.unshadowed,
            depth: self.depth,
        }
    }

    /// Builds the estimator of a SPEC for this map and this scene.
    ///
    /// # Errors
    /// If a file of the SPEC cannot be used here, or portals without a file are not found.
    pub fn estimator(&self, spec: &SamplerSpec) -> Result<Box<dyn Estimator>> {
        self.with_context(spec, |context| Ok(spec.build_in(&self.environment, context)?))?
    }

    /// Calls a function with what samplers of a SPEC are built for here; finds portals where the SPEC needs these and names
    /// no file.
    ///
    /// # Errors
    /// If portals without a file are not found.
    pub fn with_context<T>(&self, spec: &SamplerSpec, work: impl FnOnce(BuildContext<'_>) -> T) -> Result<T> {
        let found = matches!(spec.source(), Source::Portals(None)).then(|| self.portals()).transpose()?;
        Ok(work(self.build_context(found.as_ref().map_or(&[], |found| &found.portals))))
    }

    /// Builds the estimator of a SPEC, with known portals of this view for SPECs of portals without a file.
    pub(crate) fn estimator_through(&self, portals: &[Portal], spec: &SamplerSpec) -> Result<Box<dyn Estimator>> {
        Ok(spec.build_in(&self.environment, self.build_context(portals))?)
    }

    /// Builds the estimator of a SPEC with visibility.
    ///
    /// # Errors
    /// If the SPEC has none, or a file of it cannot be used here.
    pub fn learned_visibility(&self, spec: &SamplerSpec) -> Result<LearnedVisibility> {
        Ok(spec.build_learned(&self.environment, self.build_context(&[]))?)
    }

    fn build_context<'a>(&'a self, portals: &'a [Portal]) -> BuildContext<'a> {
        let (memory, always) = (self.visibility_bytes, self.visibility_always);
        let motion = Affine3A::from_rotation_y(-self.rotation.to_radians());
        BuildContext { scene: Some(&*self.scene), memory, always, motion, portals }
    }

    /// Finds the portals of the room that the camera is in.
    ///
    /// # Errors
    /// If it is no room, or no light enters.
    pub(crate) fn portals(&self) -> Result<Portals> {
        Ok(Portals::find(&self.scene, &self.camera)?)
    }

    /// Builds the estimator of `patches+vis` for this map and this scene.
    ///
    /// # Errors
    /// If the map has no light.
    pub(crate) fn patches_with_visibility(&self) -> Result<LearnedVisibility> {
        let patches = LearnedVisibility::new(self.environment.clone(), Detail::Leaves, self.visibility_bytes)?;
        Ok(if self.visibility_always { patches.always() } else { patches })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns remarks on parts of the scene's file that are not shown or were converted.
    pub fn remarks(&self) -> &[Remark] {
        &self.remarks
    }

    /// Returns the memory for precomputed visibility, in bytes.
    pub fn visibility_bytes(&self) -> usize {
        self.visibility_bytes
    }

    /// Turns the map around the vertical axis by an angle in degrees and scales its light. Scene and camera
    /// are turned against the map, which is unchanged, and the factors multiply the rendering, so that
    /// samplers made for the map stay valid.
    ///
    /// # Errors
    /// If the angle is not finite, or surfaces have a spatially varying width, which would not turn with
    /// them.
    pub fn set_light(&mut self, rotation: f32, scale: Vec3A) -> Result<()> {
        if !rotation.is_finite() {
            return Err(Error::argument("env-rotate", "the angle is not finite"));
        }
        (self.rotation, self.scale) = (rotation, scale);
        if rotation == 0.0 {
            return Ok(());
        }
        if matches!(self.material, Some(MaterialSpec::Ggx { alpha, .. }) if alpha.fixed().is_none()) {
            let reason = "a width that varies over the scene would not turn with it; give one width";
            return Err(Error::argument("env-rotate", reason));
        }
        let turn = Affine3A::from_rotation_y(-rotation.to_radians());
        self.scene = Arc::new(self.scene.moved(&turn)?);
        self.camera = self.camera.moved(&turn);
        Ok(())
    }

    /// Returns the whole view in a picture that is `coarseness` times smaller along each side, at least one
    /// pixel.
    #[must_use]
    pub fn resized(&self, coarseness: usize) -> Self {
        let side = |length: usize| (length / coarseness).max(1);
        Self { width: side(self.width), height: side(self.height), part: None, ..self.clone() }
    }

    /// Restricts rendering to a part of the picture.
    pub fn set_part(&mut self, part: Part) {
        self.part = Some(part);
    }

    /// Returns the angle in degrees by which the map is turned.
    pub fn rotation(&self) -> f32 {
        self.rotation
    }

    /// Returns the factors of the map's light.
    pub fn scale(&self) -> Vec3A {
        self.scale
    }

    /// Returns the part of the picture that is rendered.
    pub fn part(&self) -> Part {
        self.part.unwrap_or(self.view().whole())
    }

    /// Renders the part of the picture under its light; see [`integrator::render`].
    pub fn render(
        &self,
        estimator: &dyn Estimator,
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Rendering {
        let part = self.part();
        let rendering = integrator::render_part(self.view(), part, estimator, budget.into(), points, stop, progress);
        self.lit(rendering)
    }

    /// [`Self::render`] on the CPU or on a device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn render_by(
        &self,
        renderer: &dyn Renderer,
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Rendering> {
        Ok(self.lit(renderer.render_part((self.view(), self.part()), budget, points, stop, progress)?))
    }

    fn lit(&self, rendering: Rendering) -> Rendering {
        // Even a factor of 1 would change pictures that are not finite.
        if self.scale == Vec3A::ONE { rendering } else { rendering.lit_by(self.scale) }
    }

    /// Returns the camera in the coordinates of the scene before it was turned.
    pub fn own_camera(&self) -> Camera {
        self.camera.moved(&Affine3A::from_rotation_y(self.rotation.to_radians()))
    }

    /// Returns the points of a rendering.
    pub fn points(&self, seed: u64) -> Points {
        Points::new(self.points, seed)
    }

    /// Returns the scene's name with its material, and with everything else that differs from direct light on
    /// the whole picture.
    pub fn scene_name(&self) -> String {
        let name = self.scene.name();
        let name = self.material.as_ref().map_or_else(|| name.to_owned(), |material| format!("{name} of {material}"));
        let name = match (self.unshadowed, self.depth) {
            (true, _) => name + ", unshadowed",
            (false, 1) => name,
            (false, depth) => format!("{name}, depth {depth}"),
        };
        self.part.map_or(name.clone(), |part| format!("{name}, pixels {}", part_text(part)))
    }

    /// Returns the map's name with the changes of its light.
    pub fn light_name(&self) -> String {
        let [r, g, b] = self.scale.to_array();
        let turned = if self.rotation == 0.0 { String::new() } else { format!(", turned by {}\u{b0}", self.rotation) };
        let scaled = match self.scale == Vec3A::ONE {
            true => String::new(),
            false if r == g && g == b => format!(", {r} times as bright"),
            false => format!(", times {r},{g},{b}"),
        };
        format!("{}{turned}{scaled}", self.environment.name())
    }

    /// Whether all surfaces reflect like Lambert's BRDF.
    pub fn is_diffuse(&self) -> bool {
        self.scene.is_diffuse()
    }
}

/// Formats a part of a picture as `LEFT,TOP,WIDTH,HEIGHT`.
pub fn part_text(part: Part) -> String {
    format!("{},{},{},{}", part.left, part.top, part.width, part.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_describe_changes_of_the_light() {
        let mut view = ViewSettings::new("plane", "overcast", CameraSettings::of_size(8, 6)).open().unwrap();
        assert_eq!(view.light_name(), "overcast");
        view.set_light(-90.0, Vec3A::splat(2.0)).unwrap();
        assert_eq!(view.light_name(), "overcast, turned by -90\u{b0}, 2 times as bright");
        view.set_light(0.0, Vec3A::new(1.0, 0.5, 0.0)).unwrap();
        assert_eq!(view.light_name(), "overcast, times 1,0.5,0");
        assert!(view.set_light(f32::NAN, Vec3A::ONE).is_err());
    }
}
