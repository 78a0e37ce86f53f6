//! Budgets in samples or time, and finished renderings.

use std::time::Duration;

use glam::Vec3A;

use crate::{image::Image, points::PointSet, visibility::CacheSize};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// After this many samples per pixel; 0 counts as 1.
    Spp(u32),
    /// After this much wall-clock time, at the nearest end of a pass over all pixels.
    Time(Duration),
}

/// A finished or interrupted image.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Light reflected by surfaces; black where the camera sees past them.
    pub surfaces: Image,
    /// The environment where the camera sees it; black elsewhere.
    pub background: Image,
    /// Fraction of each pixel's camera rays that hit a surface, `[height * width]`.
    pub coverage: Vec<f32>,
    /// Samples taken per pixel.
    pub spp: u32,
    /// Point set of the samples.
    pub points: PointSet,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Shadow rays per light estimate.
    pub rays_per_sample: f64,
    /// Largest luminance of a single contribution, before its shadow ray.
    pub max_weight: f32,
    /// Size of the trained visibility, for estimators that train.
    pub learned: Option<CacheSize>,
}

impl Rendering {
    /// Returns the surfaces over the environment.
    pub fn composite(&self) -> Image {
        let add = |(a, b): (&[f32; 3], &[f32; 3])| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        Image { pixels: self.surfaces.pixels.iter().zip(&self.background.pixels).map(add).collect(), ..self.surfaces }
    }

    /// Scales the picture to a map that is brighter by `factors`, per channel: all light must come from the
    /// map.
    #[must_use]
    pub fn lit_by(mut self, factors: Vec3A) -> Self {
        for pixel in self.surfaces.pixels.iter_mut().chain(&mut self.background.pixels) {
            *pixel = (Vec3A::from_array(*pixel) * factors).to_array();
        }
        // An upper bound: the largest contribution may have its luminance in another channel.
        self.max_weight *= factors.max_element();
        self
    }
}
