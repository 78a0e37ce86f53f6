//! NeuSample's analytic mixture: two Gaussians and a cosine lobe over the projected disk of directions.

use std::f32::consts::{FRAC_1_PI, TAU};

use super::{
    VIEW_CONDITION,
    columns::{Local, normal_pair},
    encoding::Seen,
};
use crate::{
    brdf::neural_texture::network::Network,
    discrete::BELOW_ONE,
    error::Result,
    head::Linear,
    simd::{self, LANES, Lanes, Simd},
};

/// Sizes of the network: its outputs are the logits of the cosine lobe and of both Gaussians, then for each
/// Gaussian the mean (x, y) and the logits of the widths.
pub const LOBES_SIZES: [usize; 3] = [VIEW_CONDITION, 32, 11];
/// Smallest mixture weight of the cosine lobe; bounds the weights by those of cosine sampling.
pub const LEAST_COSINE_WEIGHT: f32 = 0.02;
/// Smallest standard deviation of a Gaussian on the disk.
pub const LEAST_WIDTH: f32 = 0.01;
/// Range of standard deviations above [`LEAST_WIDTH`].
pub const WIDTH_RANGE: f32 = 1.0;
/// Slope of the leaky ReLU of the networks of lobes and flows.
pub const LEAKY_SLOPE: f32 = 0.01;

const GAUSSIANS: usize = 2;

/// The mixture.
#[derive(Clone, Debug)]
pub struct Lobes {
    network: Network,
}

/// A strip of mixtures.
struct Mixture {
    /// Mixture weights of the cosine lobe, then of the Gaussians; they sum to 1.
    lobe_weights: [Lanes; 1 + GAUSSIANS],
    middles: [[Lanes; 2]; GAUSSIANS],
    widths: [[Lanes; 2]; GAUSSIANS],
}

impl Lobes {
    pub(super) fn new(networks: Vec<Vec<Linear>>) -> Result<Self> {
        let [layers] = super::file::of_count(networks)?;
        Ok(Self { network: Network::new("lobes", &LOBES_SIZES, layers, LEAKY_SLOPE)? })
    }

    pub(super) fn networks(&self) -> Vec<&[Linear]> {
        vec![self.network.layers()]
    }

    #[inline(always)]
    fn mixture<S: Simd>(&self, simd: S, seen: &Seen) -> Mixture {
        let mut raw = [[0.0; LANES]; 32];
        self.network.forward(simd, &seen.condition(), &mut raw);
        let zero = [0.0; LANES];
        let mut mixture = Mixture {
            lobe_weights: [zero; 1 + GAUSSIANS],
            middles: [[zero; 2]; GAUSSIANS],
            widths: [[zero; 2]; GAUSSIANS],
        };
        for lane in 0..LANES {
            let logits = [raw[0][lane], raw[1][lane], raw[2][lane]];
            let most = if logits[0] > logits[1] { logits[0] } else { logits[1] };
            let most = if most > logits[2] { most } else { logits[2] };
            let e = [simd::exp(logits[0] - most), simd::exp(logits[1] - most), simd::exp(logits[2] - most)];
            let scale = (1.0 - LEAST_COSINE_WEIGHT) / (e[0] + e[1] + e[2]);
            mixture.lobe_weights[0][lane] = LEAST_COSINE_WEIGHT + scale * e[0];
            mixture.lobe_weights[1][lane] = scale * e[1];
            mixture.lobe_weights[2][lane] = scale * e[2];
        }
        for k in 0..GAUSSIANS {
            mixture.middles[k] = [raw[3 + 4 * k], raw[4 + 4 * k]];
            for axis in 0..2 {
                let own = &raw[5 + 4 * k + axis];
                for lane in 0..LANES {
                    mixture.widths[k][axis][lane] = LEAST_WIDTH + WIDTH_RANGE * simd::sigmoid(own[lane]);
                }
            }
        }
        mixture
    }
}

impl Mixture {
    /// Returns the density over solid angle of one lane.
    #[inline(always)]
    fn density(&self, lane: usize, wi: [f32; 3]) -> f32 {
        let mut over_disk = self.lobe_weights[0][lane] * FRAC_1_PI;
        for k in 0..GAUSSIANS {
            let (a, b) = (self.widths[k][0][lane], self.widths[k][1][lane]);
            let (x, y) = ((wi[0] - self.middles[k][0][lane]) / a, (wi[1] - self.middles[k][1][lane]) / b);
            over_disk += self.lobe_weights[k + 1][lane] * simd::exp(-0.5 * (x * x + y * y)) / (TAU * a * b);
        }
        over_disk * wi[2]
    }
}

impl Local for Lobes {
    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, seen: &Seen, u: [Lanes; 2]) -> ([Lanes; 3], Lanes) {
        let mixture = self.mixture(simd, seen);
        let (mut wi, mut pdf) = ([[0.0; LANES]; 3], [0.0; LANES]);
        for lane in 0..LANES {
            let first = mixture.lobe_weights[0][lane];
            let second = first + mixture.lobe_weights[1][lane];
            let (is_cosine, is_first) = (u[0][lane] < first, u[0][lane] < second);
            let from = if is_cosine {
                0.0
            } else if is_first {
                first
            } else {
                second
            };
            let to = if is_cosine {
                first
            } else if is_first {
                second
            } else {
                1.0
            };
            // Stretches the remainder of the number to the unit interval.
            let stretched = (u[0][lane] - from) / (to - from);
            let stretched = if stretched < BELOW_ONE { stretched } else { BELOW_ONE };
            let (cos, sin) = simd::cos_sin_turns(u[1][lane]);
            let radius = stretched.sqrt();
            let (a, b) = normal_pair(stretched, cos, sin);
            let pick = |one: f32, other: f32| if is_first { one } else { other };
            let [[ax, ay], [bx, by]] = mixture.middles;
            let [[aw, ah], [bw, bh]] = mixture.widths;
            let gauss_x = pick(ax[lane], bx[lane]) + pick(aw[lane], bw[lane]) * a;
            let gauss_y = pick(ay[lane], by[lane]) + pick(ah[lane], bh[lane]) * b;
            let x = if is_cosine { radius * cos } else { gauss_x };
            let y = if is_cosine { radius * sin } else { gauss_y };
            let squared = 1.0 - x * x - y * y;
            let z = if squared > 0.0 { squared } else { 0.0 }.sqrt();
            (wi[0][lane], wi[1][lane], wi[2][lane]) = (x, y, z);
            pdf[lane] = mixture.density(lane, [x, y, z]);
        }
        (wi, pdf)
    }

    #[inline(always)]
    fn pdf<S: Simd>(&self, simd: S, seen: &Seen, wi: [Lanes; 3]) -> Lanes {
        let mixture = self.mixture(simd, seen);
        let mut pdf = [0.0; LANES];
        for lane in 0..LANES {
            pdf[lane] = mixture.density(lane, [wi[0][lane], wi[1][lane], wi[2][lane]]);
        }
        pdf
    }
}
