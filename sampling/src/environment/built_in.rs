//! Procedural environments: four kinds of light, from the easiest to the hardest to sample.
//!
//! Exported samplers identify their map by the hash of its texels, so texels are bit-identical on all
//! platforms. Elementary functions are those of [`simd`], not the platform's. Products of vectors are
//! written out, since glam's rounding differs between architectures; its sums and scalings are
//! componentwise.

use glam::{Vec2, Vec3A};

use super::Environment;
use crate::{image::Image, latlong, simd};

/// The names that [`built_in`] accepts.
pub const BUILT_IN_NAMES: [&str; 4] = ["overcast", "window", "studio", "sunset"];

const WIDTH: usize = 512;
const HEIGHT: usize = 256;

/// Makes a built-in environment of 512 x 256 texels; `None` for an unknown name.
///
/// - `overcast`: the CIE standard overcast sky over a dark ground; smooth.
/// - `window`: a dim room with one bright window and its reflection on the floor.
/// - `studio`: three softboxes and a dark backdrop; most of the light comes from 2 % of the sphere.
/// - `sunset`: a low sun of 0.5 degrees in a clear sky; half of the light comes from a few texels.
pub fn built_in(name: &str) -> Option<Environment> {
    let radiance: fn(Vec3A) -> Vec3A = match name {
        "overcast" => overcast,
        "window" => window,
        "studio" => studio,
        "sunset" => sunset,
        _ => return None,
    };
    let mut image = Image::black(WIDTH, HEIGHT);
    for (index, pixel) in image.pixels.iter_mut().enumerate() {
        *pixel = texel_mean(radiance, index % WIDTH, index / WIDTH).to_array();
    }
    Some(Environment::of_any_size(name, image, Vec::new()).expect("built-in environments are lit"))
}

/// The mean over 4 x 4 points around a texel centre, so that edges of lamps are not aliased.
fn texel_mean(radiance: fn(Vec3A) -> Vec3A, i: usize, j: usize) -> Vec3A {
    let mut sum = Vec3A::ZERO;
    for k in 0..16 {
        let offset = Vec2::new((k % 4) as f32, (k / 4) as f32) / 4.0 + Vec2::splat(0.125);
        let u = (i as f32 + offset.x) / WIDTH as f32;
        let v = (j as f32 + offset.y - 0.5) / (HEIGHT - 1) as f32;
        sum += radiance(latlong::direction(Vec2::new(u, v.clamp(0.0, 1.0))));
    }
    sum / 16.0
}

/// A unit direction from azimuth and elevation in degrees.
fn towards(azimuth: f32, elevation: f32) -> Vec3A {
    latlong::direction(Vec2::new(azimuth / 360.0, (90.0 - elevation) / 180.0))
}

/// 1 inside, 0 outside, smooth over `width` around the edge.
fn inside(distance: f32, width: f32) -> f32 {
    let t = (0.5 - distance / width).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn dot(a: Vec3A, b: Vec3A) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

fn cross(a: Vec3A, b: Vec3A) -> Vec3A {
    Vec3A::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

fn length(a: Vec3A) -> f32 {
    dot(a, a).sqrt()
}

fn mix(a: Vec3A, b: Vec3A, fraction_of_b: f32) -> Vec3A {
    a * (1.0 - fraction_of_b) + b * fraction_of_b
}

/// The angle of the point `(x, y)` in degrees.
fn angle(y: f32, x: f32) -> f32 {
    360.0 * simd::atan2_turns(y, x)
}

/// Coverage of a rectangle of half-angles `half` (degrees) around a direction.
fn rectangle(w: Vec3A, centre: Vec3A, half: Vec2, softness: f32) -> f32 {
    let side = cross(Vec3A::Y, centre);
    let side = side / length(side);
    let up = cross(centre, side);
    let depth = dot(w, centre);
    if depth <= 0.0 {
        return 0.0;
    }
    let outside = |along: Vec3A, half: f32| angle(dot(w, along), depth).abs() - half;
    inside(outside(side, half.x), softness) * inside(outside(up, half.y), softness)
}

fn overcast(w: Vec3A) -> Vec3A {
    // CIE standard overcast sky: (1 + 2 sin elevation) / 3 of the zenith.
    let sky = Vec3A::new(0.92, 0.97, 1.0) * ((1.0 + 2.0 * w.y.max(0.0)) / 3.0);
    let ground = Vec3A::new(0.10, 0.09, 0.08);
    mix(ground, sky, inside(-w.y, 0.04))
}

fn window(w: Vec3A) -> Vec3A {
    let wall = Vec3A::new(0.05, 0.045, 0.04) * (1.0 + 0.5 * w.y);
    let pane = towards(60.0, 18.0);
    let mut radiance = wall;
    let frame = rectangle(w, pane, Vec2::new(22.0, 16.0), 0.8);
    // A cross bar divides the window into four panes.
    let bars = rectangle(w, pane, Vec2::new(0.9, 17.0), 0.8).max(rectangle(w, pane, Vec2::new(23.0, 0.9), 0.8));
    radiance += Vec3A::new(5.4, 6.0, 6.8) * (frame * (1.0 - bars)) * (1.0 + 1.5 * (w.y - pane.y));
    let mirror = Vec3A::new(w.x, -w.y, w.z);
    radiance += Vec3A::new(0.42, 0.38, 0.30) * rectangle(mirror, pane, Vec2::new(26.0, 14.0), 12.0);
    radiance
}

fn studio(w: Vec3A) -> Vec3A {
    let backdrop = Vec3A::splat(0.02) + Vec3A::splat(0.03) * w.y.max(0.0);
    let key = rectangle(w, towards(40.0, 42.0), Vec2::new(11.0, 8.0), 0.6);
    let fill = rectangle(w, towards(200.0, 25.0), Vec2::new(14.0, 14.0), 0.6);
    let rim = rectangle(w, towards(310.0, 55.0), Vec2::new(3.0, 14.0), 0.6);
    backdrop
        + Vec3A::new(30.0, 29.0, 27.0) * key
        + Vec3A::new(4.0, 4.3, 4.8) * fill
        + Vec3A::new(24.0, 25.0, 27.0) * rim
}

fn sunset(w: Vec3A) -> Vec3A {
    let sun = towards(120.0, 7.0);
    // By the arc tangent: the cosine of a small angle loses half of its digits.
    let from_sun = angle(length(cross(w, sun)), dot(w, sun));
    let zenith = Vec3A::new(0.10, 0.18, 0.38);
    let horizon = Vec3A::new(0.55, 0.38, 0.26);
    // height^0.45; `ln` needs normal numbers.
    let height = if w.y > f32::MIN_POSITIVE { simd::exp(0.45 * simd::ln(w.y)) } else { 0.0 };
    let sky = mix(horizon, zenith, height);
    let glow = Vec3A::new(2.2, 1.1, 0.45) * simd::exp(-from_sun / 14.0)
        + Vec3A::new(9.0, 5.0, 2.2) * simd::exp(-from_sun / 2.5);
    let disc = Vec3A::new(9000.0, 5200.0, 2300.0) * inside(from_sun - 0.5, 0.3);
    let ground = Vec3A::new(0.06, 0.045, 0.035);
    mix(ground, sky + glow + disc, inside(-w.y, 0.01))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_the_same_hashes_on_every_platform() {
        // If these change, exported samplers of built-in maps no longer load.
        let hashes = [
            ("overcast", "e2c2e0314e101c5585ee5e64439961bea9b3d057b2a2ec302d6415e90ba772bf"),
            ("window", "a707adaefb68d343a030d8991fdf5b26c3ae2637f79fb9756b22696c74877c38"),
            ("studio", "a37d7fe666b7d4e736f3e5e7197f3d82370efa5455f224b8b4c02b9e4f7deb97"),
            ("sunset", "e42fdd51a4617845929bab7fa78f581c3babe76727f7ec5dc68dda8005306896"),
        ];
        assert_eq!(hashes.map(|(name, _)| name), BUILT_IN_NAMES);
        for (name, hash) in hashes {
            assert_eq!(built_in(name).unwrap().hash(), hash, "{name}");
        }
    }

    /// The radiance of `sunset` with the platform's functions in f64, and its change by an error of the
    /// angle to the sun.
    fn sunset_in_double_precision(w: Vec3A) -> [[f64; 2]; 3] {
        // Components of the f32 cross product are off by up to 3 roundings of 6e-8 rad, which is 1e-5
        // degrees.
        const ERROR: f64 = 2e-5;
        let w = w.as_dvec3().normalize();
        let sun = towards(120.0, 7.0).as_dvec3().normalize();
        let degrees = w.cross(sun).length().atan2(w.dot(sun)).to_degrees();
        let inside = |distance: f64, width: f64| {
            let t = (0.5 - distance / width).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        let mix = |a: f64, b: f64, t: f64| a * (1.0 - t) + b * t;
        std::array::from_fn(|c| {
            let at = |degrees: f64| {
                let sky = mix([0.55, 0.38, 0.26][c], [0.10, 0.18, 0.38][c], w.y.max(0.0).powf(0.45));
                let glow = [9.0, 5.0, 2.2][c] * (-degrees / 2.5).exp() + [2.2, 1.1, 0.45][c] * (-degrees / 14.0).exp();
                let disc = [9000.0, 5200.0, 2300.0][c] * inside(degrees - 0.5, 0.3);
                mix([0.06, 0.045, 0.035][c], sky + glow + disc, inside(-w.y, 0.01))
            };
            [at(degrees), at(degrees - ERROR) - at(degrees + ERROR)]
        })
    }

    #[test]
    fn sunset_matches_double_precision() {
        let grid = |count: usize| {
            (0..count * count).map(move |k| Vec2::new((k % count) as f32, (k / count) as f32) / count as f32)
        };
        let sphere = grid(200).map(latlong::direction);
        let around_the_sun = grid(200).map(|x| towards(119.0 + 2.0 * x.x, 6.0 + 2.0 * x.y));
        for w in sphere.chain(around_the_sun) {
            for (found, [expected, uncertainty]) in sunset(w).to_array().into_iter().zip(sunset_in_double_precision(w))
            {
                // About ten operations on numbers of the size of the result, or of 1, each with a
                // relative error of at most 3e-7.
                let error = (f64::from(found) - expected).abs();
                assert!(error < uncertainty + 3e-6 * expected.max(1.0), "{w}: {found} {expected}");
            }
        }
    }
}
