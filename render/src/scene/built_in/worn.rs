//! Worn surfaces: a texture of smooth blotches for the roughness, and coordinates for any shape.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use crate::{
    random::{Purpose, Stream},
    scene::{Mesh, Texture, Wrap},
};

/// Texels along a side.
const SIDE: usize = 128;

/// Waves that make up the blotches, of at most 12 periods along each side of the texture.
const WAVES: usize = 24;
const MOST_PERIODS: f32 = 12.0;

/// The directions along which u and v grow: skewed, so that the texture varies over every face of a box.
const ALONG: [Vec3; 2] = [Vec3::new(0.83, 0.31, 0.46), Vec3::new(-0.37, 0.86, 0.35)];

/// Returns a periodic texture of factors for roughness (green) from `least` to 1; metalness (blue) is left as
/// it is.
pub fn texture(least: f32) -> Texture {
    let mut random = Stream::new(0, Purpose::Bake, 0);
    let mut period = || (MOST_PERIODS * (2.0 * random.uniform() - 1.0)).round();
    let waves: Vec<[f32; 3]> = (0..WAVES).map(|_| [period(), period(), period()]).collect();
    let texel = |i: usize| {
        let at = Vec2::new((i % SIDE) as f32, (i / SIDE) as f32) / SIDE as f32;
        let height = |&[a, b, phase]: &[f32; 3]| (TAU * (a * at.x + b * at.y) + phase).sin() / (1.0 + a.hypot(b));
        let sum: f32 = waves.iter().map(height).sum();
        // A steep step between two levels: polished patches beside dull ones.
        let dull = 1.0 / (1.0 + (-4.0 * sum).exp());
        let factor = least + (1.0 - least) * dull;
        [255, (255.0 * factor).round() as u8, 255]
    };
    let texels = (0..SIDE * SIDE).map(texel).collect();
    Texture::new(SIDE, SIDE, texels, [Wrap::Repeat; 2]).expect("the texture has its texels")
}

/// Returns the shape with texture coordinates from its positions: the texture repeats every `size` metres.
pub fn mapped(mut shape: Mesh, size: f32) -> Mesh {
    shape.texcoords = shape.positions.iter().map(|p| Vec2::new(p.dot(ALONG[0]), p.dot(ALONG[1])) / size).collect();
    shape
}
