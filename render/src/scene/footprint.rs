//! The footprint of a pixel on a texture, and the view in its tangent frame.

use glam::{Vec2, Vec3, Vec3A};

use crate::brdf::neural_texture::Seen;

/// Returns how a triangle with coordinates `uv` is seen, where the shading normal is `n`, by a pixel that is
/// `pixel` metres wide at that distance; without the point's coordinates.
///
/// Coordinates that do not span the triangle give an arbitrary tangent and the finest detail. The footprint is
/// assumed to be round: its variance is that of a square pixel, enlarged by the obliquity (one over the cosine,
/// in area).
pub(super) fn seen(corners: [Vec3; 3], uv: [Vec2; 3], n: Vec3A, wo: Vec3A, pixel: f32) -> Seen {
    let (n, wo) = (Vec3::from(n), Vec3::from(wo));
    let [a, b] = [corners[1] - corners[0], corners[2] - corners[0]];
    let [s, t] = [uv[1] - uv[0], uv[2] - uv[0]];
    let area = s.perp_dot(t);
    // Cramer's rule without the determinant's magnitude: only its sign affects directions.
    let along = [area.signum() * (a * t.y - b * s.y), area.signum() * (b * s.x - a * t.x)];
    let per_metre = (area.abs() / a.cross(b).length()).sqrt();
    let width = pixel * per_metre / (12.0 * n.dot(wo).max(1e-2)).sqrt();
    Seen { width: if width.is_finite() { width } else { 0.0 }, ..Seen::new(n, wo, along) }
}
