//! The scenes that benchmarks look at, and how they are called.

use std::{error::Error, path::Path};

use headtail_render::scene::{MaterialSpec, Scene};

/// A scene in a material, or in the materials that it has where that is `own`; meshes of files stand on a plane.
///
/// # Errors
/// There is no such scene or material.
pub fn dressed(name: &str, material: &str) -> Result<Scene, Box<dyn Error>> {
    let mut scene = Scene::open(name)?;
    if name.contains('.') {
        scene.add_ground();
    }
    if material == "own" {
        return Ok(scene);
    }
    let bounds = scene.bounds();
    Ok(material.parse::<MaterialSpec>()?.dress(scene, &bounds)?)
}

/// The name of a file without folders and endings.
pub fn stem(name: &str) -> &str {
    Path::new(name).file_stem().and_then(|stem| stem.to_str()).unwrap_or(name)
}
