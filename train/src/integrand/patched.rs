//! Light x BRDF x cosine, seen through patches of sky and a tail: the residual that a head learns over
//! patches.

use glam::{Vec2, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    discrete::BELOW_ONE,
    patches::{Detail, Patches},
    random::Stream,
    tail::Tail,
};

use super::{
    RenderedSurface, ShaderTarget, TailMap, TailPoint,
    product::MAX_BRDF_DENSITY,
    target::{PointValues, Target},
};

/// The density over the square U that patches map to Y: the target in Y over the density of patches. It is
/// flat where the closed form is exact.
///
/// Points are uniform in U, i.e. drawn by patches.
pub struct PatchedTarget<'a, S> {
    surface: S,
    tail: &'a Tail,
    patches: Patches,
}

impl<'a, S: RenderedSurface> PatchedTarget<'a, S> {
    /// Builds the target of a surface.
    ///
    /// # Panics
    /// If the tail is not hierarchical.
    pub fn new(surface: S, tail: &'a Tail, detail: Detail) -> Self {
        let Tail::Hierarchical(quad_tree) = tail else { panic!("patches are of the hierarchical tail") };
        Self { surface, tail, patches: Patches::new(quad_tree, detail) }
    }
}

impl<S: RenderedSurface> Target for PatchedTarget<'_, S> {
    fn condition(&self) -> Condition {
        self.surface.condition()
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        self.surface.draw_condition(stream, condition);
    }

    fn at_points(&self, condition: &[f32], u: &[[f32; 2]]) -> Vec<PointValues> {
        let point = self.surface.point(condition);
        let u: Vec<Vec2> = u.iter().copied().map(Vec2::from_array).collect();
        let (y, densities): (Vec<[f32; 2]>, Vec<f32>) =
            self.patches.warp_at(self.tail, &point).forward(&u).into_iter().map(|(y, q)| (y.to_array(), q)).unzip();
        let there = TailMap::forward(self.tail, &y);
        let directions: Vec<Vec3A> = there.iter().map(|there| there.direction).collect();
        let lobes = self.surface.lobes(condition, &directions);
        let pdfs = self.surface.pdfs(condition, &directions);
        let values = |(((there, lobe), pdf), q): (((TailPoint, f32), f32), f32)| {
            if q <= 0.0 {
                // Patches have no density here, because nothing is reflected from here.
                return PointValues { target: 0.0, brdf: 0.0, tail: 1.0 };
            }
            let brdf = if pdf > 0.0 { (pdf / (there.pdf * q)).min(MAX_BRDF_DENSITY) } else { 0.0 };
            PointValues { target: lobe / q, brdf, tail: there.density * q }
        };
        there.into_iter().zip(lobes).zip(pdfs).zip(densities).map(values).collect()
    }

    fn has_brdf_sampling(&self) -> bool {
        true
    }

    fn brdf_samples(&self, condition: &[f32], u: &[[f32; 2]]) -> Vec<Option<[f32; 2]>> {
        let u: Vec<Vec2> = u.iter().copied().map(Vec2::from_array).collect();
        let drawn = self.surface.samples(condition, &u);
        let directions: Vec<Vec3A> = drawn.iter().flatten().copied().collect();
        let point = self.surface.point(condition);
        let mut found = self.patches.warp_at(self.tail, &point).inverse(&directions).into_iter();
        let inside = |u: Vec2| u.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)).to_array();
        drawn.into_iter().map(|drawn| drawn.and_then(|_| found.next().flatten()).map(inside)).collect()
    }

    fn shader_target(&self) -> Option<ShaderTarget> {
        let (grid, surface) = (self.tail.light(), self.surface.in_shaders()?);
        let arrays = [self.tail.flat(), self.patches.flat(grid.columns(), grid.rows())].concat();
        Some(ShaderTarget { arrays, surface, is_in_x: false })
    }

    fn mixture_weight_logit(&self, condition: &[f32]) -> f32 {
        Patches::mixture_weight_logit(&self.surface.point(condition))
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Viewpoints,
        integrand::{Batch, BatchShape, ConditionPoints, Ggx, Lambert, ProductTarget},
        test_support::studio,
    };

    /// Returns mean and standard error of the integral of the target, from one batch of a condition.
    fn integral(batch: &Batch) -> (f64, f64) {
        let at = batch.condition(0);
        let terms: Vec<f64> = at.densities.iter().zip(at.weights).map(|(g, v)| f64::from(g * v)).collect();
        let count = terms.len() as f64;
        let mean = terms.iter().sum::<f64>() / count;
        (mean, (terms.iter().map(|term| (term - mean).powi(2)).sum::<f64>() / count / count).sqrt())
    }

    /// The warp changes points, not integrals: with points from patches alone and with BRDF sampling.
    #[test]
    fn integrals_equal_those_over_the_intermediate_square() {
        let tail = studio();
        let ggx = || Ggx::new(Viewpoints::Sphere, 0.2, 0.8);
        for detail in [Detail::Leaves, Detail::Twigs] {
            let patched: [Box<dyn Target>; 2] = [
                Box::new(PatchedTarget::new(Lambert::default(), &tail, detail)),
                Box::new(PatchedTarget::new(ggx(), &tail, detail)),
            ];
            let plain: [Box<dyn Target>; 2] = [
                Box::new(ProductTarget::of_surface(Lambert::default(), &tail)),
                Box::new(ProductTarget::of_surface(ggx(), &tail)),
            ];
            for (patched, plain) in patched.iter().zip(&plain) {
                for index in 0..6 {
                    let draw = |target: &dyn Target, strata, brdf_samples| {
                        let shape = BatchShape { conditions: 1, strata, brdf_samples };
                        Batch::draw(target, shape, 3, Purpose::Test, index).unwrap()
                    };
                    let (exact, noise) = integral(&draw(&**plain, 128, 4096));
                    for brdf_samples in [0, 1024] {
                        let batch = draw(&**patched, 32, brdf_samples);
                        assert_eq!(batch.conditions, draw(&**plain, 2, 0).conditions);
                        let (found, error) = integral(&batch);
                        // Stratification makes errors smaller than those of independent points; 4 standard
                        // errors of those for 48 estimates.
                        let bound = 4.0 * (error * error + noise * noise).sqrt() + 2e-3 * exact;
                        assert!((found - exact).abs() < bound, "{found} {exact} +- {bound}");
                    }
                }
            }
        }
    }

    /// Without lamps smaller than a texel, densities vary only by a fraction of their mean.
    #[test]
    fn the_residual_of_patches_is_nearly_flat() {
        let tail = studio();
        let variance = |target: &dyn Target| {
            let shape = BatchShape { conditions: 16, strata: 32, brdf_samples: 0 };
            let batch = Batch::draw(target, shape, 0, Purpose::Test, 0).unwrap();
            let of_condition = |densities: &[f32]| {
                let mean = densities.iter().map(|&g| f64::from(g)).sum::<f64>() / densities.len() as f64;
                densities.iter().map(|&g| (f64::from(g) / mean - 1.0).powi(2)).sum::<f64>() / densities.len() as f64
            };
            let all: Vec<f64> =
                batch.by_condition().filter(ConditionPoints::is_lit).map(|at| of_condition(at.densities)).collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let patched = variance(&PatchedTarget::new(Lambert::default(), &tail, Detail::Leaves));
        let plain = variance(&ProductTarget::of_surface(Lambert::default(), &tail));
        assert!(patched < 0.1 * plain, "{patched} {plain}");
    }

    #[test]
    fn mixture_weights_are_one_for_diffuse_surfaces_and_half_for_narrow_lobes() {
        let tail = studio();
        let logit = |alpha: f32| {
            let surface = Ggx::new(Viewpoints::Sphere, alpha, alpha);
            let target = PatchedTarget::new(surface, &tail, Detail::Leaves);
            let mut condition = vec![0.0; 10];
            target.draw_condition(&mut Stream::new(0, Purpose::Test, 0), &mut condition);
            target.mixture_weight_logit(&condition)
        };
        assert!(logit(0.05).abs() < 1e-3 && logit(0.4) > 2.5);
        let diffuse = PatchedTarget::new(Lambert::default(), &tail, Detail::Leaves);
        assert!(diffuse.mixture_weight_logit(&[0.0, 1.0, 0.0]) > 6.0);
    }
}
