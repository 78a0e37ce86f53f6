//! Resampled importance sampling: a few candidates, one of which survives in proportion to the unshadowed integrand.

use std::sync::Arc;

use glam::Vec3A;

use super::{Contributions, Estimator, contribute, integrand};
use crate::{
    color::luminance,
    columns::Arena,
    discrete::remap,
    environment::Environment,
    error::{Error, Result},
    points::{Dimension, MAX_CANDIDATES, Points},
    sampler::{Covering, Draws, Sampler, prepared},
    simd::{LANES, Lanes},
    tile::Rows,
    timings::{Stage, timed},
};

/// Streaming RIS (Talbot et al. 2005, with a weighted reservoir) over `candidates` draws that alternate
/// between two techniques, with balance-heuristic weights between them. The target is the luminance of light
/// x BRDF x cosine without visibility; the light is that of [`Environment::luminance`], so that a hidden lamp
/// does not always survive.
///
/// The pdf of the surviving direction has no closed form, only an unbiased estimate of its reciprocal: RIS is
/// an estimator, not a sampler, and cannot be combined by MIS.
#[derive(Clone, Debug)]
pub struct Ris<A, B> {
    first: Covering<A>,
    second: Covering<B>,
    candidates: u32,
    environment: Arc<Environment>,
}

/// The reservoirs: the sum of weights so far, the survivor's direction and its target.
///
/// `random` decides whether a candidate replaces the survivor, and is remapped for the next decision: one
/// uniform number, independent of all candidates, draws the survivor. One number of a sequence per candidate
/// would be biased, because they depend on each other.
struct Reservoirs<'a> {
    total: &'a mut [Lanes],
    wi: [&'a mut [Lanes]; 3],
    target: &'a mut [Lanes],
    random: &'a mut [Lanes],
}

/// One candidate of each row.
struct Candidates<'a> {
    wi: [&'a [Lanes]; 3],
    target: &'a [Lanes],
    /// Sum over both techniques of the number of draws times the pdf: the denominator of the balance
    /// heuristic.
    density: &'a [Lanes],
}

impl Reservoirs<'_> {
    fn clear(&mut self) {
        for column in [&mut *self.total, self.target] {
            column.as_flattened_mut().fill(0.0);
        }
    }

    fn add(&mut self, candidates: &Candidates<'_>) {
        for strip in 0..self.total.len() {
            for lane in 0..LANES {
                let target = candidates.target[strip][lane];
                let weight = target / candidates.density[strip][lane];
                let counts = (target > 0.0) & (weight > 0.0);
                let total = self.total[strip][lane] + if counts { weight } else { 0.0 };
                let random = &mut self.random[strip][lane];
                let at = *random * total;
                let chosen = counts & (at < weight);
                let (from, to) = if chosen { (0.0, weight) } else { (weight, total) };
                *random = if counts { remap(at, from, to) } else { *random };
                self.total[strip][lane] = total;
                let kept = &mut self.target[strip][lane];
                *kept = if chosen { target } else { *kept };
                for (kept, wi) in self.wi.iter_mut().zip(candidates.wi) {
                    kept[strip][lane] = if chosen { wi[strip][lane] } else { kept[strip][lane] };
                }
            }
        }
    }
}

impl<A: Sampler, B: Sampler> Ris<A, B> {
    /// RIS with `candidates` draws in total; the first technique gets the extra one of an odd number.
    ///
    /// # Errors
    /// `candidates` is not in 1 to 4096.
    pub fn new(
        first: Covering<A>,
        second: Covering<B>,
        candidates: u32,
        environment: Arc<Environment>,
    ) -> Result<Self> {
        if !(1..=MAX_CANDIDATES).contains(&candidates) {
            return Err(Error::argument("ris", format!("{candidates} candidates: choose 1 to 4096")));
        }
        Ok(Self { first, second, candidates, environment })
    }

    /// Draws candidate `index` of each row and adds it to the reservoirs.
    fn draw(
        &self,
        at: &Rows<'_>,
        states: [&[Lanes]; 2],
        (points, index): (&Points, u32),
        reservoirs: &mut Reservoirs<'_>,
        arena: &Arena,
    ) {
        let of_first = index % 2 == 0;
        let (first, second): ((&dyn Sampler, _), (&dyn Sampler, _)) =
            ((&self.first, states[0]), (&self.second, states[1]));
        let (own, other) = if of_first { (first, second) } else { (second, first) };
        let mut columns = arena.columns::<9>(at.strips());
        let [u, v, x, y, z, own_pdf, target, green, blue] = columns.get_mut();
        let (technique, of) =
            if of_first { (0, self.candidates - self.candidates / 2) } else { (1, self.candidates / 2) };
        let dimension = Dimension::Candidate { technique, index: index / 2, of };
        match index {
            0 => points.draw(dimension, at, [&mut *u, &mut *v, &mut *reservoirs.random]),
            _ => points.draw(dimension, at, [&mut *u, &mut *v]),
        }
        own.0.sample(at, own.1, [u, v], Draws { wi: [x, y, z], pdf: own_pdf }, arena);
        integrand(at, &self.environment, [x, y, z], [target, green, blue], arena);
        for strip in 0..at.strips() {
            for lane in 0..LANES {
                let luminance = 0.2126 * target[strip][lane] + 0.7152 * green[strip][lane] + 0.0722 * blue[strip][lane];
                target[strip][lane] = if own_pdf[strip][lane] > 0.0 { luminance } else { 0.0 };
            }
        }
        self.raise([x, y, z], target, arena);
        let (density, others) = (own_pdf, u);
        timed(Stage::Pdf, || other.0.pdf(at, other.1, [x, y, z], others, arena));
        let of_second = (self.candidates / 2) as f32;
        let of_first_technique = (self.candidates - self.candidates / 2) as f32;
        let (own_count, other_count) =
            if of_first { (of_first_technique, of_second) } else { (of_second, of_first_technique) };
        for (density, other) in density.as_flattened_mut().iter_mut().zip(others.as_flattened()) {
            *density = own_count * *density + other_count * other;
        }
        let [_, _, x, y, z, density, target, ..] = columns.get();
        reservoirs.add(&Candidates { wi: [x, y, z], target, density });
    }
}

impl<A, B> Ris<A, B> {
    /// Raises targets under extreme lamps, as [`Environment::luminance`] does.
    fn raise(&self, wi: [&[Lanes]; 3], targets: &mut [Lanes], arena: &Arena) {
        if !self.environment.has_extreme_lamps() {
            return;
        }
        let mut radiance = arena.columns::<3>(targets.len());
        self.environment.radiances(wi, radiance.get_mut());
        let [red, green, blue] = radiance.get().map(<[Lanes]>::as_flattened);
        for (place, target) in targets.as_flattened_mut().iter_mut().enumerate() {
            let luminance = luminance(Vec3A::new(red[place], green[place], blue[place]));
            // Where there is no light, the target is 0 already.
            *target *= if luminance > 0.0 { self.environment.raised(luminance) / luminance } else { 1.0 };
        }
    }
}

impl<A: Sampler, B: Sampler> Estimator for Ris<A, B> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        let mut columns = arena.columns::<6>(at.strips());
        let [total, x, y, z, target, random] = columns.get_mut();
        timed(Stage::Sampling, || {
            let mut reservoirs =
                Reservoirs { total: &mut *total, wi: [&mut *x, &mut *y, &mut *z], target: &mut *target, random };
            reservoirs.clear();
            prepared(&self.first, at, arena, |first| {
                prepared(&self.second, at, arena, |second| {
                    for index in 0..self.candidates {
                        self.draw(at, [first, second], (points, index), &mut reservoirs, arena);
                    }
                });
            });
        });
        timed(Stage::Shading, || {
            // The unbiased contribution weight, which takes the place of 1 / pdf.
            for (total, target) in total.as_flattened_mut().iter_mut().zip(target.as_flattened()) {
                *total = if *target > 0.0 { *total / target } else { 0.0 };
            }
            contribute(at, &self.environment, [x, y, z], total, out, arena);
        });
    }
}
