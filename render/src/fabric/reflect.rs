//! Path tracing of a fabric through its yarns.

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

/// Smallest cosine of query directions: more grazing rays may leave the neighbouring tiles before they
/// leave the yarns.
pub const MIN_COSINE: f32 = 0.14;

/// Light paths traced per batch.
const PATHS: usize = 2048;
/// Index of the first bounce with Russian roulette.
const ROULETTE_FROM: u32 = 2;
/// Maximum survival probability of Russian roulette.
const MOST_SURVIVAL: f32 = 0.95;
/// Maximum bounces. At [`MOST_SURVIVAL`], 1 in 30 000 paths would be longer, with negligible throughput.
const MOST_BOUNCES: u32 = 200;

/// A periodic tile of yarns over a lining.
pub struct Fabric {
    scene: Scene,
    /// Height just above the yarns, where camera rays start.
    top: f32,
    /// Height of the reference plane.
    reference: f32,
}

/// The state of an unfinished light path.
#[derive(Clone, Copy)]
struct Path {
    query: usize,
    throughput: Vec3A,
}

impl Fabric {
    /// Creates a fabric from meshes that extend one tile beyond the unit square on all sides. `materials`
    /// are those of the meshes, then the lining's.
    ///
    /// # Errors
    /// As [`Scene::new`].
    pub(super) fn new(name: &str, mut meshes: Vec<Mesh>, materials: Vec<Material>) -> Result<Self> {
        meshes.push(lining_mesh(materials.len() - 1)?);
        let scene = Scene::new(name, meshes, materials, None)?;
        scene.prepare_materials();
        let top = scene.bounds().max.z;
        // Most visible points lie near the top.
        Ok(Self { scene, top: top + 1e-3, reference: 0.8 * top })
    }

    /// Replaces all materials with one.
    #[must_use]
    pub fn with_material(self, material: Material) -> Self {
        Self { scene: self.scene.with_material(material), ..self }
    }

    /// Returns the ray along `-wo`, from above the yarns, that meets the reference plane at `at`.
    fn seen_from(&self, at: Vec2, wo: Vec3) -> Ray {
        let up = (self.top - self.reference) / wo.z;
        let origin = Vec3A::new(at.x + up * wo.x, at.y + up * wo.y, self.top);
        Ray::new(into_tile(origin), -Vec3A::from(wo))
    }

    /// Traces `samples` paths per query and adds their contributions to `out`.
    fn trace(
        &self,
        queries: &[Query],
        samples: u32,
        random: &mut Stream,
        buffers: &mut ThreadBuffers,
        out: &mut [Vec3A],
    ) {
        buffers.rays.clear();
        buffers.paths.clear();
        for (query, asked) in queries.iter().enumerate() {
            for _ in 0..samples {
                let at = asked.uv + asked.width * gaussian(random.uniform2());
                buffers.rays.push(self.seen_from(at, asked.wo));
                buffers.paths.push(Path { query, throughput: Vec3A::ONE });
            }
        }
        for bounce in 0..MOST_BOUNCES {
            buffers.hits.clear();
            self.scene.intersect_batch(&buffers.rays, 0.0, |k| k as u32, &mut buffers.tile, &mut buffers.hits);
            if buffers.hits.is_empty() {
                break;
            }
            self.add_direct(queries, buffers, out);
            self.go_on(bounce, random, buffers);
        }
    }

    /// Adds the light that reaches the current hits unoccluded from `wi`.
    fn add_direct(&self, queries: &[Query], buffers: &mut ThreadBuffers, out: &mut [Vec3A]) {
        let ThreadBuffers { arena, tile, paths, hits, visible, shadow_rays, lit, .. } = buffers;
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

    /// Samples the next segments of the paths.
    fn go_on(&self, bounce: u32, random: &mut Stream, buffers: &mut ThreadBuffers) {
        let ThreadBuffers { arena, tile, paths, hits, rays, next, .. } = buffers;
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
        let parts =
            queries.par_chunks(chunk).enumerate().map_init(ThreadBuffers::default, |buffers, (index, queries)| {
                let mut random = Stream::new(seed, Purpose::Texture, index as u64);
                let mut out = vec![Vec3A::ZERO; queries.len()];
                self.trace(queries, samples, &mut random, buffers, &mut out);
                out.into_iter().map(|sum| Vec3::from(sum) / samples as f32).collect::<Vec<_>>()
            });
        parts.collect::<Vec<_>>().concat()
    }
}

/// Buffers of one thread.
#[derive(Default)]
struct ThreadBuffers {
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

/// Wraps a point into the central tile.
fn into_tile(p: Vec3A) -> Vec3A {
    Vec3A::new(p.x - p.x.floor(), p.y - p.y.floor(), p.z)
}

/// Returns two normal deviates (Box and Muller 1958).
fn gaussian(u: Vec2) -> Vec2 {
    (-2.0 * (1.0 - u.x).ln()).sqrt() * Vec2::from_angle(TAU * u.y)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
