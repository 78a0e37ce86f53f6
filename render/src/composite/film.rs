//! What a composition sums up in every pixel.

use glam::{DVec3, DVec4};

/// Sums over the samples of one pixel that hit the catcher.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CatcherSums {
    /// Camera rays that hit the catcher.
    pub hits: u32,
    /// Visible weights over the irradiance, per channel and of luminance.
    pub visible: DVec4,
    /// The weights that the catcher does not block itself, over the irradiance. In the mean the share of it that the catcher leaves itself.
    pub all: DVec4,
    /// Squares of the visible ones among these weights, and of all of them.
    pub visible_squares: DVec4,
    /// See `visible_squares`.
    pub all_squares: DVec4,
    /// All weights over the irradiance: 1 in the mean. Those of a plane are all open.
    pub drawn: DVec4,
    /// Draws that were visible, and draws. Those below the surface or without light are not counted.
    pub seen: u64,
    /// See `seen`.
    pub draws: u64,
    /// Light that comes from the object, over the irradiance.
    pub thrown_back: DVec3,
}

/// The sums of all pixels, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples per pixel so far.
    pub spp: u32,
    /// Of the catcher.
    pub catcher: Vec<CatcherSums>,
    /// Camera rays that hit the object, and the radiance that they found.
    pub object: Vec<(u32, DVec3)>,
    /// Shadow rays of the mask.
    pub mask_rays: u64,
    /// Shadow rays of the object and of further bounces.
    pub other_rays: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

impl Film {
    /// A film without samples.
    pub fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self {
            width,
            height,
            spp: 0,
            catcher: vec![CatcherSums::default(); pixels],
            object: vec![(0, DVec3::ZERO); pixels],
            mask_rays: 0,
            other_rays: 0,
            seconds: 0.0,
        }
    }
}
