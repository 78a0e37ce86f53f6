//! Arguments that several commands share, and what they open.

use std::{str::FromStr, sync::Arc};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use glam::Vec3A;
use headtail_eval::{Budget, CameraSettings, OpenedView, ViewSettings};
use headtail_render::{
    environment::{Environment, MapSpec},
    estimator::LearnedVisibility,
    export::{ExportedSampler, Intermediate},
    head::Condition,
    image::MapLayout,
    points::PointSet,
    remark::Remark,
    scene::{Camera, MaterialSpec, Scene},
    spec::{Companion, FileKind, SamplerSpec},
    tail::TailKind,
};

use crate::crop::Crop;
use crate::given::given;
use crate::light::LightArguments;
use crate::progress;
use crate::terminal::{self, detail, note};

/// Default memory for precomputed visibility, in MB of 2^20 bytes.
pub const VISIBILITY_MEGABYTES: u32 = (LearnedVisibility::MEMORY >> 20) as u32;

/// Scene, environment and settings of a picture.
#[derive(Args, Clone, Debug)]
pub struct ViewArguments {
    /// Built-in scene or glTF 2.0 file (.glb, .gltf).
    /// Built-in: temple, dishes, diorama, droid, bedroom, cloth, arcade, sphere, plane. FILE#NAME selects a
    /// scene of the file other than the default.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub scene: String,
    /// Built-in environment, or Radiance .hdr or OpenEXR map.
    /// Built-in: overcast, window, studio, sunset.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub env: String,
    #[command(flatten)]
    pub map: MapArguments,
    #[command(flatten)]
    pub camera: CameraArguments,
    /// Camera of the scene file, by name or by number from 0.
    /// Default: the first perspective camera.
    #[arg(long = "camera", value_name = "NAME", conflicts_with = "look_from")]
    pub own_camera: Option<String>,
    /// Put a grey diffuse plane under the scene, out to the horizon.
    #[arg(long)]
    pub ground: bool,
    /// Give every surface, the ground included, one material.
    /// Forms: lambert[:albedo=A]; ggx:alpha=A or ggx:alpha=LOW..HIGH (a roughness that varies over the
    /// scene), both with [,f0=F]; nbrdf:FILE#NAME,NAME,... (measured materials, assigned to the scene's
    /// meshes in turn); neural:FILE[,repeat=N,on=NAME] (a neural material on the meshes called `fabric` or
    /// NAME, else on all with texture coordinates). Default: the scene's materials.
    #[arg(long, value_name = "SPEC", value_parser = given::<MaterialSpec>())]
    pub material: Option<MaterialSpec>,
    /// Trace no shadow rays: every point sees the whole environment.
    #[arg(long)]
    pub unshadowed: bool,
    /// Maximum number of surfaces on a light path: 1 is direct light only.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "unshadowed", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub depth: u32,
    /// Sample points: lattice, lattice:N, sobol or independent.
    /// lattice: rank-1 lattices of the picture's number of samples, or of N; sobol: an Owen-scrambled sequence,
    /// best at powers of two; independent: random.
    #[arg(long, value_name = "POINTS", default_value = "lattice")]
    pub points: PointSet,
    /// Memory for visibility of +vis samplers, in MB of 2^20 bytes.
    /// Cells are larger where it is not enough.
    #[arg(long, value_name = "MB", default_value_t = VISIBILITY_MEGABYTES, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub visibility_memory: u32,
    /// Use +vis visibility even if its predicted gain is below its cost.
    #[arg(long)]
    pub visibility_always: bool,
    /// Threads to render with. Default: all cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Camera and image size.
#[derive(Args, Clone, Debug)]
pub struct CameraArguments {
    /// Image width in pixels.
    #[arg(long, default_value_t = 640, value_parser = clap::value_parser!(u32).range(1..=16384))]
    pub width: u32,
    /// Image height in pixels.
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(1..=16384))]
    pub height: u32,
    /// Camera position in metres.
    /// Default: the scene's camera, else one that frames the scene.
    #[arg(long, value_name = "X,Y,Z", requires = "look_at", allow_hyphen_values = true)]
    pub look_from: Option<Triple>,
    /// The point that the camera looks at.
    #[arg(long, value_name = "X,Y,Z", requires = "look_from", allow_hyphen_values = true)]
    pub look_at: Option<Triple>,
    /// Vertical field of view in degrees.
    #[arg(long, value_name = "DEGREES")]
    pub fov: Option<f32>,
}

/// Layout and layer of a map, where its file leaves them open.
#[derive(Args, Clone, Debug, Default)]
pub struct MapArguments {
    /// Layout of the map: latlong, equal-area, cube, cross or angular.
    /// equal-area: the square of pbrt-v4; cube: six faces in a row or a column; cross: an unfolded cube;
    /// angular: a light probe. Default: that of the file, else latlong.
    #[arg(long, value_name = "LAYOUT")]
    pub env_layout: Option<MapLayout>,
    /// Layer of an OpenEXR map, or the end of its name.
    /// Default: R, G and B without a layer, else Combined, beauty and the like.
    #[arg(long, value_name = "NAME")]
    pub env_layer: Option<String>,
}

impl MapArguments {
    /// Returns the map's name with the given layout and layer.
    pub fn of(&self, env: &str) -> String {
        match (self.env_layout, &self.env_layer, MapSpec::parse(env)) {
            (None, None, _) | (.., Err(_)) => env.to_owned(),
            (layout, layer, Ok(spec)) => {
                let (layout, layer) = (layout.or(spec.layout), layer.clone().or(spec.layer));
                MapSpec { name: spec.name, layout, layer }.to_string()
            }
        }
    }
}

impl CameraArguments {
    /// Returns the scene's own camera and this image size.
    pub fn of_size(width: u32, height: u32) -> Self {
        Self { width, height, look_from: None, look_at: None, fov: None }
    }

    /// Returns the settings that the arguments describe.
    pub fn settings(&self) -> CameraSettings {
        let place = |triple: Option<Triple>| triple.map(|triple| triple.0.to_array());
        let (look_from, look_at) = (place(self.look_from), place(self.look_at));
        CameraSettings { width: self.width, height: self.height, look_from, look_at, fov: self.fov }
    }

    /// Opens the camera; missing values are those of the scene's own.
    pub fn open(&self, scene: &Scene) -> Result<Camera> {
        Ok(self.settings().open(scene)?)
    }
}

/// Three numbers separated by commas.
#[derive(Clone, Copy, Debug)]
pub struct Triple(pub Vec3A);

impl FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f32> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
        match numbers[..] {
            [x, y, z] if text.split(',').count() == 3 && [x, y, z].iter().all(|n| n.is_finite()) => {
                Ok(Self(Vec3A::new(x, y, z)))
            }
            _ => Err("write three numbers separated by commas, as in 0,1.5,4".into()),
        }
    }
}

/// Two counts written `ROWSxCOLUMNS`.
#[derive(Clone, Copy, Debug)]
pub struct Grid(pub usize, pub usize);

impl FromStr for Grid {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let counts = text.split_once('x').and_then(|(rows, columns)| Some((rows.parse().ok()?, columns.parse().ok()?)));
        counts.map(|(rows, columns)| Self(rows, columns)).ok_or_else(|| "write two counts, as in 16x32".into())
    }
}

/// The kinds of tail warp.
pub const TAILS: [(TailKind, &str, &str); 3] = [
    (TailKind::Hierarchical, "hierarchical", "Quad-tree warp: neighbours stay together; best on most maps"),
    (TailKind::RowColumn, "row-column", "First a row, then a column"),
    (TailKind::Flow, "flow", "A smooth flow that is fitted to the map first"),
];

impl ViewArguments {
    /// Returns a view with the scene's own materials, shadows and direct light, rendered with the default points.
    pub fn of(scene: &str, env: &str, camera: CameraArguments) -> Self {
        Self {
            scene: scene.to_owned(),
            env: env.to_owned(),
            map: MapArguments::default(),
            camera,
            own_camera: None,
            ground: false,
            material: None,
            unshadowed: false,
            depth: 1,
            points: PointSet::default(),
            visibility_memory: VISIBILITY_MEGABYTES,
            visibility_always: false,
            threads: None,
        }
    }

    /// Returns the settings that the arguments describe.
    pub fn settings(&self) -> ViewSettings {
        ViewSettings {
            ground: self.ground,
            material: self.material.clone(),
            unshadowed: self.unshadowed,
            depth: self.depth,
            points: self.points,
            visibility_bytes: (self.visibility_memory as usize) << 20,
            visibility_always: self.visibility_always,
            own_camera: self.own_camera.clone(),
            ..ViewSettings::new(&self.scene, &self.map.of(&self.env), self.camera.settings())
        }
    }

    /// Opens scene and environment and sets the number of threads.
    pub fn open(&self) -> Result<OpenedView> {
        if let Some(threads) = self.threads {
            // `build_global` succeeds once per process; each command calls this once.
            rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
        }
        open_view(&self.settings())
    }

    /// [`Self::open`] with changed light and restricted to a part of the picture.
    ///
    /// # Errors
    /// Those of [`Self::open`]; if the part is outside the picture; if the light cannot be turned.
    pub fn open_part(&self, light: LightArguments, crop: Option<Crop>) -> Result<OpenedView> {
        let mut opened = self.open()?;
        let part = crop.map(|crop| crop.of(&opened.view())).transpose()?;
        part.into_iter().for_each(|part| opened.set_part(part));
        opened.set_light(light.env_rotate, light.env_scale.0).map_err(|error| anyhow!("--{error}"))?;
        Ok(opened)
    }
}

/// Opens scene and environment, and prints the remarks on their files.
///
/// # Errors
/// If one of them cannot be read, or the camera or the material does not fit the scene; with `--strict`, also for
/// warnings.
pub fn open_view(settings: &ViewSettings) -> Result<OpenedView> {
    let opened = settings.open_under(open_environment(&settings.env)?)?;
    say_remarks(&settings.scene, opened.remarks())?;
    if settings.material.is_some() {
        opened.scene().brdf_notes().for_each(|said| note!("material {said}"));
    }
    Ok(opened)
}

/// Returns a first sentence and the list of all forms of SPEC.
pub fn samplers_help(first: &str) -> String {
    use headtail_render::spec::forms::{Purpose, list};
    let [used, paper, baseline, study] =
        [Purpose::Use, Purpose::Paper, Purpose::Baseline, Purpose::Study].map(|purpose| list(&[purpose]));
    format!(
        "{first}\n\nTo render with:\n{used}\nThe paper's method:\n{paper}\nBaselines:\n{baseline}\nFor study:\n{study}"
    )
}

/// Prints notes and warnings about a file on standard error.
///
/// # Errors
/// With `--strict`, the first warning.
pub fn say_remarks(file: &str, remarks: &[Remark]) -> Result<()> {
    remarks.iter().try_for_each(|remark| terminal::say_remark(file, remark))
}

/// Opens a scene and reports on standard error which parts of its file are not shown. If `materials` is
/// false, the file's materials are not read.
pub fn open_scene(name_or_path: &str, materials: bool) -> Result<Scene> {
    let scene = Scene::open_dressed(name_or_path, materials)?;
    say_remarks(name_or_path, scene.remarks())?;
    Ok(scene)
}

/// Opens an environment and reports conversions and repairs on standard error.
pub fn open_environment(name_or_path: &str) -> Result<Arc<Environment>> {
    let busy = progress::busy("map");
    let environment = Environment::open(name_or_path)?;
    drop(busy);
    detail!("{name_or_path}: {} x {} pixels, hash {}", environment.width(), environment.height(), environment.hash());
    say_remarks(name_or_path, environment.remarks())?;
    Ok(Arc::new(environment))
}

/// Notes on standard error if a file made for diffuse surfaces is used on glossy ones.
pub fn note_surfaces(spec: &SamplerSpec, opened: &OpenedView) -> Result<()> {
    if !opened.is_diffuse()
        && spec.has_pdf()
        && spec.companion() == Companion::None
        && let Some((_, file)) = spec.path()
    {
        let of_glossy = match &ExportedSampler::read(file)?.intermediate {
            Intermediate::Head(head) => head.condition() != Condition::Normal,
            Intermediate::Bake(_) | Intermediate::DirectBake(_) => false,
        };
        if !of_glossy {
            note!(
                "{spec} was made for diffuse surfaces and knows nothing of glossy ones, of which there are some here: it will be noisy there; \
                 ris:4:{spec} or patches serve both"
            );
        }
    }
    Ok(())
}

/// Notes on standard error if a file is used in a way that it was not trained for.
pub fn note_use(spec: &SamplerSpec) -> Result<()> {
    if let Some((FileKind::Head, file)) = spec.path()
        && spec.has_pdf()
        && spec.companion() == Companion::None
    {
        let meant = SamplerSpec::of_exported(&ExportedSampler::read(file)?, file.to_owned());
        if meant != *spec {
            note!("{spec} was trained to be mixed with BRDF sampling and may be noisy alone; {meant} mixes it");
        }
    }
    Ok(())
}

/// Returns the budget of samples per pixel or of seconds; exactly one must be given.
pub fn budget(spp: Option<u32>, seconds: Option<f64>) -> Result<Budget> {
    match (spp, seconds) {
        (Some(spp), None) => {
            ensure!(spp > 0, "--spp: at least 1 sample per pixel is needed");
            Ok(Budget::Samples(spp))
        }
        (None, Some(seconds)) => {
            ensure!(seconds > 0.0 && seconds <= 1e6, "--seconds: {seconds} is not between 0 and 1e6");
            Ok(Budget::Seconds(seconds))
        }
        _ => bail!("give one of --spp and --seconds"),
    }
}
