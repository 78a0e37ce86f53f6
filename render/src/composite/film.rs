//! Per-pixel sums of a composite.

use glam::{DVec3, DVec4};

/// Sums over the samples of one pixel that hit the catcher.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CatcherSums {
    /// Camera rays that hit the catcher.
    pub hits: u32,
    /// Sum of the visible weights over the irradiance, per channel and for luminance.
    pub visible: DVec4,
    /// Sum of the weights, over the irradiance, that the catcher does not block. Its mean is the fraction of
    /// the irradiance that self-shadowing leaves.
    pub all: DVec4,
    /// Sum of the squares of the weights in `visible`.
    pub visible_squares: DVec4,
    /// Sum of the squares of the weights in `all`.
    pub all_squares: DVec4,
    /// Sum of all weights over the irradiance, 1 on average; equals `all` for a plane.
    pub drawn: DVec4,
    /// Number of visible draws. Draws below the surface or without light are not counted.
    pub seen: u64,
    /// Number of draws that the catcher does not block, counted as for `seen`.
    pub draws: u64,
    /// Sum of the light that the object reflects to the catcher, over the irradiance.
    pub thrown_back: DVec3,
}

/// The sums of all pixels, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Samples per pixel so far.
    pub spp: u32,
    /// Sums of the catcher.
    pub catcher: Vec<CatcherSums>,
    /// Camera rays that hit the object, and the sum of their radiance.
    pub object: Vec<(u32, DVec3)>,
    /// Shadow rays of the mask.
    pub mask_rays: u64,
    /// Shadow rays of the object and of further bounces.
    pub other_rays: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

impl Film {
    /// Creates a film without samples.
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
