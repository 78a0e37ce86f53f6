//! Woven cloth: warp yarns along v, weft yarns along u, and the order of the two at each crossing.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::yarn::{Section, TriangleSoup, irregular};

/// Segments of a yarn from one crossing to the next and around it.
const STEPS: [usize; 2] = [7, 14];

/// A weave of one tile.
pub struct Weave {
    /// Warp yarns and weft yarns per tile.
    pub yarns: [usize; 2],
    /// Returns whether a warp yarn lies over a weft yarn.
    pub warp_is_over: fn(usize, usize) -> bool,
    /// Cross-sections of warp and weft.
    pub sections: [Section; 2],
    /// Mean height of warp and weft, in tiles; `amplitudes` are their deviations from it.
    pub middle: f32,
    pub amplitudes: [f32; 2],
    /// Returns the height that is added at a coordinate u.
    pub relief: fn(f32) -> f32,
    /// Returns the material index of a warp yarn; weft yarns have index 0.
    pub warp_material: fn(usize) -> usize,
}

impl Weave {
    /// Adds the yarns of one tile to the triangles of their materials.
    pub fn build(&self, soups: &mut [TriangleSoup]) {
        let [warps, wefts] = self.yarns;
        let place = |k: usize, count: usize| (k as f32 + 0.5) / count as f32;
        for i in 0..warps {
            let (x, lean) = (place(i, warps), 0.08 / warps as f32);
            let phase = irregular(i, 1);
            let path = |s: f32| {
                let side = |j: usize| if (self.warp_is_over)(i, j) { 1.0 } else { -1.0 };
                let z = self.middle + self.amplitudes[0] * smooth(s, wefts, side);
                let x = x + lean * (TAU * (s + phase)).sin();
                Vec3::new(x, s, z + (self.relief)(x))
            };
            let section = Section { twist: self.sections[0].twist + (4.0 * phase).floor(), ..self.sections[0] };
            let swell = |s: f32| 1.0 + 0.04 * (TAU * (2.0 * s + 3.0 * phase)).sin();
            soups[(self.warp_material)(i)].sweep(path, &section, swell, [STEPS[0] * wefts, STEPS[1]]);
        }
        for j in 0..wefts {
            let y = place(j, wefts);
            let path = |s: f32| {
                let side = |i: usize| if (self.warp_is_over)(i, j) { -1.0 } else { 1.0 };
                let z = self.middle + self.amplitudes[1] * smooth(s, warps, side);
                Vec3::new(s, y, z + (self.relief)(s))
            };
            soups[0].sweep(path, &self.sections[1], |_| 1.0, [STEPS[0] * warps, STEPS[1]]);
        }
    }
}

/// Interpolates smoothly between the values `at(k)` at `(k + 1/2) / count`, with period 1.
fn smooth(s: f32, count: usize, at: impl Fn(usize) -> f32) -> f32 {
    let x = s * count as f32 - 0.5;
    let (below, t) = (x.floor(), x - x.floor());
    let value = |offset: i64| at((below as i64 + offset).rem_euclid(count as i64) as usize);
    let blend = 0.5 - 0.5 * (PI * t).cos();
    value(0) + (value(1) - value(0)) * blend
}

/// Returns a plain weave with ribs along v: cream stripes on the ribs, blue in the grooves.
pub fn welt() -> Weave {
    Weave {
        yarns: [12, 16],
        warp_is_over: |i, j| (i + j) % 2 == 0,
        sections: [
            Section { radii: Vec2::new(0.037, 0.022), plies: 3.0, groove: 0.3, twist: 9.0 },
            Section { radii: Vec2::new(0.027, 0.019), plies: 2.0, groove: 0.25, twist: 8.0 },
        ],
        middle: 0.046,
        amplitudes: [0.017, 0.02],
        relief: |x| 0.045 * (0.5 - 0.5 * (2.0 * TAU * x).cos()),
        warp_material: |i| if matches!(i % 6, 1..=4) { 1 } else { 2 },
    }
}

/// Returns an eight-end satin: each warp yarn floats over seven weft yarns and passes under the eighth.
pub fn satin() -> Weave {
    Weave {
        yarns: [8, 8],
        warp_is_over: |i, j| (3 * i + 1) % 8 != j,
        sections: [
            Section { radii: Vec2::new(0.062, 0.030), plies: 3.0, groove: 0.12, twist: 2.0 },
            Section { radii: Vec2::new(0.050, 0.022), plies: 2.0, groove: 0.12, twist: 3.0 },
        ],
        middle: 0.058,
        amplitudes: [0.018, 0.032],
        relief: |_| 0.0,
        warp_material: |_| 1,
    }
}
