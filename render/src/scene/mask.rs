//! Alpha masks: rays pass a surface where its alpha is below a cutoff (glTF 2.0, section 3.9.4).
//!
//! Masked triangles have a hierarchy of their own. Rays are traced through the opaque hierarchy and
//! then through the masked one, again from behind each transparent point. A scene without masks has
//! no second hierarchy.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{Hit, Mesh, OFFSET, Ray, Scene, ray::RayKind, texture::AlphaTexture};

/// Maximum number of masked surfaces that one ray meets. The last one counts as opaque whatever its alpha:
/// this bounds the time per ray, and few rays pass 255 layers.
const MOST_LAYERS: usize = 256;

/// The alpha test of a material: points are opaque where alpha is at least the cutoff.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mask {
    /// The least opaque alpha, not negative; above 1, all points are transparent.
    pub cutoff: f32,
    /// Alpha in `[0, 1]`, which multiplies the alphas of texture and vertices.
    pub factor: f32,
    /// Alpha at the texture coordinates of the base colour; 1 where the mesh has none.
    pub texture: Option<Arc<AlphaTexture>>,
}

impl Mask {
    fn alpha(&self, texel: f32, vertex: f32) -> f32 {
        (self.factor * texel * vertex).min(1.0)
    }

    /// The least and the greatest alpha that points of a mesh may have.
    fn range(&self, mesh: &Mesh) -> [f32; 2] {
        let texels = self.texture.as_ref().filter(|_| !mesh.texcoords.is_empty());
        let texels = texels.map_or([1.0; 2], |texture| texture.range());
        let vertices = match mesh.alphas.as_slice() {
            [] => [1.0; 2],
            alphas => alphas.iter().fold([f32::INFINITY, 0.0], |[least, most], &a| [least.min(a), most.max(a)]),
        };
        [0, 1].map(|end| self.alpha(texels[end], vertices[end]))
    }
}

impl Mesh {
    /// Returns the mesh with a mask. A mask that passes no ray is dropped, and a mesh without opaque points
    /// loses its triangles.
    pub(super) fn with_mask(mut self, mask: Mask) -> Self {
        let [least, greatest] = mask.range(&self);
        if greatest < mask.cutoff {
            self.triangles.clear();
        }
        self.mask = (least < mask.cutoff && mask.cutoff <= greatest).then_some(mask);
        if self.mask.is_none() {
            self.alphas = Vec::new();
        }
        self
    }

    /// Whether a hit of the mesh's triangle `triangle` is opaque.
    fn is_opaque_at(&self, triangle: usize, hit: &Hit) -> bool {
        let Some(mask) = &self.mask else { return true };
        let vertices = self.triangles[triangle].map(|i| i as usize);
        let texel = match &mask.texture {
            Some(texture) if !self.texcoords.is_empty() => {
                let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
                texture.sample((0..3).map(|k| weights[k] * self.texcoords[vertices[k]]).sum::<Vec2>())
            }
            _ => 1.0,
        };
        let vertex = if self.alphas.is_empty() {
            1.0
        } else {
            // Exact between equal alphas, so that an alpha of 1 passes a cutoff of 1.
            let [a, b, c] = vertices.map(|i| self.alphas[i]);
            a + hit.u * (b - a) + hit.v * (c - a)
        };
        mask.alpha(texel, vertex) >= mask.cutoff
    }
}

/// The part of a ray where masked faces are still to be tested.
struct RaySegment {
    /// Index of the ray.
    ray: usize,
    /// End of the segment: distance from the ray's origin in metres.
    limit: f32,
    /// Start of the segment, likewise.
    start: f32,
    /// Distance in metres from the last transparent hit to `start`.
    step: f32,
}

impl RaySegment {
    fn new(ray: usize, limit: f32) -> Self {
        Self { ray, limit, start: 0.0, step: 0.0 }
    }

    /// The part of `ray` from the start on.
    fn of(&self, ray: &Ray) -> Ray {
        Ray { origin: ray.at(self.start), direction: ray.direction }
    }

    /// Moves the start behind a transparent hit at `t`; `reach` is the largest coordinate involved.
    ///
    /// Masked surfaces within [`OFFSET`] times `reach` of one another are passed together.
    fn pass(&mut self, t: f32, reach: f32) {
        // A grazing ray may hit the same surface again within rounding error; doubled steps leave it quickly.
        self.step = if t < self.start + self.step { 2.0 * self.step } else { OFFSET * reach };
        self.start = t + self.step;
    }
}

impl Scene {
    /// Replaces hits of opaque faces by nearer hits of masked ones; both slices have equal length.
    pub(super) fn add_masked_hits(&self, kind: RayKind, rays: &[Ray], hits: &mut [Option<Hit>]) {
        let limits = hits.iter().map(|hit| hit.map_or(f32::INFINITY, |hit| hit.t));
        let segments = limits.enumerate().map(|(ray, limit)| RaySegment::new(ray, limit)).collect();
        self.trace_masked(kind, rays, segments, |ray, hit| hits[ray] = Some(hit));
    }

    /// Marks the rays that masked faces occlude; both slices have equal length.
    pub(super) fn add_masked_occlusion(&self, rays: &[Ray], occluded: &mut [bool]) {
        let open = (0..rays.len()).filter(|&ray| !occluded[ray]);
        let segments = open.map(|ray| RaySegment::new(ray, f32::INFINITY)).collect();
        self.trace_masked(RayKind::Bounce, rays, segments, |ray, _| occluded[ray] = true);
    }

    /// Finds the first opaque hit of a masked face on each segment; calls `found` with the index of
    /// its ray and the hit.
    fn trace_masked(
        &self,
        kind: RayKind,
        rays: &[Ray],
        mut segments: Vec<RaySegment>,
        mut found: impl FnMut(usize, Hit),
    ) {
        let (mut shortened, mut hits) = (Vec::new(), Vec::new());
        for layer in 1..=MOST_LAYERS {
            shortened.clear();
            shortened.extend(segments.iter().map(|segment| segment.of(&rays[segment.ray])));
            hits.clear();
            hits.resize(segments.len(), None);
            self.masked.closest_batch(kind, &shortened, &mut hits);
            let mut nearest = hits.iter();
            segments.retain_mut(|segment| {
                let Some(hit) = nearest.next().copied().flatten() else { return false };
                let hit = Hit { triangle: self.opaque.count() + hit.triangle, t: segment.start + hit.t, ..hit };
                if hit.t >= segment.limit {
                    return false;
                }
                if layer == MOST_LAYERS || self.is_opaque_at(&hit) {
                    found(segment.ray, hit);
                    return false;
                }
                segment.pass(hit.t, self.reach(&rays[segment.ray], &hit));
                true
            });
            if segments.is_empty() {
                return;
            }
        }
    }

    fn is_opaque_at(&self, hit: &Hit) -> bool {
        let face = self.face(hit.triangle);
        face.mesh.is_opaque_at(face.triangle, hit)
    }

    /// The largest coordinate, in metres, of a ray's origin, its hit and the triangle hit.
    fn reach(&self, ray: &Ray, hit: &Hit) -> f32 {
        let corners = self.face(hit.triangle).corners().map(Vec3A::from);
        let points = corners.into_iter().chain([ray.origin, ray.at(hit.t)]);
        points.fold(Vec3A::ZERO, |reach, p| reach.max(p.abs())).max_element()
    }
}
