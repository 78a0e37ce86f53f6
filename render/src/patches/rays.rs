//! Rays to the patches of a sky, sent for what they say of its visibility: which patch, and where to.
//!
//! They are drawn as samples are, with masses that know the surface, but without densities and to one of a few directions for each patch: that takes a fraction of a
//! sample's time.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::{
    PARTS, PatchSampler, Patches,
    draw::{COLUMNS, rectangles, walk, within},
    tree::Points,
};
use crate::{
    columns::{Arena, vectorized},
    sampler::EnvironmentLight,
    simd::{LANES, Lanes},
    tile::Rows,
    visibility::Unoccluded,
};

/// Directions along a side of a patch's rectangle of Y.
const SIDE: usize = 8;
/// Directions of a patch.
const EACH: usize = SIDE * SIDE;
/// Stands for no patch.
const NONE: u32 = u32::MAX;

/// The patches of a sky as rays are sent to them.
#[derive(Debug)]
pub struct SkyRays {
    sampler: PatchSampler,
    /// For each patch those to the centres of equal cells of its rectangle, row after row.
    directions: Vec<[f32; 3]>,
}

impl SkyRays {
    /// Those of a sampler's patches. A head before them is left out.
    pub fn new(sampler: PatchSampler) -> Self {
        let directions = directions(&sampler.patches, &sampler.light);
        Self { sampler: PatchSampler { head: None, ..sampler }, directions }
    }

    /// The patches.
    pub fn sampler(&self) -> &PatchSampler {
        &self.sampler
    }

    /// Sends `rays` rays from each row. `draw` is told the number of a ray and gives uniform points `u`, `v` of all rows; `send` is told the place of a row, the unit
    /// direction, and the patch of [`PatchSampler::division`] that this is in. What leads below a surface is left out.
    pub fn send(
        &self,
        at: &Rows<'_>,
        rays: u32,
        mut draw: impl FnMut(u32, [&mut [Lanes]; 2]),
        mut send: impl FnMut(usize, Vec3A, u16),
        arena: &Arena,
    ) {
        let patches = &*self.sampler.patches;
        let mut state = arena.columns::<1>(COLUMNS * at.strips());
        let [state] = state.get_mut();
        patches.prepare(&Unoccluded, at, state, arena);
        let mut columns = arena.columns::<6>(at.strips());
        let [u, v, x, y, z, patch] = columns.get_mut();
        for ray in 0..rays {
            draw(ray, [&mut *u, &mut *v]);
            aim(patches, &self.directions, at, state, [u, v], [&mut *x, &mut *y, &mut *z], patch);
            let [x, y, z, patch] = [&*x, &*y, &*z, &*patch].map(<[_]>::as_flattened);
            for place in 0..at.len() {
                let patch = patch[place].to_bits();
                if patch != NONE {
                    send(place, Vec3A::new(x[place], y[place], z[place]), patch as u16);
                }
            }
        }
    }
}

/// [`SkyRays::directions`].
fn directions(patches: &Patches, light: &EnvironmentLight) -> Vec<[f32; 3]> {
    let of_patch = |&[left, right, top, bottom, _]: &[f32; 5]| {
        let place = |k: usize| (k as f32 + 0.5) / SIDE as f32;
        let point = |k: usize| {
            let (u, v) = (place(k % SIDE), place(k / SIDE));
            Vec2::new(within(left, right, u), within(top, bottom, v))
        };
        // Patches that there are not have an empty rectangle.
        let points: Vec<Vec2> = if right > left { (0..EACH).map(point).collect() } else { vec![Vec2::ZERO; EACH] };
        light.tail().forward_directions(&points).map(|(_, wi, _)| wi.to_array()).collect::<Vec<_>>()
    };
    patches.leaves.rectangles.par_iter().flat_map_iter(of_patch).collect()
}

vectorized! {
    /// Directions for uniform points, and the numbers of their patches as bits: [`NONE`] where they are below a surface.
    fn aim['a](
        simd, patches: &'a Patches, directions: &'a [[f32; 3]], at: &'a Rows<'a>, state: &'a [Lanes],
        u: [&'a [Lanes]; 2], wi: [&'a mut [Lanes]; 3], out: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..out.len() {
            let aim = Points([u[0][strip], u[1][strip]]);
            let (path, narrow) = walk(simd, patches, &Unoccluded, (at, strip), state, [&aim; 3]);
            let inside = path.cuts.inside(&aim.0[0], &aim.0[1]);
            let [left, right, top, bottom, _] = &rectangles(patches, &path, &narrow);
            for k in 0..LANES {
                let (y_u, y_v) = (within(left[k], right[k], inside[0][k]), within(top[k], bottom[k], inside[1][k]));
                let number = path.number[k] as usize;
                let patch = if narrow[k] { number / PARTS } else { number };
                let [left, right, top, bottom, _] = patches.leaves.rectangles[patch];
                let place = |y: f32, from: f32, to: f32| (((y - from) / (to - from) * SIDE as f32) as usize).min(SIDE - 1);
                let direction = place(y_v, top, bottom) * SIDE + place(y_u, left, right);
                [x[strip][k], y[strip][k], z[strip][k]] = directions[patch * EACH + direction];
                let number = patches.numbers[patch / PARTS] * PARTS + patch % PARTS;
                out[strip][k] = f32::from_bits(if path.probability[k] > 0.0 { number as u32 } else { NONE });
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
        environment::built_in,
        latlong,
        patches::Detail,
        random::{Purpose, Stream},
        sampler::{Draws, Sampler, prepared},
        tail::TailKind,
        tile::{ShadingPoint, Tile},
    };

    /// Rays of a sampler's patches, beside what the sampler draws from the same points: how many of them are in the same patch, in another, and how many rays are missing
    /// of those that a sampler draws. All are in the patch that they say, and above their surface.
    fn compare(name: &str, surface: Surface) -> [usize; 3] {
        const RAYS: u32 = 8;
        let light = EnvironmentLight::new(Arc::new(built_in(name).unwrap()), TailKind::Hierarchical).unwrap();
        let sampler = PatchSampler::new(light, Detail::Leaves).unwrap();
        let rays = SkyRays::new(sampler.clone());
        let mut random = Stream::new(5, Purpose::Test, 0);
        let mut tile = Tile::default();
        for key in 0..500 {
            let n = random.direction();
            let wo = (n + 0.7 * n.any_orthonormal_vector()).normalize();
            let ng = (n + 0.2 * wo).normalize();
            tile.push(&ShadingPoint { p: Vec3A::ZERO, ng, ns: n, wo, surface }, key);
        }
        let (at, arena) = (tile.rows(), Arena::default());
        let mut points: Vec<[Vec<Lanes>; 2]> = Vec::new();
        let mut sent: Vec<(usize, Vec3A, u16)> = Vec::new();
        let mut of_ray = Vec::new();
        let draw = |_, [u, v]: [&mut [Lanes]; 2]| {
            for column in [&mut *u, &mut *v] {
                column.as_flattened_mut().fill_with(|| random.uniform());
            }
            points.push([u.to_vec(), v.to_vec()]);
        };
        rays.send(&at, RAYS, draw, |place, wi, patch| sent.push((place, wi, patch)), &arena);
        prepared(&sampler, &at, &arena, |state| {
            for [u, v] in &points {
                let mut columns = arena.columns::<4>(at.strips());
                let [x, y, z, pdf] = columns.get_mut();
                sampler.sample(&at, state, [u, v], Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, &arena);
                let [x, y, z, pdf] = [&*x, &*y, &*z, &*pdf].map(<[_]>::as_flattened);
                let patch =
                    |k: usize| (pdf[k] > 0.0).then(|| sampler.patch_at(latlong::square(Vec3A::new(x[k], y[k], z[k]))));
                of_ray.push((0..at.len()).map(patch).collect::<Vec<_>>());
            }
        });
        let mut found = [0; 3];
        let (mut ray, mut last) = (0, None);
        for &(place, wi, patch) in &sent {
            // Places rise within a ray.
            ray += usize::from(last.is_some_and(|last| place <= last));
            last = Some(place);
            let point = tile.point(place);
            assert!(wi.is_normalized() && wi.dot(point.ns) > 0.0 && wi.dot(point.ng) > 0.0);
            assert_eq!(sampler.patch_at(latlong::square(wi)), patch, "{name}: {wi}");
            found[usize::from(of_ray[ray][place] != Some(patch))] += 1;
        }
        let drawn = of_ray.iter().flatten().filter(|patch| patch.is_some()).count();
        found[2] = drawn - sent.len();
        found
    }

    #[test]
    fn rays_go_to_the_patches_that_samples_are_in() {
        for name in ["studio", "sunset"] {
            for surface in [Lambert { albedo: Vec3::ONE }.into(), Ggx::new(0.2, Vec3::ONE).into()] {
                let [same, other, missing] = compare(name, surface);
                // A sample may be rounded across the edge of its patch; what is below a surface is a small part of what is drawn.
                assert!(same > 3000 && other * 200 <= same && missing * 3 < same, "{name}: {same} {other} {missing}");
            }
        }
    }
}
