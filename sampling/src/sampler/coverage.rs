//! What of the integrand a sampler can draw, as a value: only what covers all of it may be used alone.

use super::{Draws, Sampler};
use crate::{
    columns::Arena,
    error::{Error, Result},
    simd::Lanes,
    tile::Rows,
};

/// What of light x BRDF x cosine a sampler can draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// The pdf is positive wherever the integrand is: the sampler may be used alone without bias.
    Everything,
    /// Regions are left to a partner.
    Part,
}

/// A sampler that covers the integrand: the only kind that an estimator takes.
#[derive(Clone, Debug)]
pub struct Covering<S>(S);

impl<S: Sampler> Covering<S> {
    /// Takes a sampler that covers the integrand.
    ///
    /// # Errors
    /// It does not: an estimate with it alone would be biased.
    pub fn new(sampler: S) -> Result<Self> {
        match sampler.coverage() {
            Coverage::Everything => Ok(Self(sampler)),
            Coverage::Part => {
                Err(Error::argument("sampler", "leaves regions to a partner and cannot be used alone without bias"))
            }
        }
    }

    /// The sampler.
    pub fn get(&self) -> &S {
        &self.0
    }

    /// The sampler, alone.
    pub fn into_inner(self) -> S {
        self.0
    }
}

impl<S: Sampler> Sampler for Covering<S> {
    fn columns(&self) -> usize {
        self.0.columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.0.prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        self.0.sample(at, state, u, out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.0.pdf(at, state, wi, out, arena);
    }

    fn share(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        self.0.share(at, out, arena);
    }

    fn has_share_in_state(&self) -> bool {
        self.0.has_share_in_state()
    }

    fn share_of_state(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        self.0.share_of_state(at, state, out, arena);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}
