//! Scenes: triangle meshes, materials, cameras, and the rays that are traced against them.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | scenes, hits and shadow rays |
//! | `open.rs` | opening scenes by name or file |
//! | `built_in/`, `gltf/`, `fspy.rs` | built-in scenes; glTF 2.0; cameras of fSpy projects |
//! | `mesh.rs`, `ground.rs` | triangles; the ground plane |
//! | `parts.rs` | moving scenes, dividing them by mesh names and joining them |
//! | `material.rs`, `material_spec.rs` | materials of surfaces; `--material` |
//! | `neural.rs`, `footprint.rs` | neural materials in scenes; pixels on their textures |
//! | `texture.rs`, `normal_map.rs` | textures; shading normals from a texture |
//! | `camera.rs`, `ray.rs` | cameras; rays, hits and bounds |
//! | `faces.rs` | the triangles that rays can hit |
//! | `bvh.rs` | building the bounding volume hierarchy |
//! | `wide.rs`, `wide/` | the eight-wide hierarchy and its traversal |
//! | `copies.rs` | copies of meshes, by reference |
//! | `mask.rs` | alpha masks |
//! | `context.rs`, `hash.rs` | the scene as samplers see it; content hashes |
//! | `flat_face.rs` | triangles with their attributes, for other devices |

mod built_in;
mod bvh;
mod camera;
mod context;
mod copies;
mod faces;
mod flat_face;
mod footprint;
mod fspy;
mod gltf;
mod ground;
mod hash;
mod mask;
mod material;
mod material_spec;
mod mesh;
mod neural;
mod normal_map;
mod open;
mod parts;
mod ray;
mod texture;
mod wide;

pub use built_in::built_in_names;
pub use bvh::Bvh;
pub use camera::Camera;
pub use flat_face::{FlatFace, FlatMask};
pub use fspy::{FspyProject, UpAxis};
pub use gltf::LoadOptions;
pub use material::{AlphaField, Material, SurfacePoint, TexturedMetallicRoughness};
pub use material_spec::{AlphaRange, MaterialSpec};
pub use mesh::{MAX_COORDINATE, Mesh};
pub use neural::{NeuralMaterial, NeuralSpec};
pub use normal_map::{NormalMap, TangentSpace};
pub(crate) use ray::RayKind;
pub use ray::{Bounds, Hit, Ray};
pub use texture::{Filter, Texture, Wrap};

use glam::{Vec2, Vec3, Vec3A};

use self::faces::{Face, Faces};
use crate::{
    brdf::{BrdfTable, neural_texture::Seen, tabulate_lobe_albedo},
    error::{Error, Result},
    remark::Remark,
    tile::{ShadingPoint, Tile},
};

/// Offset of a point above its surface, relative to the largest coordinate involved.
///
/// A point of a triangle is off its plane by at most 7 rounding errors (6e-8) of the largest corner
/// coordinate (Pharr, Jakob and Humphreys, "Physically Based Rendering", section 6.8.5); intersecting a ray
/// from there with the same plane adds a few more. 16 of them leave a margin. The offset does not depend on
/// the scene's size, so that a ground plane can reach the horizon.
const OFFSET: f32 = 1e-6;

/// Smallest cosine between the shading normal and the view direction.
const MIN_COSINE: f32 = 1e-2;

/// Triangles with materials under a bounding volume hierarchy, seen by a camera.
pub struct Scene {
    name: String,
    meshes: Vec<Mesh>,
    materials: Vec<Material>,
    /// The BRDFs that surfaces refer to.
    brdfs: BrdfTable,
    camera: Option<Camera>,
    /// All cameras of the file with their names, or why they cannot be opened.
    cameras: Vec<(String, std::result::Result<Camera, String>)>,
    /// Features of the file that are ignored or converted.
    remarks: Vec<Remark>,
    opaque: Faces,
    /// The masked triangles, numbered after the opaque ones.
    masked: Faces,
    bounds: Bounds,
}

impl Scene {
    /// Creates a scene of meshes whose material indices point into `materials`. Triangles without area are
    /// left out.
    ///
    /// # Errors
    /// When a material index is out of range, or there are more than [`Bvh::MOST_TRIANGLES`] triangles.
    pub fn new(
        name: impl Into<String>,
        mut meshes: Vec<Mesh>,
        materials: Vec<Material>,
        camera: Option<Camera>,
    ) -> Result<Self> {
        if let Some(mesh) = meshes.iter().find(|mesh| mesh.material >= materials.len()) {
            let reason = format!("index {} is out of range: there are {}", mesh.material, materials.len());
            return Err(Error::argument("materials", reason));
        }
        for normal in meshes.iter_mut().flat_map(|mesh| &mut mesh.normals) {
            *normal = normal.normalize_or_zero();
        }
        let mut scene = Self {
            name: name.into(),
            meshes,
            materials,
            brdfs: BrdfTable::default(),
            camera,
            cameras: Vec::new(),
            remarks: Vec::new(),
            opaque: Faces::default(),
            masked: Faces::default(),
            bounds: Bounds::EMPTY,
        };
        let triangles: usize = scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
        if triangles > Bvh::MOST_TRIANGLES {
            let reason = format!("there are {triangles}, more than {}", Bvh::MOST_TRIANGLES);
            return Err(Error::argument("triangles", reason));
        }
        scene.rebuild();
        Ok(scene)
    }

    /// Returns a face by its number; opaque faces come first.
    fn face(&self, number: usize) -> Face<'_> {
        match number.checked_sub(self.opaque.count()) {
            None => self.opaque.face(&self.meshes, number),
            Some(number) => self.masked.face(&self.meshes, number),
        }
    }

    /// Rebuilds the hierarchies and the bounds from the meshes.
    fn rebuild(&mut self) {
        self.opaque = Faces::build(&self.meshes, false);
        self.masked = Faces::build(&self.meshes, true);
        let [opaque, masked] = [&self.opaque, &self.masked].map(|faces| faces.bounds(&self.meshes));
        self.bounds = opaque.union(&masked);
    }

    /// Returns the same geometry and alpha masks with a single material.
    #[must_use]
    pub fn with_material(mut self, material: Material) -> Self {
        self.materials.fill(material);
        self
    }

    /// Returns whether all surfaces reflect like Lambert's BRDF.
    pub fn is_diffuse(&self) -> bool {
        self.meshes.iter().all(|mesh| self.materials[mesh.material].is_diffuse())
    }

    /// Computes the tables that materials need, once per process, so that no first pixel waits for them.
    pub fn prepare_materials(&self) {
        let is_mixture = |mesh: &Mesh| matches!(self.materials[mesh.material], Material::MetallicRoughness(_));
        if self.meshes.iter().any(is_mixture) {
            tabulate_lobe_albedo();
        }
    }

    /// Returns the built-in name, or the file name without its extension.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the box around all triangles, in metres.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Returns the number of triangles that rays can hit, masked ones included.
    pub fn triangle_count(&self) -> usize {
        self.opaque.count() + self.masked.count()
    }

    /// Returns the corners (metres) of the triangles that rays can hit: opaque ones, then those with alpha
    /// masks.
    pub fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        (0..self.triangle_count()).map(|number| self.face(number).corners())
    }

    /// Returns remarks on features of the file that are ignored or converted.
    pub fn remarks(&self) -> &[Remark] {
        &self.remarks
    }

    /// Returns the names of the file's cameras, in order; empty for unnamed ones.
    pub fn camera_names(&self) -> impl Iterator<Item = &str> {
        self.cameras.iter().map(|(name, _)| name.as_str())
    }

    /// Selects the file's camera of that name, or of that number in the file's order.
    ///
    /// # Errors
    /// [`Error::Argument`] that lists the names if there is no such camera, or says why it cannot be opened.
    pub fn use_camera(&mut self, name: &str) -> Result<()> {
        let numbered = || self.cameras.get(name.parse::<usize>().ok()?);
        let found = self.cameras.iter().find(|(own, _)| own == name).or_else(numbered);
        let Some((_, camera)) = found else {
            let names: Vec<String> =
                self.camera_names().take(12).map(|name| format!("'{}'", name.escape_debug())).collect();
            let there =
                if names.is_empty() { "the scene has none".into() } else { format!("there are {}", names.join(", ")) };
            return Err(Error::argument(format!("camera '{name}'"), there));
        };
        let broken = |reason: &String| Error::argument(format!("camera '{name}'"), reason);
        self.camera = Some(*camera.as_ref().map_err(broken)?);
        Ok(())
    }

    /// Returns the scene's camera, or one that frames it for a 4:3 image.
    pub fn camera(&self) -> Camera {
        self.camera_for(4.0 / 3.0)
    }

    /// Returns the scene's camera, or one that frames it for an image of aspect ratio `aspect`.
    pub fn camera_for(&self, aspect: f32) -> Camera {
        let faces = || (0..self.triangle_count()).map(|number| self.face(number));
        let framed = || faces().filter(|face| !face.mesh.is_ground).flat_map(|face| face.corners()).map(Vec3A::from);
        self.camera.unwrap_or_else(|| Camera::framing(framed, aspect))
    }

    /// Returns the nearest surface along a ray of a camera, as seen from the ray's origin: both normals are on
    /// the viewer's side. Back faces of single-sided materials of glTF are invisible.
    pub fn intersect(&self, ray: &Ray) -> Option<ShadingPoint> {
        self.intersect_one(RayKind::Camera, ray)
    }

    /// [`Self::intersect`] for a ray of a kind.
    pub(crate) fn intersect_one(&self, kind: RayKind, ray: &Ray) -> Option<ShadingPoint> {
        let mut hits = [None];
        self.closest_batch(kind, std::slice::from_ref(ray), &mut hits);
        Some(self.surface(ray, &hits[0]?, 0.0))
    }

    /// Intersects many rays of a camera: fills a tile with the surfaces hit and appends to `indices` the rays
    /// that hit something, in order. `key` returns the key of a ray's shading point; `spread` is the angle in
    /// radians between the rays of neighbouring pixels.
    pub fn intersect_batch(
        &self,
        rays: &[Ray],
        spread: f32,
        key: impl Fn(usize) -> u32,
        tile: &mut Tile,
        indices: &mut Vec<usize>,
    ) {
        self.intersect_and_emit((RayKind::Camera, rays), spread, key, tile, indices, None);
    }

    /// [`Self::intersect_batch`] for rays of a kind that also appends the radiance emitted by each surface to
    /// `emission`, if given.
    pub(crate) fn intersect_and_emit(
        &self,
        (kind, rays): (RayKind, &[Ray]),
        spread: f32,
        key: impl Fn(usize) -> u32,
        tile: &mut Tile,
        indices: &mut Vec<usize>,
        mut emission: Option<&mut Vec<Vec3A>>,
    ) {
        /// Hits on the stack at a time.
        const CHUNK: usize = 256;
        tile.clear(&self.brdfs);
        for (chunk, rays) in rays.chunks(CHUNK).enumerate() {
            let mut hits = [None; CHUNK];
            let hits = &mut hits[..rays.len()];
            self.closest_batch(kind, rays, hits);
            if let Some(emission) = &mut emission {
                emission.extend(hits.iter().flatten().map(|hit| self.emission(hit)));
            }
            for (k, (ray, hit)) in rays.iter().zip(hits).enumerate() {
                if let Some(hit) = hit {
                    let index = chunk * CHUNK + k;
                    indices.push(index);
                    tile.push(&self.surface(ray, hit, spread), key(index));
                }
            }
        }
    }

    /// Returns whether any material emits light.
    pub fn is_emissive(&self) -> bool {
        self.materials.iter().any(Material::is_emissive)
    }

    /// Returns the radiance emitted at a hit.
    fn emission(&self, hit: &Hit) -> Vec3A {
        let face = self.face(hit.triangle);
        let (mesh, vertices) = (face.mesh, face.vertices());
        let texcoords = mesh.emission_texcoords.as_ref().unwrap_or(&mesh.texcoords);
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
        let emission_uv = (!texcoords.is_empty()).then(|| (0..3).map(|k| weights[k] * texcoords[vertices[k]]).sum());
        self.materials[mesh.material].emission(&SurfacePoint { emission_uv, ..SurfacePoint::default() })
    }

    /// Finds the nearest hits of many rays; both slices have equal length.
    pub(crate) fn closest_batch(&self, kind: RayKind, rays: &[Ray], hits: &mut [Option<Hit>]) {
        self.opaque.closest_batch(kind, rays, hits);
        if self.masked.count() > 0 {
            self.add_masked_hits(kind, rays, hits);
        }
    }

    /// Returns the BRDFs that surfaces refer to.
    pub fn brdfs(&self) -> &BrdfTable {
        &self.brdfs
    }

    /// Returns the index of the mesh that was hit.
    pub(crate) fn mesh_of(&self, hit: &Hit) -> usize {
        self.face(hit.triangle).number
    }

    /// Returns the surface that a ray hits; rays of neighbouring pixels are `spread` radians apart.
    pub(crate) fn surface(&self, ray: &Ray, hit: &Hit, spread: f32) -> ShadingPoint {
        let face = self.face(hit.triangle);
        let (mesh, vertices) = (face.mesh, face.vertices());
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];

        let wo = -ray.direction;
        let wound = face.wound;
        let ng = if wound.dot(wo) < 0.0 { -wound } else { wound };
        // From the corners, not along the ray, so that the error does not grow with the distance. It scales
        // with the corners' coordinates even where the point itself is near the origin.
        let corners = face.corners();
        let [a, b, c] = corners.map(Vec3A::from);
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        // Corners of copies, and rays transformed to them, have twice the error.
        let offset = if face.is_copied() { 2.0 * OFFSET } else { OFFSET };
        let p = weights[0] * a + weights[1] * b + weights[2] * c + (offset * reach) * ng;
        let interpolated = face.smooth_normal(weights);
        let uv = |texcoords: &[Vec2]| {
            (!texcoords.is_empty()).then(|| (0..3).map(|k| weights[k] * texcoords[vertices[k]]).sum::<Vec2>())
        };
        let color_uv = uv(&mesh.texcoords);
        let roughness_uv = mesh.roughness_texcoords.as_ref().map_or(color_uv, |own| uv(own));
        let material = &self.materials[mesh.material];
        let smooth = interpolated.unwrap_or(ng);
        let bent = match (material.normal_map(), &mesh.tangent_space, interpolated.unwrap_or(wound).try_normalize()) {
            (Some(map), Some(space), Some(outside)) => {
                let uv = vertices.map(|i| space.texcoords[i]);
                let tangent = face.tangent(space, uv, weights, outside);
                let bent = map.bend(outside, tangent, (0..3).map(|k| weights[k] * uv[k]).sum());
                // The map is defined on the outside; seen from inside, the whole normal is flipped.
                let bent = if outside.dot(ng) < 0.0 { -bent } else { bent };
                if bent.dot(ng) > 0.0 { bent } else { smooth }
            }
            _ => smooth,
        };
        let ns = shading_normal(bent, ng, wo);
        let view = match material {
            Material::Neural(_) if color_uv.is_some() => {
                let uv = vertices.map(|i| mesh.texcoords[i]);
                footprint::seen(corners, uv, ns, wo, spread * hit.t)
            }
            _ => Seen::default(),
        };
        let vertex_color =
            (!mesh.colors.is_empty()).then(|| (0..3).map(|k| weights[k] * Vec3A::from(mesh.colors[vertices[k]])).sum());
        let surface = material.surface(&SurfacePoint {
            p,
            color_uv,
            roughness_uv,
            vertex_color,
            view,
            ..SurfacePoint::default()
        });
        ShadingPoint { p, ng, ns, wo, surface }
    }

    /// Returns the ray that leaves a surface at `p` (metres) of geometric normal `ng` towards `wi`, which is
    /// above it.
    ///
    /// Shading points already lie above their surface by more than their own error; the offset added here is
    /// for the error of a `p` that was moved since.
    #[inline]
    pub fn leaving(&self, p: Vec3A, ng: Vec3A, wi: Vec3A) -> Ray {
        Ray::new(p + (OFFSET * p.abs().max_element()) * ng, wi)
    }

    /// Tests whether rays reach the environment; both slices have equal length.
    pub fn visible_batch(&self, rays: &[Ray], out: &mut [bool]) {
        self.opaque.occluded_batch(rays, out);
        if self.masked.count() > 0 {
            self.add_masked_occlusion(rays, out);
        }
        out.iter_mut().for_each(|out| *out = !*out);
    }
}

/// Returns the interpolated normal on the viewer's side, bent towards the viewer where it still faces away,
/// or `ng` where it is degenerate.
fn shading_normal(interpolated: Vec3A, ng: Vec3A, wo: Vec3A) -> Vec3A {
    let Some(ns) = interpolated.try_normalize() else { return ng };
    let ns = if ns.dot(ng) < 0.0 { -ns } else { ns };
    let cosine = ns.dot(wo);
    if cosine >= MIN_COSINE {
        return ns;
    }
    // Near silhouettes: bent just far enough to face the viewer.
    match (ns + (MIN_COSINE - cosine) * wo).try_normalize() {
        Some(bent) if bent.dot(wo) > 0.0 && bent.dot(ng) > 0.0 => bent,
        _ => ng,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    #[test]
    fn shading_normals_are_unit_and_face_the_viewer() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for _ in 0..20_000 {
            let (ng, wo, interpolated) = (random.direction(), random.direction(), random.direction());
            let ng = if ng.dot(wo) < 0.0 { -ng } else { ng };
            let ns = shading_normal(random.uniform() * interpolated, ng, wo);
            assert!(ns.is_normalized() && ns.dot(wo) > 0.0 && ns.dot(ng) > 0.0, "{interpolated} {ng} {wo} -> {ns}");
        }
        assert_eq!(shading_normal(Vec3A::ZERO, Vec3A::Y, Vec3A::Y), Vec3A::Y);
    }

    #[test]
    fn agreeing_normals_are_kept() {
        let ns = Vec3A::new(0.1, 1.0, -0.2).normalize();
        assert_eq!(shading_normal(2.0 * ns, Vec3A::Y, Vec3A::Y), ns);
        assert_eq!(shading_normal(-ns, Vec3A::Y, Vec3A::Y), ns);
    }
}
