//! Environments made by code: four kinds of light, from the easiest to the hardest to sample.

use std::f32::consts::PI;

use glam::{Vec2, Vec3A};

use super::Environment;
use crate::{image::Image, latlong};

/// The names that [`built_in`] knows.
pub const BUILT_IN_NAMES: [&str; 4] = ["overcast", "window", "studio", "sunset"];

const WIDTH: usize = 512;
const HEIGHT: usize = 256;

/// A built-in environment of 512 x 256 texels; `None` for an unknown name.
///
/// - `overcast`: the CIE standard overcast sky over a dark ground; smooth.
/// - `window`: a dim room with one bright window and its reflection on the floor.
/// - `studio`: three softboxes and a dark backdrop; most of the light from 2 % of the sphere.
/// - `sunset`: a low sun of half a degree in a clear sky; half of the light from a few texels.
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
    Some(Environment::from_image(name, image).expect("built-in environments are lit"))
}

/// The mean over 4 x 4 points around a texel centre: edges of lamps are not aliased.
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

/// Coverage of a rectangle of half-angles `half` (degrees) around a direction.
fn rectangle(w: Vec3A, centre: Vec3A, half: Vec2, softness: f32) -> f32 {
    let side = Vec3A::Y.cross(centre).normalize();
    let up = centre.cross(side);
    let depth = w.dot(centre);
    if depth <= 0.0 {
        return 0.0;
    }
    let angles = Vec2::new(w.dot(side).atan2(depth), w.dot(up).atan2(depth)) * (180.0 / PI);
    let outside = angles.abs() - half;
    inside(outside.x, softness) * inside(outside.y, softness)
}

fn overcast(w: Vec3A) -> Vec3A {
    // CIE standard overcast sky: (1 + 2 sin elevation) / 3 of the zenith.
    let sky = Vec3A::new(0.92, 0.97, 1.0) * ((1.0 + 2.0 * w.y.max(0.0)) / 3.0);
    let ground = Vec3A::new(0.10, 0.09, 0.08);
    ground.lerp(sky, inside(-w.y, 0.04))
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
    let angle = w.dot(sun).clamp(-1.0, 1.0).acos() * (180.0 / PI);
    let height = w.y.max(0.0);
    let zenith = Vec3A::new(0.10, 0.18, 0.38);
    let horizon = Vec3A::new(0.55, 0.38, 0.26);
    let sky = horizon.lerp(zenith, height.powf(0.45));
    let glow = Vec3A::new(2.2, 1.1, 0.45) * (-angle / 14.0).exp() + Vec3A::new(9.0, 5.0, 2.2) * (-angle / 2.5).exp();
    let disc = Vec3A::new(9000.0, 5200.0, 2300.0) * inside(angle - 0.5, 0.3);
    let ground = Vec3A::new(0.06, 0.045, 0.035);
    ground.lerp(sky + glow + disc, inside(-w.y, 0.01))
}
