//! A reparameterised sampler: a network maps uniform points to directions, and its Jacobian, computed in
//! forward mode, gives the density (after Wu et al. 2025, "Neural BRDF Importance Sampling by
//! Reparameterization").
//!
//! Directions are slopes `s = wi.xy / wi.z`, points of a disk `d` are slopes `p = d / sqrt(1 - |d|^2)`, so
//! that the identity from `p` to `s` is cosine sampling. From features, view and `d`, the network computes a
//! shift `t` and a logarithmic scale `b`, and
//!
//! ```text
//! F(p) = exp(b(d)) p + t(d),   pdf(wi) = 1 / (pi (1 + p^2)^2 |det dF/dp| wi.z^3)
//! ```
//!
//! Both are bounded, so that F is homotopic to the identity far out and reaches every direction. F may not be
//! one-to-one, and where several points map to a direction the formula alone would be biased. A deterministic
//! search therefore assigns one point to every direction. A draw from any other point is rejected, and
//! directions whose search fails have the density of a cosine lobe, from which a fraction of the draws comes.
//! The density is thereby exact for all network weights.

use std::f32::consts::FRAC_1_PI;

use super::{
    COORDINATE, DISK_CONDITION,
    columns::Local,
    encoding::{Seen, encode, encoding_slopes},
};
use crate::{
    brdf::neural_texture::FEATURES,
    discrete::BELOW_ONE,
    error::Result,
    head::Linear,
    linear::{Packed, Start as From},
    simd::{self, LANES, Lanes, Simd},
};

/// Sizes of the network: its outputs are the shift (x, y) and the logarithmic scale.
pub const REPARAM_SIZES: [usize; 5] = [DISK_CONDITION, 16, 16, 16, 3];
/// Mixture weight of the cosine lobe.
pub const COSINE_WEIGHT: f32 = 0.05;
/// Largest shift along an axis, as a slope.
pub const LARGEST_SHIFT: f32 = 8.0;
/// Largest absolute value of the logarithm of the scale.
pub const LARGEST_LOG_SCALE: f32 = 3.0;

/// The widest layer.
const WIDEST: usize = 16;
/// Number of steps of the search for the point of a direction, and the largest step relative to
/// `sqrt(1 + p^2)`.
const SEARCH_STEPS: usize = 12;
const LARGEST_STEP: f32 = 0.7;
/// Tolerance in `p`, relative to `sqrt(1 + p^2)`, between the search's result and the point that drew a
/// direction; and in `s`, between the result's direction and the target. Rounding of `s` by f32 is about
/// 1e-6, stretched by `1 / |dF|`.
const SAME_POINT: f32 = 1e-2;
const SAME_SLOPE: f32 = 1e-3;

/// The sampler.
#[derive(Clone, Debug)]
pub struct Reparameterised {
    layers: Vec<Linear>,
    /// The first layer's parts for features and view, and for the disk; then the other layers.
    packed: Vec<Packed>,
}

/// The first layer's contribution from features and view.
pub(super) type Start = [Lanes; WIDEST];

/// A strip of values of F, with the columns of its Jacobian.
pub(super) struct Mapped {
    pub s: [Lanes; 2],
    /// `ds/dp_x` and `ds/dp_y`.
    pub by: [[Lanes; 2]; 2],
}

impl Mapped {
    #[inline(always)]
    pub(super) fn determinant(&self, lane: usize) -> f32 {
        self.by[0][0][lane] * self.by[1][1][lane] - self.by[0][1][lane] * self.by[1][0][lane]
    }
}

impl Reparameterised {
    pub(super) fn new(networks: Vec<Vec<Linear>>) -> Result<Self> {
        let [layers] = super::file::of_count(networks)?;
        super::file::check_sizes("warp", &REPARAM_SIZES, &layers)?;
        let known = FEATURES + 2;
        let mut packed = vec![Packed::part(&layers[0], 0, known), Packed::part(&layers[0], known, 2 * COORDINATE)];
        packed.extend(layers[1..].iter().map(Packed::new));
        Ok(Self { layers, packed })
    }

    pub(super) fn networks(&self) -> Vec<&[Linear]> {
        vec![&self.layers]
    }

    /// The first layer's contribution from features and view.
    #[inline(always)]
    pub(super) fn start<S: Simd>(&self, simd: S, seen: &Seen) -> Start {
        let mut input = [[0.0; LANES]; FEATURES + 2];
        input[..FEATURES].copy_from_slice(&seen.features);
        (input[FEATURES], input[FEATURES + 1]) = (seen.wo[0], seen.wo[1]);
        let mut out = [[0.0; LANES]; WIDEST];
        self.packed[0].forward(simd, From::Bias, &input, &mut out, None);
        out
    }

    /// Evaluates the network and its derivatives by both coordinates of the disk.
    #[inline(always)]
    fn network<S: Simd>(&self, simd: S, start: &Start, d: &[Lanes; 2]) -> [[Lanes; WIDEST]; 3] {
        let zeros = [[0.0; LANES]; WIDEST];
        let mut input = [[0.0; LANES]; 2 * COORDINATE];
        let mut slopes = [[[0.0; LANES]; 2 * COORDINATE]; 2];
        for axis in 0..2 {
            let range = axis * COORDINATE..(axis + 1) * COORDINATE;
            encode(&d[axis], &mut input[range.clone()]);
            let encoded = &input[range.clone()];
            encoding_slopes(encoded, &mut slopes[axis][range]);
        }
        let mut x = [zeros; 3];
        self.packed[1].forward(simd, From::Of(start), &input, &mut x[0], None);
        self.packed[1].forward(simd, From::Of(&zeros), &slopes[0], &mut x[1], None);
        self.packed[1].forward(simd, From::Of(&zeros), &slopes[1], &mut x[2], None);
        for layer in &self.packed[2..] {
            let [value, by_x, by_y] = &mut x;
            for k in 0..WIDEST {
                for lane in 0..LANES {
                    let v = value[k][lane];
                    let sigmoid = simd::sigmoid(v);
                    let slope = sigmoid * (1.0 + v * (1.0 - sigmoid));
                    value[k][lane] = v * sigmoid;
                    by_x[k][lane] *= slope;
                    by_y[k][lane] *= slope;
                }
            }
            let mut next = [zeros; 3];
            layer.forward(simd, From::Bias, &x[0], &mut next[0], None);
            layer.forward(simd, From::Of(&zeros), &x[1], &mut next[1], None);
            layer.forward(simd, From::Of(&zeros), &x[2], &mut next[2], None);
            x = next;
        }
        x
    }

    /// Evaluates F with its Jacobian.
    #[inline(always)]
    pub(super) fn map<S: Simd>(&self, simd: S, start: &Start, p: &[Lanes; 2]) -> Mapped {
        let (mut d, mut inverse) = ([[0.0; LANES]; 2], [0.0; LANES]);
        for lane in 0..LANES {
            inverse[lane] = 1.0 / (1.0 + p[0][lane] * p[0][lane] + p[1][lane] * p[1][lane]).sqrt();
            d[0][lane] = p[0][lane] * inverse[lane];
            d[1][lane] = p[1][lane] * inverse[lane];
        }
        let [raw, by_dx, by_dy] = self.network(simd, start, &d);
        let zero = [0.0; LANES];
        let mut out = Mapped { s: [zero; 2], by: [[zero; 2]; 2] };
        for lane in 0..LANES {
            let (x, y, i) = (d[0][lane], d[1][lane], inverse[lane]);
            // dd/dp, symmetric.
            let (xx, xy, yy) = (i * (1.0 - x * x), -i * x * y, i * (1.0 - y * y));
            let (b, b_slope) = bounded(raw[2][lane], LARGEST_LOG_SCALE);
            let scale = simd::exp(b);
            let (dx, dy) = (by_dx[2][lane], by_dy[2][lane]);
            let b_x = scale * b_slope * (dx * xx + dy * xy);
            let b_y = scale * b_slope * (dx * xy + dy * yy);
            for axis in 0..2 {
                let (t, t_slope) = bounded(raw[axis][lane], LARGEST_SHIFT);
                let (dx, dy) = (by_dx[axis][lane], by_dy[axis][lane]);
                let (t_x, t_y) = (dx * xx + dy * xy, dx * xy + dy * yy);
                let own = p[axis][lane];
                out.s[axis][lane] = scale * own + t;
                out.by[0][axis][lane] = b_x * own + t_slope * t_x + if axis == 0 { scale } else { 0.0 };
                out.by[1][axis][lane] = b_y * own + t_slope * t_y + if axis == 1 { scale } else { 0.0 };
            }
        }
        out
    }

    /// Returns the point that the search assigns to a direction, equal for equal directions; and the density
    /// there without the cosine lobe, 0 where the search fails.
    #[inline(always)]
    pub(super) fn search<S: Simd>(&self, simd: S, start: &Start, wi: &[Lanes; 3]) -> ([Lanes; 2], Lanes) {
        let mut s = [[0.0; LANES]; 2];
        for axis in 0..2 {
            for lane in 0..LANES {
                s[axis][lane] = wi[axis][lane] / wi[2][lane];
            }
        }
        // Newton's steps of bounded length from the centre.
        let mut p = [[0.0; LANES]; 2];
        for _ in 0..SEARCH_STEPS {
            let there = self.map(simd, start, &p);
            for lane in 0..LANES {
                let (x, y) = (s[0][lane] - there.s[0][lane], s[1][lane] - there.s[1][lane]);
                let determinant = there.determinant(lane);
                let by = 1.0 / if determinant.abs() > 1e-12 { determinant } else { 1e-12 };
                let dx = by * (there.by[1][1][lane] * x - there.by[1][0][lane] * y);
                let dy = by * (there.by[0][0][lane] * y - there.by[0][1][lane] * x);
                let length = (dx * dx + dy * dy).sqrt();
                let most = LARGEST_STEP * size(p[0][lane], p[1][lane]);
                let scale = if length > most { most / length } else { 1.0 };
                p[0][lane] += scale * dx;
                p[1][lane] += scale * dy;
            }
        }
        let there = self.map(simd, start, &p);
        let mut density = [0.0; LANES];
        for lane in 0..LANES {
            let (x, y) = (s[0][lane] - there.s[0][lane], s[1][lane] - there.s[1][lane]);
            let found =
                (x * x + y * y).sqrt() < SAME_SLOPE * size(s[0][lane], s[1][lane]) * determinant_root(&there, lane);
            let squared = size(p[0][lane], p[1][lane]);
            let squared = squared * squared;
            let z = wi[2][lane];
            let own = FRAC_1_PI / (squared * squared * there.determinant(lane).abs() * z * z * z);
            density[lane] = if found & (own < 1e30) { own } else { 0.0 };
        }
        (p, density)
    }
}

/// Returns the change of `p` that changes the disk's point by about 1.
#[inline(always)]
pub(super) fn size(x: f32, y: f32) -> f32 {
    (1.0 + x * x + y * y).sqrt()
}

/// Returns the factor by which F stretches lengths, at most 1: where F compresses, the tolerance of slopes
/// shrinks as well.
#[inline(always)]
fn determinant_root(there: &Mapped, lane: usize) -> f32 {
    let root = there.determinant(lane).abs().sqrt();
    if root < 1.0 { root } else { 1.0 }
}

/// Returns `bound tanh(x / bound)` and its slope.
#[inline(always)]
fn bounded(x: f32, bound: f32) -> (f32, f32) {
    let t = 2.0 * simd::sigmoid(2.0 * x / bound) - 1.0;
    (bound * t, 1.0 - t * t)
}

impl Local for Reparameterised {
    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, seen: &Seen, u: [Lanes; 2]) -> ([Lanes; 3], Lanes) {
        let start = self.start(simd, seen);
        let (mut drawn, mut is_cosine) = ([[0.0; LANES]; 2], [0.0; LANES]);
        for lane in 0..LANES {
            let own = u[0][lane] < COSINE_WEIGHT;
            let rest = (u[0][lane] - COSINE_WEIGHT) / (1.0 - COSINE_WEIGHT);
            let first = if own { u[0][lane] / COSINE_WEIGHT } else { rest };
            let first = if first < BELOW_ONE { first } else { BELOW_ONE };
            let (cos, sin) = simd::cos_sin_turns(u[1][lane]);
            let slope = (first / (1.0 - first)).sqrt();
            (drawn[0][lane], drawn[1][lane]) = (slope * cos, slope * sin);
            is_cosine[lane] = if own { 1.0 } else { 0.0 };
        }
        let there = self.map(simd, &start, &drawn);
        let mut wi = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let own = is_cosine[lane] > 0.5;
            let x = if own { drawn[0][lane] } else { there.s[0][lane] };
            let y = if own { drawn[1][lane] } else { there.s[1][lane] };
            let z = 1.0 / size(x, y);
            (wi[0][lane], wi[1][lane], wi[2][lane]) = (x * z, y * z, z);
        }
        let (found, density) = self.search(simd, &start, &wi);
        let mut pdf = [0.0; LANES];
        for lane in 0..LANES {
            let (x, y) = (found[0][lane] - drawn[0][lane], found[1][lane] - drawn[1][lane]);
            let near = (x * x + y * y).sqrt() < SAME_POINT * size(drawn[0][lane], drawn[1][lane]);
            let is_own = near & (density[lane] > 0.0);
            let mixed = mixture(density[lane], wi[2][lane]);
            pdf[lane] = if is_own | (is_cosine[lane] > 0.5) { mixed } else { 0.0 };
        }
        (wi, pdf)
    }

    #[inline(always)]
    fn pdf<S: Simd>(&self, simd: S, seen: &Seen, wi: [Lanes; 3]) -> Lanes {
        let start = self.start(simd, seen);
        let (_, density) = self.search(simd, &start, &wi);
        let mut pdf = [0.0; LANES];
        for lane in 0..LANES {
            pdf[lane] = mixture(density[lane], wi[2][lane]);
        }
        pdf
    }
}

/// Returns the density of the mixture with the cosine lobe.
#[inline(always)]
pub(super) fn mixture(density: f32, z: f32) -> f32 {
    (1.0 - COSINE_WEIGHT) * density + COSINE_WEIGHT * FRAC_1_PI * z
}
