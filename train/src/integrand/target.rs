//! Targets of training.

use headtail_model::Condition;
use headtail_render::random::Stream;

use super::shader::ShaderTarget;
use crate::{Error, Result};

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

    /// Describes the target to shaders that draw it as [`place`](Self::place) does; `None` for one that they do not
    /// know.
    fn shader_target(&self) -> Option<ShaderTarget> {
        None
    }

    /// Turns uniform numbers into points with values, in place. By default the first `strata^2` are one in
    /// each stratum of Y and the rest are BRDF samples, combined by the balance heuristic.
    ///
    /// # Errors
    /// [`Error::BadTarget`] if a density is negative or not finite.
    fn place(&self, condition: &[f32], shape: BatchShape, points: PlacedPoints<'_>) -> Result<()> {
        place_strata_and_brdf_samples(self, condition, shape, points)
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

/// Sizes of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchShape {
    /// Number of conditions.
    pub conditions: usize,
    /// Strata per side of Y: each condition has `strata^2` points that cover Y evenly.
    pub strata: usize,
    /// Points per condition from BRDF sampling.
    pub brdf_samples: usize,
}

impl BatchShape {
    /// Returns the number of points per condition.
    pub fn samples(&self) -> usize {
        self.strata * self.strata + self.brdf_samples
    }
}

/// Maps uniform numbers to one point in each stratum and to BRDF samples, and evaluates the target there.
///
/// Of `n` points, `s` are uniform and `b` come from BRDF sampling with density `d`: the balance heuristic
/// weights a point by `n / (s + b d)`, whichever strategy drew it. BRDF samples without light have no
/// position in Y and weight 0.
pub(super) fn place_strata_and_brdf_samples<T: Target + ?Sized>(
    target: &T,
    condition: &[f32],
    shape: BatchShape,
    place: PlacedPoints<'_>,
) -> Result<()> {
    let PlacedPoints { points, densities, weights, brdf, tails } = place;
    let (points, _) = points.as_chunks_mut::<2>();
    let strata = shape.strata;
    let (uniform, of_brdf) = points.split_at_mut(strata * strata);
    for (index, y) in uniform.iter_mut().enumerate() {
        y[0] = ((index % strata) as f32 + y[0]) / strata as f32;
        y[1] = ((index / strata) as f32 + y[1]) / strata as f32;
    }
    for (turn, u) in of_brdf.iter_mut().enumerate() {
        u[0] = (turn as f32 + u[0]) / shape.brdf_samples as f32;
    }
    let found = target.brdf_samples(condition, of_brdf);
    for ((y, found), weight) in of_brdf.iter_mut().zip(found).zip(&mut weights[strata * strata..]) {
        if found.is_none() {
            *weight = 0.0;
        }
        *y = found.unwrap_or([0.5; 2]);
    }
    let (uniform, count) = (strata * strata, shape.samples() as f32);
    for (index, (&at, values)) in points.iter().zip(target.at_points(condition, points)).enumerate() {
        if weights[index] == 0.0 {
            continue;
        }
        let values = checked(values, condition, at)?;
        densities[index] = values.target;
        brdf[index] = values.brdf;
        tails[index] = values.tail;
        weights[index] = count / (uniform as f32 + shape.brdf_samples as f32 * values.brdf);
    }
    Ok(())
}

/// Returns the values if both densities are finite and not negative.
fn checked(values: PointValues, condition: &[f32], y: [f32; 2]) -> Result<PointValues> {
    for density in [values.target, values.brdf] {
        if !(density.is_finite() && density >= 0.0) {
            return Err(Error::BadTarget { density, y, condition: condition.to_vec() });
        }
    }
    Ok(values)
}
