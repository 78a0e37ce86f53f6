//! Unbiased estimators of the light that shading points reflect from the environment.
//!
//! An estimator proposes contributions; whoever owns the scene finds out which of them are visible and tells the estimator.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the traits `Estimator` and `Learner`, contributions |
//! | `single_sample.rs`, `split.rs` | one direction, and the mean of several |
//! | `two_sample_mis.rs`, `ris.rs` | two-sample MIS, resampling |
//! | `learned_visibility.rs` | patches with visibility learned before each rendering |
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

use crate::{columns::Arena, environment::Environment, points::Points, simd::Lanes, tile::Rows, visibility::CacheSize};

/// An unbiased estimator of reflected light: the sum of its contributions that are not occluded.
pub trait Estimator: Send + Sync {
    /// Adds contributions for each row; all randomness comes from `points`.
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena);

    /// An estimator of its own for one rendering, if this one learns before it renders: what it has learned ends with the rendering, so that results
    /// depend on nothing else.
    fn learner<'a>(&'a self, _setting: Setting) -> Option<Box<dyn Learner + 'a>> {
        None
    }
}

/// What a rendering is like, for those that learn from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Where the camera stands, in metres.
    pub eye: Vec3A,
    /// The angle that a pixel spans, in radians.
    pub pixel: f32,
    /// Pixels of the image.
    pub pixels: usize,
}

/// An estimator that learns from shadow rays.
pub trait Learner: Estimator {
    /// Tells which of the contributions that were proposed for these rows while it [explored](Self::explore) are visible.
    fn observe(&self, at: &Rows<'_>, contributions: &Contributions, visible: &[bool]);

    /// Takes in what was observed, so that it needs less memory.
    fn settle(&mut self);

    /// Takes in what was observed, and finds out what it is worth.
    fn learn(&mut self);

    /// Lets what was learned be drawn with from now on.
    fn finish(&mut self);

    /// Whether there may be something to gain from learning so many times as much in all; it is told by what was gained since it was last asked, too.
    fn promises(&mut self, times: f64) -> bool;

    /// Whether what it proposes is for learning alone from now on: what such contributions add to an estimate is of no account.
    fn explore(&mut self, explores: bool);

    /// What there is to be told about it.
    fn size(&self) -> CacheSize;
}

/// Directions and what they add to an estimate if the environment is seen along them. None of them is black, but those that are sent to learn from.
#[derive(Clone, Debug, Default)]
pub struct Contributions {
    places: Vec<u16>,
    wi: Vec<Vec3A>,
    radiance: Vec<Vec3A>,
    /// The patches of sky that they are in, of those that are sent to learn from.
    patches: Vec<u16>,
}

impl Contributions {
    /// Removes all.
    pub fn clear(&mut self) {
        self.places.clear();
        self.wi.clear();
        self.radiance.clear();
        self.patches.clear();
    }

    /// Adds a contribution of the point at a place among the rows.
    pub fn push(&mut self, place: usize, wi: Vec3A, radiance: Vec3A) {
        self.places.push(place as u16);
        self.wi.push(wi);
        self.radiance.push(radiance);
    }

    /// Adds a direction that is sent to learn from, in a patch of sky.
    pub(crate) fn push_ray(&mut self, place: usize, wi: Vec3A, patch: u16) {
        self.push(place, wi, Vec3A::ZERO);
        self.patches.push(patch);
    }

    /// Places of the shading points among the rows that were proposed for.
    pub fn places(&self) -> &[u16] {
        &self.places
    }

    /// Unit directions, above the geometric surfaces.
    pub fn wi(&self) -> &[Vec3A] {
        &self.wi
    }

    /// Reflected radiance per channel, if visible.
    pub fn radiance(&self) -> &[Vec3A] {
        &self.radiance
    }
}

/// Light x BRDF x cosine per channel for one direction of each row.
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

/// Adds `light x BRDF x cosine x weight` for a direction of each row; a weight of 0 is no sample.
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
        // No sample has any direction, and what it reflects may be no number.
        if weight > 0.0 && radiance.max_element() > 0.0 {
            out.push(place, Vec3A::new(x[place], y[place], z[place]), radiance);
        }
    }
}
