//! A pyramid of periodic textures, looked up trilinearly.

use glam::Vec2;

use super::FEATURES;
use crate::error::{Error, Result};

/// Maximum side of the finest level.
const MOST_TEXELS: usize = 1024;

/// Textures of `side`, `side / 2`, ..., 1 texels along each axis of the periodic unit square.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid {
    side: usize,
    /// `[texels]` of all levels, the finest first; rows along v.
    texels: Vec<[f32; FEATURES]>,
}

impl Pyramid {
    /// Total number of texels of all levels.
    pub fn texel_count(side: usize) -> usize {
        (0..=side.ilog2()).map(|level| (side >> level) * (side >> level)).sum()
    }

    /// Makes a pyramid of the texels of all levels, the finest first.
    ///
    /// # Errors
    /// The side is not a power of two up to 1024, the number of texels does not match, or a number is
    /// not finite.
    pub fn new(side: usize, texels: Vec<[f32; FEATURES]>) -> Result<Self> {
        if !side.is_power_of_two() || side > MOST_TEXELS {
            return Err(Error::argument("texture", format!("side {side} is not a power of two up to {MOST_TEXELS}")));
        }
        if texels.len() != Self::texel_count(side) {
            let (found, wanted) = (texels.len(), Self::texel_count(side));
            return Err(Error::argument("texture", format!("{found} texels instead of {wanted} for a side of {side}")));
        }
        if !texels.as_flattened().iter().all(|value| value.is_finite()) {
            return Err(Error::argument("texture", "holds a value that is not finite"));
        }
        Ok(Self { side, texels })
    }

    /// Texels along an axis of the finest level.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Number of levels.
    pub fn levels(&self) -> usize {
        self.side.ilog2() as usize + 1
    }

    /// `[texels]` of all levels, the finest first.
    pub fn texels(&self) -> &[[f32; FEATURES]] {
        &self.texels
    }

    /// The eight texels that a lookup at a position (in tiles) and a level reads, and their weights.
    pub fn taps(side: usize, uv: Vec2, level: f32) -> [(usize, f32); 8] {
        let coarsest = side.ilog2();
        // NaN becomes 0.
        let level = level.max(0.0).min(coarsest as f32);
        let below = (level as u32).min(coarsest);
        let between = level - below as f32;
        let mut taps = [(0, 0.0); 8];
        for (k, weight) in [(0, 1.0 - between), (1, between)] {
            let own = (below + k as u32).min(coarsest);
            let first: usize = (0..own).map(|level| (side >> level) * (side >> level)).sum();
            for (tap, (texel, fraction)) in taps[4 * k..].iter_mut().zip(bilinear(side >> own, uv)) {
                *tap = (first + texel, weight * fraction);
            }
        }
        taps
    }

    /// Looks up the features at a position (in tiles) and a level; 0 is the finest.
    pub fn sample(&self, uv: Vec2, level: f32) -> [f32; FEATURES] {
        let mut sum = [0.0; FEATURES];
        for (texel, weight) in Self::taps(self.side, uv, level) {
            for (sum, feature) in sum.iter_mut().zip(&self.texels[texel]) {
                *sum += weight * feature;
            }
        }
        sum
    }
}

/// The four texels around a position in a periodic texture of `side` texels, with centres at
/// half-integers, and their weights.
fn bilinear(side: usize, uv: Vec2) -> [(usize, f32); 4] {
    // The position within the tile; 0 if not finite.
    let part = |x: f32| if x.is_finite() { x - x.floor() } else { 0.0 };
    let (x, y) = (part(uv.x) * side as f32 - 0.5, part(uv.y) * side as f32 - 0.5);
    let (left, top) = (x.floor(), y.floor());
    let (s, t) = (x - left, y - top);
    let wrapped = |k: f32, offset: i32| (k as i32 + offset).rem_euclid(side as i32) as usize;
    let texel = |dx: i32, dy: i32| wrapped(top, dy) * side + wrapped(left, dx);
    [
        (texel(0, 0), (1.0 - s) * (1.0 - t)),
        (texel(1, 0), s * (1.0 - t)),
        (texel(0, 1), (1.0 - s) * t),
        (texel(1, 1), s * t),
    ]
}
