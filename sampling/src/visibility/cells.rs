//! Cells of space, within which visibility is nearly the same.

use glam::Vec3A;

use crate::{
    columns::vectorized,
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Number of levels of cells, each twice as large as the one below.
pub const LEVELS: usize = 7;

/// Bits of a coordinate in a key.
const COORDINATE_BITS: u32 = 17;
/// Bits of the direction of the normal.
const AXIS_BITS: u32 = 3;
/// Bits of the logarithm of a size.
const SIZE_BITS: u32 = 8;
/// The smallest logarithm of a size.
const LEAST_SIZE: i32 = -100;
/// The largest logarithm of a size at the finest level.
const MOST_SIZE: i32 = 100;
/// Bits of a key.
const CELL_BITS: u32 = 3 * COORDINATE_BITS + AXIS_BITS + SIZE_BITS;

/// The division of space into cubes, which grow with the distance from the camera, and of normals by their nearest axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cells {
    eye: Vec3A,
    /// Side of a cell over its distance from the eye.
    angle: f32,
}

/// A cell: its size, axis of normals, and three coordinates modulo 2^17. Cells that coincide modulo 2^17
/// share their visibility, which adds variance but no bias.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CellKey(pub u64);

impl Cells {
    /// Cells that subtend `angle` to `2 angle` radians from `eye`.
    pub fn new(eye: Vec3A, angle: f32) -> Self {
        Self { eye, angle: angle.max(f32::MIN_POSITIVE) }
    }

    /// Returns the eye and the angle.
    pub fn parts(&self) -> (Vec3A, f32) {
        (self.eye, self.angle)
    }

    /// Returns the finest cell of a point with a normal.
    pub fn key(&self, p: Vec3A, n: Vec3A) -> CellKey {
        let lanes = |vector: Vec3A| vector.to_array().map(|number| [number; LANES]);
        CellKey(self.keys(&lanes(p), &lanes(n))[0])
    }

    /// Returns the finest cells of points.
    pub fn keys_of(&self, at: &Rows<'_>) -> Vec<CellKey> {
        let mut keys = Vec::with_capacity(at.len());
        for strip in 0..at.strips() {
            let mut own = [0; LANES];
            self::keys(self, &at.positions(strip), &at.normals(strip), &mut own);
            keys.extend(own[..LANES.min(at.len() - strip * LANES)].iter().map(|&key| CellKey(key)));
        }
        keys
    }

    /// Returns the finest cells of a strip of points with normals.
    #[inline(always)]
    fn keys(&self, p: &[Lanes; 3], n: &[Lanes; 3]) -> [u64; LANES] {
        let eye = self.eye.to_array();
        let (mut high, mut scale) = ([0_u32; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let away = [p[0][k] - eye[0], p[1][k] - eye[1], p[2][k] - eye[2]];
            let squared = away[0] * away[0] + away[1] * away[1] + away[2] * away[2];
            let wanted = self.angle * squared.sqrt();
            // The exponent of the next power of two.
            let size = (wanted.to_bits() >> 23) as i32 - 126;
            let size = if size < MOST_SIZE { size } else { MOST_SIZE };
            let size = if size > LEAST_SIZE { size } else { LEAST_SIZE };
            scale[k] = f32::from_bits(((127 - size) as u32) << 23);
            let [x, y, z] = [n[0][k].abs(), n[1][k].abs(), n[2][k].abs()];
            let is_x = (x >= y) & (x >= z);
            let along = if is_x {
                n[0][k]
            } else if y >= z {
                n[1][k]
            } else {
                n[2][k]
            };
            let axis = if is_x {
                0
            } else if y >= z {
                2
            } else {
                4
            };
            high[k] = ((size - LEAST_SIZE) as u32) << AXIS_BITS | axis | u32::from(along < 0.0);
        }
        let mut at = [[0_u32; LANES]; 3];
        for (at, p) in at.iter_mut().zip(p) {
            for k in 0..LANES {
                at[k] = (p[k] * scale[k]).floor() as i32 as u32 & ((1 << COORDINATE_BITS) - 1);
            }
        }
        let mut out = [0; LANES];
        for k in 0..LANES {
            let middle = u64::from(at[0][k]) << (2 * COORDINATE_BITS) | u64::from(at[1][k]) << COORDINATE_BITS;
            out[k] = u64::from(high[k]) << (3 * COORDINATE_BITS) | middle | u64::from(at[2][k]);
        }
        out
    }
}

vectorized! {
    /// Computes [`Cells::keys`], compiled for every instruction set.
    pub fn keys['a](_simd, cells: &'a Cells, p: &'a [Lanes; 3], n: &'a [Lanes; 3], out: &'a mut [u64; LANES]) {
        *out = cells.keys(p, n);
    }
}

impl CellKey {
    /// Returns a number that orders cells by their sizes.
    pub fn size(self) -> u64 {
        self.0 >> (3 * COORDINATE_BITS + AXIS_BITS) & ((1 << SIZE_BITS) - 1)
    }

    /// Whether a cell can have this key.
    pub fn is_valid(self) -> bool {
        self.0 >> CELL_BITS == 0
    }

    /// Returns the cell of the next level that contains it.
    #[inline]
    pub fn parent(self) -> Self {
        let own = |k: u32| {
            // Extends the sign.
            let shifted = (self.0 >> (k * COORDINATE_BITS)) << (64 - COORDINATE_BITS);
            (shifted as i64 >> (64 - COORDINATE_BITS + 1)) as u64 & ((1 << COORDINATE_BITS) - 1)
        };
        let rest = (self.0 >> (3 * COORDINATE_BITS)) + (1 << AXIS_BITS);
        Self(rest << (3 * COORDINATE_BITS) | own(2) << (2 * COORDINATE_BITS) | own(1) << COORDINATE_BITS | own(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_subtend_one_to_two_times_the_angle() {
        let cells = Cells::new(Vec3A::new(1.0, 2.0, 3.0), 0.01);
        for distance in [1e-3_f32, 0.5, 1.0, 7.0, 300.0, 1e6] {
            let p = Vec3A::new(1.0 + distance, 2.0, 3.0);
            let size = cells.key(p, Vec3A::X).size() as i32 + LEAST_SIZE;
            let ratio = 2.0_f32.powi(size) / (0.01 * distance);
            assert!((0.999..=2.001).contains(&ratio), "{distance}: {ratio}");
        }
    }

    #[test]
    fn neighbours_share_a_cell_and_other_sides_do_not() {
        let cells = Cells::new(Vec3A::ZERO, 0.01);
        let key = |x: f32, y: f32, n: Vec3A| cells.key(Vec3A::new(x, y, 10.0), n);
        // A side of 0.125.
        assert_eq!(key(0.01, 0.01, Vec3A::Y), key(0.12, 0.12, Vec3A::new(0.1, 0.9, 0.3)));
        assert_ne!(key(0.01, 0.01, Vec3A::Y), key(0.13, 0.01, Vec3A::Y));
        assert_ne!(key(0.01, 0.01, Vec3A::Y), key(-0.01, 0.01, Vec3A::Y));
        assert_ne!(key(0.01, 0.01, Vec3A::Y), key(0.01, 0.01, Vec3A::NEG_Y));
    }

    #[test]
    fn parents_hold_two_cells_along_each_axis() {
        let cells = Cells::new(Vec3A::ZERO, 0.01);
        for x in [-100, -5, -4, -1, 0, 3, 4, 77] {
            let key = |x: i32| cells.key(Vec3A::new((x as f32 + 0.5) / 8.0, 1.0, 100.0), Vec3A::Y);
            let parent = |x: i32| key(x).parent();
            assert_eq!(parent(x) == parent(x + 1), x.div_euclid(2 * 8) == (x + 1).div_euclid(2 * 8));
        }
        let key = cells.key(Vec3A::new(-3.0, 4.0, 5.0), Vec3A::Z);
        let far = (0..LEVELS).fold(key, |key, _| key.parent());
        assert_eq!(far.0 >> (3 * COORDINATE_BITS) & 7, 4, "the axis stays");
        assert_eq!((far.is_valid(), far.size()), (true, key.size() + LEVELS as u64));
    }

    #[test]
    fn extreme_inputs_have_keys() {
        for p in [f32::NAN, f32::INFINITY, -1e38, 1e-44, 0.0] {
            for angle in [0.0, 1e-3, f32::MAX] {
                let cells = Cells::new(Vec3A::ZERO, angle);
                let key = cells.key(Vec3A::splat(p), Vec3A::splat(p));
                let _ = (0..LEVELS).fold(key, |key, _| key.parent());
            }
        }
    }
}
