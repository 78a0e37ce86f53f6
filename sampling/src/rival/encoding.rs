//! Inputs of the networks: features and views, with sines and cosines of several octaves (Mildenhall et al.
//! 2020).

use crate::{
    brdf::neural_texture::FEATURES,
    simd::{LANES, Lanes, cos_sin_turns},
};

/// Octaves of each coordinate of the view.
pub const OCTAVES_OF_VIEW: usize = 5;
/// Octaves of each coordinate of a direction.
pub const OCTAVES_OF_COORDINATE: usize = 4;
/// Number of inputs for features and view: features, `wo.xy`, then for each coordinate and each octave `k`
/// the sine and cosine of `2^k pi` times it.
pub const VIEW_CONDITION: usize = FEATURES + 2 * (1 + 2 * OCTAVES_OF_VIEW);
/// Number of inputs for a coordinate: itself, then sines and cosines.
pub const COORDINATE: usize = 1 + 2 * OCTAVES_OF_COORDINATE;
/// Number of inputs for features, view and a point of the disk: features, `wo.xy`, then each coordinate of
/// the point as [`COORDINATE`] numbers.
pub const DISK_CONDITION: usize = FEATURES + 2 + 2 * COORDINATE;

/// Features and views of a strip of shading points, in the tangent frame.
pub(super) struct Seen {
    pub features: [Lanes; FEATURES],
    pub wo: [Lanes; 3],
}

impl Seen {
    /// Encodes features and view.
    #[inline(always)]
    pub fn condition(&self) -> [Lanes; VIEW_CONDITION] {
        let mut out = [[0.0; LANES]; VIEW_CONDITION];
        out[..FEATURES].copy_from_slice(&self.features);
        out[FEATURES] = self.wo[0];
        out[FEATURES + 1] = self.wo[1];
        for axis in 0..2 {
            waves(&self.wo[axis], &mut out[FEATURES + 2 + axis * 2 * OCTAVES_OF_VIEW..], OCTAVES_OF_VIEW);
        }
        out
    }
}

/// Computes sine and cosine of `2^k pi x` for octaves `k`.
#[inline(always)]
fn waves(x: &Lanes, out: &mut [Lanes], octaves: usize) {
    let mut turns = 0.5;
    for k in 0..octaves {
        for lane in 0..LANES {
            let (cos, sin) = cos_sin_turns(turns * x[lane]);
            out[2 * k][lane] = sin;
            out[2 * k + 1][lane] = cos;
        }
        turns *= 2.0;
    }
}

/// Encodes a coordinate as [`COORDINATE`] numbers.
#[inline(always)]
pub(super) fn encode(x: &Lanes, out: &mut [Lanes]) {
    out[0] = *x;
    waves(x, &mut out[1..], OCTAVES_OF_COORDINATE);
}

/// Computes the derivatives of the numbers of [`encode`] from these numbers.
#[inline(always)]
pub(super) fn encoding_slopes(encoded: &[Lanes], out: &mut [Lanes]) {
    out[0] = [1.0; LANES];
    let mut rate = std::f32::consts::PI;
    for k in 0..OCTAVES_OF_COORDINATE {
        for lane in 0..LANES {
            out[1 + 2 * k][lane] = rate * encoded[2 + 2 * k][lane];
            out[2 + 2 * k][lane] = -rate * encoded[1 + 2 * k][lane];
        }
        rate *= 2.0;
    }
}
