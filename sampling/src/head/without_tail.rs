//! A head directly over the map, without a tail: the paper's naive flow.

use super::Head;
use crate::{
    columns::Arena,
    latlong,
    sampler::{Coverage, Draws, IntermediateDensity, Sampler},
    simd::Lanes,
    tile::Rows,
};

/// A head trained over X, the baseline for tails. In files it is a head over an identity tail.
pub struct WithoutTail(pub Head);

impl Sampler for WithoutTail {
    fn columns(&self) -> usize {
        self.0.columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.0.prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let mut x = arena.columns::<2>(at.strips());
        self.0.sample(at, state, u, x.get_mut(), out.pdf, arena);
        latlong::directions(x.get(), out.wi, out.pdf);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let mut x = arena.columns::<2>(at.strips());
        latlong::squares(wi, x.get_mut());
        self.0.density(at, state, x.get(), out, arena);
        latlong::to_solid_angle(x.get()[1], out);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}
