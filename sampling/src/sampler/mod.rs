//! Direction samplers for direct light: each is written once, over columns of shading points.
//!
//! Every pdf at these interfaces is over solid angle. A pdf of 0 means "no sample": the estimate of that draw is zero.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `Sampler` |
//! | `coverage.rs` | what of the integrand a sampler can draw, and `Covering` |
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

/// Directions that were drawn, one for each row.
#[derive(Debug)]
pub struct Draws<'a> {
    /// Unit directions towards the environment; anything where the pdf is 0.
    pub wi: [&'a mut [Lanes]; 3],
    /// Solid-angle pdfs, finite; 0 is no sample.
    pub pdf: &'a mut [Lanes],
}

/// A distribution of directions at each shading point, with a pdf that can be evaluated anywhere.
///
/// A batch is a list of rows of a tile. All columns of a call have [`Rows::strips`] strips, one lane for each row of the list. An
/// implementation gives `sample`, `pdf` and `coverage`, and `columns` and `prepare` if something depends on the shading point alone.
pub trait Sampler: Send + Sync {
    /// How many columns of state a point has.
    fn columns(&self) -> usize {
        0
    }

    /// Computes what depends on the shading points alone: `state` has [`Self::columns`] lanes for each strip of rows, one strip after the other. A
    /// sampler that wraps others and keeps the state of several divides it at `columns() * rows.strips()`.
    fn prepare(&self, _at: &Rows<'_>, _state: &mut [Lanes], _arena: &Arena) {}

    /// Draws a direction for each row from a uniform point `u` of `[0, 1)^2`.
    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena);

    /// The solid-angle pdfs with which [`Self::sample`] draws the unit directions `wi`; 0 where it never does.
    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena);

    /// Which share of samples to draw from this sampler in a mixture with BRDF sampling, in (0, 1): one half, unless the sampler
    /// has learned better.
    fn share(&self, _at: &Rows<'_>, out: &mut [Lanes], _arena: &Arena) {
        out.as_flattened_mut().fill(0.5);
    }

    /// Whether the share follows from the state: a mixture then prepares all rows before it divides them, and asks [`Self::share_of_state`].
    fn has_share_in_state(&self) -> bool {
        false
    }

    /// [`Self::share`] with the state that was prepared; of samplers that have it there.
    fn share_of_state(&self, at: &Rows<'_>, _state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        self.share(at, out, arena);
    }

    /// What of the integrand it can draw.
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

    fn share(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        (**self).share(at, out, arena);
    }

    fn has_share_in_state(&self) -> bool {
        (**self).has_share_in_state()
    }

    fn share_of_state(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        (**self).share_of_state(at, state, out, arena);
    }

    fn coverage(&self) -> Coverage {
        (**self).coverage()
    }
}

/// Prepares a sampler for rows and hands its state to `work`.
pub fn prepared<T>(sampler: &dyn Sampler, at: &Rows<'_>, arena: &Arena, work: impl FnOnce(&[Lanes]) -> T) -> T {
    let mut state = arena.columns::<1>(sampler.columns() * at.strips());
    sampler.prepare(at, state.get_mut()[0], arena);
    work(state.get()[0])
}
