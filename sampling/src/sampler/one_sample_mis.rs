//! One-sample multiple importance sampling with the balance heuristic (Veach 1997, section 9.2.4): a mixture of two samplers.

use super::{Coverage, Draws, Sampler, prepared};
use crate::{
    columns::{Arena, gather, scatter},
    discrete::remap,
    simd::{LANES, Lanes},
    tile::Rows,
    timings::{Stage, timed},
};

/// Draws from `first` with its mixture weight ([`Sampler::mixture_weight`], 0.5 unless it was learned), else from
/// `second`. Its pdf is that of the mixture, so that it is a sampler like any other. One shadow ray per
/// sample.
///
/// Rows are split by sampler before anything is prepared, so that no state is moved; unless the mixture
/// weight follows from the state of `first`, which is then prepared for all rows. Where few of these draw
/// from `second`, `first` draws for all of them in place, and the few are overwritten: that costs less than
/// moving rows and their state.
#[derive(Clone, Debug)]
pub struct OneSampleMis<A, B> {
    first: A,
    second: B,
}

impl<A: Sampler, B: Sampler> OneSampleMis<A, B> {
    /// The mixture of two samplers.
    pub fn new(first: A, second: B) -> Self {
        Self { first, second }
    }
}

impl<A: Sampler, B: Sampler> Sampler for OneSampleMis<A, B> {
    fn columns(&self) -> usize {
        if self.first.mixes_by_state() { self.first.columns() } else { 0 }
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        if self.first.mixes_by_state() {
            self.first.prepare(at, state, arena);
        }
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], mut out: Draws<'_>, arena: &Arena) {
        let mut mixture_weights = arena.columns::<1>(at.strips());
        self.first.mixture_weight(at, state, mixture_weights.get_mut()[0], arena);
        let mixture_weights = mixture_weights.get()[0].as_flattened();
        let (mut of_first, mut of_second) = (arena.list(), arena.list());
        for (place, (&u, &weight)) in u[0].as_flattened()[..at.len()].iter().zip(mixture_weights).enumerate() {
            if u < weight { &mut of_first } else { &mut of_second }.push(place as u16);
        }
        let (first, second) = (self.first_with(state), Source { sampler: &self.second, state: None });
        if self.first.mixes_by_state() && MANY * of_second.len() < at.len() {
            self.sample_first_in_place(at, state, mixture_weights, u, &mut out, arena);
        } else {
            let part = Part { own: first, other: second, places: &of_first, from: |_| 0.0, to: |weight| weight };
            part.sample(at, mixture_weights, u, &mut out, arena);
        }
        let part = Part { own: second, other: first, places: &of_second, from: |weight| weight, to: |_| 1.0 };
        part.sample(at, mixture_weights, u, &mut out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<2>(at.strips());
        let [mixture_weights, of_second] = columns.get_mut();
        self.first.mixture_weight(at, state, mixture_weights, arena);
        self.first_with(state).with_state(at, None, arena, |state| self.first.pdf(at, state, wi, out, arena));
        prepared(&self.second, at, arena, |state| self.second.pdf(at, state, wi, of_second, arena));
        let both = mixture_weights.as_flattened().iter().zip(of_second.as_flattened());
        for (out, (weight, second)) in out.as_flattened_mut().iter_mut().zip(both) {
            *out = weight * *out + (1.0 - weight) * second;
        }
    }

    fn coverage(&self) -> Coverage {
        if self.first.coverage() == Coverage::Everything { Coverage::Everything } else { self.second.coverage() }
    }
}

impl<A: Sampler, B: Sampler> OneSampleMis<A, B> {
    /// Draws from `first` for all rows; arbitrary for those that draw from `second`.
    fn sample_first_in_place(
        &self,
        at: &Rows<'_>,
        state: &[Lanes],
        mixture_weights: &[f32],
        u: [&[Lanes]; 2],
        out: &mut Draws<'_>,
        arena: &Arena,
    ) {
        let mut columns = arena.columns::<2>(at.strips());
        let [numbers, of_second] = columns.get_mut();
        for ((number, &u), &weight) in
            numbers.as_flattened_mut().iter_mut().zip(u[0].as_flattened()).zip(mixture_weights)
        {
            *number = remap(if u < weight { u } else { 0.0 }, 0.0, weight);
        }
        let [x, y, z] = &mut out.wi;
        self.first.sample(at, state, [numbers, u[1]], Draws { wi: [&mut *x, y, z], pdf: out.pdf }, arena);
        let is_alone = mixture_weights[..at.len()].iter().all(|&weight| weight == 1.0);
        if is_alone {
            of_second.as_flattened_mut().fill(0.0);
        } else {
            timed(Stage::Pdf, || {
                prepared(&self.second, at, arena, |state| self.second.pdf(at, state, [x, y, z], of_second, arena));
            });
        }
        let both = mixture_weights.iter().zip(of_second.as_flattened());
        for (pdf, (weight, second)) in out.pdf.as_flattened_mut().iter_mut().zip(both) {
            *pdf = of_mixture(*pdf, *second, *weight);
        }
    }

    fn first_with<'a>(&'a self, state: &'a [Lanes]) -> Source<'a> {
        Source { sampler: &self.first, state: self.first.mixes_by_state().then_some(state) }
    }
}

/// `first` draws in place where all rows are more than this many times the rows of `second`.
const MANY: usize = 4;

/// Returns the pdf of a mixture at a draw of one of its samplers, whose mixture weight is `weight`; 0 where
/// that sampler rejects the draw.
fn of_mixture(own: f32, other: f32, weight: f32) -> f32 {
    if own > 0.0 { weight * own + (1.0 - weight) * other } else { 0.0 }
}

/// A sampler, and its state if all rows are prepared.
#[derive(Clone, Copy)]
struct Source<'a> {
    sampler: &'a dyn Sampler,
    state: Option<&'a [Lanes]>,
}

impl Source<'_> {
    /// Passes its state for rows to `work`: for those at `places` of the prepared ones, or for all.
    fn with_state(&self, at: &Rows<'_>, places: Option<&[u16]>, arena: &Arena, work: impl FnOnce(&[Lanes])) {
        match (self.state, places) {
            (Some(state), None) => work(state),
            (Some(state), Some(places)) => {
                let width = self.sampler.columns();
                let mut own = arena.columns::<1>(width * at.strips());
                move_state(state, width, places, own.get_mut()[0]);
                work(own.get()[0]);
            }
            (None, _) => prepared(self.sampler, at, arena, work),
        }
    }
}

/// Gathers the state of the rows at `places`, of `width` lanes for each strip; lanes beyond the last place
/// repeat it.
fn move_state(state: &[Lanes], width: usize, places: &[u16], out: &mut [Lanes]) {
    for (places, out) in places.chunks(LANES).zip(out.chunks_exact_mut(width)) {
        let from: [usize; LANES] = std::array::from_fn(|lane| places[lane.min(places.len() - 1)].into());
        for (column, out) in out.iter_mut().enumerate() {
            for lane in 0..LANES {
                out[lane] = state[from[lane] / LANES * width + column][from[lane] % LANES];
            }
        }
    }
}

/// The rows that draw from one of the two samplers.
struct Part<'a> {
    own: Source<'a>,
    other: Source<'a>,
    places: &'a [u16],
    /// The interval of uniform numbers that selects it, from the mixture weight of the first sampler.
    from: fn(f32) -> f32,
    to: fn(f32) -> f32,
}

impl Part<'_> {
    fn sample(&self, at: &Rows<'_>, mixture_weights: &[f32], u: [&[Lanes]; 2], out: &mut Draws<'_>, arena: &Arena) {
        if self.places.is_empty() {
            return;
        }
        let (mut rows, all) = (arena.list(), at.len());
        let at = at.select(self.places, &mut rows);
        let mut numbers = arena.columns::<2>(at.strips());
        let [u_0, u_1] = numbers.get_mut();
        gather(u[1], self.places, u_1);
        for (number, &place) in u_0.as_flattened_mut().iter_mut().zip(self.places) {
            let weight = mixture_weights[place as usize];
            *number = remap(u[0].as_flattened()[place as usize], (self.from)(weight), (self.to)(weight));
        }
        let mut drawn = arena.columns::<5>(at.strips());
        let [x, y, z, pdf, other] = drawn.get_mut();
        // If all rows are in this part, they are in order.
        let moved = (self.places.len() < all).then_some(self.places);
        self.own.with_state(&at, moved, arena, |state| {
            self.own.sampler.sample(&at, state, numbers.get(), Draws { wi: [x, y, z], pdf }, arena);
        });
        // The pdf of a sampler with mixture weight 0 does not contribute.
        let is_certain = |&place: &u16| {
            let weight = mixture_weights[place as usize];
            (self.to)(weight) - (self.from)(weight) == 1.0
        };
        if self.places.iter().all(is_certain) {
            other.as_flattened_mut().fill(0.0);
        } else {
            timed(Stage::Pdf, || {
                self.other.with_state(&at, moved, arena, |state| {
                    self.other.sampler.pdf(&at, state, [x, y, z], other, arena);
                });
            });
        }
        let all = pdf.as_flattened_mut().iter_mut().zip(other.as_flattened()).zip(self.places);
        for ((pdf, other), &place) in all {
            let weight = mixture_weights[place as usize];
            let own = (self.to)(weight) - (self.from)(weight);
            *pdf = of_mixture(*pdf, *other, own);
        }
        let [x, y, z, pdf, _] = drawn.get();
        for (from, to) in [x, y, z].into_iter().zip(&mut out.wi) {
            scatter(from, self.places, to);
        }
        scatter(pdf, self.places, out.pdf);
    }
}
