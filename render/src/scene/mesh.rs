//! Triangle meshes of one material.

use glam::{Affine3A, Mat3, Vec2, Vec3, Vec4};

use super::{mask::Mask, normal_map::TangentSpace};
use crate::error::{Error, Result};

/// Largest coordinate, in metres: up to it, areas and squared lengths stay finite in f32.
pub const MAX_COORDINATE: f32 = 1e9;

/// Triangles of one material, in world space or as copies in several places.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// `[vertices]` positions in metres.
    pub(super) positions: Vec<Vec3>,
    /// `[vertices]` shading normals, of any length (in a scene: of unit length, or 0); empty for flat shading.
    pub(super) normals: Vec<Vec3>,
    /// `[vertices]` texture coordinates, v downwards; empty where there are none.
    pub(super) texcoords: Vec<Vec2>,
    /// `[vertices]` texture coordinates of metalness and roughness, if not those of the base colour.
    pub(super) roughness_texcoords: Option<Vec<Vec2>>,
    /// `[vertices]` texture coordinates of emitted light, if not those of the base colour.
    pub(super) emission_texcoords: Option<Vec<Vec2>>,
    /// `[vertices]` linear Rec.709 colours that multiply the material's base colour; empty where there are none.
    pub(super) colors: Vec<Vec3>,
    /// `[vertices]` alphas that multiply the mask's; empty if there are none.
    pub(super) alphas: Vec<f32>,
    /// The alpha test, if the mesh has both opaque and transparent points.
    pub(super) mask: Option<Mask>,
    /// Whether cameras do not see its back faces, from which the corners of triangles are clockwise.
    pub(super) is_single_sided: bool,
    /// Whether it is the plane of [`Scene::add_ground`](super::Scene::add_ground), which cameras do not frame.
    pub(super) is_ground: bool,
    /// Coordinates and tangents for the material's normal map, if it has one.
    pub(super) tangent_space: Option<TangentSpace>,
    /// `[triangles]` vertex indices, counter-clockwise as seen from outside.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Index into the scene's materials.
    pub(super) material: usize,
    /// Invertible transforms of its copies to world space. If empty, the mesh is in world space.
    pub(super) places: Vec<Affine3A>,
    /// Name in the file; empty if it has none.
    pub(super) name: String,
}

impl Mesh {
    /// Creates a mesh of `[vertices]` positions (metres), shading normals and texture coordinates (each may
    /// be empty), and `[triangles]` indices into them.
    ///
    /// # Errors
    /// When an index is out of range, an array has a wrong length, or a number is not finite (or beyond
    /// [`MAX_COORDINATE`]); the error's `what` is the attribute.
    pub fn new(
        positions: Vec<Vec3>,
        normals: Vec<Vec3>,
        texcoords: Vec<Vec2>,
        triangles: Vec<[u32; 3]>,
        material: usize,
    ) -> Result<Self> {
        let vertices = positions.len();
        if !normals.is_empty() && normals.len() != vertices {
            return Err(Error::argument("normals", format!("there are {}, but {vertices} positions", normals.len())));
        }
        if let Some(i) = positions.iter().position(|p| !p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all()) {
            let reason =
                format!("vertex {i} is at {}, which is not finite or beyond {MAX_COORDINATE:e} m", positions[i]);
            return Err(Error::argument("positions", reason));
        }
        if let Some(i) = normals.iter().position(|n| !n.is_finite()) {
            return Err(Error::argument("normals", format!("vertex {i} has {}, which is not finite", normals[i])));
        }
        check_texcoords(&texcoords, vertices)?;
        if let Some(&index) = triangles.iter().flatten().find(|&&index| index as usize >= vertices) {
            return Err(Error::argument(
                "indices",
                format!("index {index} is out of range: there are {vertices} vertices"),
            ));
        }
        Ok(Self { positions, normals, texcoords, triangles, material, ..Self::default() })
    }

    /// Returns the mesh with texture coordinates `[vertices]` (or none) for metalness and roughness that are
    /// not those of the base colour.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_roughness_texcoords(mut self, texcoords: Vec<Vec2>) -> Result<Self> {
        check_texcoords(&texcoords, self.positions.len())?;
        self.roughness_texcoords = Some(texcoords);
        Ok(self)
    }

    /// Returns the mesh with texture coordinates `[vertices]` (or none) for emitted light that are not those
    /// of the base colour.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_emission_texcoords(mut self, texcoords: Vec<Vec2>) -> Result<Self> {
        check_texcoords(&texcoords, self.positions.len())?;
        self.emission_texcoords = Some(texcoords);
        Ok(self)
    }

    /// Returns the mesh with coordinates and tangents (or none) for a normal map.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_tangent_space(mut self, space: TangentSpace) -> Result<Self> {
        check_texcoords(&space.texcoords, self.positions.len())?;
        let (tangents, vertices) = (&space.tangents, self.positions.len());
        if !tangents.is_empty() && tangents.len() != vertices {
            return Err(Error::argument("tangents", format!("there are {}, but {vertices} positions", tangents.len())));
        }
        if let Some(i) = tangents.iter().position(|t| !t.is_finite()) {
            return Err(Error::argument("tangents", format!("vertex {i} has {}, which is not finite", tangents[i])));
        }
        self.tangent_space = (!space.texcoords.is_empty()).then_some(space);
        Ok(self)
    }

    /// Returns the mesh with linear Rec.709 colours `[vertices]` (or none) that multiply the base colour.
    ///
    /// # Errors
    /// When there is not one per position, or one is negative or not finite.
    pub fn with_colors(mut self, colors: Vec<Vec3>) -> Result<Self> {
        let vertices = self.positions.len();
        if !colors.is_empty() && colors.len() != vertices {
            return Err(Error::argument("colours", format!("there are {}, but {vertices} positions", colors.len())));
        }
        if let Some(i) = colors.iter().position(|color| !(color.is_finite() && color.min_element() >= 0.0)) {
            return Err(Error::argument("colours", format!("vertex {i} has {}", colors[i])));
        }
        self.colors = colors;
        Ok(self)
    }

    /// Returns the mesh with alphas `[vertices]` (or none) that multiply the alpha of its mask.
    ///
    /// # Errors
    /// When there is not one per position, or one is negative or not finite.
    pub(super) fn with_alphas(mut self, alphas: Vec<f32>) -> Result<Self> {
        let vertices = self.positions.len();
        if !alphas.is_empty() && alphas.len() != vertices {
            return Err(Error::argument("alphas", format!("there are {}, but {vertices} positions", alphas.len())));
        }
        if let Some(i) = alphas.iter().position(|alpha| !(alpha.is_finite() && *alpha >= 0.0)) {
            return Err(Error::argument("alphas", format!("vertex {i} has {}", alphas[i])));
        }
        self.alphas = alphas;
        Ok(self)
    }

    /// Returns the three corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.positions[i as usize])
    }

    /// Returns whether a triangle has no area, so that rays cannot hit it and it has no normal.
    pub fn is_degenerate(&self, triangle: usize) -> bool {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a).try_normalize().is_none()
    }

    /// Returns the mesh moved by `transform`: normals by the inverse transpose, windings reversed if it
    /// mirrors.
    pub fn transformed(mut self, transform: &Affine3A) -> Self {
        if !self.places.is_empty() {
            self.places.iter_mut().for_each(|place| *place = *transform * *place);
            return self;
        }
        let normals = normal_matrix(transform);
        for p in &mut self.positions {
            *p = transform.transform_point3(*p);
        }
        for n in &mut self.normals {
            *n = normals * *n;
        }
        // In 64 bits, the product of three small scales does not vanish.
        let mirrors = transform.matrix3.as_dmat3().determinant() < 0.0;
        for t in self.tangent_space.iter_mut().flat_map(|space| &mut space.tangents) {
            *t = moved_tangent(*t, transform);
        }
        if mirrors {
            self.turn_over();
        }
        self
    }

    /// Reverses the windings of all triangles.
    pub(super) fn turn_over(&mut self) {
        self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }

    /// Returns the vertex positions of all copies in world space.
    pub(super) fn world_positions(&self) -> impl Iterator<Item = Vec3> + '_ {
        let places = if self.places.is_empty() { &[Affine3A::IDENTITY] } else { self.places.as_slice() };
        places.iter().flat_map(|place| self.positions.iter().map(|&p| place.transform_point3(p)))
    }

    /// Adds the triangles of `other`, which has the same attributes and no colours, mask, normal map or
    /// emission.
    pub(super) fn append(&mut self, other: &Self) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.texcoords.extend(&other.texcoords);
        if let (Some(own), Some(other)) = (&mut self.roughness_texcoords, &other.roughness_texcoords) {
            own.extend(other);
        }
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| first + i)));
    }
}

fn check_texcoords(texcoords: &[Vec2], vertices: usize) -> Result<()> {
    let wrong = |reason| Err(Error::argument("texture coordinates", reason));
    if !texcoords.is_empty() && texcoords.len() != vertices {
        return wrong(format!("there are {}, but {vertices} positions", texcoords.len()));
    }
    match texcoords.iter().position(|t| !t.is_finite()) {
        Some(i) => wrong(format!("vertex {i} has {}, which is not finite", texcoords[i])),
        None => Ok(()),
    }
}

/// Returns the matrix that moves normals as `transform` moves points, up to a positive factor: the cofactor
/// matrix, which is the inverse transpose times the determinant and exists for singular transforms too, with
/// the determinant's sign removed.
///
/// The matrix is scaled to unit size first, so that its products neither overflow nor vanish.
pub(super) fn normal_matrix(transform: &Affine3A) -> Mat3 {
    let m = Mat3::from(transform.matrix3);
    let scale = m.to_cols_array().into_iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
    let m = if scale > 0.0 { m * (1.0 / scale) } else { m };
    let cofactor = Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { cofactor * -1.0 } else { cofactor }
}

/// Returns a tangent moved by `transform`; its handedness flips if that mirrors.
pub(super) fn moved_tangent(tangent: Vec4, transform: &Affine3A) -> Vec4 {
    let along = transform.transform_vector3(tangent.truncate()).normalize_or_zero();
    along.extend(if transform.matrix3.determinant() < 0.0 { -tangent.w } else { tangent.w })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sloped_triangle() -> Mesh {
        let positions = vec![Vec3::ZERO, Vec3::new(1.0, 0.2, 0.0), Vec3::new(0.1, 0.7, 1.0)];
        let normal = (positions[1]).cross(positions[2]).normalize();
        Mesh::new(positions, vec![normal; 3], vec![], vec![[0, 1, 2]], 0).unwrap()
    }

    #[test]
    fn normals_stay_perpendicular_and_on_the_wound_side_under_any_transform() {
        let turn = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -0.7);
        for scale in [[1.0, 1.0, 1.0], [3.0, 0.2, 1.0], [-1.0, 1.0, 1.0], [-2.0, -0.5, -3.0], [1e-6, 2e-6, 1e-6]] {
            let scale = Vec3::from(scale);
            let place = scale.abs().max_element() * Vec3::new(5.0, -2.0, 1.0);
            let transform = Affine3A::from_scale_rotation_translation(scale, turn, place);
            let moved = sloped_triangle().transformed(&transform);
            let [a, b, c] = moved.corners(0);
            let wound = (b - a).cross(c - a).normalize();
            let shading = moved.normals[0].normalize();
            // Both are products of a few f32 operations on matrices of condition up to 15.
            assert!(wound.dot(shading) > 1.0 - 1e-4, "{scale:?}: {wound} against {shading}");
        }
    }

    #[test]
    fn wrong_attributes_are_refused_by_name() {
        let p = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let fails = |mesh: Result<Mesh>, word: &str| {
            let message = mesh.unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        };
        fails(Mesh::new(p.clone(), vec![], vec![], vec![[0, 1, 3]], 0), "index 3 is out of range");
        fails(Mesh::new(p.clone(), vec![Vec3::X], vec![], vec![], 0), "normals");
        fails(Mesh::new(vec![Vec3::NAN; 3], vec![], vec![], vec![], 0), "vertex 0");
        fails(Mesh::new(vec![Vec3::new(0.0, f32::NAN, 0.0); 3], vec![], vec![], vec![], 0), "vertex 0");
        fails(Mesh::new(vec![Vec3::splat(2e9); 3], vec![], vec![], vec![], 0), "vertex 0");
        fails(Mesh::new(p.clone(), vec![Vec3::INFINITY; 3], vec![], vec![], 0), "normals");
        fails(Mesh::new(p, vec![], vec![Vec2::NAN; 3], vec![], 0), "texture coordinates");
    }
}
