//! Layered materials: an absorbing rough dielectric coat over a diffuse or metallic base.
//!
//! Position-free light paths (Guo et al. 2018, "Position-Free Monte Carlo Simulation for Arbitrary
//! Layered BSDFs") without a scattering medium: a path enters through the coat, is reflected by base and
//! coat in turn, and is connected to the light wherever it reaches the coat from below. The squared
//! refractive indices that scale radiance on entry and exit cancel and are omitted.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{Query, Source};
use crate::{
    brdf::{Ggx, Kernel, Lambert},
    random::{Purpose, Stream},
};

/// Refractive index of the coat.
const ETA: f32 = 1.5;
/// Index of the first bounce off the base with Russian roulette.
const ROULETTE_FROM: u32 = 3;
/// Maximum survival probability of Russian roulette.
const MOST_SURVIVAL: f32 = 0.95;
/// Maximum bounces off the base.
const MOST_BOUNCES: u32 = 200;
/// Queries that share a random stream.
const CHUNK: usize = 256;

/// The layers at one point.
#[derive(Clone, Copy, Debug)]
pub struct Layers {
    /// Trowbridge-Reitz width of the coat.
    pub coat_alpha: f32,
    /// Optical depth of the coat at normal incidence, per channel.
    pub absorption: Vec3,
    /// The surface below the coat.
    pub base: Base,
}

/// The surface below a coat.
#[derive(Clone, Copy, Debug)]
pub enum Base {
    /// A diffuse surface.
    Diffuse(Lambert),
    /// A metal.
    Metal(Ggx),
}

/// Layers that vary over the tile.
pub struct Layered(fn(Vec2) -> Layers);

impl Layered {
    /// Creates a material from the layers at each point of the tile.
    pub fn of(layers: fn(Vec2) -> Layers) -> Self {
        Self(layers)
    }

    /// Returns a coat of varying roughness over a pattern in two colours.
    pub fn lacquer() -> Self {
        Self(|uv| {
            let waves = (TAU * 2.0 * uv.x).sin() * (TAU * 2.0 * uv.y).cos();
            let ink = 1.0 / (1.0 + (-12.0 * (waves + 0.2 * (TAU * uv.x).cos())).exp());
            let worn = 0.5 + 0.5 * (TAU * (uv.x - uv.y)).sin();
            let albedo = Vec3::new(0.75, 0.62, 0.40).lerp(Vec3::new(0.30, 0.03, 0.02), ink);
            let base = Base::Diffuse(Lambert { albedo });
            Layers { coat_alpha: 0.15 + 0.25 * worn, absorption: Vec3::splat(0.05), base }
        })
    }

    /// Returns a tinted coat over brushed metal.
    pub fn anodized() -> Self {
        Self(|uv| {
            let stripes = 0.5 + 0.5 * (TAU * (3.0 * uv.x + 0.2 * (TAU * uv.y).sin())).sin();
            let base = Base::Metal(Ggx::new(0.2 + 0.2 * stripes, Vec3::new(0.9, 0.9, 0.88)));
            let depth = 0.6 + 0.4 * (TAU * uv.y).cos();
            Layers { coat_alpha: 0.2, absorption: depth * Vec3::new(0.9, 0.35, 0.08), base }
        })
    }
}

impl Source for Layered {
    fn reflect(&self, queries: &[Query], samples: u32, seed: u64) -> Vec<Vec3> {
        let parts = queries.par_chunks(CHUNK).enumerate().map(|(index, queries)| {
            let mut random = Stream::new(seed, Purpose::Texture, index as u64);
            let mean = |query: &Query| {
                let mut path = || {
                    let u = random.uniform2();
                    let radius = (-2.0 * (1.0 - u.x).ln()).sqrt();
                    let at = query.uv + query.width * radius * Vec2::from_angle(TAU * u.y);
                    (self.0)(at).path(query.wo, query.wi, &mut random)
                };
                (0..samples).map(|_| path()).sum::<Vec3>() / samples as f32
            };
            queries.iter().map(mean).collect::<Vec<Vec3>>()
        });
        parts.collect::<Vec<_>>().concat()
    }
}

impl Layers {
    /// Estimates `f_r cos` with one light path.
    fn path(&self, wo: Vec3, wi: Vec3, random: &mut Stream) -> Vec3 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return Vec3::ZERO;
        }
        let coat = Coat { alpha: self.coat_alpha };
        let mut sum = Vec3::splat(coat.reflected(wo, wi));
        let h = coat.visible_normal(wo, random.uniform2());
        let Some(entered) = refract(wo, h) else { return sum };
        let mut throughput = Vec3::splat((1.0 - fresnel(wo.dot(h), ETA)) * coat.masking(entered));
        let mut down = entered;
        for bounce in 0..MOST_BOUNCES {
            throughput *= self.left(down);
            let (up, weight) = self.base.sample(-down, random.uniform2());
            if up.z <= 0.0 {
                break;
            }
            throughput *= weight * self.left(up);
            sum += throughput * coat.transmitted(up, wi);
            // The reflection at the coat's inside, in a frame whose z points down.
            let mirrored = Vec3::new(-up.x, -up.y, up.z);
            let h = coat.visible_normal(mirrored, random.uniform2());
            let back = 2.0 * mirrored.dot(h) * h - mirrored;
            if back.z <= 0.0 {
                break;
            }
            throughput *= fresnel(mirrored.dot(h), 1.0 / ETA) * coat.masking(back);
            if bounce >= ROULETTE_FROM {
                let survival = throughput.max_element().min(MOST_SURVIVAL);
                if random.uniform() >= survival {
                    break;
                }
                throughput /= survival;
            }
            // From the mirrored frame to the direction below the coat.
            down = Vec3::new(-back.x, -back.y, -back.z);
        }
        sum
    }

    /// Returns the transmittance of the coat along `w`.
    fn left(&self, w: Vec3) -> Vec3 {
        (-self.absorption / w.z.abs().max(1e-3)).exp()
    }
}

impl Base {
    /// Samples a direction for `wo` and returns it with `f_r cos / pdf`.
    fn sample(&self, wo: Vec3, u: Vec2) -> (Vec3, Vec3) {
        let of = |(wi, pdf): (Vec3, f32), value: &dyn Fn(Vec3) -> Vec3| {
            (wi, if pdf > 0.0 { value(wi) / pdf } else { Vec3::ZERO })
        };
        match self {
            Self::Diffuse(base) => of(base.sample(Vec3::Z, wo, u), &|wi| base.evaluate_cosine(Vec3::Z, wo, wi)),
            Self::Metal(base) => of(base.sample(Vec3::Z, wo, u), &|wi| base.evaluate_cosine(Vec3::Z, wo, wi)),
        }
    }
}

/// A rough dielectric interface around z = 0 (Walter et al. 2007), Trowbridge-Reitz, with uncorrelated masking.
struct Coat {
    alpha: f32,
}

impl Coat {
    fn density(&self, h: Vec3) -> f32 {
        let a = self.alpha * self.alpha;
        let d = h.z * h.z * (a - 1.0) + 1.0;
        if h.z > 0.0 { a / (PI * d * d) } else { 0.0 }
    }

    /// Returns Smith's masking of a direction on either side.
    fn masking(&self, w: Vec3) -> f32 {
        let squared = w.z * w.z;
        let tan = (1.0 - squared).max(0.0) / squared.max(1e-12);
        2.0 / (1.0 + (1.0 + self.alpha * self.alpha * tan).sqrt())
    }

    /// Samples a normal in proportion to its area visible from `w`, above the coat.
    fn visible_normal(&self, w: Vec3, u: Vec2) -> Vec3 {
        let v = Vec3::new(self.alpha * w.x, self.alpha * w.y, w.z).normalize();
        // A spherical cap (Dupuy and Benyoub 2023): uniform in height above -v.z.
        let height = (1.0 - u.y) * (1.0 + v.z) - v.z;
        let radius = (1.0 - height * height).max(0.0).sqrt();
        let (sin, cos) = (TAU * u.x).sin_cos();
        let cap = Vec3::new(radius * cos, radius * sin, height) + v;
        Vec3::new(self.alpha * cap.x, self.alpha * cap.y, cap.z.max(1e-6)).normalize()
    }

    /// Returns `f_r cos` of the reflection at the outside.
    fn reflected(&self, wo: Vec3, wi: Vec3) -> f32 {
        let h = (wo + wi).normalize();
        let shared = self.density(h) * self.masking(wo) * self.masking(wi);
        shared * fresnel(wo.dot(h), ETA) / (4.0 * wo.z)
    }

    /// Returns `f_t cos`, without the squared index, for light from `wi` outside that arrives from `up` at
    /// the base.
    fn transmitted(&self, up: Vec3, wi: Vec3) -> f32 {
        let inside = -up;
        let h = -(wi + ETA * inside);
        let h = h.normalize_or_zero();
        let (cos_i, cos_t) = (wi.dot(h), inside.dot(h));
        if h.z <= 0.0 || cos_i <= 0.0 || cos_t >= 0.0 {
            return 0.0;
        }
        let sum = cos_i + ETA * cos_t;
        let shared = self.density(h) * self.masking(wi) * self.masking(inside) * (1.0 - fresnel(cos_i, ETA));
        shared * cos_i * -cos_t / (up.z * sum * sum)
    }
}

/// Refracts `w`, which points up, at the normal `h` into a direction that points down.
fn refract(w: Vec3, h: Vec3) -> Option<Vec3> {
    let cos = w.dot(h);
    let squared = 1.0 - (1.0 - cos * cos) / (ETA * ETA);
    let inside = (cos / ETA - squared.max(0.0).sqrt()) * h - w / ETA;
    (cos > 0.0 && inside.z < 0.0).then_some(inside)
}

/// Returns the Fresnel reflectance of a dielectric with relative index `eta`; 1 for total reflection.
fn fresnel(cos: f32, eta: f32) -> f32 {
    let cos = cos.clamp(0.0, 1.0);
    let squared = 1.0 - (1.0 - cos * cos) / (eta * eta);
    if squared <= 0.0 {
        return 1.0;
    }
    let other = squared.sqrt();
    let s = (cos - eta * other) / (cos + eta * other);
    let p = (eta * cos - other) / (eta * cos + other);
    0.5 * (s * s + p * p)
}
