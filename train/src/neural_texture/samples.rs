//! Samples of a bidirectional texture: queries and answers.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use headtail_render::{
    brdf::neural_texture::{Mixture, NeuralTexture, Seen, TEXEL_WIDTH},
    color::luminance,
    columns::Arena,
    fabric::{MIN_COSINE, Query, Source},
    random::{Purpose, Stream},
};

use super::settings::Settings;

/// Probabilities that a direction is uniform in the projected disk, or mirrored about a slope of [`SLOPES`];
/// otherwise it is uniform over the hemisphere. Directions to the viewer are not mirrored.
const DISK_PROBABILITY: f32 = 0.5;
const MIRROR_PROBABILITY: f32 = 0.25;
/// Slopes of half vectors of mirrored directions.
const SLOPES: Mixture = Mixture { lobe_weight: 1.0, widths: Vec2::splat(0.35), shift: Vec2::ZERO };

/// Queries with estimates of their answers.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// The queries.
    pub queries: Vec<Query>,
    /// Levels of the footprints.
    pub levels: Vec<f32>,
    /// Estimates of `f_r cos` per channel.
    pub values: Vec<Vec3>,
    /// The density of each `wi` in solid angle, up to a factor that depends on `wo`.
    pub densities: Vec<f32>,
}

impl Samples {
    /// Draws the samples of a step; equal settings and steps give equal samples.
    pub fn draw(source: &dyn Source, settings: &Settings, step: usize) -> Self {
        let mut random = Stream::new(settings.seed, Purpose::Batch, step as u64);
        let mut samples = Self::questions(settings.side, settings.batch, &mut random);
        let seed = settings.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ step as u64;
        samples.values = source.reflect(&samples.queries, settings.paths, seed);
        samples
    }

    /// Draws queries without answers: positions are uniform over the tile, levels more often fine than
    /// coarse.
    pub fn questions(side: usize, count: usize, random: &mut Stream) -> Self {
        let mut samples = Self::default();
        for _ in 0..count {
            let level = side.ilog2() as f32 * random.uniform().powi(2);
            let width = TEXEL_WIDTH / side as f32 * level.exp2();
            let wo = direction(random);
            let wi = light(wo, random);
            samples.queries.push(Query { uv: random.uniform2(), width, wo, wi });
            samples.levels.push(level);
            samples.densities.push((1.0 - MIRROR_PROBABILITY) * density(wi) + MIRROR_PROBABILITY * SLOPES.pdf(wo, wi));
        }
        samples
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.queries.len()
    }

    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.queries.is_empty()
    }

    /// Iterates over the luminances of the values.
    pub fn luminances(&self) -> impl Iterator<Item = f32> {
        self.values.iter().map(|&value| luminance(value.into()))
    }
}

/// Draws a direction above [`MIN_COSINE`].
fn direction(random: &mut Stream) -> Vec3 {
    let (u, disk) = (random.uniform2(), random.uniform() < DISK_PROBABILITY);
    let squared = 1.0 - u.x * (1.0 - MIN_COSINE * MIN_COSINE);
    let z = if disk { squared.sqrt() } else { MIN_COSINE + (1.0 - MIN_COSINE) * u.x };
    ((1.0 - z * z).max(0.0).sqrt() * Vec2::from_angle(TAU * u.y)).extend(z)
}

/// Draws a direction to the light. Mirrored directions below [`MIN_COSINE`] are drawn again, from all kinds.
fn light(wo: Vec3, random: &mut Stream) -> Vec3 {
    loop {
        if random.uniform() >= MIRROR_PROBABILITY {
            return direction(random);
        }
        let wi = SLOPES.mirrored(wo, random.uniform2());
        if wi.z >= MIN_COSINE {
            return wi;
        }
    }
}

/// Returns the density of [`direction`] in solid angle.
fn density(w: Vec3) -> f32 {
    let disk = w.z / (PI * (1.0 - MIN_COSINE * MIN_COSINE));
    let hemisphere = 1.0 / (TAU * (1.0 - MIN_COSINE));
    DISK_PROBABILITY * disk + (1.0 - DISK_PROBABILITY) * hemisphere
}

/// Difference between a material and its source, in dB.
#[derive(Clone, Copy, Debug)]
pub struct Decibels {
    /// Peak signal-to-noise ratio: from the mean of squared differences of `pi f_r cos`, which is 1 for a
    /// white diffuse surface that faces the light. Highlights of glossy cloth are far above this peak.
    pub psnr: f64,
    /// Peak signal-to-noise ratio of the reference, as an estimate of its noise.
    pub noise: f64,
    /// Signal-to-noise ratio: the mean square of the reference over that of the differences.
    pub snr: f64,
}

/// Compares a material with its source over `count` queries that are not used for training. The reference is
/// the mean of `paths` light paths; its noise is measured from two halves of them.
pub fn error_over(source: &dyn Source, material: &NeuralTexture, count: usize, paths: u32, seed: u64) -> Decibels {
    let mut random = Stream::new(seed, Purpose::Validation, 0);
    let mut asked = Samples::questions(material.pyramid().side(), count, &mut random);
    let halves = [1, 2].map(|half| source.reflect(&asked.queries, paths.div_ceil(2), seed.wrapping_add(half << 32)));
    asked.values = halves[0].iter().zip(&halves[1]).map(|(&a, &b)| 0.5 * (a + b)).collect();
    let answers = answers(material, &asked.queries);
    let squared = |a: &Vec3, b: &Vec3| f64::from((PI * (*a - *b)).length_squared()) / 3.0;
    let mean = |sum: f64| (sum / count as f64).max(f64::MIN_POSITIVE);
    let error = mean(asked.values.iter().zip(&answers).map(|(a, b)| squared(a, b)).sum());
    // The mean of both halves has 1/4 of the variance of their difference.
    let noise = mean(halves[0].iter().zip(&halves[1]).map(|(a, b)| squared(a, b)).sum()) / 4.0;
    let signal = mean(asked.values.iter().map(|value| squared(value, &Vec3::ZERO)).sum());
    let decibels = |error: f64| -10.0 * error.log10();
    Decibels { psnr: decibels(error), noise: decibels(noise.max(f64::MIN_POSITIVE)), snr: decibels(error / signal) }
}

/// Returns a material's answers, as a renderer evaluates it.
pub fn answers(material: &NeuralTexture, queries: &[Query]) -> Vec<Vec3> {
    use headtail_render::{
        brdf::{Brdf, Surfaces},
        columns::strips,
        simd::LANES,
    };
    let arena = Arena::default();
    let mut columns = arena.columns::<23>(strips(queries.len()));
    let mut all = columns.get_mut();
    for (k, query) in queries.iter().enumerate() {
        // The first axis of the frame of +z is +x: local directions equal world directions.
        let seen = Seen { uv: query.uv, width: query.width, wo: query.wo, tangent: [1.0, 0.0, 1.0] };
        let numbers = [0.0, 0.0, 1.0].into_iter().chain(query.wo.to_array()).chain(query.wi.to_array());
        for (column, number) in all.iter_mut().zip(numbers.chain(material.parameters(&seen))) {
            column[k / LANES][k % LANES] = number;
        }
    }
    let [nx, ny, nz, ox, oy, oz, x, y, z, rest @ ..] = all;
    let [p0, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, red, green, blue] = rest;
    let parameters: [&[[f32; LANES]]; 11] = [p0, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10];
    let at = Surfaces { n: [nx, ny, nz], wo: [ox, oy, oz], parameters };
    material.evaluate_cosine(&at, [x, y, z], [&mut *red, &mut *green, &mut *blue]);
    let value = |k: usize| {
        let number = |column: &[[f32; LANES]]| column[k / LANES][k % LANES];
        Vec3::new(number(red), number(green), number(blue))
    };
    (0..queries.len()).map(value).collect()
}
