//! The composed warp: a density over the intermediate square Y, mapped to directions by the tail.

use super::{Coverage, Draws, EnvironmentLight, Sampler};
use crate::{columns::Arena, simd::Lanes, tile::Rows};

/// A conditional distribution over the intermediate square Y: a head warp, or a table in its place. Columns are as in [`Sampler`].
///
/// It must be positive everywhere on Y, or at least wherever the BRDF times cosine of the direction `t(y)`
/// is.
pub trait IntermediateDensity: Send + Sync {
    /// Returns the number of columns of state of a point.
    fn columns(&self) -> usize;

    /// Computes the state, which depends on the condition (normal, view direction, material) alone.
    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena);

    /// Maps uniform points `z` of `[0, 1)^2` to `y` and the density over Y there.
    fn sample(
        &self,
        at: &Rows<'_>,
        state: &[Lanes],
        z: [&[Lanes]; 2],
        y: [&mut [Lanes]; 2],
        q: &mut [Lanes],
        arena: &Arena,
    );

    /// Computes the density over Y at `y`.
    fn density(&self, at: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], q: &mut [Lanes], arena: &Arena);

    /// See [`Sampler::mixture_weight`].
    fn mixture_weight(&self, _at: &Rows<'_>, out: &mut [Lanes], _arena: &Arena) {
        out.as_flattened_mut().fill(0.5);
    }
}

/// Samples directions in proportion to light x BRDF x cosine, as closely as the intermediate density allows (paper, eq. 6:
/// the pdf of the composition is the density over Y divided by the tail's Jacobian).
#[derive(Clone, Debug)]
pub struct ProductSampler<I> {
    light: EnvironmentLight,
    intermediate: I,
}

impl<I: IntermediateDensity> ProductSampler<I> {
    /// Composes an intermediate density with the tail of a light.
    pub fn new(light: EnvironmentLight, intermediate: I) -> Self {
        Self { light, intermediate }
    }
}

impl<I: IntermediateDensity> Sampler for ProductSampler<I> {
    fn columns(&self) -> usize {
        self.intermediate.columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.intermediate.prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let mut y = arena.columns::<2>(at.strips());
        self.intermediate.sample(at, state, u, y.get_mut(), out.pdf, arena);
        self.light.directions(y.get(), out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<3>(at.strips());
        let [u, v, pdf] = columns.get_mut();
        self.light.pull_back(wi, [u, v], pdf, arena);
        let [u, v, pdf] = columns.get();
        self.intermediate.density(at, state, [u, v], out, arena);
        for (out, &pdf) in out.as_flattened_mut().iter_mut().zip(pdf.as_flattened()) {
            *out = if pdf > 0.0 { *out * pdf } else { 0.0 };
        }
    }

    fn mixture_weight(&self, at: &Rows<'_>, _state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        self.intermediate.mixture_weight(at, out, arena);
    }

    fn coverage(&self) -> Coverage {
        self.light.coverage()
    }
}
