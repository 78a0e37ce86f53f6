//! Ideal diffuse reflection.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3A};

use crate::{frame::Frame, simd};

/// Lambert's BRDF, `f_r = albedo / pi`.
#[derive(Clone, Copy, Debug)]
pub struct Lambert {
    /// Reflectance per channel, in `[0, 1]`.
    pub albedo: Vec3A,
}

impl Lambert {
    /// `albedo / pi max(0, n . wi)`.
    pub fn evaluate_cosine(&self, normal: Vec3A, _wo: Vec3A, wi: Vec3A) -> Vec3A {
        self.albedo * (FRAC_1_PI * normal.dot(wi).max(0.0))
    }

    /// A cosine-distributed direction and its solid-angle pdf.
    pub fn sample(&self, normal: Vec3A, _wo: Vec3A, u: Vec2) -> Option<(Vec3A, f32)> {
        let disk = concentric_disk(u);
        let cos = (1.0 - disk.length_squared()).max(0.0).sqrt();
        let wi = Frame::from_normal(normal).to_world(Vec3A::new(disk.x, disk.y, cos));
        let pdf = self.pdf(normal, wi, wi);
        (pdf > 0.0).then_some((wi, pdf))
    }

    /// `max(0, n . wi) / pi`.
    pub fn pdf(&self, normal: Vec3A, _wo: Vec3A, wi: Vec3A) -> f32 {
        FRAC_1_PI * normal.dot(wi).max(0.0)
    }
}

/// The area-preserving map from the unit square to the unit disk (Shirley and Chiu 1997).
fn concentric_disk(u: Vec2) -> Vec2 {
    let p = 2.0 * u - Vec2::ONE;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, turns) =
        if p.x.abs() > p.y.abs() { (p.x, 0.125 * (p.y / p.x)) } else { (p.y, 0.25 - 0.125 * (p.x / p.y)) };
    let (cos, sin) = simd::cos_sin_turns(turns);
    radius * Vec2::new(cos, sin)
}
