//! Moving scenes, dividing them by mesh names, and joining them.

use std::{collections::BTreeSet, sync::Arc};

use glam::{Affine3A, Vec3, Vec3A};

use super::{Camera, MAX_COORDINATE, Material, Mesh, Scene};
use crate::{
    brdf::{Brdf, BrdfTable},
    error::{Error, Result},
};

impl Scene {
    /// Returns the names of the meshes, sorted; unnamed meshes are skipped.
    pub fn mesh_names(&self) -> BTreeSet<&str> {
        self.meshes.iter().map(|mesh| mesh.name.as_str()).filter(|name| !name.is_empty()).collect()
    }

    /// Returns the moved surfaces, without the camera.
    ///
    /// # Errors
    /// When a corner moves beyond [`MAX_COORDINATE`].
    pub fn moved(&self, motion: &Affine3A) -> Result<Self> {
        let meshes: Vec<Mesh> = self.meshes.iter().map(|mesh| mesh.clone().transformed(motion)).collect();
        let is_far = |p: &Vec3| !p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all();
        if meshes.iter().flat_map(Mesh::world_positions).any(|p| is_far(&p)) {
            return Err(Error::argument("placement", format!("takes the scene beyond {MAX_COORDINATE:e} m")));
        }
        self.with_meshes(meshes, None)
    }

    /// Splits the scene into the meshes called `name` and all others.
    ///
    /// # Errors
    /// When no mesh has the name, or all have it; the error lists the names.
    pub fn divided(&self, name: &str) -> Result<(Self, Self)> {
        let (named, others): (Vec<Mesh>, Vec<Mesh>) = self.meshes.iter().cloned().partition(|mesh| mesh.name == name);
        if named.is_empty() || others.is_empty() {
            let names: Vec<&str> = self.mesh_names().into_iter().take(12).collect();
            let reason = match (named.is_empty(), names.is_empty()) {
                (true, true) => "there is none: the meshes have no names".to_owned(),
                (true, false) => format!("there is none; meshes are {}", names.join(", ")),
                (false, _) => "there is nothing else in the scene".to_owned(),
            };
            return Err(Error::argument(format!("mesh '{name}'"), reason));
        }
        Ok((self.with_meshes(named, None)?, self.with_meshes(others, self.camera)?))
    }

    /// Returns a scene of this scene's meshes followed by those of `other`.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn joined(&self, other: &Self) -> Result<Self> {
        let first = self.materials.len();
        let added = other.meshes.iter().map(|mesh| Mesh { material: mesh.material + first, ..mesh.clone() });
        let meshes = self.meshes.iter().cloned().chain(added).collect();
        let added = self.brdfs.added().count() as u32;
        let renamed = other.materials.iter().map(|material| match material {
            Material::Indexed(index) => Material::Indexed(index + added),
            Material::Neural(neural) => Material::Neural(neural.renumbered(added)),
            material => material.clone(),
        });
        let materials = self.materials.iter().cloned().chain(renamed).collect();
        let mut joined = Self::new(self.name.clone(), meshes, materials, self.camera)?;
        joined.brdfs = other.brdfs.added().fold(self.brdfs.clone(), |table, brdf| table.with(brdf.clone()).0);
        Ok(joined)
    }

    /// Creates a white diffuse square of `width` metres around `center` that faces `normal`.
    ///
    /// # Errors
    /// When `normal` has no direction or the square reaches beyond [`MAX_COORDINATE`].
    pub fn square(center: Vec3A, normal: Vec3A, width: f32) -> Result<Self> {
        let Some(n) = normal.try_normalize() else {
            return Err(Error::argument("plane", format!("{normal} is not a normal")));
        };
        let (a, b) = n.any_orthonormal_pair();
        // Counter-clockwise as seen from the side of the normal.
        let (a, b) = if a.cross(b).dot(n) > 0.0 { (a, b) } else { (b, a) };
        let corner = |x: f32, y: f32| Vec3::from(center + 0.5 * width * (x * a + y * b));
        let positions = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let mesh = Mesh::new(positions, vec![], vec![], vec![[0, 1, 2], [0, 2, 3]], 0)?;
        Self::new("plane", vec![mesh], vec![Material::diffuse(Vec3A::ONE)], None)
    }

    /// Returns the number of meshes.
    pub(crate) fn mesh_count(&self) -> usize {
        self.meshes.len()
    }

    /// Returns the same geometry with BRDFs without parameters, which the meshes take in turn.
    ///
    /// # Panics
    /// If `brdfs` is empty.
    #[must_use]
    pub fn with_brdfs(mut self, brdfs: Vec<Arc<dyn Brdf>>) -> Self {
        assert!(!brdfs.is_empty(), "a scene is made of something");
        self.brdfs = BrdfTable::default();
        let indices = brdfs.into_iter().map(|brdf| {
            let (table, index) = self.brdfs.with(brdf);
            self.brdfs = table;
            index
        });
        self.materials = indices.map(Material::Indexed).collect();
        let count = self.materials.len();
        self.meshes.iter_mut().enumerate().for_each(|(number, mesh)| mesh.material = number % count);
        self
    }

    /// Returns the notes of the scene's own BRDFs.
    pub fn brdf_notes(&self) -> impl Iterator<Item = String> + '_ {
        self.brdfs.added().filter_map(|brdf| brdf.note())
    }

    fn with_meshes(&self, meshes: Vec<Mesh>, camera: Option<Camera>) -> Result<Self> {
        let mut scene = Self::new(self.name.clone(), meshes, self.materials.clone(), camera)?;
        scene.brdfs = self.brdfs.clone();
        Ok(scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_found_by_their_names_and_joined_again() {
        let named = |name: &str, x: f32| {
            let at = Vec3A::new(x, 0.0, 0.0);
            let mut scene = Scene::square(at, Vec3A::Y, 1.0).unwrap();
            scene.meshes[0].name = name.into();
            scene
        };
        let both = named("table", 0.0).joined(&named("cup", 5.0)).unwrap();
        assert_eq!(both.mesh_names().into_iter().collect::<Vec<_>>(), ["cup", "table"]);
        let (table, rest) = both.divided("table").unwrap();
        assert!(table.bounds().max.x < 1.0 && rest.bounds().min.x > 4.0);
        assert!(both.divided("chair").err().unwrap().to_string().contains("cup, table"));
        assert!(table.divided("table").err().unwrap().to_string().contains("nothing else"));
    }

    #[test]
    fn a_square_faces_its_normal() {
        for normal in [Vec3A::Y, Vec3A::NEG_Y, Vec3A::new(0.3, -0.2, 0.9)] {
            let scene = Scene::square(Vec3A::new(1.0, 2.0, 3.0), normal, 4.0).unwrap();
            let n = normal.normalize();
            for number in 0..scene.triangle_count() {
                assert!(scene.face(number).wound.dot(n) > 1.0 - 1e-5);
            }
        }
        assert!(Scene::square(Vec3A::ZERO, Vec3A::ZERO, 1.0).is_err());
    }

    #[test]
    fn moves_beyond_the_largest_coordinate_are_rejected() {
        let scene = Scene::square(Vec3A::ZERO, Vec3A::Y, 1.0).unwrap();
        assert!(scene.moved(&Affine3A::from_translation(Vec3::new(3.0, 0.0, 0.0))).unwrap().bounds().min.x > 2.0);
        assert!(scene.moved(&Affine3A::from_scale(Vec3::splat(1e12))).is_err());
    }
}
