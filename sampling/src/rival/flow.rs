//! NeuSample's flow: two coupling layers of rational-quadratic splines on the square around the projected disk, over a conditional Gaussian.
//!
//! With `x` a point of the plane, `z_1 = A(x_1; x_0)` and `z_0 = B(x_0; z_1)`, each a spline on `[-1, 1]` and
//! the identity outside, and `z` has a Gaussian density. Directions are the points of the disk; draws outside
//! of it are rejected.

use std::f32::consts::TAU;

use super::{
    COORDINATE, VIEW_CONDITION,
    columns::{Local, normal_pair},
    encoding::{Seen, encode},
    lobes::LEAKY_SLOPE,
};
use crate::{
    brdf::neural_texture::network::Network,
    error::Result,
    head::Linear,
    simd::{self, LANES, Lanes, Simd},
    spline::{self, Logits, Topology, logit_count},
};

/// Number of bins of a spline.
pub const BINS: usize = 20;
/// Number of outputs of a spline's network: widths, heights, and slopes at the inner knots. The slopes at
/// both ends are 1.
pub const SPLINE_OUTPUTS: usize = 3 * BINS - 1;
/// Sizes of the network of the Gaussian: its outputs are the mean and the logarithms of the widths.
pub const PRIOR_SIZES: [usize; 3] = [VIEW_CONDITION, 32, 4];
/// Sizes of the network of a spline: its inputs are the condition and the other coordinate.
pub const FLOW_SIZES: [usize; 4] = [VIEW_CONDITION + COORDINATE, 32, 32, SPLINE_OUTPUTS];
/// Logarithms of widths are `LOG_WIDTH[0] + LOG_WIDTH[1] (2 sigmoid(raw) - 1)`.
pub const LOG_WIDTH: [f32; 2] = [-1.5, 2.5];

/// Rows of a network's output, and of a spline's input.
const WIDEST: usize = SPLINE_OUTPUTS;
const LOGITS: usize = logit_count(BINS);

/// The flow.
#[derive(Clone, Debug)]
pub struct Flow {
    prior: Network,
    /// Network of `B`, which transforms coordinate 0.
    second: Network,
    /// Network of `A`, which transforms coordinate 1.
    first: Network,
}

impl Flow {
    pub(super) fn new(networks: Vec<Vec<Linear>>) -> Result<Self> {
        let [prior, second, first] = super::file::of_count(networks)?;
        Ok(Self {
            prior: Network::new("prior", &PRIOR_SIZES, prior, LEAKY_SLOPE)?,
            second: Network::new("second", &FLOW_SIZES, second, LEAKY_SLOPE)?,
            first: Network::new("first", &FLOW_SIZES, first, LEAKY_SLOPE)?,
        })
    }

    pub(super) fn networks(&self) -> Vec<&[Linear]> {
        vec![self.prior.layers(), self.second.layers(), self.first.layers()]
    }

    /// Computes mean and widths of the Gaussian.
    #[inline(always)]
    fn prior<S: Simd>(&self, simd: S, condition: &[Lanes; VIEW_CONDITION]) -> [[Lanes; 2]; 2] {
        let mut raw = [[0.0; LANES]; 32];
        self.prior.forward(simd, condition, &mut raw);
        let mut widths = [[0.0; LANES]; 2];
        for axis in 0..2 {
            for lane in 0..LANES {
                let log = LOG_WIDTH[0] + LOG_WIDTH[1] * (2.0 * simd::sigmoid(raw[2 + axis][lane]) - 1.0);
                widths[axis][lane] = simd::exp(log);
            }
        }
        [[raw[0], raw[1]], widths]
    }

    /// Computes the logits of a spline from the condition and the other coordinate.
    #[inline(always)]
    fn logits<S: Simd>(
        simd: S,
        network: &Network,
        condition: &[Lanes; VIEW_CONDITION],
        other: &Lanes,
        out: &mut [Lanes; LOGITS],
    ) {
        let mut input = [[0.0; LANES]; VIEW_CONDITION + COORDINATE];
        input[..VIEW_CONDITION].copy_from_slice(condition);
        encode(other, &mut input[VIEW_CONDITION..]);
        let mut raw = [[0.0; LANES]; WIDEST];
        network.forward(simd, &input, &mut raw);
        out[..2 * BINS].copy_from_slice(&raw[..2 * BINS]);
        // Zero logits give slopes of 1, which match the identity outside.
        out[2 * BINS] = [0.0; LANES];
        out[2 * BINS + 1..LOGITS - 1].copy_from_slice(&raw[2 * BINS..SPLINE_OUTPUTS]);
        out[LOGITS - 1] = [0.0; LANES];
    }
}

/// Evaluates a spline on `[-1, 1]`, the identity outside: value and slope `dz/dx`.
#[inline(always)]
fn coupling(logits: &[Lanes; LOGITS], at: &Lanes, draws: bool) -> (Lanes, Lanes) {
    let mut scratch = [[0.0; LANES]; 2 * BINS];
    let mut unit = [0.0; LANES];
    for lane in 0..LANES {
        unit[lane] = 0.5 * (at[lane] + 1.0);
    }
    let (value, slopes) = if draws {
        spline::forward(Topology::Interval, Logits::strip(logits), &mut scratch, &unit)
    } else {
        spline::inverse(Topology::Interval, Logits::strip(logits), &mut scratch, &unit)
    };
    let (mut out, mut out_slopes) = ([0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        let inside = (at[lane] > -1.0) & (at[lane] < 1.0);
        out[lane] = if inside { 2.0 * value[lane] - 1.0 } else { at[lane] };
        out_slopes[lane] = if inside { slopes[lane] } else { 1.0 };
    }
    (out, out_slopes)
}

impl Local for Flow {
    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, seen: &Seen, u: [Lanes; 2]) -> ([Lanes; 3], Lanes) {
        let condition = seen.condition();
        let [middles, widths] = self.prior(simd, &condition);
        let (mut z, mut density) = ([[0.0; LANES]; 2], [0.0; LANES]);
        for lane in 0..LANES {
            let (cos, sin) = simd::cos_sin_turns(u[1][lane]);
            let (a, b) = normal_pair(u[0][lane], cos, sin);
            z[0][lane] = middles[0][lane] + widths[0][lane] * a;
            z[1][lane] = middles[1][lane] + widths[1][lane] * b;
            density[lane] = (1.0 - u[0][lane]) / (TAU * widths[0][lane] * widths[1][lane]);
        }
        let mut logits = [[0.0; LANES]; LOGITS];
        Self::logits(simd, &self.second, &condition, &z[1], &mut logits);
        let (x, slopes) = coupling(&logits, &z[0], true);
        Self::logits(simd, &self.first, &condition, &x, &mut logits);
        let (y, more) = coupling(&logits, &z[1], true);
        let mut up = [0.0; LANES];
        for lane in 0..LANES {
            let squared = 1.0 - x[lane] * x[lane] - y[lane] * y[lane];
            up[lane] = if squared > 0.0 { squared } else { 0.0 }.sqrt();
            density[lane] *= slopes[lane] * more[lane] * up[lane];
        }
        ([x, y, up], density)
    }

    #[inline(always)]
    fn pdf<S: Simd>(&self, simd: S, seen: &Seen, wi: [Lanes; 3]) -> Lanes {
        let condition = seen.condition();
        let [middles, widths] = self.prior(simd, &condition);
        let mut logits = [[0.0; LANES]; LOGITS];
        Self::logits(simd, &self.first, &condition, &wi[0], &mut logits);
        let (b, slopes) = coupling(&logits, &wi[1], false);
        Self::logits(simd, &self.second, &condition, &b, &mut logits);
        let (a, more) = coupling(&logits, &wi[0], false);
        let mut density = [0.0; LANES];
        for lane in 0..LANES {
            let x = (a[lane] - middles[0][lane]) / widths[0][lane];
            let y = (b[lane] - middles[1][lane]) / widths[1][lane];
            let gauss = simd::exp(-0.5 * (x * x + y * y)) / (TAU * widths[0][lane] * widths[1][lane]);
            density[lane] = gauss * slopes[lane] * more[lane] * wi[2][lane];
        }
        density
    }
}
