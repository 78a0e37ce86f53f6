//! The lat-long parametrisation of the sphere: sample square X <-> unit directions (Mitsuba 3's
//! `envmap` convention).
//!
//! `x = (u, v)` in `[0,1]^2`, azimuth `phi = 2 pi u`, polar angle `theta = pi v`, Y up:
//! `w = (sin phi sin theta, cos theta, -cos phi sin theta)`.

use std::f32::consts::PI;

use glam::{Vec2, Vec3A};

use crate::{
    columns::vectorized,
    simd::{self, LANES, Lanes},
};

/// The smallest `sin theta` in a change of measure, which keeps the pdf at the exact pole finite everywhere.
const MIN_SIN_THETA: f32 = 1e-7;

/// Maps a point of the square to its unit direction.
pub fn direction(x: Vec2) -> Vec3A {
    direction_and_factor(x).0
}

/// Maps a point of the square to its unit direction and [`solid_angle_factor`].
pub fn direction_and_factor(x: Vec2) -> (Vec3A, f32) {
    let (w, factor) = components_and_factor(x.x, x.y);
    (Vec3A::from_array(w), factor)
}

/// [`direction_and_factor`] of one lane.
#[inline(always)]
fn components_and_factor(u: f32, v: f32) -> ([f32; 3], f32) {
    let (cos_phi, sin_phi) = simd::cos_sin_turns(u);
    let (cos_theta, sin_theta) = simd::cos_sin_turns(0.5 * v);
    ([sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta], factor_of(sin_theta))
}

/// Maps a unit direction to its point of the square; `u` in `[0, 1)`, `v` in `[0, 1]`.
///
/// `theta` comes from the arc tangent: near the poles, the arc cosine loses half of the digits, and with them
/// the accuracy of the pdf.
pub fn square(w: Vec3A) -> Vec2 {
    let [u, v] = square_of(w.x, w.y, w.z);
    Vec2::new(u, v)
}

/// [`square`] of one lane.
#[inline(always)]
pub(crate) fn square_of(x: f32, y: f32, z: f32) -> [f32; 2] {
    let u = simd::atan2_turns(x, -z);
    let u = if u < 0.0 { u + 1.0 } else { u };
    let v = 2.0 * simd::atan2_turns((x * x + z * z).sqrt(), y);
    [if u >= 1.0 { 0.0 } else { u }, if v > 1.0 { 1.0 } else { v }]
}

vectorized! {
    /// [`square`] over columns.
    pub fn squares['a](_simd, w: [&'a [Lanes]; 3], x: [&'a mut [Lanes]; 2]) {
        let [u, v] = x;
        for strip in 0..u.len() {
            let w = [w[0][strip], w[1][strip], w[2][strip]];
            let mut out = [[0.0; LANES]; 2];
            for k in 0..LANES {
                let [u, v] = square_of(w[0][k], w[1][k], w[2][k]);
                (out[0][k], out[1][k]) = (u, v);
            }
            (u[strip], v[strip]) = (out[0], out[1]);
        }
    }
}

vectorized! {
    /// [`direction`] over columns; converts `pdf` from X to solid angle. A pdf that is not positive and
    /// finite becomes 0: the edge of a dark region, which is hit with probability 0.
    pub fn directions['a](_simd, x: [&'a [Lanes]; 2], w: [&'a mut [Lanes]; 3], pdf: &'a mut [Lanes]) {
        let [right, up, back] = w;
        for strip in 0..pdf.len() {
            let (u, v) = (x[0][strip], x[1][strip]);
            let (mut out, mut pdfs) = ([[0.0; LANES]; 3], pdf[strip]);
            for k in 0..LANES {
                let (w, factor) = components_and_factor(u[k], v[k]);
                (out[0][k], out[1][k], out[2][k]) = (w[0], w[1], w[2]);
                let density = pdfs[k] * factor;
                pdfs[k] = if (density > 0.0) & (density < f32::INFINITY) { density } else { 0.0 };
            }
            (right[strip], up[strip], back[strip]) = (out[0], out[1], out[2]);
            pdf[strip] = pdfs;
        }
    }
}

vectorized! {
    /// Converts densities over X at elevations `v` to pdfs over solid angle.
    pub fn to_solid_angle['a](_simd, v: &'a [Lanes], pdf: &'a mut [Lanes]) {
        for (v, pdf) in v.iter().zip(pdf) {
            for k in 0..LANES {
                pdf[k] *= factor_at(v[k]);
            }
        }
    }
}

/// `sin theta` of a row of the square, bounded away from zero.
pub fn sin_theta(v: f32) -> f32 {
    simd::cos_sin_turns(0.5 * v).1.max(MIN_SIN_THETA)
}

/// The factor from a pdf over X to a pdf over solid angle: `1 / (2 pi^2 sin theta)`.
pub fn solid_angle_factor(v: f32) -> f32 {
    factor_at(v)
}

/// [`solid_angle_factor`] of one lane.
#[inline(always)]
fn factor_at(v: f32) -> f32 {
    factor_of(simd::cos_sin_turns(0.5 * v).1)
}

#[inline(always)]
fn factor_of(sin_theta: f32) -> f32 {
    let bounded = if sin_theta > MIN_SIN_THETA { sin_theta } else { MIN_SIN_THETA };
    1.0 / (2.0 * PI * PI * bounded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_follow_mitsuba() {
        let near = |a: Vec3A, b: Vec3A| (a - b).length() < 1e-6;
        assert!(near(direction(Vec2::new(0.3, 0.0)), Vec3A::Y));
        assert!(near(direction(Vec2::new(0.0, 0.5)), -Vec3A::Z));
        assert!(near(direction(Vec2::new(0.25, 0.5)), Vec3A::X));
        assert!(near(direction(Vec2::new(0.75, 0.5)), -Vec3A::X));
    }

    #[test]
    fn round_trip_is_exact_to_rounding_even_next_to_the_poles() {
        for v in [1e-5, 1e-3, 0.01, 0.37, 0.5, 0.93, 0.999, 0.999_99] {
            for u in [0.0, 1e-6, 0.1, 0.25, 0.4999, 0.5, 0.77, 0.999_99] {
                let x = Vec2::new(u, v);
                let y = square(direction(x));
                let du = (y.x - x.x).abs();
                // u: f32 angle error (2e-7) grows with 1 / sin theta only through the rounding of w,
                // which is relative.
                assert!(du.min(1.0 - du) < 1e-6, "{x} -> {y}");
                // v: sin(pi v) of an f32 argument near pi has absolute error 1e-7, i.e. 4e-8 in v.
                assert!((y.y - x.y).abs() < 2e-7, "{x} -> {y}");
            }
        }
    }

    #[test]
    fn degenerate_directions_stay_inside_the_square() {
        for w in [Vec3A::Y, -Vec3A::Y, Vec3A::new(-1e-30, 0.0, -1.0), Vec3A::new(-0.0, 1.0, -0.0)] {
            let x = square(w);
            assert!((0.0..1.0).contains(&x.x) && (0.0..=1.0).contains(&x.y), "{w} -> {x}");
        }
    }
}
