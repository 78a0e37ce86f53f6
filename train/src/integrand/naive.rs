//! The product in X, without a tail: the paper's naive flow, which has to learn the light too.

use glam::{Vec2, Vec3A};
use headtail_model::Condition;
use headtail_render::{latlong, random::Stream};

use super::{
    ShaderTarget, TailMap,
    target::{BatchShape, PlacedPoints, PointValues, Target},
};
use crate::Result;

/// The density of `target` mapped to X, light x BRDF x cosine x sin theta up to a factor.
///
/// Points are those of `target`, mapped through the tail, with weights proportional to the area that they
/// cover in X: small lights are sampled even if the head misses them.
pub struct NaiveTarget<'a> {
    target: Box<dyn Target + 'a>,
    tail: &'a dyn TailMap,
}

impl<'a> NaiveTarget<'a> {
    /// Wraps `target`, which is in Y under `tail`.
    pub fn new(target: Box<dyn Target + 'a>, tail: &'a dyn TailMap) -> Self {
        Self { target, tail }
    }

    /// Maps points of Y with their values to X.
    fn carry(&self, place: PlacedPoints<'_>) {
        let PlacedPoints { points, densities, weights, brdf, tails } = place;
        let (points, _) = points.as_chunks_mut::<2>();
        let there = self.tail.forward(points);
        for (index, (y, there)) in points.iter_mut().zip(there).enumerate() {
            *y = there.x;
            if weights[index] > 0.0 && there.density > 0.0 && there.density.is_finite() {
                densities[index] *= there.density;
                brdf[index] *= there.density;
                weights[index] /= there.density;
            } else {
                weights[index] = 0.0;
            }
            tails[index] = 1.0;
        }
    }
}

impl Target for NaiveTarget<'_> {
    fn condition(&self) -> Condition {
        self.target.condition()
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        self.target.draw_condition(stream, condition);
    }

    fn at_points(&self, condition: &[f32], x: &[[f32; 2]]) -> Vec<PointValues> {
        let directions: Vec<Vec3A> = x.iter().map(|&x| latlong::direction(Vec2::from_array(x))).collect();
        let found = self.tail.inverse(&directions);
        let y: Vec<[f32; 2]> = found.iter().flatten().copied().collect();
        let mut values = self.target.at_points(condition, &y).into_iter().zip(self.tail.forward(&y));
        let carried = |y: Option<[f32; 2]>| {
            let Some((values, there)) = y.and_then(|_| values.next()) else { return PointValues::of(0.0) };
            PointValues { target: values.target * there.density, brdf: values.brdf * there.density, tail: 1.0 }
        };
        found.into_iter().map(carried).collect()
    }

    fn has_brdf_sampling(&self) -> bool {
        self.target.has_brdf_sampling()
    }

    fn shader_target(&self) -> Option<ShaderTarget> {
        Some(ShaderTarget { is_in_x: true, ..self.target.shader_target()? })
    }

    fn place(&self, condition: &[f32], shape: BatchShape, mut place: PlacedPoints<'_>) -> Result<()> {
        self.target.place(condition, shape, place.reborrow())?;
        self.carry(place);
        Ok(())
    }

    fn place_for_validation(&self, condition: &[f32], shape: BatchShape, mut place: PlacedPoints<'_>) -> Result<()> {
        self.target.place_for_validation(condition, shape, place.reborrow())?;
        self.carry(place);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{CosineTarget, Loss, Objective, integrand::Batch, loss::LossDerivatives, test_support::studio};

    /// If the density over X is the tail's, it has the divergence of the uniform density over Y.
    #[test]
    fn divergences_are_equal_in_both_squares() {
        let tail = studio();
        let naive = NaiveTarget::new(Box::new(CosineTarget::new(&tail)), &tail);
        let shape = BatchShape { conditions: 6, strata: 16, brdf_samples: 64 };
        let in_x = Batch::draw(&naive, shape, 0, Purpose::Test, 0).unwrap();
        let in_y = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, 0).unwrap();
        assert_ne!(in_x.points, in_y.points);
        let evaluate = |batch: &Batch, index: usize, loss: Loss, log_q: &[f32]| {
            let mut unused = vec![0.0; batch.samples];
            let mut out = LossDerivatives { d_log_q: &mut unused, d_mixture_weight_logit: 0.0 };
            Objective::from(loss).evaluate(&batch.condition(index), log_q, None, &mut out).unwrap()
        };
        for loss in [Loss::ForwardKl, Loss::LogChiSquare] {
            for index in 0..6 {
                let logs: Vec<f32> = in_y.condition(index).tails.iter().map(|density| density.ln()).collect();
                let carried = evaluate(&in_x, index, loss, &logs);
                let expected = evaluate(&in_y, index, loss, &vec![0.0; in_y.samples]);
                assert!((carried - expected).abs() < 1e-4, "{loss}: {carried} {expected}");
            }
        }
    }

    #[test]
    fn point_values_match_the_batch() {
        let tail = studio();
        let naive = NaiveTarget::new(Box::new(CosineTarget::new(&tail)), &tail);
        let shape = BatchShape { conditions: 4, strata: 8, brdf_samples: 0 };
        let batch = Batch::draw(&naive, shape, 0, Purpose::Test, 1).unwrap();
        let mut close = 0;
        for (index, x) in batch.points.chunks_exact(2).enumerate() {
            let at = naive.at(&batch.conditions[index / 64 * 3..][..3], [x[0], x[1]]).target;
            close += usize::from((at - batch.densities[index]).abs() <= 1e-2 * batch.densities[index]);
        }
        // A point is rounded to 6e-8 of X, which can cross the edge of a light.
        assert!(close > 250, "{close}");
    }
}
