//! Direction samplers for direct light, and the traits behind which they stand.
//!
//! Every pdf at these interfaces is over solid angle. `None` means "no sample": the estimate of that draw is zero.

mod brdf;
mod compact;
mod emitter;
mod light;
mod one_sample_mis;
mod oracle;
mod product;
mod resampled;
mod spec;

pub use brdf::BrdfSampler;
pub use compact::{CompactEmitters, WithCompactEmitters};
pub use emitter::{CompensatedEmitterSampler, EmitterSampler};
pub use light::EnvironmentLight;
pub use one_sample_mis::OneSampleMis;
pub(crate) use one_sample_mis::directions;
pub use oracle::{Oracle, OracleTable};
pub use product::{IntermediateDensity, ProductSampler};
pub use resampled::{Resampled, ResampledDirection, ResampledSampler};
pub use spec::{FileKind, SamplerSpec};

use glam::{Vec2, Vec3A};

use crate::brdf::Brdf;

/// A point to be shaded; all vectors are unit length, in world space, and point away from the surface.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// Position in metres.
    pub p: Vec3A,
    /// Geometric normal, on the side of `wo`.
    pub ng: Vec3A,
    /// Shading normal, on the side of `wo`.
    pub ns: Vec3A,
    /// Direction to the viewer.
    pub wo: Vec3A,
    /// The surface's BRDF, textures looked up.
    pub brdf: Brdf,
}

impl ShadingPoint {
    /// `f_r cos` towards `wi`, per channel; zero where `wi` is below the geometric surface.
    pub fn brdf_cosine(&self, wi: Vec3A) -> Vec3A {
        if self.ng.dot(wi) <= 0.0 { Vec3A::ZERO } else { self.brdf.evaluate_cosine(self.ns, self.wo, wi) }
    }
}

/// A sampled direction towards the environment.
#[derive(Clone, Copy, Debug)]
pub struct DirectionSample {
    /// Unit direction.
    pub wi: Vec3A,
    /// Solid-angle pdf of `wi`, positive and finite.
    pub pdf: f32,
    /// The environment's radiance from `wi`.
    pub radiance: Vec3A,
}

/// A distribution of directions at a shading point, with a pdf that can be evaluated anywhere.
pub trait DirectionSampler: Send + Sync {
    /// What depends on the shading point alone and is computed once for all of its samples.
    type Prepared: Send;

    /// Computes what depends on the shading point alone.
    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared;

    /// Draws a direction from a uniform point `u` of `[0, 1)^2`.
    fn sample(&self, prepared: &Self::Prepared, at: &ShadingPoint, u: Vec2) -> Option<DirectionSample>;

    /// The solid-angle pdf with which [`Self::sample`] draws `wi`; 0 where it never does.
    fn pdf(&self, prepared: &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32;

    /// Which share of samples to draw from this sampler in a mixture with BRDF sampling, in (0, 1): one half, unless the sampler
    /// has learned better.
    fn share_beside_brdf(&self, _prepared: &Self::Prepared) -> f32 {
        0.5
    }

    /// Draws one direction for each of many shading points: `at`, `u` and `out` have equal length.
    /// The wavefront form; networks and tables override it.
    fn sample_batch(&self, at: &[ShadingPoint], u: &[Vec2], out: &mut [Option<DirectionSample>]) {
        for ((at, &u), out) in at.iter().zip(u).zip(out) {
            *out = self.sample(&self.prepare(at), at, u);
        }
    }

    /// [`Self::share_beside_brdf`] of many shading points; both slices have equal length.
    fn share_batch(&self, at: &[ShadingPoint], shares: &mut [f32]) {
        for (at, share) in at.iter().zip(shares) {
            *share = self.share_beside_brdf(&self.prepare(at));
        }
    }

    /// [`Self::pdf`] for many shading points; all slices have equal length.
    fn pdf_batch(&self, at: &[ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        let prepared = self.prepare_batch(at);
        let (prepared, at): (Vec<_>, Vec<_>) = prepared.iter().zip(at).unzip();
        self.pdf_prepared(&prepared, &at, wi, out);
    }

    /// [`Self::prepare`] for many shading points.
    fn prepare_batch(&self, at: &[ShadingPoint]) -> Vec<Self::Prepared> {
        at.iter().map(|at| self.prepare(at)).collect()
    }

    /// [`Self::sample`] for many prepared shading points; all slices have equal length.
    fn sample_prepared(
        &self,
        prepared: &[&Self::Prepared],
        at: &[&ShadingPoint],
        u: &[Vec2],
        out: &mut [Option<DirectionSample>],
    ) {
        for (((prepared, at), &u), out) in prepared.iter().zip(at).zip(u).zip(out) {
            *out = self.sample(prepared, at, u);
        }
    }

    /// [`Self::pdf`] for many prepared shading points; all slices have equal length.
    fn pdf_prepared(&self, prepared: &[&Self::Prepared], at: &[&ShadingPoint], wi: &[Vec3A], out: &mut [f32]) {
        for (((prepared, at), &wi), out) in prepared.iter().zip(at).zip(wi).zip(out) {
            *out = self.pdf(prepared, at, wi);
        }
    }
}

/// Marks a sampler whose pdf is positive wherever light x BRDF x cosine is: it may be used alone without bias.
///
/// A sampler that leaves parts to a partner (MIS compensation) does not have it, so the compiler refuses to use it alone.
pub trait CoversIntegrand: DirectionSampler {}
