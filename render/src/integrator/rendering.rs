//! What is asked for in samples or time, and the picture that comes of it.

use std::time::Duration;

use glam::Vec3A;

use crate::{image::Image, points::PointSet, visibility::CacheSize};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// After this many samples per pixel; 0 counts as 1.
    Spp(u32),
    /// After this much wall-clock time, at the end of the pass over all pixels that comes nearest to it.
    Time(Duration),
}

/// A finished or interrupted image.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Light reflected by surfaces; black where the camera sees past them.
    pub surfaces: Image,
    /// The environment where the camera sees it; black elsewhere.
    pub background: Image,
    /// Share of each pixel's camera rays that hit a surface, `[height * width]`.
    pub coverage: Vec<f32>,
    /// Samples per pixel that were taken.
    pub spp: u32,
    /// The points that they were taken at.
    pub points: PointSet,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Shadow rays over light estimates.
    pub rays_per_sample: f64,
    /// The largest luminance of a single contribution before its shadow ray.
    pub max_weight: f32,
    /// What was learned of visibility, by an estimator that learns.
    pub learned: Option<CacheSize>,
}

impl Rendering {
    /// Surfaces before the environment.
    pub fn composite(&self) -> Image {
        let add = |(a, b): (&[f32; 3], &[f32; 3])| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        Image { pixels: self.surfaces.pixels.iter().zip(&self.background.pixels).map(add).collect(), ..self.surfaces }
    }

    /// The picture under a map that is so many times as bright, per channel: all light comes from the map.
    #[must_use]
    pub fn lit_by(mut self, factors: Vec3A) -> Self {
        for pixel in self.surfaces.pixels.iter_mut().chain(&mut self.background.pixels) {
            *pixel = (Vec3A::from_array(*pixel) * factors).to_array();
        }
        // A bound: the brightest contribution need not have been of the brightest channel.
        self.max_weight *= factors.max_element();
        self
    }
}
