//! What a fabric reflects: light paths through its yarns.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::{Query, Source, kinds::lining_mesh};
use crate::{
    columns::{Arena, strips},
    error::Result,
    random::{Purpose, Stream},
    scene::{Material, Mesh, Ray, Scene},
    simd::LANES,
    tile::Tile,
};

/// The least cosine of directions that a fabric is asked for: rays that are more grazing may leave the neighbouring tiles before they leave
/// the yarns.
pub const MIN_COSINE: f32 = 0.14;

/// Light paths that are traced side by side.
const PATHS: usize = 2048;
/// From this bounce on, paths end at random.
const ROULETTE_FROM: u32 = 2;
/// The largest chance to go on.
const MOST_SURVIVAL: f32 = 0.95;
/// No path is longer. With [`MOST_SURVIVAL`] one in 30 000 would be, and it carries nothing to speak of.
const MOST_BOUNCES: u32 = 200;

/// A periodic tile of yarns over a lining.
pub struct Fabric {
    scene: Scene,
    /// Height of the yarns: where rays start and end.
    top: f32,
    /// Height of the reference plane.
    reference: f32,
}

/// A light path in the making.
#[derive(Clone, Copy)]
struct Path {
    query: usize,
    throughput: Vec3A,
}

impl Fabric {
    /// A fabric of meshes that reach one tile beyond the unit square to all sides, with their materials and the lining's behind them.
    ///
    /// # Errors
    /// As [`Scene::new`].
    pub(super) fn new(name: &str, mut meshes: Vec<Mesh>, materials: Vec<Material>) -> Result<Self> {
        meshes.push(lining_mesh(materials.len() - 1)?);
        let scene = Scene::new(name, meshes, materials, None)?;
        scene.prepare_materials();
        let top = scene.bounds().max.z;
        // Most of what is seen lies near the top.
        Ok(Self { scene, top: top + 1e-3, reference: 0.8 * top })
    }

    /// The same geometry of one material.
    #[must_use]
    pub fn with_material(self, material: Material) -> Self {
        Self { scene: self.scene.with_material(material), ..self }
    }

    /// The ray from above that meets the reference plane at `at` and comes from `wo`.
    fn seen_from(&self, at: Vec2, wo: Vec3) -> Ray {
        let up = (self.top - self.reference) / wo.z;
        let origin = Vec3A::new(at.x + up * wo.x, at.y + up * wo.y, self.top);
        Ray::new(into_tile(origin), -Vec3A::from(wo))
    }

    /// Adds the paths of some queries to `out`.
    fn trace(&self, queries: &[Query], samples: u32, random: &mut Stream, work: &mut Work, out: &mut [Vec3A]) {
        work.rays.clear();
        work.paths.clear();
        for (query, asked) in queries.iter().enumerate() {
            for _ in 0..samples {
                let at = asked.uv + asked.width * gaussian(random.uniform2());
                work.rays.push(self.seen_from(at, asked.wo));
                work.paths.push(Path { query, throughput: Vec3A::ONE });
            }
        }
        for bounce in 0..MOST_BOUNCES {
            work.hits.clear();
            self.scene.intersect_batch(&work.rays, 0.0, |k| k as u32, &mut work.tile, &mut work.hits);
            if work.hits.is_empty() {
                break;
            }
            self.add_direct(queries, work, out);
            self.go_on(bounce, random, work);
        }
    }

    /// Light that comes straight from `wi`.
    fn add_direct(&self, queries: &[Query], work: &mut Work, out: &mut [Vec3A]) {
        let Work { arena, tile, paths, hits, visible, shadow_rays, lit, .. } = work;
        let mut columns = arena.columns::<6>(strips(hits.len()));
        let [x, y, z, red, green, blue] = columns.get_mut();
        for (place, &hit) in hits.iter().enumerate() {
            let wi = queries[paths[hit].query].wi;
            let (strip, lane) = (place / LANES, place % LANES);
            (x[strip][lane], y[strip][lane], z[strip][lane]) = (wi.x, wi.y, wi.z);
        }
        tile.rows().brdf_cosine([x, y, z], [red, green, blue], arena);
        shadow_rays.clear();
        lit.clear();
        for (place, &hit) in hits.iter().enumerate() {
            let (strip, lane) = (place / LANES, place % LANES);
            let f = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
            if f.max_element() > 0.0 {
                let (p, ng) = tile.position_and_normal(place);
                let path = paths[hit];
                shadow_rays.push(self.scene.leaving(into_tile(p), ng, queries[path.query].wi.into()));
                lit.push(Path { query: path.query, throughput: path.throughput * f });
            }
        }
        visible.clear();
        visible.resize(shadow_rays.len(), false);
        self.scene.visible_batch(shadow_rays, visible);
        for (path, _) in lit.iter().zip(visible).filter(|(_, visible)| **visible) {
            out[path.query] += path.throughput;
        }
    }

    /// The next segments of the paths.
    fn go_on(&self, bounce: u32, random: &mut Stream, work: &mut Work) {
        let Work { arena, tile, paths, hits, rays, next, .. } = work;
        let at = tile.rows();
        let mut columns = arena.columns::<9>(at.strips());
        let [u, v, x, y, z, pdf, red, green, blue] = columns.get_mut();
        for place in 0..hits.len() {
            let (strip, lane) = (place / LANES, place % LANES);
            (u[strip][lane], v[strip][lane]) = random.uniform2().into();
        }
        at.sample_brdf([u, v], [&mut *x, &mut *y, &mut *z], pdf, arena);
        at.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], arena);
        rays.clear();
        next.clear();
        for (place, &hit) in hits.iter().enumerate() {
            let (strip, lane) = (place / LANES, place % LANES);
            let f = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
            let mut throughput = if pdf[strip][lane] > 0.0 { f / pdf[strip][lane] } else { Vec3A::ZERO };
            throughput *= paths[hit].throughput;
            if bounce >= ROULETTE_FROM {
                let survival = throughput.max_element().min(MOST_SURVIVAL);
                throughput = if random.uniform() < survival { throughput / survival } else { Vec3A::ZERO };
            }
            if throughput.max_element() > 0.0 {
                let (p, ng) = tile.position_and_normal(place);
                let wi = Vec3A::new(x[strip][lane], y[strip][lane], z[strip][lane]);
                rays.push(self.scene.leaving(into_tile(p), ng, wi));
                next.push(Path { query: paths[hit].query, throughput });
            }
        }
        std::mem::swap(paths, next);
    }
}

impl Source for Fabric {
    fn reflect(&self, queries: &[Query], samples: u32, seed: u64) -> Vec<Vec3> {
        let chunk = (PATHS / samples.max(1) as usize).max(1);
        let parts = queries.par_chunks(chunk).enumerate().map_init(Work::default, |work, (index, queries)| {
            let mut random = Stream::new(seed, Purpose::Texture, index as u64);
            let mut out = vec![Vec3A::ZERO; queries.len()];
            self.trace(queries, samples, &mut random, work, &mut out);
            out.into_iter().map(|sum| Vec3::from(sum) / samples as f32).collect::<Vec<_>>()
        });
        parts.collect::<Vec<_>>().concat()
    }
}

/// What a thread works with.
#[derive(Default)]
struct Work {
    arena: Arena,
    tile: Tile,
    paths: Vec<Path>,
    next: Vec<Path>,
    rays: Vec<Ray>,
    hits: Vec<usize>,
    lit: Vec<Path>,
    shadow_rays: Vec<Ray>,
    visible: Vec<bool>,
}

/// The same place of the tile in the middle.
fn into_tile(p: Vec3A) -> Vec3A {
    Vec3A::new(p.x - p.x.floor(), p.y - p.y.floor(), p.z)
}

/// Two normal deviates (Box and Muller 1958).
fn gaussian(u: Vec2) -> Vec2 {
    (-2.0 * (1.0 - u.x).ln()).sqrt() * Vec2::from_angle(TAU * u.y)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
