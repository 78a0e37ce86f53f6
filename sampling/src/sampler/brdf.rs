//! BRDF sampling; for Lambert surfaces this is cosine sampling.

use super::{Coverage, Draws, Sampler};
use crate::{columns::Arena, simd::Lanes, tile::Rows};

/// Samples the BRDF times cosine, without regard to the light.
#[derive(Clone, Copy, Debug)]
pub struct BrdfSampler;

impl Sampler for BrdfSampler {
    fn sample(&self, at: &Rows<'_>, _state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        at.sample_brdf(u, out.wi, out.pdf, arena);
    }

    fn pdf(&self, at: &Rows<'_>, _state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        at.brdf_pdf(wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}
