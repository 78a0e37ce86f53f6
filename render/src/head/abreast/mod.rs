//! Inference for many samples: [`LANES`] go through networks and splines abreast.
//!
//! The results are those of [`Head`](super::Head)'s functions of one point, to rounding; those are the oracle in tests. Networks are
//! bound by multiply-adds: all weights of a head fit the second-level cache and are read once per strip of [`LANES`] samples.

mod linear;
mod spline;
#[cfg(test)]
mod tests;

use glam::Vec2;

use super::{Condition, MAX_CONDITION, MAX_HIDDEN, Mode, PreparedHead, SELECTION_FLOOR, SplineNetwork, Topology};
use crate::{
    head::{Linear, network::MAX_LOGITS},
    sampler::ShadingPoint,
    simd::{self, LANES, Lanes, Simd, Vectorized},
};
use linear::{LinearAbreast, Start};
use spline::Direction;

/// A head's networks in the order in which strips read their weights.
#[derive(Clone, Debug)]
pub(super) struct HeadAbreast {
    condition: Condition,
    mode: Mode,
    slope: f32,
    encoder: Vec<LinearAbreast>,
    elevation: NetworkAbreast,
    azimuth: NetworkAbreast,
    selection: Vec<LinearAbreast>,
}

/// A spline network; its first layer is split into what the condition gives and what the other coordinate gives.
#[derive(Clone, Debug)]
struct NetworkAbreast {
    topology: Topology,
    of_condition: LinearAbreast,
    of_features: LinearAbreast,
    later: Vec<LinearAbreast>,
}

/// Numbers of one strip between layers.
struct Strip {
    /// Condition, then the encoder's output.
    seen: Vec<Lanes>,
    /// What depends on the condition alone, see [`PreparedHead`].
    elevation: Vec<Lanes>,
    azimuth: Vec<Lanes>,
    hidden: [Vec<Lanes>; 2],
    logits: Vec<Lanes>,
}

/// What is asked of a head for many samples. All slices have equal length.
pub(super) enum Job<'a> {
    /// Prepares shading points: the matrices of [`PreparedHead`], one for each strip, and the shares. Not of equal length.
    Prepare { at: &'a [ShadingPoint], values: &'a mut Vec<f32>, shares: &'a mut Vec<f32> },
    /// Prepares shading points and carries a point `z` to `(y, density over Y)` for each.
    Sample { at: &'a [ShadingPoint], z: &'a [Vec2], y: &'a mut [Vec2], q: &'a mut [f32] },
    /// The same for points that have been prepared.
    SamplePrepared { prepared: &'a [&'a PreparedHead], z: &'a [Vec2], y: &'a mut [Vec2], q: &'a mut [f32] },
    /// Prepares shading points and gives the density over Y at a point for each.
    DensityAt { at: &'a [ShadingPoint], y: &'a [Vec2], q: &'a mut [f32] },
    /// The share of samples beside BRDF sampling for each shading point.
    Share { at: &'a [ShadingPoint], shares: &'a mut [f32] },
    /// The densities over Y at given points.
    Density { prepared: &'a [&'a PreparedHead], y: &'a [Vec2], q: &'a mut [f32] },
}

impl HeadAbreast {
    pub fn new(
        (condition, mode, slope): (Condition, Mode, f32),
        encoder: &[Linear],
        [elevation, azimuth]: [&SplineNetwork; 2],
    ) -> Self {
        Self {
            condition,
            mode,
            slope,
            encoder: encoder.iter().map(LinearAbreast::new).collect(),
            elevation: NetworkAbreast::new(elevation),
            azimuth: NetworkAbreast::new(azimuth),
            selection: Vec::new(),
        }
    }

    /// With the network of the learned selection probability.
    pub fn with_selection(self, selection: &[Linear]) -> Self {
        Self { selection: selection.iter().map(LinearAbreast::new).collect(), ..self }
    }

    /// Does a job with the best instructions that the processor has.
    pub fn run(&self, job: Job<'_>) {
        simd::dispatch(Work { head: self, job });
    }

    /// From the condition in `strip.seen` to what depends on it alone.
    #[inline(always)]
    fn prepare<S: Simd>(&self, simd: S, strip: &mut Strip) {
        self.encode(simd, strip);
        let Strip { seen, elevation, azimuth, hidden, logits, .. } = strip;
        self.azimuth.of_condition.forward(simd, Start::Bias, seen, azimuth, None);
        self.elevation.of_condition.forward(simd, Start::Bias, seen, elevation, None);
        if self.mode == Mode::Autoregressive {
            let logits = &mut logits[..self.elevation.outputs()];
            self.elevation.logits(simd, self.slope, elevation, &[], hidden, logits);
            elevation[..logits.len()].copy_from_slice(logits);
        }
    }

    /// The encoder, which completes `strip.seen`.
    #[inline(always)]
    fn encode<S: Simd>(&self, simd: S, strip: &mut Strip) {
        let Strip { seen, hidden, .. } = strip;
        let length = self.condition.length();
        if let Some((last, inner)) = self.encoder.split_last() {
            let [mut from, mut to] = hidden.each_mut();
            from[..length].copy_from_slice(&seen[..length]);
            for layer in inner {
                layer.forward(simd, Start::Bias, from, to, Some(self.slope));
                std::mem::swap(&mut from, &mut to);
            }
            last.forward(simd, Start::Bias, from, &mut seen[length..], Some(self.slope));
        }
    }

    /// The share of samples beside BRDF sampling, from `strip.seen`; 1/2 where nothing was learned.
    #[inline(always)]
    fn select<S: Simd>(&self, simd: S, strip: &mut Strip) -> Lanes {
        let Strip { seen, hidden, logits, .. } = strip;
        let mut share = [0.5; LANES];
        if let [first, second] = &self.selection[..] {
            first.forward(simd, Start::Bias, seen, &mut hidden[0], Some(self.slope));
            second.forward(simd, Start::Bias, &hidden[0], logits, None);
            for l in 0..LANES {
                share[l] = SELECTION_FLOOR + (1.0 - 2.0 * SELECTION_FLOOR) * simd::sigmoid(logits[0][l]);
            }
        }
        share
    }

    /// Both splines in one direction: images of `(u, v)`, and the densities over Y.
    #[inline(always)]
    fn warp<S: Simd>(&self, simd: S, direction: Direction, strip: &mut Strip, u: &Lanes, v: &Lanes) -> [Lanes; 3] {
        let (image_u, image_v, by_u, by_v);
        // Coupled: F0(y_v; y_u), then F1(y_u; z_v). Sampling undoes F1 first.
        if direction == Direction::Forward && self.mode == Mode::Coupled {
            (image_u, by_u) = self.of_azimuth(simd, direction, strip, u, v);
            (image_v, by_v) = self.of_elevation(simd, direction, strip, v, &image_u);
        } else {
            (image_v, by_v) = self.of_elevation(simd, direction, strip, v, u);
            let y_v = if direction == Direction::Forward { &image_v } else { v };
            let seen = if self.mode == Mode::Coupled { &image_v } else { y_v };
            (image_u, by_u) = self.of_azimuth(simd, direction, strip, u, seen);
        }
        let mut density = [0.0; LANES];
        for l in 0..LANES {
            density[l] = by_u[l] * by_v[l];
        }
        [image_u, image_v, density]
    }

    #[inline(always)]
    fn of_azimuth<S: Simd>(
        &self,
        simd: S,
        direction: Direction,
        strip: &mut Strip,
        u: &Lanes,
        seen: &Lanes,
    ) -> (Lanes, Lanes) {
        let Strip { azimuth, hidden, logits, .. } = strip;
        let logits = &mut logits[..self.azimuth.outputs()];
        self.azimuth.logits(simd, self.slope, azimuth, &[*seen], hidden, logits);
        spline::evaluate(simd, self.azimuth.topology, direction, logits, u)
    }

    #[inline(always)]
    fn of_elevation<S: Simd>(
        &self,
        simd: S,
        direction: Direction,
        strip: &mut Strip,
        v: &Lanes,
        seen: &Lanes,
    ) -> (Lanes, Lanes) {
        let Strip { elevation, hidden, logits, .. } = strip;
        let logits = &mut logits[..self.elevation.outputs()];
        if self.mode == Mode::Autoregressive {
            logits.copy_from_slice(&elevation[..self.elevation.outputs()]);
        } else {
            let (mut cos, mut sin) = ([0.0; LANES], [0.0; LANES]);
            for l in 0..LANES {
                (cos[l], sin[l]) = simd::cos_sin_turns(seen[l]);
            }
            self.elevation.logits(simd, self.slope, elevation, &[cos, sin], hidden, logits);
        }
        spline::evaluate(simd, self.elevation.topology, direction, logits, v)
    }

    /// Rows of [`PreparedHead`] that belong to the elevation and to the azimuth.
    fn rows(&self) -> (usize, usize) {
        let of_elevation = match self.mode {
            Mode::Coupled => self.elevation.of_condition.outputs(),
            Mode::Autoregressive => self.elevation.outputs(),
        };
        (of_elevation, self.azimuth.of_condition.outputs())
    }

    fn strip(&self) -> Strip {
        let lanes = |count: usize| vec![[0.0; LANES]; count];
        let networks = [&self.elevation, &self.azimuth];
        let layers = networks.into_iter().flat_map(NetworkAbreast::layers).chain(&self.encoder).chain(&self.selection);
        let widest = layers.map(LinearAbreast::outputs).max().unwrap_or(0).max(MAX_CONDITION);
        Strip {
            seen: lanes(MAX_CONDITION + widest),
            elevation: lanes(widest),
            azimuth: lanes(widest),
            hidden: [lanes(widest), lanes(widest)],
            // The two splines may have different numbers of bins.
            logits: lanes(self.azimuth.outputs().max(self.elevation.outputs())),
        }
    }
}

impl NetworkAbreast {
    fn new(network: &SplineNetwork) -> Self {
        let (first, later) = network.layers().split_first().expect("a network has layers");
        let seen = network.condition();
        Self {
            topology: network.topology(),
            of_condition: LinearAbreast::part(first, 0, seen),
            of_features: LinearAbreast::part(first, seen, first.inputs() - seen),
            later: later.iter().map(LinearAbreast::new).collect(),
        }
    }

    fn layers(&self) -> impl Iterator<Item = &LinearAbreast> {
        [&self.of_condition, &self.of_features].into_iter().chain(&self.later)
    }

    fn outputs(&self) -> usize {
        self.later.last().map_or(0, LinearAbreast::outputs)
    }

    /// Logits from the condition's part of the first layer and the other coordinate's features.
    #[inline(always)]
    fn logits<S: Simd>(
        &self,
        simd: S,
        slope: f32,
        prepared: &[Lanes],
        features: &[Lanes],
        hidden: &mut [Vec<Lanes>; 2],
        logits: &mut [Lanes],
    ) {
        let [mut from, mut to] = hidden.each_mut();
        self.of_features.forward(simd, Start::Of(prepared), features, from, Some(slope));
        let (last, inner) = self.later.split_last().expect("a network has at least two layers");
        for layer in inner {
            layer.forward(simd, Start::Bias, from, to, Some(slope));
            std::mem::swap(&mut from, &mut to);
        }
        last.forward(simd, Start::Bias, from, logits, None);
    }
}

struct Work<'a> {
    head: &'a HeadAbreast,
    job: Job<'a>,
}

impl Vectorized for Work<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let head = self.head;
        let mut strip = head.strip();
        match self.job {
            Job::Prepare { at, values, shares } => {
                for at in at.chunks(LANES) {
                    load_conditions(head.condition, at, &mut strip.seen);
                    head.prepare(simd, &mut strip);
                    let (of_elevation, of_azimuth) = head.rows();
                    values.extend_from_slice(strip.elevation[..of_elevation].as_flattened());
                    values.extend_from_slice(strip.azimuth[..of_azimuth].as_flattened());
                    shares.extend_from_slice(&head.select(simd, &mut strip)[..at.len()]);
                }
            }
            Job::Sample { at, z, y, q } => {
                let chunks = at.chunks(LANES).zip(z.chunks(LANES));
                for (((at, z), y), q) in chunks.zip(y.chunks_mut(LANES)).zip(q.chunks_mut(LANES)) {
                    load_conditions(head.condition, at, &mut strip.seen);
                    head.prepare(simd, &mut strip);
                    warp_chunk(simd, head, Direction::Forward, &mut strip, z, Some(y), q);
                }
            }
            Job::SamplePrepared { prepared, z, y, q } => {
                let chunks = prepared.chunks(LANES).zip(z.chunks(LANES));
                for (((prepared, z), y), q) in chunks.zip(y.chunks_mut(LANES)).zip(q.chunks_mut(LANES)) {
                    load_prepared(head, prepared, &mut strip);
                    warp_chunk(simd, head, Direction::Forward, &mut strip, z, Some(y), q);
                }
            }
            Job::DensityAt { at, y, q } => {
                for ((at, y), q) in at.chunks(LANES).zip(y.chunks(LANES)).zip(q.chunks_mut(LANES)) {
                    load_conditions(head.condition, at, &mut strip.seen);
                    head.prepare(simd, &mut strip);
                    warp_chunk(simd, head, Direction::Inverse, &mut strip, y, None, q);
                }
            }
            Job::Share { at, shares } => {
                for (at, shares) in at.chunks(LANES).zip(shares.chunks_mut(LANES)) {
                    load_conditions(head.condition, at, &mut strip.seen);
                    head.encode(simd, &mut strip);
                    shares.copy_from_slice(&head.select(simd, &mut strip)[..shares.len()]);
                }
            }
            Job::Density { prepared, y, q } => {
                let chunks = prepared.chunks(LANES).zip(y.chunks(LANES));
                for ((prepared, y), q) in chunks.zip(q.chunks_mut(LANES)) {
                    load_prepared(head, prepared, &mut strip);
                    warp_chunk(simd, head, Direction::Inverse, &mut strip, y, None, q);
                }
            }
        }
    }
}

/// Conditions of at most [`LANES`] points; lanes without a point keep what they had, which nobody reads.
#[inline(always)]
fn load_conditions(condition: Condition, at: &[ShadingPoint], seen: &mut [Lanes]) {
    for (lane, at) in at.iter().enumerate() {
        let numbers = condition.of(at);
        for (seen, number) in seen[..condition.length()].iter_mut().zip(numbers) {
            seen[lane] = number;
        }
    }
}

/// Columns of at most [`LANES`] prepared points; lanes without a point keep what they had, which nobody reads.
#[inline(always)]
fn load_prepared(head: &HeadAbreast, prepared: &[&PreparedHead], strip: &mut Strip) {
    let (of_elevation, of_azimuth) = head.rows();
    let (elevation, azimuth) = (&mut strip.elevation[..of_elevation], &mut strip.azimuth[..of_azimuth]);
    let first = prepared[0];
    let is_next = |(lane, p): (usize, &&PreparedHead)| {
        std::sync::Arc::ptr_eq(&p.values, &first.values) && p.start == first.start + lane && p.stride == LANES
    };
    // A strip as it was prepared. Its first column begins at a whole strip.
    if first.start.is_multiple_of(LANES) && prepared.iter().enumerate().all(is_next) {
        let (strips, _) = first.values[first.start..].as_chunks::<LANES>();
        elevation.copy_from_slice(&strips[..of_elevation]);
        azimuth.copy_from_slice(&strips[of_elevation..of_elevation + of_azimuth]);
        return;
    }
    for (lane, prepared) in prepared.iter().enumerate() {
        let column = prepared.values[prepared.start..].iter().step_by(prepared.stride);
        for (lanes, &number) in elevation.iter_mut().chain(&mut *azimuth).zip(column) {
            lanes[lane] = number;
        }
    }
}

/// At most [`LANES`] points through a prepared strip.
#[inline(always)]
fn warp_chunk<S: Simd>(
    simd: S,
    head: &HeadAbreast,
    direction: Direction,
    strip: &mut Strip,
    at: &[Vec2],
    images: Option<&mut [Vec2]>,
    q: &mut [f32],
) {
    let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
    for (lane, at) in at.iter().enumerate() {
        (u[lane], v[lane]) = (at.x, at.y);
    }
    let [image_u, image_v, density] = head.warp(simd, direction, strip, &u, &v);
    for (lane, image) in images.into_iter().flatten().enumerate() {
        *image = Vec2::new(image_u[lane], image_v[lane]);
    }
    q.copy_from_slice(&density[..q.len()]);
}

/// Logits of the autoregressive elevation spline take the place of its first layer.
const _: () = assert!(MAX_LOGITS <= MAX_HIDDEN);
