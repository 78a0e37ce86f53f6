//! Portal-masked sampling: directions in proportion to the light that comes through portals.
//!
//! After Bitterli, Novák and Jarosz 2015, "Portal-Masked Environment Map Sampling". Here a portal is chosen in proportion to its light
//! times the mean cosine of its corners and its middle, which is 0 where it is below the horizon of the surface. Emitter sampling
//! beside it finds the light that portals miss: with a few of the samples, a sun through a crack is noise and not a rare surprise.

use std::sync::Arc;

use glam::Vec3A;

use super::{
    Portal,
    image::{PortalImage, Span, direction},
};
use crate::{
    columns::{Arena, vectorized},
    discrete::remap,
    environment::Environment,
    sampler::{Coverage, Draws, EmitterSampler, EnvironmentLight, OneSampleMis, Sampler},
    simd::{LANES, Lanes},
    tile::Rows,
};

/// State of a portal at a point: the tangents of its left, right, lower and upper sides, these in pixels, and the probability that it
/// is chosen.
const COLUMNS: usize = 9;
const PIXELS: usize = 4;
const CHANCE: usize = 8;
/// Distance of a point from the plane of a portal over its size, below which the point is not inside.
const LEAST_DISTANCE: f32 = 1e-5;

/// Fraction of the samples beside emitter sampling, at points that see a portal.
const MIXTURE_WEIGHT: f32 = 0.875;

/// The number of no portal.
const NONE: u16 = u16::MAX;

/// Samples the light that comes through portals. Its pdf is 0 in directions that pass through none of them; see
/// [`Self::beside_emitter`].
///
/// ```
/// use std::sync::Arc;
///
/// use glam::Vec3A;
/// use headtail_sampling::{
///     environment::Environment,
///     portals::{Portal, PortalSampler},
///     sampler::EnvironmentLight,
///     tail::TailKind,
/// };
///
/// let window = Portal {
///     center: Vec3A::new(2.0, 1.5, 0.0),
///     normal: Vec3A::NEG_X,
///     up: Vec3A::Y,
///     width: 1.0,
///     height: 1.2,
/// };
/// let environment = Arc::new(Environment::open("sunset")?);
/// let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
/// let sampler = PortalSampler::new(&[window], &environment).beside_emitter(light);
/// # Ok::<(), headtail_sampling::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct PortalSampler {
    pub(super) openings: Vec<Opening>,
}

/// A portal, and the map in its frame.
#[derive(Clone, Debug)]
pub(super) struct Opening {
    pub portal: Portal,
    /// The axes of its width, its height and its normal, and half its size.
    pub axes: [[f32; 3]; 3],
    pub half: [f32; 2],
    /// Portals with the same axes share it.
    pub image: Arc<PortalImage>,
}

impl PortalSampler {
    /// Resamples a map to the frame of each portal: up to 4 MB for each pair of axes.
    ///
    /// # Panics
    /// Its methods panic if there are no portals.
    pub fn new(portals: &[Portal], environment: &Environment) -> Self {
        let mut openings: Vec<Opening> = Vec::new();
        for &portal in portals {
            let same = |own: &&Opening| (own.portal.normal, own.portal.up) == (portal.normal, portal.up);
            let image = match openings.iter().find(same) {
                Some(known) => known.image.clone(),
                None => Arc::new(PortalImage::new(&portal, environment)),
            };
            let axes = [portal.right(), portal.up, portal.normal].map(|axis| axis.to_array());
            openings.push(Opening { portal, axes, half: [0.5 * portal.width, 0.5 * portal.height], image });
        }
        Self { openings }
    }

    /// Returns the mixture with emitter sampling of the same map, which draws all light: 1 of 8 samples from emitter sampling where a
    /// portal is seen, else all.
    pub fn beside_emitter(self, light: EnvironmentLight) -> OneSampleMis<Self, EmitterSampler> {
        OneSampleMis::new(self, EmitterSampler::new(light))
    }

    /// Returns whether two portals have one image.
    #[cfg(test)]
    pub(super) fn shares_image(&self, a: usize, b: usize) -> bool {
        Arc::ptr_eq(&self.openings[a].image, &self.openings[b].image)
    }

    /// Draws for one lane. The pdf leaves out other portals that the direction also passes through.
    #[inline]
    fn draw(&self, state: &[Lanes], lane: usize, u: [f32; 2]) -> Option<Drawn> {
        let chance = |number: usize| state[number * COLUMNS + CHANCE][lane];
        let (mut number, mut from, mut below) = (usize::MAX, 0.0, 0.0);
        for k in 0..self.openings.len() {
            // The last portal takes what is left by rounding.
            if chance(k) > 0.0 && below <= u[0] {
                (number, from) = (k, below);
            }
            below += chance(k);
        }
        let opening = self.openings.get(number)?;
        let within = remap(u[0], from, from + chance(number));
        let (place, density) = opening.image.draw(span(&state[number * COLUMNS..], lane), [within, u[1]]);
        let tangents = place.map(|at| opening.image.tangent(at));
        let pdf = chance(number) * density / opening.image.solid_angle(tangents);
        // A chance is an upper bound: the rectangle itself may be dark.
        (pdf > 0.0).then(|| Drawn { number, wi: direction(&opening.portal, tangents), pdf })
    }
}

/// A direction, and the portal that it was drawn through.
struct Drawn {
    number: usize,
    wi: Vec3A,
    pdf: f32,
}

/// Returns the rectangle of a portal in pixels.
#[inline(always)]
fn span(state: &[Lanes], lane: usize) -> Span {
    [state[PIXELS][lane], state[PIXELS + 1][lane], state[PIXELS + 2][lane], state[PIXELS + 3][lane]]
}

impl Opening {
    /// Returns the density over solid angle within the portal, if it is chosen.
    #[inline]
    fn density(&self, state: &[Lanes], lane: usize, tangents: [f32; 2]) -> f32 {
        let total = self.image.total(span(state, lane));
        let value = self.image.value(tangents.map(|tangent| self.image.pixel(tangent)));
        if total > 0.0 { value / (total * self.image.solid_angle(tangents)) } else { 0.0 }
    }
}

#[inline(always)]
fn dot(axis: [f32; 3], v: &[Lanes; 3], lane: usize) -> f32 {
    axis[0] * v[0][lane] + axis[1] * v[1][lane] + axis[2] * v[2][lane]
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

vectorized! {
    /// Computes the state of every strip.
    fn prepare['a](_simd, openings: &'a [Opening], at: &'a Rows<'a>, state: &'a mut [Lanes]) {
        for (strip, state) in state.chunks_exact_mut(COLUMNS * openings.len()).enumerate() {
            let (p, n) = (at.positions(strip), at.normals(strip));
            let mut sum = [0.0; LANES];
            for (opening, state) in openings.iter().zip(state.chunks_exact_mut(COLUMNS)) {
                sides_and_cosine(opening, &p, &n, state);
                // Lanes beyond the last row are not read, and may be anything.
                for lane in 0..LANES {
                    let cosine = state[CHANCE][lane];
                    let chance = if cosine > 0.0 { cosine * opening.image.bound(span(state, lane)) } else { 0.0 };
                    state[CHANCE][lane] = chance;
                    sum[lane] += chance;
                }
            }
            for state in state.chunks_exact_mut(COLUMNS) {
                for lane in 0..LANES {
                    state[CHANCE][lane] = if sum[lane] > 0.0 { state[CHANCE][lane] / sum[lane] } else { 0.0 };
                }
            }
        }
    }
}

/// Computes the tangents of the sides of a portal, and in place of its chance the mean cosine of corners and middle; 0 for points
/// that are not inside.
#[inline(always)]
fn sides_and_cosine(opening: &Opening, p: &[Lanes; 3], n: &[Lanes; 3], state: &mut [Lanes]) {
    let ([right, up, normal], [half_width, half_height]) = (opening.axes, opening.half);
    let center = opening.portal.center.to_array();
    let own = |axis: [f32; 3]| axis[0] * center[0] + axis[1] * center[1] + axis[2] * center[2];
    let middle = [own(right), own(up), own(normal)];
    let least = LEAST_DISTANCE * (half_width + half_height);
    for lane in 0..LANES {
        let distance = dot(normal, p, lane) - middle[2];
        let per_distance = 1.0 / larger(distance, least);
        let (x, y) = (middle[0] - dot(right, p, lane), middle[1] - dot(up, p, lane));
        let sides = [x - half_width, x + half_width, y - half_height, y + half_height].map(|side| side * per_distance);
        let [left, far, bottom, top] = sides;
        let cosines = [dot(right, n, lane), dot(up, n, lane), dot(normal, n, lane)];
        let sum = cosine(cosines, left, bottom)
            + cosine(cosines, far, bottom)
            + cosine(cosines, left, top)
            + cosine(cosines, far, top)
            + cosine(cosines, 0.5 * (left + far), 0.5 * (bottom + top));
        for side in 0..4 {
            state[side][lane] = sides[side];
            state[PIXELS + side][lane] = opening.image.pixel(sides[side]);
        }
        state[CHANCE][lane] = if distance > least { sum } else { 0.0 };
    }
}

/// Returns the cosine of the direction of two tangents, at least 0, from those of the axes.
#[inline(always)]
fn cosine(of_axes: [f32; 3], x: f32, y: f32) -> f32 {
    larger(x * of_axes[0] + y * of_axes[1] - of_axes[2], 0.0) / (1.0 + x * x + y * y).sqrt()
}

vectorized! {
    /// Adds the pdf of each direction through all portals but the one in `drawn`, which may be empty.
    fn add_densities['a](_simd, openings: &'a [Opening], state: &'a [Lanes], wi: [&'a [Lanes]; 3], drawn: &'a [u16], out: &'a mut [Lanes]) {
        for (strip, state) in state.chunks_exact(COLUMNS * openings.len()).enumerate() {
            let wi = [wi[0][strip], wi[1][strip], wi[2][strip]];
            for (number, (opening, state)) in openings.iter().zip(state.chunks_exact(COLUMNS)).enumerate() {
                let [right, up, normal] = opening.axes;
                let (mut x, mut y, mut z) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
                let mut is_through = [false; LANES];
                for lane in 0..LANES {
                    (x[lane], y[lane], z[lane]) = (dot(right, &wi, lane), dot(up, &wi, lane), -dot(normal, &wi, lane));
                    is_through[lane] = (z[lane] > 0.0)
                        & (state[CHANCE][lane] > 0.0)
                        & (x[lane] >= state[0][lane] * z[lane])
                        & (x[lane] <= state[1][lane] * z[lane])
                        & (y[lane] >= state[2][lane] * z[lane])
                        & (y[lane] <= state[3][lane] * z[lane]);
                }
                for lane in 0..LANES {
                    if is_through[lane] && drawn.get(strip * LANES + lane) != Some(&(number as u16)) {
                        let density = opening.density(state, lane, [x[lane] / z[lane], y[lane] / z[lane]]);
                        out[strip][lane] += state[CHANCE][lane] * density;
                    }
                }
            }
        }
    }
}

impl Sampler for PortalSampler {
    fn columns(&self) -> usize {
        COLUMNS * self.openings.len()
    }

    fn mixes_by_state(&self) -> bool {
        true
    }

    fn mixture_weight(&self, _at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], _arena: &Arena) {
        out.fill([0.0; LANES]);
        for (out, state) in out.iter_mut().zip(state.chunks_exact(self.columns().max(1))) {
            for state in state.chunks_exact(COLUMNS) {
                for lane in 0..LANES {
                    out[lane] = if state[CHANCE][lane] > 0.0 { MIXTURE_WEIGHT } else { out[lane] };
                }
            }
        }
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], _arena: &Arena) {
        prepare(&self.openings, at, state);
    }

    fn sample(&self, _at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let Draws { wi: [x, y, z], pdf } = out;
        let mut drawn = arena.list();
        for (strip, state) in state.chunks_exact(self.columns()).enumerate() {
            for lane in 0..LANES {
                let own = self.draw(state, lane, [u[0][strip][lane], u[1][strip][lane]]);
                drawn.push(own.as_ref().map_or(NONE, |own| own.number as u16));
                let (wi, own) = own.map_or((Vec3A::Z, 0.0), |own| (own.wi, own.pdf));
                (x[strip][lane], y[strip][lane], z[strip][lane], pdf[strip][lane]) = (wi.x, wi.y, wi.z, own);
            }
        }
        add_densities(&self.openings, state, [x, y, z], &drawn, pdf);
        for (pdf, &number) in pdf.as_flattened_mut().iter_mut().zip(drawn.iter()) {
            *pdf = if number == NONE { 0.0 } else { *pdf };
        }
    }

    fn pdf(&self, _at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], _arena: &Arena) {
        out.fill([0.0; LANES]);
        add_densities(&self.openings, state, wi, &[], out);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Part
    }
}
