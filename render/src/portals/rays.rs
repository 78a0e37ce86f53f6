//! Rays from the surfaces of a room.

use std::f32::consts::TAU;

use glam::{Vec3, Vec3A};
use rayon::prelude::*;

use crate::{
    frame::Frame,
    random::{Purpose, Stream},
    scene::{Camera, Ray, RayKind, Scene},
};

/// Pixels that paths start at.
const WIDTH: usize = 96;
const HEIGHT: usize = 72;
/// Surfaces on a path, and rays from each.
const SURFACES: usize = 4;
const RAYS: usize = 8;
/// Rays that planes are searched with: those that reach the environment, and the others.
const MOST: [usize; 2] = [16_000, 8_000];

/// Rays that reach the environment, and those that hit a surface.
pub struct RoomRays {
    pub open: Vec<Ray>,
    pub blocked: Vec<Ray>,
    /// Rays that each of `open` and `blocked` stands for.
    pub weights: [f32; 2],
}

impl RoomRays {
    /// Traces rays along diffuse paths, cosine-weighted at each surface; one of `step` paths.
    pub fn trace(scene: &Scene, camera: &Camera, seed: u64, step: usize) -> Self {
        let numbers = (0..WIDTH * HEIGHT / step).into_par_iter();
        // In every row at other columns.
        let paths = numbers.map(|number| path(scene, camera, seed, number * step + number * step / WIDTH % step));
        let paths: Vec<[Vec<Ray>; 2]> = paths.collect();
        let of = |kind: usize| paths.iter().flat_map(|path| &path[kind]).copied().collect();
        Self { open: of(0), blocked: of(1), weights: [1.0; 2] }
    }

    /// Returns the fraction of the rays that reach the environment.
    pub fn openness(&self) -> f32 {
        self.open.len() as f32 / (self.open.len() + self.blocked.len()).max(1) as f32
    }

    /// Returns a subset of the rays, evenly spread, with weights that stand for all.
    pub fn thinned(self) -> Self {
        let some = |rays: Vec<Ray>, most: usize| {
            let step = rays.len().div_ceil(most).max(1);
            let kept: Vec<Ray> = rays.iter().step_by(step).copied().collect();
            let weight = rays.len() as f32 / kept.len().max(1) as f32;
            (kept, weight)
        };
        let ((open, of_open), (blocked, of_blocked)) = (some(self.open, MOST[0]), some(self.blocked, MOST[1]));
        Self { open, blocked, weights: [of_open, of_blocked] }
    }
}

/// Returns the rays of one pixel's path that reach the environment, and those that do not.
fn path(scene: &Scene, camera: &Camera, seed: u64, pixel: usize) -> [Vec<Ray>; 2] {
    let mut random = Stream::new(seed, Purpose::Portals, pixel as u64);
    let mut rays = [Vec::new(), Vec::new()];
    let [x, y] = [(pixel % WIDTH) as f32, (pixel / WIDTH) as f32];
    let mut next = scene.intersect(&camera.ray(x + random.uniform(), y + random.uniform(), WIDTH, HEIGHT));
    for _ in 0..SURFACES {
        let Some(at) = next.take() else { break };
        for _ in 0..RAYS {
            let ray = scene.leaving(at.p, at.ng, cosine_weighted(at.ng, &mut random));
            let hit = scene.intersect_one(RayKind::Bounce, &ray);
            rays[usize::from(hit.is_some())].push(ray);
            // The path goes on to the last surface that was hit.
            next = hit.or(next);
        }
    }
    rays
}

fn cosine_weighted(n: Vec3A, random: &mut Stream) -> Vec3A {
    let u = random.uniform2();
    let (sin, cos) = (TAU * u.x).sin_cos();
    let local = Vec3::new(u.y.sqrt() * cos, u.y.sqrt() * sin, (1.0 - u.y).sqrt());
    Frame::from_normal(n.into()).to_world(local).normalize().into()
}
