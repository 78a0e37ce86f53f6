//! Exploration rays to the patches of a sky, which record a patch and a direction.
//!
//! Each patch gets as many rays as samples, by masses that account for the surface. But each ray takes one of
//! a few directions of its patch, and no density is computed, so that a ray takes a fraction of a sample's
//! time.

use crate::parallel::*;
use glam::{Vec2, Vec3A};

use super::{
    draw::{COLUMNS, Reflections, SUMS, part_sums, within},
    hierarchy::{PARTS, Patches},
    sampler::PatchSampler,
};
use crate::{
    columns::{Arena, vectorized},
    sampler::{EnvironmentLight, prepared},
    simd::{LANES, Lanes},
    tile::Rows,
    visibility::CLUSTERS,
};

/// Directions along a side of a patch's rectangle of Y.
const SIDE: usize = 8;
/// Number of directions per patch.
const EACH: usize = SIDE * SIDE;
/// Stride between the directions of consecutive rays: odd, so that all occur.
const STRIDE: usize = 27;
/// Marks a missing patch.
const NONE: u32 = u32::MAX;

/// The patches of a sky, with directions of rays to them.
#[derive(Debug)]
pub struct SkyRays {
    sampler: PatchSampler,
    /// Directions to the centres of equal cells of each patch's rectangle, row by row.
    directions: Vec<[f32; 3]>,
}

impl SkyRays {
    /// The rays of a sampler's patches; a head is ignored.
    pub fn new(sampler: PatchSampler) -> Self {
        let directions = directions(&sampler.patches, &sampler.light);
        Self { sampler: PatchSampler { head: None, ..sampler }, directions }
    }

    /// Returns the sampler of the patches.
    pub fn sampler(&self) -> &PatchSampler {
        &self.sampler
    }

    /// Sends `rays` rays from each row, by one uniform point `u` of `[0, 1)^2` for all of them: they divide
    /// the reflected light of the sky into equal parts. `send` gets the index of the row, the unit direction,
    /// and its patch of [`PatchSampler::division`]. Directions below a surface are skipped.
    pub fn send(
        &self,
        at: &Rows<'_>,
        rays: u32,
        u: [&[Lanes]; 2],
        mut send: impl FnMut(usize, Vec3A, u16),
        arena: &Arena,
    ) {
        let mut columns = arena.columns::<4>(at.strips());
        let [x, y, z, patch] = columns.get_mut();
        prepared(&self.sampler, at, arena, |state| {
            for ray in 0..rays {
                let wi = [&mut *x, &mut *y, &mut *z];
                aim(&self.sampler.patches, &self.directions, at, state, (ray, rays), u, wi, patch);
                let [x, y, z, patch] = [&*x, &*y, &*z, &*patch].map(<[_]>::as_flattened);
                for place in 0..at.len() {
                    let patch = patch[place].to_bits();
                    if patch != NONE {
                        send(place, Vec3A::new(x[place], y[place], z[place]), patch as u16);
                    }
                }
            }
        });
    }
}

/// Computes [`SkyRays::directions`].
fn directions(patches: &Patches, light: &EnvironmentLight) -> Vec<[f32; 3]> {
    let of_patch = |&[left, right, top, bottom, _]: &[f32; 5]| {
        let place = |k: usize| (k as f32 + 0.5) / SIDE as f32;
        let point = |k: usize| {
            let (u, v) = (place(k % SIDE), place(k / SIDE));
            Vec2::new(within(left, right, u), within(top, bottom, v))
        };
        // Missing patches have an empty rectangle.
        let points: Vec<Vec2> = if right > left { (0..EACH).map(point).collect() } else { vec![Vec2::ZERO; EACH] };
        light.tail().forward_directions(&points).map(|(_, wi, _)| wi.to_array()).collect::<Vec<_>>()
    };
    patches.leaves.rectangles.par_iter().flat_map_iter(of_patch).collect()
}

vectorized! {
    /// Computes the directions of one ray of each row, `rays.0` of `rays.1`, and the numbers of their patches
    /// as bits: [`NONE`] where they are below a surface.
    fn aim['a](
        simd, patches: &'a Patches, directions: &'a [[f32; 3]], at: &'a Rows<'a>, state: &'a [Lanes],
        rays: (u32, u32), u: [&'a [Lanes]; 2], wi: [&'a mut [Lanes]; 3], out: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..out.len() {
            let (lobes, sums) = state[strip * COLUMNS..][..COLUMNS].split_at(SUMS);
            let (reflections, total) = (Reflections::new(at, strip, lobes), sums[CLUSTERS - 1]);
            let (mut aims, mut before, mut cluster) = ([0.0; LANES], [0.0; LANES], [0_u32; LANES]);
            for k in 0..LANES {
                aims[k] = total[k] * ((rays.0 as f32 + u[0][strip][k]) / rays.1 as f32);
            }
            for sum in &sums[..CLUSTERS - 1] {
                for k in 0..LANES {
                    let is_past = sum[k] <= aims[k];
                    cluster[k] += u32::from(is_past);
                    before[k] = if is_past { sum[k] } else { before[k] };
                }
            }
            for k in 0..LANES {
                // Beyond all sums where nothing is reflected, and by rounding.
                let own = (cluster[k] as usize).min(patches.leaves.blocks.len() - 1);
                let mass = sums[own][k] - before[k];
                let part_sums = part_sums(simd, &patches.leaves.blocks[own], &reflections.lane(k), &[1.0; LANES]);
                let aim = part_sums[PARTS - 1] * ((aims[k] - before[k]) / mass);
                let (mut part, mut below) = (0, 0.0);
                for sum in &part_sums[..PARTS - 1] {
                    part += usize::from(*sum <= aim);
                    below = if *sum <= aim { *sum } else { below };
                }
                let is_lit = (mass > 0.0) & (part_sums[part] > below);
                // Rays from one point to the same patch take different directions.
                let direction = ((u[1][strip][k] * EACH as f32) as usize + rays.0 as usize * STRIDE) % EACH;
                [x[strip][k], y[strip][k], z[strip][k]] = directions[(own * PARTS + part) * EACH + direction];
                let number = (patches.numbers[own] * PARTS + part) as u32;
                out[strip][k] = f32::from_bits(if is_lit { number } else { NONE });
            }
            for [nx, ny, nz] in [at.normals(strip), at.geometric_normals(strip)] {
                for k in 0..LANES {
                    let cosine = nx[k] * x[strip][k] + ny[k] * y[strip][k] + nz[k] * z[strip][k];
                    out[strip][k] = if cosine > 0.0 { out[strip][k] } else { f32::from_bits(NONE) };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::{
        brdf::{Ggx, Lambert, Surface},
        environment::{Environment, built_in},
        image::Image,
        latlong,
        patches::Detail,
        random::{Purpose, Stream},
        sampler::{Draws, Sampler},
        tail::TailKind,
        tile::{ShadingPoint, Tile},
        visibility::PATCHES,
    };

    const POINTS: usize = 4000;
    const RAYS: u32 = 8;

    fn points(surface: Surface) -> Tile {
        let mut random = Stream::new(5, Purpose::Test, 0);
        let mut tile = Tile::default();
        for key in 0..POINTS {
            let n = random.direction();
            let wo = (n + 0.7 * n.any_orthonormal_vector()).normalize();
            let ng = (n + 0.2 * wo).normalize();
            tile.push(&ShadingPoint { p: Vec3A::ZERO, ng, ns: n, wo, surface }, key as u32);
        }
        tile
    }

    /// Counts the rays and the samples in each patch. Asserts that all rays are in the reported patch and
    /// above their surface.
    fn count(map: Environment, surface: Surface) -> [Vec<f64>; 2] {
        let light = EnvironmentLight::new(Arc::new(map), TailKind::Hierarchical).unwrap();
        let sampler = PatchSampler::new(light, Detail::Leaves).unwrap();
        let (tile, arena) = (points(surface), Arena::default());
        let at = tile.rows();
        let mut counts = [vec![0.0; PATCHES], vec![0.0; PATCHES]];
        let mut random = Stream::new(6, Purpose::Test, 0);
        let mut uniform = || {
            let mut column = vec![[0.0; LANES]; at.strips()];
            column.as_flattened_mut().fill_with(|| random.uniform());
            column
        };
        let is_above = |place: usize, wi: Vec3A| {
            let point = tile.point(place);
            wi.dot(point.ns) > 0.0 && wi.dot(point.ng) > 0.0
        };
        let send = |place: usize, wi: Vec3A, patch: u16| {
            assert!(wi.is_normalized() && is_above(place, wi));
            assert_eq!(sampler.patch_at(latlong::square(wi)), patch, "{wi}");
            counts[0][usize::from(patch)] += 1.0;
        };
        SkyRays::new(sampler.clone()).send(&at, RAYS, [&uniform(), &uniform()], send, &arena);
        prepared(&sampler, &at, &arena, |state| {
            for _ in 0..RAYS {
                let mut columns = arena.columns::<4>(at.strips());
                let [x, y, z, pdf] = columns.get_mut();
                let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
                sampler.sample(&at, state, [&uniform(), &uniform()], out, &arena);
                let [x, y, z, pdf] = [&*x, &*y, &*z, &*pdf].map(<[_]>::as_flattened);
                for place in 0..at.len() {
                    let wi = Vec3A::new(x[place], y[place], z[place]);
                    if pdf[place] > 0.0 && is_above(place, wi) {
                        counts[1][usize::from(sampler.patch_at(latlong::square(wi)))] += 1.0;
                    }
                }
            }
        });
        counts
    }

    #[test]
    fn small_maps_and_unlit_points_get_valid_rays() {
        // A single bright texel, which is below the surface for half of the points.
        let mut pixels = vec![[0.0; 3]; 8];
        pixels[1] = [1.0; 3];
        let map = Environment::from_image("small", Image { width: 4, height: 2, pixels }).unwrap();
        let surface = Lambert { albedo: Vec3::ONE }.into();
        // The last ray of the largest number is rounded to the end of all sums.
        let light = EnvironmentLight::new(Arc::new(map.clone()), TailKind::Hierarchical).unwrap();
        let (sky, tile) = (SkyRays::new(PatchSampler::new(light, Detail::Leaves).unwrap()), points(surface));
        assert!(sky.sampler.patches.clusters.len() < CLUSTERS);
        let last = vec![[1.0_f32.next_down(); LANES]; tile.rows().strips()];
        sky.send(&tile.rows(), RAYS, [&last, &last], |_, wi, _| assert!(wi.is_normalized()), &Arena::default());
        let [rays, samples] = count(map, surface).map(|counts| counts.iter().sum::<f64>());
        let all = f64::from(RAYS) * POINTS as f64;
        assert!(rays > 0.3 * all && rays < 0.9 * all && (rays / samples - 1.0).abs() < 0.02, "{rays} {samples} {all}");
    }

    #[test]
    fn rays_per_patch_match_samples() {
        for name in ["studio", "sunset"] {
            for surface in [Lambert { albedo: Vec3::ONE }.into(), Ggx::new(0.4, Vec3::ONE).into()] {
                let [rays, samples] = count(built_in(name).unwrap(), surface);
                let [all_rays, all_samples] = [&rays, &samples].map(|counts| counts.iter().sum::<f64>());
                assert!(all_samples > 0.6 * f64::from(RAYS) * POINTS as f64);
                // Both are counts of independent events or less noisy. The part of a patch above a surface is
                // resolved to 1/64 of the patch.
                let (mut sum, mut freedom) = (0.0, 0.0);
                for (rays, samples) in rays.iter().zip(&samples).filter(|(rays, samples)| **rays + **samples > 20.0) {
                    let difference = (rays - samples).abs() - (rays + samples) / 128.0;
                    sum += difference.max(0.0).powi(2) / (rays + samples);
                    freedom += 1.0;
                }
                // The sum is at most chi-square distributed: its mean is the degrees of freedom, its variance
                // twice that. The bound is 5 standard deviations.
                assert!(freedom > 30.0 && sum < freedom + 5.0 * f64::sqrt(2.0 * freedom), "{name}: {sum} {freedom}");
                assert!((all_rays / all_samples - 1.0).abs() < 0.02, "{name}: {all_rays} {all_samples}");
            }
        }
    }
}
