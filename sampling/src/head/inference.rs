//! Inference of a head over strips of samples.
//!
//! Networks are bound by multiply-adds: all weights of a head fit into the L2 cache and are read once
//! per strip.

use glam::Vec2;

use super::{Condition, Head, MAX_CONDITION, MIXTURE_WEIGHT_FLOOR, Mode};
use crate::{
    brdf::OF_MATERIAL,
    columns::{Arena, vectorized},
    error::{Error, Result},
    linear::Start,
    sampler::IntermediateDensity,
    simd::{self, LANES, Lanes, Simd},
    spline::{self, Logits, Topology},
    tile::Rows,
};

/// The direction in which a head is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    /// `z -> y`, sampling.
    Forward,
    /// `y -> z`, the density direction.
    Inverse,
}

/// Buffers of one strip between layers.
struct Scratch<'a> {
    /// Condition, then the encoder's output.
    seen: &'a mut [Lanes],
    first_layer: &'a mut [Lanes],
    hidden: [&'a mut [Lanes]; 2],
    logits: &'a mut [Lanes],
}

impl Head {
    /// Number of strips in [`Scratch`].
    fn scratch_strips(&self) -> usize {
        MAX_CONDITION + 4 * self.widest() + self.logits()
    }

    fn widest(&self) -> usize {
        let layers = self.encoder.layers.iter().chain(&self.mixture_weight.layers).map(super::Linear::outputs);
        // Splines need fewer rows of scratch than they have logits.
        layers.chain([self.elevation.widest(), self.azimuth.widest(), MAX_CONDITION]).max().unwrap_or(0)
    }

    /// The larger number of logits of the two splines, whose numbers of bins may differ.
    fn logits(&self) -> usize {
        self.azimuth.outputs().max(self.elevation.outputs())
    }

    fn scratch<'a>(&self, buffer: &'a mut [Lanes]) -> Scratch<'a> {
        let widest = self.widest();
        let (seen, rest) = buffer.split_at_mut(MAX_CONDITION + widest);
        let (first_layer, rest) = rest.split_at_mut(widest);
        let (first, rest) = rest.split_at_mut(widest);
        let (second, logits) = rest.split_at_mut(widest);
        Scratch { seen, first_layer, hidden: [first, second], logits }
    }

    /// Number of state columns of the elevation's network: the condition's part of the first hidden
    /// layer (coupled), or the logits of the spline, which depend only on the condition
    /// (autoregressive). The azimuth's columns follow.
    fn elevation_columns(&self) -> usize {
        match self.mode {
            Mode::Coupled => self.elevation.of_condition.outputs(),
            Mode::Autoregressive => self.elevation.outputs(),
        }
    }

    /// Fills the state from the condition in `scratch.seen`.
    #[inline(always)]
    fn prepare_strip<S: Simd>(&self, simd: S, scratch: &mut Scratch<'_>, state: &mut [Lanes]) {
        self.encode(simd, scratch);
        let Scratch { seen, first_layer, hidden: [first, second], .. } = scratch;
        let (elevation, azimuth) = state.split_at_mut(self.elevation_columns());
        self.azimuth.prepare(simd, seen, azimuth);
        if self.mode == Mode::Autoregressive {
            self.elevation.prepare(simd, seen, first_layer);
            self.elevation.logits(simd, self.leaky_slope, first_layer, &[], [first, second], elevation);
        } else {
            self.elevation.prepare(simd, seen, elevation);
        }
    }

    /// Runs the encoder, which completes `scratch.seen`.
    #[inline(always)]
    fn encode<S: Simd>(&self, simd: S, scratch: &mut Scratch<'_>) {
        let Scratch { seen, hidden: [first, second], .. } = scratch;
        let length = self.condition.length();
        if let Some((last, inner)) = self.encoder.packed.split_last() {
            let (mut from, mut to) = (&mut **first, &mut **second);
            from[..length].copy_from_slice(&seen[..length]);
            for layer in inner {
                layer.forward(simd, Start::Bias, from, to, Some(self.leaky_slope));
                std::mem::swap(&mut from, &mut to);
            }
            last.forward(simd, Start::Bias, from, &mut seen[length..], Some(self.leaky_slope));
        }
    }

    /// The mixture weight against BRDF sampling, from `scratch.seen`: `0.02 + 0.96 sigmoid(logit + prior)`.
    #[inline(always)]
    fn select<S: Simd>(&self, simd: S, scratch: &mut Scratch<'_>, prior: &Lanes) -> Lanes {
        let Scratch { seen, hidden: [first, _], logits, .. } = scratch;
        let mut mixture_weight = [0.5; LANES];
        if let [inner, last] = &self.mixture_weight.packed[..] {
            inner.forward(simd, Start::Bias, seen, first, Some(self.leaky_slope));
            last.forward(simd, Start::Bias, first, logits, None);
            for l in 0..LANES {
                mixture_weight[l] =
                    MIXTURE_WEIGHT_FLOOR + (1.0 - 2.0 * MIXTURE_WEIGHT_FLOOR) * simd::sigmoid(logits[0][l] + prior[l]);
            }
        }
        mixture_weight
    }

    /// Evaluates both splines in one direction: images of `(u, v)`, and the densities over Y.
    #[inline(always)]
    fn warp<S: Simd>(
        &self,
        simd: S,
        direction: Direction,
        scratch: &mut Scratch<'_>,
        state: &[Lanes],
        [u, v]: [&Lanes; 2],
    ) -> [Lanes; 3] {
        let (image_u, image_v, d_u, d_v);
        // Coupled: F0(y_v; y_u), then F1(y_u; z_v). Sampling inverts F1 first.
        if direction == Direction::Forward && self.mode == Mode::Coupled {
            (image_u, d_u) = self.azimuth_spline(simd, direction, scratch, state, u, v);
            (image_v, d_v) = self.elevation_spline(simd, direction, scratch, state, v, &image_u);
        } else {
            (image_v, d_v) = self.elevation_spline(simd, direction, scratch, state, v, u);
            let y_v = if direction == Direction::Forward { &image_v } else { v };
            let seen = if self.mode == Mode::Coupled { &image_v } else { y_v };
            (image_u, d_u) = self.azimuth_spline(simd, direction, scratch, state, u, seen);
        }
        let mut density = [0.0; LANES];
        for l in 0..LANES {
            density[l] = d_u[l] * d_v[l];
        }
        [image_u, image_v, density]
    }

    #[inline(always)]
    fn azimuth_spline<S: Simd>(
        &self,
        simd: S,
        direction: Direction,
        scratch: &mut Scratch<'_>,
        state: &[Lanes],
        u: &Lanes,
        seen: &Lanes,
    ) -> (Lanes, Lanes) {
        let Scratch { hidden: [first, second], logits, .. } = scratch;
        let logits = &mut logits[..self.azimuth.outputs()];
        let state = &state[self.elevation_columns()..];
        self.azimuth.logits(simd, self.leaky_slope, state, &[*seen], [first, second], logits);
        evaluate(self.azimuth.topology, direction, logits, first, u)
    }

    #[inline(always)]
    fn elevation_spline<S: Simd>(
        &self,
        simd: S,
        direction: Direction,
        scratch: &mut Scratch<'_>,
        state: &[Lanes],
        v: &Lanes,
        seen: &Lanes,
    ) -> (Lanes, Lanes) {
        let Scratch { hidden: [first, second], logits, .. } = scratch;
        let state = &state[..self.elevation_columns()];
        if self.mode == Mode::Autoregressive {
            return evaluate(self.elevation.topology, direction, state, first, v);
        }
        let (mut cos, mut sin) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            (cos[l], sin[l]) = simd::cos_sin_turns(seen[l]);
        }
        let logits = &mut logits[..self.elevation.outputs()];
        self.elevation.logits(simd, self.leaky_slope, state, &[cos, sin], [first, second], logits);
        evaluate(self.elevation.topology, direction, logits, first, v)
    }

    /// Prepares the head for a condition vector of [`super::Condition::length`] numbers.
    ///
    /// # Errors
    /// The vector has a different length.
    pub fn at(&self, condition: &[f32]) -> Result<HeadAt<'_>> {
        let length = self.condition.length();
        if condition.len() != length {
            let reason = format!("has {} numbers, and the head takes {length}", condition.len());
            return Err(Error::argument("condition", reason));
        }
        let mut lanes = [[0.0; LANES]; MAX_CONDITION];
        for (lanes, &number) in lanes.iter_mut().zip(condition) {
            *lanes = [number; LANES];
        }
        let (mut state, mut mixture_weight) = (vec![[0.0; LANES]; self.columns()], [0.0; LANES]);
        let mut scratch = vec![[0.0; LANES]; self.scratch_strips()];
        prepare_one(self, &lanes, &mut scratch, &mut state, &mut mixture_weight);
        Ok(HeadAt { head: self, state, mixture_weight: mixture_weight[0] })
    }
}

/// Evaluates splines given their logits: images of `at`, and `|dz/dy|` there.
#[inline(always)]
fn evaluate(
    topology: Topology,
    direction: Direction,
    logits: &[Lanes],
    scratch: &mut [Lanes],
    at: &Lanes,
) -> (Lanes, Lanes) {
    match direction {
        Direction::Forward => spline::forward(topology, Logits::strip(logits), scratch, at),
        Direction::Inverse => spline::inverse(topology, Logits::strip(logits), scratch, at),
    }
}

/// A head at one condition, which all lanes of a strip share.
#[derive(Clone, Debug)]
pub struct HeadAt<'a> {
    head: &'a Head,
    state: Vec<Lanes>,
    mixture_weight: f32,
}

impl HeadAt<'_> {
    /// The head's mixture weight against BRDF sampling.
    pub fn mixture_weight(&self) -> f32 {
        self.mixture_weight
    }

    /// Maps uniform points `z` to `(y, density over Y)`.
    pub fn sample(&self, z: &[Vec2]) -> Vec<(Vec2, f32)> {
        self.map(Direction::Forward, z)
    }

    /// Maps points `y` to `(z, density over Y)`: the density direction.
    pub fn invert(&self, y: &[Vec2]) -> Vec<(Vec2, f32)> {
        self.map(Direction::Inverse, y)
    }

    fn map(&self, direction: Direction, points: &[Vec2]) -> Vec<(Vec2, f32)> {
        let mut scratch = vec![[0.0; LANES]; self.head.scratch_strips()];
        let strip = |points: &[Vec2]| {
            let (mut from, mut to, mut q) = ([[[0.5; LANES]]; 2], [[[0.0; LANES]]; 2], [[0.0; LANES]]);
            for (k, point) in points.iter().enumerate() {
                (from[0][0][k], from[1][0][k]) = (point.x, point.y);
            }
            let [u, v] = &mut to;
            warp_strips(self.head, direction, &self.state, [&from[0], &from[1]], [u, v], &mut q, &mut scratch);
            (0..points.len()).map(|k| (Vec2::new(to[0][0][k], to[1][0][k]), q[0][k])).collect::<Vec<_>>()
        };
        points.chunks(LANES).flat_map(strip).collect()
    }
}

vectorized! {
    fn prepare_one['a](
        simd, head: &'a Head, condition: &'a [Lanes; MAX_CONDITION],
        scratch: &'a mut [Lanes], state: &'a mut [Lanes], mixture_weight: &'a mut Lanes,
    ) {
        let mut scratch = head.scratch(scratch);
        scratch.seen[..MAX_CONDITION].copy_from_slice(condition);
        head.prepare_strip(simd, &mut scratch, state);
        *mixture_weight = head.select(simd, &mut scratch, &[0.0; LANES]);
    }
}

vectorized! {
    /// Prepares rows; with an empty `state`, replaces the prior logits in `mixture_weights` by mixture weights
    /// instead.
    fn prepare_rows['a](
        simd, head: &'a Head, at: &'a Rows<'a>, material: [&'a [Lanes]; OF_MATERIAL],
        state: &'a mut [Lanes], mixture_weights: &'a mut [Lanes], scratch: &'a mut [Lanes],
    ) {
        let mut scratch = head.scratch(scratch);
        let columns = head.columns();
        for strip in 0..at.strips() {
            let mut own = [[1.0; LANES]; OF_MATERIAL];
            for (own, column) in own.iter_mut().zip(material).take(head.condition.of_material()) {
                *own = column[strip];
            }
            head.condition.load(&at.normals(strip), &at.views(strip), &own, scratch.seen);
            if state.is_empty() {
                head.encode(simd, &mut scratch);
                mixture_weights[strip] = head.select(simd, &mut scratch, &mixture_weights[strip]);
            } else {
                head.prepare_strip(simd, &mut scratch, &mut state[strip * columns..][..columns]);
            }
        }
    }
}

vectorized! {
    fn warp_strips['a](
        simd, head: &'a Head, direction: Direction, state: &'a [Lanes], from: [&'a [Lanes]; 2],
        to: [&'a mut [Lanes]; 2], q: &'a mut [Lanes], scratch: &'a mut [Lanes],
    ) {
        let mut scratch = head.scratch(scratch);
        let columns = head.columns();
        let [to_u, to_v] = to;
        for strip in 0..q.len() {
            let state = &state[strip * columns..][..columns];
            let [u, v, density] = head.warp(simd, direction, &mut scratch, state, [&from[0][strip], &from[1][strip]]);
            (to_u[strip], to_v[strip], q[strip]) = (u, v, density);
        }
    }
}

impl IntermediateDensity for Head {
    fn columns(&self) -> usize {
        self.elevation_columns() + self.azimuth.of_condition.outputs()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.with_conditions(at, arena, |material, scratch| {
            prepare_rows(self, at, material, state, &mut [], scratch);
        });
    }

    fn sample(
        &self,
        _at: &Rows<'_>,
        state: &[Lanes],
        z: [&[Lanes]; 2],
        y: [&mut [Lanes]; 2],
        q: &mut [Lanes],
        arena: &Arena,
    ) {
        let mut scratch = arena.columns::<1>(self.scratch_strips());
        warp_strips(self, Direction::Forward, state, z, y, q, scratch.get_mut()[0]);
    }

    fn density(&self, at: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], q: &mut [Lanes], arena: &Arena) {
        let (mut scratch, mut z) = (arena.columns::<1>(self.scratch_strips()), arena.columns::<2>(at.strips()));
        warp_strips(self, Direction::Inverse, state, y, z.get_mut(), q, scratch.get_mut()[0]);
    }

    fn mixture_weight(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        out.as_flattened_mut().fill(0.0);
        self.mixture_weight_after(at, out, arena);
    }
}

impl Head {
    /// [`IntermediateDensity::mixture_weight`] with prior logits in `out`, which are added to the learned ones;
    /// 1/2 if none are learned.
    pub fn mixture_weight_after(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        if self.has_mixture_weight() {
            self.with_conditions(at, arena, |material, scratch| {
                prepare_rows(self, at, material, &mut [], out, scratch);
            });
        } else {
            out.as_flattened_mut().fill(0.5);
        }
    }

    /// Calls `work` with the material's columns of the condition, and with scratch.
    fn with_conditions(&self, at: &Rows<'_>, arena: &Arena, work: impl FnOnce([&[Lanes]; OF_MATERIAL], &mut [Lanes])) {
        let known = if self.condition.of_material() > 0 { at.strips() } else { 0 };
        let (mut material, mut scratch) =
            (arena.columns::<OF_MATERIAL>(known), arena.columns::<1>(self.scratch_strips()));
        match self.condition {
            Condition::Normal | Condition::Ggx => (),
            Condition::GgxRoughness => at.alpha(material.get_mut()[0], arena),
            Condition::Family => {
                let [a, b, c, d, e, f, ..] = material.get_mut();
                at.latents([a, b, c, d, e, f], arena);
            }
            Condition::Texture => at.textures(material.get_mut(), arena),
        }
        work(material.get(), scratch.get_mut()[0]);
    }
}
