//! The part of the integrand that a sampler covers, as a value: only a sampler that covers all of it may be
//! used alone.

use super::{Draws, Sampler};
use crate::{
    columns::Arena,
    error::{Error, Result},
    simd::Lanes,
    tile::Rows,
};

/// The part of light x BRDF x cosine that a sampler covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// The pdf is positive wherever the integrand is: the sampler may be used alone without bias.
    Everything,
    /// Some regions are left to another sampler.
    Part,
}

/// A sampler that covers the integrand; estimators accept no other.
#[derive(Clone, Debug)]
pub struct Covering<S>(S);

impl<S: Sampler> Covering<S> {
    /// Wraps a sampler that covers the integrand.
    ///
    /// # Errors
    /// The sampler covers only a part; an estimate with it alone would be biased.
    pub fn new(sampler: S) -> Result<Self> {
        match sampler.coverage() {
            Coverage::Everything => Ok(Self(sampler)),
            Coverage::Part => {
                Err(Error::argument("sampler", "leaves regions to a partner and cannot be used alone without bias"))
            }
        }
    }

    /// Returns the sampler.
    pub fn get(&self) -> &S {
        &self.0
    }

    /// Unwraps the sampler.
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

    fn mixture_weight(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        self.0.mixture_weight(at, state, out, arena);
    }

    fn mixes_by_state(&self) -> bool {
        self.0.mixes_by_state()
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}
