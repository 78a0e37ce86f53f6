//! A material beside its source: a flat piece of cloth under three lights, seen from three distances.

use glam::{Vec2, Vec3};
use headtail_render::{
    brdf::neural_texture::NeuralTexture,
    fabric::{Query, Source},
    image::Image,
};
use std::f32::consts::PI;

use super::samples::answers;

/// Distances of the camera, in tiles, and half the tangent of its field of view.
pub const DISTANCES: [f32; 3] = [2.5, 7.0, 20.0];
const HALF_HEIGHT: f32 = 0.268;
/// Side length of a picture, and the gap between two, in pixels.
const SIDE: usize = 192;
const GAP: usize = 4;
/// Directions and strengths of the lights: a white diffuse surface that faces a light of strength 1 has
/// radiance 1.
const LIGHTS: [([f32; 3], f32); 3] = [([0.1, 0.75, 0.65], 0.8), ([-0.7, 0.1, 0.7], 0.3), ([0.75, -0.45, 0.5], 0.3)];

/// Number of queries to a source by [`side_by_side`].
pub const QUERIES: usize = DISTANCES.len() * LIGHTS.len() * SIDE * SIDE;

/// Returns rows of pictures from near to far, the source on the left and the material on the right, and for
/// each row the peak signal-to-noise ratio in dB. The source uses `paths` light paths per pixel and light.
pub fn side_by_side(source: &dyn Source, material: &NeuralTexture, paths: u32) -> (Image, Vec<f64>) {
    let mut image = Image::black(2 * SIDE + GAP, DISTANCES.len() * (SIDE + GAP) - GAP);
    image.pixels.fill([1.0; 3]);
    let mut errors = Vec::new();
    for (row, &distance) in DISTANCES.iter().enumerate() {
        let truth = picture(distance, |queries| source.reflect(queries, paths, row as u64));
        let neural = picture(distance, |queries| answers(material, queries));
        let squared = truth.iter().zip(&neural).map(|(a, b)| f64::from((*a - *b).length_squared()) / 3.0);
        errors.push(-10.0 * (squared.sum::<f64>() / truth.len() as f64).max(f64::MIN_POSITIVE).log10());
        for (column, picture) in [truth, neural].iter().enumerate() {
            for (k, value) in picture.iter().enumerate() {
                let (x, y) = (column * (SIDE + GAP) + k % SIDE, row * (SIDE + GAP) + k / SIDE);
                image.pixels[y * image.width + x] = value.to_array();
            }
        }
    }
    (image, errors)
}

/// Returns the radiances of the pixels under all lights.
fn picture(distance: f32, answer: impl Fn(&[Query]) -> Vec<Vec3>) -> Vec<Vec3> {
    let mut sum = vec![Vec3::ZERO; SIDE * SIDE];
    for (light, strength) in LIGHTS {
        let values = answer(&queries(distance, Vec3::from_array(light).normalize()));
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += strength * PI * value);
    }
    sum
}

/// Returns the queries of a camera's pixels that looks down at the cloth, 40 degrees from its normal.
fn queries(distance: f32, wi: Vec3) -> Vec<Query> {
    let (sin, cos) = 40.0_f32.to_radians().sin_cos();
    let eye = distance * Vec3::new(0.0, -sin, cos);
    let (forward, up) = (Vec3::new(0.0, sin, -cos), Vec3::new(0.0, cos, sin));
    let pixel = 2.0 * HALF_HEIGHT / SIDE as f32;
    let query = |k: usize| {
        let across = pixel * ((k % SIDE) as f32 + 0.5) - HALF_HEIGHT;
        let rise = HALF_HEIGHT - pixel * ((k / SIDE) as f32 + 0.5);
        let ray = (forward + across * Vec3::X + rise * up).normalize();
        let reach = -eye.z / ray.z;
        let at = eye + reach * ray;
        let width = pixel * reach / (12.0 * -ray.z).sqrt();
        Query { uv: Vec2::new(at.x, at.y), width, wo: -ray, wi }
    };
    (0..SIDE * SIDE).map(query).collect()
}
