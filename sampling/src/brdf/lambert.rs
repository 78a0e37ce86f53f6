//! Ideal diffuse reflection.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::{Kernel, Lobes, parameters::MAX_PARAMETERS};
use crate::{frame::Frame, simd};

/// Lambert's BRDF, `f_r = albedo / pi`. Parameters: the albedo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lambert {
    /// Reflectance per channel, in `[0, 1]`.
    pub albedo: Vec3,
}

impl Kernel for Lambert {
    const PARAMETERS: usize = 3;

    #[inline(always)]
    fn of_parameters(parameters: &[f32; MAX_PARAMETERS]) -> Self {
        Self { albedo: Vec3::new(parameters[0], parameters[1], parameters[2]) }
    }

    fn parameters(&self) -> [f32; MAX_PARAMETERS] {
        let mut parameters = [0.0; MAX_PARAMETERS];
        parameters[..3].copy_from_slice(&self.albedo.to_array());
        parameters
    }

    #[inline(always)]
    fn evaluate_cosine(&self, n: Vec3, _wo: Vec3, wi: Vec3) -> Vec3 {
        let cosine = n.dot(wi);
        let cosine = if cosine > 0.0 { cosine } else { 0.0 };
        self.albedo * (FRAC_1_PI * cosine)
    }

    #[inline(always)]
    fn sample(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        let disk = concentric_disk(u);
        let squared = 1.0 - (disk.x * disk.x + disk.y * disk.y);
        let cos = if squared > 0.0 { squared } else { 0.0 }.sqrt();
        let wi = Frame::from_normal(n).to_world(Vec3::new(disk.x, disk.y, cos));
        (wi, self.pdf(n, wo, wi))
    }

    /// `max(0, n . wi) / pi`.
    #[inline(always)]
    fn pdf(&self, n: Vec3, _wo: Vec3, wi: Vec3) -> f32 {
        let cosine = n.dot(wi);
        FRAC_1_PI * if cosine > 0.0 { cosine } else { 0.0 }
    }

    fn alpha(&self) -> f32 {
        1.0
    }

    /// The diffuse lobe has weight 1 even for black surfaces, which are sampled like others.
    #[inline(always)]
    fn lobes(&self, _cos_o: f32) -> Lobes {
        Lobes { diffuse: 1.0, specular: 0.0, f0: 0.0, alpha: 1.0 }
    }
}

/// Maps the unit square to the unit disk, preserving area (Shirley and Chiu 1997).
#[inline(always)]
fn concentric_disk(u: Vec2) -> Vec2 {
    let (x, y) = (2.0 * u.x - 1.0, 2.0 * u.y - 1.0);
    let across = x.abs() > y.abs();
    let (radius, other) = (if across { x } else { y }, if across { y } else { x });
    // At the centre both are 0.
    let turns = 0.125 * (other / if radius == 0.0 { 1.0 } else { radius });
    let (cos, sin) = simd::cos_sin_turns(if across { turns } else { 0.25 - turns });
    Vec2::new(radius * cos, radius * sin)
}
