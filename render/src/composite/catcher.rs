//! The geometry in a photograph: the object, the catcher of its shadow, and the catcher's appearance.

use std::f32::consts::PI;

use glam::{Vec2, Vec3A};

use super::irradiance::Irradiance;
use crate::{
    environment::Environment,
    error::Result,
    image::Photograph,
    latlong,
    scene::{Camera, Hit, Scene},
    tile::ShadingPoint,
};

/// Width of a catcher plane relative to the larger of the object's extent and the camera's distance.
const PLANE_WIDTH: f32 = 60.0;

/// Rows of the irradiance table of a mesh catcher. Normals are 1.4 degrees apart, for which linear
/// interpolation has an error of 7.5e-5 of the largest cosine.
const TABLE_ROWS: usize = 129;
/// Largest radius, in radians, of the map's blocks that the table does not refine, see
/// [`Irradiance::to_within`].
const COARSE: f64 = 0.01;

/// The diffuse surface in the photograph that catches the shadow.
pub struct Catcher {
    scene: Scene,
    /// Normal, if the catcher is a plane.
    plane: Option<Vec3A>,
}

impl Catcher {
    /// Creates a plane through `at`, large enough for the shadow of `object` as seen from `camera`.
    ///
    /// # Errors
    /// If `normal` has no direction.
    pub fn plane(at: Vec3A, normal: Vec3A, object: &Scene, camera: &Camera) -> Result<Self> {
        let bounds = object.bounds();
        let reach = bounds.extent().max_element().max((camera.look_from() - at).length()).max(1e-3);
        let scene = Scene::square(at, normal, PLANE_WIDTH * reach)?;
        Ok(Self { scene, plane: normal.try_normalize() })
    }

    /// Creates a catcher from any surface. Its self-shadowing is already in the photograph.
    pub fn mesh(scene: Scene) -> Self {
        Self { scene, plane: None }
    }
}

/// The object with its catcher.
pub struct Stage {
    /// The object alone, which casts the shadow.
    pub(super) object: Scene,
    /// The catcher alone.
    pub(super) catcher: Scene,
    /// Both, for camera rays and paths.
    pub(super) all: Scene,
    first_catcher: usize,
    plane: Option<Vec3A>,
}

impl Stage {
    /// Joins an object and a catcher.
    ///
    /// # Errors
    /// If there are too many triangles.
    pub fn new(object: Scene, catcher: Catcher) -> Result<Self> {
        let all = object.joined(&catcher.scene)?;
        let first_catcher = object.mesh_count();
        Ok(Self { object, catcher: catcher.scene, all, first_catcher, plane: catcher.plane })
    }

    /// Returns whether the catcher is a plane, whose unshadowed irradiance is exact.
    pub fn is_plane(&self) -> bool {
        self.plane.is_some()
    }

    /// Returns the object.
    pub fn object(&self) -> &Scene {
        &self.object
    }

    /// Returns whether a hit of [`Self::all`] is on the catcher.
    pub(super) fn is_catcher(&self, hit: &Hit) -> bool {
        self.all.mesh_of(hit) >= self.first_catcher
    }

    /// Returns whether a point of the catcher is on the side that catches shadows.
    pub(super) fn faces(&self, point: &ShadingPoint) -> bool {
        self.plane.is_none_or(|normal| normal.dot(point.ng) > 0.0)
    }
}

/// The photograph as a texture of the catcher, and the unshadowed irradiance of the map there.
pub struct Backdrop<'a> {
    environment: &'a Environment,
    photograph: &'a Photograph,
    camera: Camera,
    /// Factor from the photograph's values to the map's units, per channel.
    gain: Vec3A,
    irradiance: Table,
}

enum Table {
    Plane(Vec3A),
    /// Values for the normals of a lat-long grid, `[rows * columns]`.
    Normals {
        columns: usize,
        values: Vec<Vec3A>,
    },
}

impl<'a> Backdrop<'a> {
    /// Creates the backdrop from a photograph and its camera. Values times `gain` (positive, per channel) are
    /// radiance in the units of the map.
    pub fn new(
        stage: &Stage,
        environment: &'a Environment,
        photograph: &'a Photograph,
        camera: Camera,
        gain: Vec3A,
    ) -> Self {
        let exact = Irradiance::new(environment);
        let irradiance = match stage.plane {
            Some(normal) => Table::Plane(exact.at(normal)),
            None => Table::of_normals(&exact),
        };
        Self { environment, photograph, camera, gain, irradiance }
    }

    /// Returns the unshadowed irradiance per channel of a surface with the unit normal `n`, in W/m^2.
    pub fn irradiance(&self, n: Vec3A) -> Vec3A {
        self.irradiance.at(n)
    }

    /// Returns one over [`Self::irradiance`]; 0 for channels without light.
    pub(super) fn inverse_irradiance(&self, n: Vec3A) -> Vec3A {
        let irradiance = self.irradiance.at(n);
        Vec3A::select(irradiance.cmpgt(Vec3A::splat(f32::MIN_POSITIVE)), irradiance.recip(), Vec3A::ZERO)
    }

    /// Converts light of the map to the units of the photograph.
    pub(super) fn seen(&self, light: Vec3A) -> Vec3A {
        light / self.gain
    }

    /// Returns the radiance of the catcher at `p` without the object, in the map's units: from the photograph
    /// where it shows `p`, elsewhere from the map in the direction from the camera.
    pub fn radiance(&self, p: Vec3A) -> Vec3A {
        let (width, height) = (self.photograph.image.width, self.photograph.image.height);
        let seen = self.camera.project(p, width, height).and_then(|at| self.photograph.sample(at));
        match (seen, (p - self.camera.look_from()).try_normalize()) {
            (Some(seen), _) => self.gain * seen,
            (None, Some(direction)) => self.environment.radiance(direction),
            (None, None) => Vec3A::ZERO,
        }
    }

    /// Returns the diffuse reflectance that makes the catcher radiate [`Self::radiance`] under the map. It
    /// exceeds 1 where the photograph is brighter than the map can light a surface.
    pub fn albedo(&self, p: Vec3A, n: Vec3A) -> Vec3A {
        PI * self.radiance(p) * self.inverse_irradiance(n)
    }
}

impl Table {
    fn of_normals(exact: &Irradiance<'_>) -> Self {
        use rayon::prelude::*;
        let columns = 2 * (TABLE_ROWS - 1);
        let normal = |k: usize| {
            let at = Vec2::new((k % columns) as f32 / columns as f32, (k / columns) as f32 / (TABLE_ROWS - 1) as f32);
            latlong::direction(at)
        };
        let values =
            (0..columns * TABLE_ROWS).into_par_iter().map(|k| exact.to_within(normal(k).normalize(), COARSE)).collect();
        Self::Normals { columns, values }
    }

    fn at(&self, n: Vec3A) -> Vec3A {
        let (columns, values) = match self {
            Self::Plane(value) => return *value,
            Self::Normals { columns, values } => (*columns, values),
        };
        let x = latlong::square(n);
        let (across, down) = (x.x * columns as f32, x.y * (TABLE_ROWS - 1) as f32);
        let (left, top) = (across as usize % columns, (down as usize).min(TABLE_ROWS - 2));
        let right = (left + 1) % columns;
        let row = |j: usize| values[j * columns + left].lerp(values[j * columns + right], across.fract());
        row(top).lerp(row(top + 1), down - top as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        environment::built_in,
        random::{Purpose, Stream},
    };

    #[test]
    fn the_table_is_close_to_the_integral() {
        let mut random = Stream::new(3, Purpose::Test, 1);
        for name in ["studio", "sunset"] {
            let map = built_in(name).unwrap();
            let exact = Irradiance::new(&map);
            let table = Table::of_normals(&exact);
            let largest = (0..40).map(|_| exact.at(random.direction()).max_element()).fold(0.0, f32::max);
            for _ in 0..40 {
                let n = random.direction();
                let error = (table.at(n) - exact.at(n)).abs().max_element();
                // 7.5e-5 along each of u and v, and a quarter of a step, 0.006, times the slope where a lamp
                // crosses the horizon.
                assert!(error < 1e-3 * largest, "{name} {n}: {error} of {largest}");
            }
        }
    }
}
