//! Portals of rooms, for samplers on other devices.

use std::path::PathBuf;

use glam::{Affine3A, Mat3, Vec3, Vec3A};
use headtail_eval::need_no_pilot;
use headtail_render::{
    export::flat_portals,
    portals::{Portal, Portals, read},
    scene::{Camera, Material, Mesh, Scene},
};
use numpy::PyReadonlyArray2;
use pyo3::{prelude::*, types::PyDict};

use crate::{arrays::rows, environment::Environment, error::of_render, sampler::dictionary};

/// A portal: centre, normal, up, width and height.
type Row = ([f32; 3], [f32; 3], [f32; 3], [f32; 2]);

fn row(portal: &Portal) -> Row {
    let [center, normal, up] = [portal.center, portal.normal, portal.up].map(|vector| vector.to_array());
    (center, normal, up, [portal.width, portal.height])
}

fn portal(&(center, normal, up, [width, height]): &Row) -> Portal {
    let [center, normal, up] = [center, normal, up].map(Vec3A::from_array);
    Portal { center, normal, up, width, height }
}

/// Returns the portals of a file.
#[pyfunction]
pub fn read_portals(path: PathBuf) -> PyResult<Vec<Row>> {
    Ok(read(&path).map_err(of_render)?.iter().map(row).collect())
}

/// Finds the portals of the room of triangles that a camera (position, target, vertical field of view in degrees) is in.
/// Also returns the fraction of the light that they cover, and whether `auto` chooses them without a pilot.
#[pyfunction]
pub fn find_portals(
    py: Python<'_>,
    positions: PyReadonlyArray2<'_, f32>,
    triangles: PyReadonlyArray2<'_, u32>,
    camera: ([f32; 3], [f32; 3], f32),
) -> PyResult<(Vec<Row>, f32, bool)> {
    let (scene, camera) = room(&positions, &triangles, camera)?;
    let found = py.detach(|| {
        let found = Portals::find(&scene, &camera)?;
        let coverage = found.coverage(&scene, &camera, 1);
        Ok((found.portals.iter().map(row).collect(), coverage, need_no_pilot(&found, coverage)))
    });
    found.map_err(of_render)
}

fn room(
    positions: &PyReadonlyArray2<'_, f32>,
    triangles: &PyReadonlyArray2<'_, u32>,
    (from, at, fov): ([f32; 3], [f32; 3], f32),
) -> PyResult<(Scene, Camera)> {
    let positions = rows(positions)?.iter().map(|&place| Vec3::from_array(place)).collect();
    let triangles = triangles.as_slice()?.as_chunks().0.to_vec();
    let opened = || {
        let mesh = Mesh::new(positions, Vec::new(), Vec::new(), triangles, 0)?;
        let scene = Scene::new("scene", vec![mesh], vec![Material::diffuse(Vec3A::splat(0.5))], None)?;
        Ok((scene, Camera::new(Vec3A::from_array(from), Vec3A::from_array(at), fov)?))
    };
    opened().map_err(of_render)
}

/// Returns the arrays of portals and of the map's tail, after a rotation by the rows `to_map`.
#[pyfunction]
pub fn portal_arrays<'py>(
    py: Python<'py>,
    portals: Vec<Row>,
    environment: &Environment,
    to_map: [[f32; 3]; 3],
) -> PyResult<Bound<'py, PyDict>> {
    let map = environment.0.clone();
    let motion = Affine3A::from_mat3(Mat3::from_cols_array_2d(&to_map).transpose());
    let arrays = py.detach(|| {
        let portals: Vec<_> = portals.iter().map(|own| portal(own).moved(&motion)).collect();
        flat_portals(&portals, &map)
    });
    dictionary(py, arrays.map_err(of_render)?)
}
