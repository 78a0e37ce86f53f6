//! The sums of all pixels, and passes over them.

use std::cell::RefCell;

use glam::{DVec3, Vec3A};

use super::{
    rendering::Rendering,
    tiles::Tiles,
    view::{Part, View},
    wavefront::{Estimate, Pixel, Workspace},
};
use crate::{
    estimator::{Estimator, LearningSession},
    image::Image,
    points::{PointSet, Points},
    timings::flush,
};

/// A range of samples of every pixel.
pub(super) struct Pass<'a> {
    pub estimator: &'a dyn Estimator,
    /// Receives the visibility of contributions.
    pub session: Option<&'a LearningSession<'a>>,
    pub points: Points,
    /// First sample and end of the range.
    pub samples: (u32, u32),
}

/// The sums of all pixels.
pub(super) struct Film {
    part: Part,
    tiles: Tiles<Pixel>,
}

impl Film {
    pub fn new(part: Part) -> Self {
        Self::of(part, |_| true)
    }

    /// Creates a film of the pixels whose keys `has` accepts.
    pub fn of(part: Part, has: impl Fn(u32) -> bool) -> Self {
        Self { part, tiles: Tiles::new(part, has) }
    }

    /// Adds samples to every pixel, tiles in parallel.
    pub fn add(&mut self, view: &View<'_>, pass: &Pass<'_>) {
        thread_local! {
            static WORKSPACE: RefCell<Workspace> = RefCell::default();
        }
        self.tiles.par_for_each(|mut pixels| {
            WORKSPACE.with_borrow_mut(|workspace| {
                let estimate = Estimate { estimator: pass.estimator, session: pass.session };
                for sample in pass.samples.0..pass.samples.1 {
                    workspace.sample(view, estimate, pass.points.at_sample(sample), &mut pixels);
                }
            });
            flush();
        });
    }

    /// Divides the sums by `spp`.
    pub fn resolve(&self, points: PointSet, spp: u32, seconds: f64) -> Rendering {
        let Part { width, height, .. } = self.part;
        let pixels = self.tiles.row_major();
        let image = |of: fn(&Pixel) -> DVec3| Image {
            width,
            height,
            pixels: pixels.iter().map(|pixel| Vec3A::from((of(pixel) / f64::from(spp)).as_vec3()).to_array()).collect(),
        };
        let (estimates, rays) = pixels.iter().fold((0, 0), |(e, r), pixel| (e + pixel.estimates, r + pixel.rays));
        Rendering {
            surfaces: image(|pixel| pixel.surfaces),
            background: image(|pixel| pixel.background),
            coverage: pixels.iter().map(|pixel| pixel.estimates as f32 / spp as f32).collect(),
            spp,
            points,
            seconds,
            rays_per_sample: rays as f64 / estimates.max(1) as f64,
            max_weight: pixels.iter().map(|pixel| pixel.max_weight).fold(0.0, f32::max),
            learned: None,
        }
    }
}
