//! Unbiased estimators of the environment light reflected by shading points.
//!
//! An estimator proposes contributions; the owner of the scene adds those whose shadow rays are unblocked.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `Estimator`, contributions |
//! | `single_sample.rs`, `split.rs` | one direction, and the mean of several |
//! | `two_sample_mis.rs`, `ris.rs` | two-sample MIS, resampling |
//! | `learned_visibility.rs` | patches with visibility that is learned before each rendering |
//! | `exploration.rs` | the shadow rays that visibility is learned from |

mod exploration;
mod learned_visibility;
mod ris;
mod single_sample;
mod split;
mod two_sample_mis;

pub use learned_visibility::{LearnedVisibility, LearningSession};
pub use ris::Ris;
pub use single_sample::SingleSample;
pub use split::Split;
pub use two_sample_mis::TwoSampleMis;

use glam::Vec3A;

use crate::{
    columns::Arena,
    environment::Environment,
    points::Points,
    simd::Lanes,
    tile::{MAX_POINTS, Rows},
};

/// An unbiased estimator of reflected light: the sum of its unoccluded contributions.
pub trait Estimator: Send + Sync {
    /// Adds contributions for each row; all randomness comes from `points`.
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena);

    /// Returns an estimator for one rendering, if this one learns visibility before it renders. What it
    /// learns is dropped after the rendering, so that images do not depend on earlier ones.
    fn learning_session(&self, _view: ViewGeometry) -> Option<LearningSession<'_>> {
        None
    }
}

/// Camera and size of a rendering, which determine the size of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewGeometry {
    /// Position of the camera, in metres.
    pub eye: Vec3A,
    /// Angle of a pixel, in radians.
    pub pixel: f32,
    /// Number of pixels of the image.
    pub pixels: usize,
}

/// Directions with their contributions if unoccluded. Contributions are positive, except those of exploration
/// rays.
#[derive(Clone, Debug, Default)]
pub struct Contributions {
    places: Vec<u16>,
    wi: Vec<Vec3A>,
    radiance: Vec<Vec3A>,
    /// The patches of exploration rays.
    patches: Vec<u16>,
}

impl Contributions {
    /// Removes all contributions.
    pub fn clear(&mut self) {
        self.places.clear();
        self.wi.clear();
        self.radiance.clear();
        self.patches.clear();
    }

    /// Adds a contribution of a row.
    ///
    /// # Panics
    /// If `place` is not below [`MAX_POINTS`], the size of a full tile.
    pub fn push(&mut self, place: usize, wi: Vec3A, radiance: Vec3A) {
        assert!(place < MAX_POINTS, "a tile has no row {place}");
        self.places.push(place as u16);
        self.wi.push(wi);
        self.radiance.push(radiance);
    }

    /// Adds an exploration ray to a patch.
    pub(crate) fn push_ray(&mut self, place: usize, wi: Vec3A, patch: u16) {
        self.push(place, wi, Vec3A::ZERO);
        self.patches.push(patch);
    }

    /// Returns the row of each contribution.
    pub fn places(&self) -> &[u16] {
        &self.places
    }

    /// Returns unit directions, above the geometric surfaces.
    pub fn wi(&self) -> &[Vec3A] {
        &self.wi
    }

    /// Returns the reflected radiance per channel, if unoccluded.
    pub fn radiance(&self) -> &[Vec3A] {
        &self.radiance
    }
}

/// Evaluates light x BRDF x cosine per channel for one direction per row.
pub(crate) fn integrand(
    at: &Rows<'_>,
    environment: &Environment,
    wi: [&[Lanes]; 3],
    mut out: [&mut [Lanes]; 3],
    arena: &Arena,
) {
    let mut radiance = arena.columns::<3>(at.strips());
    environment.radiances(wi, radiance.get_mut());
    at.brdf_cosine(wi, out.each_mut().map(|column| &mut **column), arena);
    for (out, radiance) in out.into_iter().zip(radiance.get()) {
        for (out, radiance) in out.as_flattened_mut().iter_mut().zip(radiance.as_flattened()) {
            *out *= radiance;
        }
    }
}

/// Adds `light x BRDF x cosine x weight` for one direction per row; rows with weight 0 are skipped.
pub(crate) fn contribute(
    at: &Rows<'_>,
    environment: &Environment,
    wi: [&[Lanes]; 3],
    weights: &[Lanes],
    out: &mut Contributions,
    arena: &Arena,
) {
    let mut values = arena.columns::<3>(at.strips());
    integrand(at, environment, wi, values.get_mut(), arena);
    let ([x, y, z], [red, green, blue]) = (wi.map(<[Lanes]>::as_flattened), values.get().map(<[Lanes]>::as_flattened));
    for (place, &weight) in weights.as_flattened()[..at.len()].iter().enumerate() {
        let radiance = Vec3A::new(red[place], green[place], blue[place]) * weight;
        // Rejected samples have arbitrary directions and may evaluate to NaN.
        if weight > 0.0 && radiance.max_element() > 0.0 {
            out.push(place, Vec3A::new(x[place], y[place], z[place]), radiance);
        }
    }
}
