//! Inputs of a composite: photograph, camera, map, object and catcher.

use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use headtail_render::{
    color::luminance,
    composite::{Backdrop, Catcher, Stage, rectified_view},
    environment::Environment,
    image::{Image, Photograph},
    memory,
    scene::{Camera, FspyProject, MaterialSpec, Scene},
};

use super::arguments::Arguments;
use crate::arguments::{open_environment, open_scene, say_remarks};
use crate::light::{Factors, LightArguments};
use crate::terminal::note;

/// Inputs, all in the coordinates of the map.
pub struct Setting {
    /// The photograph in the size of the composite.
    pub photograph: Photograph,
    /// Camera of the photograph.
    pub camera: Camera,
    /// The map.
    pub environment: Arc<Environment>,
    /// Object and catcher.
    pub stage: Stage,
    /// Factor from the photograph's values to the units of the map as it is lit.
    pub gain: f32,
    /// Per-channel factor from the photograph's values to the units of the original map, for which samplers
    /// were made: the photograph is divided by the light's factors instead of multiplying the map.
    pub to_map: Vec3A,
}

/// Minimum width of a preview.
const PREVIEW_WIDTH: usize = 160;

impl Setting {
    /// Opens the inputs that the arguments name.
    pub fn open(arguments: &Arguments) -> Result<Self> {
        let (photograph, camera) = photograph_and_camera(arguments)?;
        let environment = open_environment(&arguments.map.of(&arguments.env))?;
        let LightArguments { env_rotate, env_scale: Factors(scale) } = arguments.light;
        arguments.light.check()?;
        ensure!(scale.min_element() > 0.0, "--env-scale: a composite needs light in all three channels");
        // Samplers were made for the map, so everything else is turned the other way.
        let turn = Affine3A::from_rotation_y(-env_rotate.to_radians());
        let camera = camera.moved(&turn);
        let stage = stage(arguments, &camera, &turn)?;
        let photograph = sized(arguments, photograph)?;
        let gain = match arguments.gain {
            Some(gain) => {
                ensure!(gain > 0.0 && gain.is_finite(), "--gain: {gain} is not a positive factor");
                gain
            }
            None if photograph.is_radiance => 1.0,
            None => {
                let gain = automatic_gain(&photograph.image, &environment, &camera);
                note!("the photograph's values times {gain:.4} are taken for the map's (--gain)");
                gain
            }
        };
        Ok(Self { photograph, camera, environment, stage, gain, to_map: gain / scale })
    }

    /// Returns the appearance of the catcher.
    pub fn backdrop(&self) -> Backdrop<'_> {
        Backdrop::new(&self.stage, &self.environment, &self.photograph, self.camera, self.to_map)
    }
}

fn photograph_and_camera(arguments: &Arguments) -> Result<(Photograph, Camera)> {
    let named = arguments.photo.as_ref().map(|file| -> Result<Photograph> {
        let photograph = Photograph::read(file)?;
        say_remarks(&file.display().to_string(), &photograph.remarks)?;
        Ok(photograph)
    });
    let named = named.transpose()?;
    let Some(file) = &arguments.camera else {
        let (Some(from), Some(at), Some(photograph)) = (arguments.look_from, arguments.look_at, named) else {
            bail!("give --camera FILE.fspy, or --photo with --look-from and --look-at");
        };
        return Ok((photograph, Camera::new(from.0, at.0, arguments.fov)?));
    };
    let project = FspyProject::read(file, arguments.up)?;
    let photograph = match named {
        Some(photograph) => photograph,
        None => {
            let photograph = project.photograph().map_err(|error| error.in_file(file))?;
            say_remarks(&file.display().to_string(), &photograph.remarks)?;
            photograph
        }
    };
    let own = photograph.image.width as f64 / photograph.image.height as f64;
    let calibrated = f64::from(project.width) / f64::from(project.height);
    ensure!(
        (own / calibrated - 1.0).abs() < 0.01,
        "{}: the project is of a picture of {} x {} pixels, and the photograph has {} x {}: another shape",
        file.display(),
        project.width,
        project.height,
        photograph.image.width,
        photograph.image.height
    );
    Ok((photograph, project.camera))
}

fn sized(arguments: &Arguments, photograph: Photograph) -> Result<Photograph> {
    let Image { width, height, .. } = photograph.image;
    let wanted = match arguments.width {
        Some(width) => width as usize,
        None if arguments.preview => (width / 4).max(PREVIEW_WIDTH).min(width),
        None => width,
    };
    let scaled = (height as f64 * wanted as f64 / width as f64).round().max(1.0) as usize;
    // Sums of catcher and object, and layers.
    memory::require_pictures(wanted, scaled, 10)?;
    Ok(if wanted == width { photograph } else { photograph.resized(wanted, scaled) })
}

/// Returns the object on its catcher, in the coordinates of the map.
fn stage(arguments: &Arguments, camera: &Camera, turn: &Affine3A) -> Result<Stage> {
    let is_dressed = arguments.material.as_ref().is_some_and(MaterialSpec::is_for_all);
    let mut scene = open_scene(&arguments.scene, !is_dressed)?;
    if let Some(spec) = &arguments.material {
        let bounds = scene.bounds();
        scene = spec.dress(scene, &bounds)?;
        scene.brdf_notes().for_each(|said| crate::terminal::note!("material {said}"));
    }
    let is_plane = arguments.catcher == "plane";
    let to_world = *turn * placement(arguments, &scene, is_plane)?;
    let stage = if is_plane {
        let object = scene.moved(&to_world)?;
        let (at, normal) =
            (turn.transform_point3a(arguments.plane_at.0), turn.transform_vector3a(arguments.plane_normal.0));
        let catcher = Catcher::plane(at, normal, &object, camera).context("--plane-normal")?;
        Stage::new(object, catcher)?
    } else {
        let (catcher, object) = scene.divided(&arguments.catcher).context("--catcher")?;
        Stage::new(object.moved(&to_world)?, Catcher::mesh(catcher.moved(&to_world)?))?
    };
    Ok(stage)
}

/// Returns the transform from the object's coordinates to those of the photograph. An object without a
/// catcher of its own stands with the centre of its underside at its position; one with a catcher keeps its
/// origin.
fn placement(arguments: &Arguments, scene: &Scene, stands: bool) -> Result<Affine3A> {
    let bounds = scene.bounds();
    let scale = match arguments.size {
        Some(size) => size / bounds.extent().max_element().max(f32::MIN_POSITIVE),
        None => arguments.scale,
    };
    ensure!(scale > 0.0 && scale.is_finite(), "--scale: {scale} is not a positive factor");
    ensure!(arguments.turn.is_finite(), "--turn: not an angle");
    let center = bounds.center();
    let foot = if stands { Vec3A::new(center.x, bounds.min.y, center.z) } else { Vec3A::ZERO };
    let turn = Quat::from_rotation_y(arguments.turn.to_radians());
    let to_place = Affine3A::from_scale_rotation_translation(Vec3::splat(scale), turn, arguments.place.0.into());
    Ok(to_place * Affine3A::from_translation((-foot).into()))
}

/// Returns the factor that gives the photograph the brightness of the map in the same view: the ratio of
/// geometric means over pixels that are neither black nor clipped.
fn automatic_gain(photograph: &Image, environment: &Environment, camera: &Camera) -> f32 {
    const SIDE: usize = 96;
    let height = (SIDE * photograph.height).div_ceil(photograph.width).max(1);
    let map = rectified_view(environment, camera, SIDE, height);
    let small = Photograph::of_radiance(photograph.clone()).resized(SIDE, height).image;
    let pairs = small.pixels.iter().zip(&map.pixels).filter(|(own, _)| own.iter().all(|&value| value < 0.95));
    let logs = pairs.map(|(&own, &map)| (luminance(own.into()), luminance(map.into())));
    let logs: Vec<f32> =
        logs.filter(|(own, map)| *own > 1e-3 && *map > 0.0).map(|(own, map)| (map / own).ln()).collect();
    if logs.is_empty() { 1.0 } else { (logs.iter().sum::<f32>() / logs.len() as f32).exp() }
}
