//! Target densities in the intermediate square Y.
//!
//! An exact tail maps uniform points of Y to directions in proportion to radiance, so the ideal intermediate
//! density `q*(y|c)` is BRDF x cosine at the tail's direction: it is evaluated at points of Y without
//! tabulation.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `Target` |
//! | `surface.rs` | the trait `Surface`; diffuse surfaces |
//! | `ggx.rs`, `measured.rs`, `textured.rs` | microfacet, measured and neural materials |
//! | `viewpoints.rs` | the distribution of views and normals |
//! | `product.rs`, `tail_map.rs` | a surface seen through a tail |
//! | `patched.rs` | a surface seen through patches and a tail |
//! | `tabulated.rs`, `naive.rs` | the paper's table in X; the product without a tail |
//! | `batch.rs` | strata and BRDF samples with weights |
//! | `shader.rs` | targets that shaders can draw |

mod batch;
mod ggx;
mod measured;
mod naive;
mod patched;
mod product;
mod shader;
mod surface;
mod tabulated;
mod tail_map;
mod textured;
mod viewpoints;

pub use batch::{Batch, BatchShape, ConditionPoints, UniformBatch};
pub use ggx::Ggx;
pub use measured::MeasuredSurface;
pub use naive::NaiveTarget;
pub use patched::PatchedTarget;
pub use product::{CosineTarget, ProductTarget};
pub use shader::{ShaderSurface, ShaderTarget};
pub use surface::{Lambert, RenderedSurface, Surface};
pub use tabulated::TabulatedTarget;
pub use tail_map::{TailMap, TailPoint};
pub use textured::TexturedSurface;
pub use viewpoints::{SeenPoint, Viewpoints};

use headtail_model::Condition;
use headtail_render::random::Stream;

use crate::Result;

/// The training target of a head: a distribution of conditions, and an unnormalised density in Y for each.
pub trait Target: Sync {
    /// Returns the layout of a condition.
    fn condition(&self) -> Condition;

    /// Draws a condition of [`Condition::length`] numbers.
    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]);

    /// Returns the densities at points `y`. The target may be zero everywhere (no light above the horizon);
    /// such conditions are excluded from losses and statistics.
    fn at_points(&self, condition: &[f32], y: &[[f32; 2]]) -> Vec<PointValues>;

    /// Returns the densities at one point.
    fn at(&self, condition: &[f32], y: [f32; 2]) -> PointValues {
        self.at_points(condition, &[y])[0]
    }

    /// Returns whether [`brdf_samples`](Self::brdf_samples) and [`PointValues::brdf`] are meaningful.
    fn has_brdf_sampling(&self) -> bool {
        false
    }

    /// Draws BRDF samples with the uniform numbers `u`, pulled back to Y; `None` if there is no direction or
    /// no light in it.
    fn brdf_samples(&self, _condition: &[f32], u: &[[f32; 2]]) -> Vec<Option<[f32; 2]>> {
        vec![None; u.len()]
    }

    /// Returns the offset of the logit of a learned mixture weight.
    fn mixture_weight_logit(&self, _condition: &[f32]) -> f32 {
        0.0
    }

    /// Describes the target to shaders that draw it as [`place`](Self::place) does by default; `None` for one that
    /// they do not know.
    fn shader_target(&self) -> Option<ShaderTarget<'_>> {
        None
    }

    /// Turns uniform numbers into points with values, in place. By default the first `strata^2` are one in
    /// each stratum of Y and the rest are BRDF samples, combined by the balance heuristic.
    ///
    /// # Errors
    /// [`Error::BadTarget`](crate::Error::BadTarget) if a density is negative or not finite.
    fn place(&self, condition: &[f32], shape: BatchShape, points: PlacedPoints<'_>) -> Result<()> {
        batch::place_strata_and_brdf_samples(self, condition, shape, points)
    }

    /// Places points as [`place`](Self::place), but independent of how training points are drawn.
    ///
    /// # Errors
    /// As [`place`](Self::place).
    fn place_for_validation(&self, condition: &[f32], shape: BatchShape, points: PlacedPoints<'_>) -> Result<()> {
        self.place(condition, shape, points)
    }
}

/// Densities at a point of Y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointValues {
    /// The target, unnormalised, per unit area of Y: finite, at least 0.
    pub target: f32,
    /// BRDF sampling pulled back to Y, per unit area of Y. Its integral is the fraction of BRDF samples that
    /// find light.
    pub brdf: f32,
    /// The density over X of the tail's image of uniform points, at the point's image.
    pub tail: f32,
}

impl PointValues {
    /// Returns the values of a target without tail and BRDF sampling.
    pub fn of(target: f32) -> Self {
        Self { target, brdf: 0.0, tail: 1.0 }
    }
}

/// The points of one condition while they are placed. Every slice has one entry per point, `points` two.
pub struct PlacedPoints<'a> {
    /// Uniform numbers on input, points of Y on output.
    pub points: &'a mut [f32],
    /// See [`PointValues::target`].
    pub densities: &'a mut [f32],
    /// One over the density of the points, so that `mean(weight f)` estimates the integral of `f` over Y.
    pub weights: &'a mut [f32],
    /// See [`PointValues::brdf`].
    pub brdf: &'a mut [f32],
    /// See [`PointValues::tail`].
    pub tails: &'a mut [f32],
}

impl PlacedPoints<'_> {
    /// Reborrows the points.
    pub fn reborrow(&mut self) -> PlacedPoints<'_> {
        PlacedPoints {
            points: self.points,
            densities: self.densities,
            weights: self.weights,
            brdf: self.brdf,
            tails: self.tails,
        }
    }
}
