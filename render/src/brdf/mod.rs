//! BRDFs at a shading point.

mod ggx;
mod lambert;
mod lobe_albedo;
mod metallic_roughness;

pub use ggx::Ggx;
pub use lambert::Lambert;
pub(crate) use lobe_albedo::tabulate as tabulate_lobe_albedo;
pub use metallic_roughness::MetallicRoughness;

use glam::{Vec2, Vec3A};

/// The BRDF of a surface at one point, its textures already looked up.
#[derive(Clone, Copy, Debug)]
pub enum Brdf {
    /// Ideal diffuse reflection.
    Lambert(Lambert),
    /// Rough mirror.
    Ggx(Ggx),
    /// A diffuse lobe below a specular one.
    MetallicRoughness(MetallicRoughness),
}

impl Brdf {
    /// `f_r(wo, wi) max(0, n . wi)` per channel, in 1/sr.
    pub fn evaluate_cosine(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> Vec3A {
        match self {
            Self::Lambert(lambert) => lambert.evaluate_cosine(normal, wo, wi),
            Self::Ggx(ggx) => ggx.evaluate_cosine(normal, wo, wi),
            Self::MetallicRoughness(mixture) => mixture.evaluate_cosine(normal, wo, wi),
        }
    }

    /// Draws a direction in proportion to (a close approximation of) `f_r cos`; `(wi, solid-angle pdf)`.
    pub fn sample(&self, normal: Vec3A, wo: Vec3A, u: Vec2) -> Option<(Vec3A, f32)> {
        match self {
            Self::Lambert(lambert) => lambert.sample(normal, wo, u),
            Self::Ggx(ggx) => ggx.sample(normal, wo, u),
            Self::MetallicRoughness(mixture) => mixture.sample(normal, wo, u),
        }
    }

    /// The solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, normal: Vec3A, wo: Vec3A, wi: Vec3A) -> f32 {
        match self {
            Self::Lambert(lambert) => lambert.pdf(normal, wo, wi),
            Self::Ggx(ggx) => ggx.pdf(normal, wo, wi),
            Self::MetallicRoughness(mixture) => mixture.pdf(normal, wo, wi),
        }
    }

    /// The width in radians of the narrowest lobe, to within a small factor.
    pub fn narrowest_lobe(&self) -> f32 {
        match self {
            Self::Lambert(_) => std::f32::consts::PI,
            Self::Ggx(ggx) => ggx.alpha(),
            Self::MetallicRoughness(mixture) => mixture.alpha(),
        }
    }
}
