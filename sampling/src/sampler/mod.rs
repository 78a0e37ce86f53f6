//! Direction samplers for direct light, implemented over columns of shading points.
//!
//! Every pdf at these interfaces is over solid angle. A pdf of 0 means "no sample": the estimate of that draw
//! is 0.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `Sampler` |
//! | `coverage.rs` | the part of the integrand that a sampler covers, and `Covering` |
//! | `light.rs` | a map with its tail |
//! | `brdf.rs`, `emitter.rs` | BRDF sampling; emitter sampling, MIS compensation |
//! | `one_sample_mis.rs` | the mixture of two samplers |
//! | `product.rs` | a density over Y composed with a tail |
//! | `oracle.rs` | the product tabulated at every shading point |
//! | `single.rs` | any sampler at one shading point |

mod brdf;
mod coverage;
mod emitter;
mod light;
mod one_sample_mis;
mod oracle;
mod product;
mod single;

pub use brdf::BrdfSampler;
pub use coverage::{Coverage, Covering};
pub use emitter::EmitterSampler;
pub use light::EnvironmentLight;
pub use one_sample_mis::OneSampleMis;
pub use oracle::Oracle;
pub use product::{IntermediateDensity, ProductSampler};
pub use single::{AtPoint, Direction};

use std::sync::Arc;

use crate::{columns::Arena, simd::Lanes, tile::Rows};

/// Sampled directions, one per row.
#[derive(Debug)]
pub struct Draws<'a> {
    /// Unit directions towards the environment; arbitrary where the pdf is 0.
    pub wi: [&'a mut [Lanes]; 3],
    /// Solid-angle pdfs, finite; 0 means "no sample".
    pub pdf: &'a mut [Lanes],
}

/// A distribution of directions at each shading point, with a pdf that can be evaluated anywhere.
///
/// A batch is a list of rows of a tile. All columns of a call have [`Rows::strips`] strips, one lane per row
/// of the list. An implementation provides `sample`, `pdf` and `coverage`, and `columns` and `prepare` if it
/// has state that depends on the shading point alone.
///
/// # Panics
/// Methods panic if a column or the state is too short.
pub trait Sampler: Send + Sync {
    /// Returns the number of columns of state of a point.
    fn columns(&self) -> usize {
        0
    }

    /// Computes the state, which depends on the shading points alone: `state` has [`Self::columns`] lanes for
    /// each strip of rows, one strip after the other. A sampler that wraps others and stores the state of
    /// several splits it at `columns() * rows.strips()`.
    fn prepare(&self, _at: &Rows<'_>, _state: &mut [Lanes], _arena: &Arena) {}

    /// Draws a direction for each row from a uniform point `u` of `[0, 1)^2`.
    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena);

    /// Computes the solid-angle pdfs with which [`Self::sample`] draws the unit directions `wi`; 0 for
    /// directions that it never draws.
    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena);

    /// Computes the mixture weight of this sampler in [`OneSampleMis`], in `[0, 1]`: 0.5, unless the sampler has
    /// its own. The state is prepared, or empty where the sampler [does not need it](Self::mixes_by_state).
    fn mixture_weight(&self, _at: &Rows<'_>, _state: &[Lanes], out: &mut [Lanes], _arena: &Arena) {
        out.as_flattened_mut().fill(0.5);
    }

    /// Whether the mixture weight follows from the state: a mixture then prepares all rows before it splits
    /// them.
    fn mixes_by_state(&self) -> bool {
        false
    }

    /// Returns the part of the integrand that the sampler covers.
    fn coverage(&self) -> Coverage;
}

impl<S: Sampler + ?Sized> Sampler for Arc<S> {
    fn columns(&self) -> usize {
        (**self).columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        (**self).prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        (**self).sample(at, state, u, out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        (**self).pdf(at, state, wi, out, arena);
    }

    fn mixture_weight(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        (**self).mixture_weight(at, state, out, arena);
    }

    fn mixes_by_state(&self) -> bool {
        (**self).mixes_by_state()
    }

    fn coverage(&self) -> Coverage {
        (**self).coverage()
    }
}

/// Prepares a sampler for rows and passes its state to `work`.
pub fn prepared<T>(sampler: &dyn Sampler, at: &Rows<'_>, arena: &Arena, work: impl FnOnce(&[Lanes]) -> T) -> T {
    let mut state = arena.columns::<1>(sampler.columns() * at.strips());
    sampler.prepare(at, state.get_mut()[0], arena);
    work(state.get()[0])
}
