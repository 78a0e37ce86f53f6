//! The warp of patches at one shading point, for training.

use glam::{Vec2, Vec3A, Vec4};

use super::{
    draw::{self, COLUMNS, LOBES},
    hierarchy::Patches,
};
use crate::{
    head::logit_of_mixture_weight,
    latlong,
    one_point::OnePoint,
    simd::{LANES, Lanes},
    tail::{Tail, TailWarp},
    visibility::Unoccluded,
};

/// The warp by patches of the square of uniform points at one shading point.
#[derive(Debug)]
pub struct PatchWarp<'a> {
    patches: &'a Patches,
    tail: &'a Tail,
    point: &'a OnePoint,
    state: Vec<Lanes>,
}

impl Patches {
    /// Returns the warp at a point, over the tail that the patches were built from.
    pub fn warp_at<'a>(&'a self, tail: &'a Tail, point: &'a OnePoint) -> PatchWarp<'a> {
        let rows = point.tile().rows();
        let mut state = vec![[0.0; LANES]; COLUMNS * rows.strips()];
        self.prepare(&Unoccluded, &rows, &mut state, &point.arena);
        PatchWarp { patches: self, tail, point, state }
    }

    /// Returns the logit of the mixture weight, beside BRDF sampling, of patches below a head at a point; the
    /// head's is added to it.
    pub fn mixture_weight_logit(point: &OnePoint) -> f32 {
        let rows = point.tile().rows();
        let (mut mixture_weights, mut lobes) =
            (vec![[0.0; LANES]; rows.strips()], point.arena.columns::<LOBES>(rows.strips()));
        rows.lobes(lobes.get_mut(), &point.arena);
        draw::mixture_weights_by_width(lobes.get(), &mut mixture_weights);
        logit_of_mixture_weight(mixture_weights[0][0])
    }
}

impl PatchWarp<'_> {
    /// Maps points of the square to points of Y, with their density over Y: 0 where there is nothing to draw.
    pub fn forward(&self, z: &[Vec2]) -> Vec<(Vec2, f32)> {
        let rows = self.point.tile().rows();
        let draw = |z: [&[Lanes]; 2], [u, v, q]: [&mut [Lanes]; 3]| {
            draw::sample(self.patches, &Unoccluded, &rows, &self.state, z, [u, v], q);
        };
        self.point.map(z, draw).map(|[u, v, q]| (Vec2::new(u, v), q)).collect()
    }

    /// Maps directions to the points of the square from which patches and tail map to them; `None` where
    /// there is none.
    pub fn inverse(&self, wi: &[Vec3A]) -> Vec<Option<Vec2>> {
        let x: Vec<Vec2> = wi.iter().map(|&wi| latlong::square(wi)).collect();
        let y = self.tail.inverse_points(&x);
        let both: Vec<(Vec2, Vec2)> = x.into_iter().zip(&y).map(|(x, &(y, _))| (x, y)).collect();
        let found = self.preimages(&both).into_iter().zip(&y);
        found.map(|((z, q), &(_, density))| (q > 0.0 && density > 0.0).then_some(z)).collect()
    }

    /// Returns the points that map to points of Y with their images in X, and the densities over Y.
    fn preimages(&self, x_and_y: &[(Vec2, Vec2)]) -> Vec<(Vec2, f32)> {
        let (rows, grid) = (self.point.tile().rows(), self.tail.light());
        let invert = |[x_u, x_v, y_u, y_v]: [&[Lanes]; 4], [u, v, q]: [&mut [Lanes]; 3]| {
            draw::invert(self.patches, &Unoccluded, grid, &rows, &self.state, [x_u, x_v], [y_u, y_v], [u, v], q);
        };
        let all: Vec<Vec4> = x_and_y.iter().map(|(x, y)| Vec4::new(x.x, x.y, y.x, y.y)).collect();
        self.point.map(&all, invert).map(|[u, v, q]| (Vec2::new(u, v), q)).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::{
        brdf::{Ggx, Lambert, MetallicRoughness, Surface},
        environment::built_in,
        patches::{Detail, PatchSampler, hierarchy::PARTS},
        random::{Purpose, Stream},
        sampler::EnvironmentLight,
        tail::TailKind,
        tile::ShadingPoint,
    };

    fn surfaces() -> [Surface; 4] {
        let ggx = |alpha| Ggx::new(alpha, Vec3::ONE).into();
        let mixture = MetallicRoughness::new(Vec3::splat(0.6), 0.5, 0.4).into();
        [Lambert { albedo: Vec3::ONE }.into(), ggx(0.05), ggx(0.4), mixture]
    }

    /// Each coordinate is rounded at most 4 times by 6e-8 on its way there and back, in units of the narrower
    /// of both rectangles that contain it: in the square or in Y.
    #[test]
    fn inverse_undoes_the_warp() {
        const BOUND: f32 = 5e-7;
        for name in ["studio", "sunset"] {
            let light = EnvironmentLight::new(Arc::new(built_in(name).unwrap()), TailKind::Hierarchical).unwrap();
            for (k, detail) in [Detail::Leaves, Detail::Twigs].into_iter().enumerate() {
                let sampler = PatchSampler::new(light.clone(), detail).unwrap();
                let mut random = Stream::new(2, Purpose::Test, k as u64);
                let (mut wrong, mut all) = (0, 0);
                for surface in surfaces() {
                    let n = random.direction();
                    let wo = (n + 0.7 * n.any_orthonormal_vector()).normalize();
                    let point = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }.one();
                    let warp = sampler.patches.warp_at(light.tail(), &point);
                    let z: Vec<Vec2> = (0..4000).map(|_| random.uniform2()).collect();
                    let there = warp.forward(&z);
                    let y: Vec<Vec2> = there.iter().map(|&(y, _)| y).collect();
                    let x = light.tail().forward_points(&y);
                    let both: Vec<(Vec2, Vec2)> = x.into_iter().zip(&y).map(|((x, _), &y)| (x, y)).collect();
                    let back: Vec<(Vec2, f32)> = warp.preimages(&both);
                    let again = warp.forward(&back.iter().map(|&(z, _)| z).collect::<Vec<_>>());
                    for k in (0..z.len()).filter(|&k| there[k].1 > 0.0) {
                        let (in_square, in_y) = ((back[k].0 - z[k]).abs(), (again[k].0 - y[k]).abs());
                        let is_near = (0..2).all(|axis| in_square[axis].min(in_y[axis]) < BOUND);
                        all += 1;
                        wrong += usize::from(!is_near || back[k].1.to_bits() != there[k].1.to_bits());
                    }
                }
                // A point rounded across the edge of a patch belongs to the neighbour: 256 edges of 1e-7 are
                // 3e-5 of the square, and under a sun the whole patch is a few steps of X wide.
                assert!(all > 10_000 && wrong as f32 <= 2e-3 * all as f32, "{name} {detail:?}: {wrong} of {all}");
            }
        }
    }

    #[test]
    fn a_sun_gets_a_multiple_of_a_quarter_of_the_square() {
        let light = EnvironmentLight::new(Arc::new(built_in("sunset").unwrap()), TailKind::Hierarchical).unwrap();
        let sampler = PatchSampler::new(light.clone(), Detail::Leaves).unwrap();
        assert!(
            sampler.patches.small > 0 && PatchSampler::new(light.clone(), Detail::Twigs).unwrap().patches.small == 0
        );
        const SIDE: usize = 64;
        let place = |k: usize| (k as f32 + 0.5) / SIDE as f32;
        let z: Vec<Vec2> = (0..SIDE * SIDE).map(|k| Vec2::new(place(k % SIDE), place(k / SIDE))).collect();
        let (mut random, mut found) = (Stream::new(6, Purpose::Test, 0), [0; 4]);
        for _ in 0..40 {
            let n = random.direction();
            let surface = Lambert { albedo: Vec3::ONE }.into();
            let point = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface }.one();
            let y: Vec<Vec2> = sampler.patches.warp_at(light.tail(), &point).forward(&z).iter().map(|d| d.0).collect();
            let is_small = |(x, _): (Vec2, f32)| {
                let (column, row, _) = light.tail().light().cell(x);
                let twig = sampler.patches.lookup.patch(column as u32, row as u32) as usize;
                twig / PARTS / PARTS < sampler.patches.small
            };
            let drawn: Vec<bool> = light.tail().forward_points(&y).into_iter().map(is_small).collect();
            let quarters = 4 * drawn.iter().filter(|&&is_small| is_small).count() / (SIDE * SIDE);
            // Each column of the grid belongs to the sun entirely or not at all.
            let wrong = z.iter().zip(&drawn).filter(|(z, drawn)| (4.0 * z.x < quarters as f32) != **drawn).count();
            // Where little of its light arrives, the sun is drawn in proportion to its light; a point may be
            // rounded into the neighbour.
            if quarters > 0 {
                assert!(wrong <= 2, "{n}: {quarters} quarters, {wrong}");
            }
            found[quarters] += 1;
        }
        assert!(found[1..].iter().sum::<i32>() > 8 && found[2..].iter().sum::<i32>() > 4, "{found:?}");
    }

    #[test]
    fn inverse_of_directions_matches_points() {
        let light = EnvironmentLight::new(Arc::new(built_in("studio").unwrap()), TailKind::Hierarchical).unwrap();
        let sampler = PatchSampler::new(light.clone(), Detail::Leaves).unwrap();
        let surface = Ggx::new(0.2, Vec3::ONE).into();
        let at = ShadingPoint { p: Vec3A::ZERO, ng: Vec3A::Y, ns: Vec3A::Y, wo: Vec3A::Y, surface };
        let point = at.one();
        let warp = sampler.patches.warp_at(light.tail(), &point);
        let mut random = Stream::new(4, Purpose::Test, 0);
        let z: Vec<Vec2> = (0..4000).map(|_| random.uniform2()).collect();
        let there = warp.forward(&z);
        let wi: Vec<Vec3A> =
            light.tail().forward_directions(&there.iter().map(|&(y, _)| y).collect::<Vec<_>>()).map(|d| d.1).collect();
        let near = |(z, found): (&Vec2, Option<Vec2>)| found.is_some_and(|own: Vec2| (own - *z).length() < 1e-2);
        let close = z.iter().zip(warp.inverse(&wi)).filter(|&(z, found)| near((z, found))).count();
        // A direction is rounded to 1e-7, which the densities of tail and patches magnify by up to 1e5.
        assert!(close > 3960, "{close}");
        // Below the surface nothing is drawn.
        assert_eq!(warp.inverse(&[-Vec3A::Y]), [None]);
        // BRDF sampling has mixture weight 0.5 at a width of 0.05.
        let mixture_weight = 1.0 - 0.5 * 0.25_f32.powf(1.25);
        assert!((Patches::mixture_weight_logit(&point) - logit_of_mixture_weight(mixture_weight)).abs() < 1e-4);
    }
}
