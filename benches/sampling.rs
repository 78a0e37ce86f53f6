//! Time of one direction sample, without rays: `cargo bench --bench sampling`.
//!
//! Samplers process tiles of 256 shading points, as in the integrator; each point has its own normal, so
//! preparation is included. `coherent` normals lie within six degrees of each other, like those of
//! neighbouring pixels; `scattered` normals are uniform over the sphere. The map is the file named by the
//! environment variable HEADTAIL_MAP, else the built-in `studio`; `patches-ggx` and `mis-ggx` use a surface
//! of alpha = 0.4 seen from all sides. Weights of heads are the initial ones; they do not affect the time.

use std::{
    hint::black_box,
    sync::{Arc, LazyLock},
};

use divan::{Bencher, counter::ItemsCount};
use glam::{Vec3, Vec3A};
use headtail_model::HeadConfig;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::{Ggx, Lambert, Surface},
    columns::Arena,
    environment::Environment,
    estimator::{Contributions, Estimator, Ris},
    head::Head,
    patches::{Detail, PatchSampler},
    points::{Dimension, PointSet, Points},
    random::{Purpose, Stream},
    sampler::{
        BrdfSampler, Covering, Draws, EmitterSampler, EnvironmentLight, OneSampleMis, ProductSampler, Sampler, prepared,
    },
    tail::TailKind,
    tile::{ShadingPoint, Tile},
};
use headtail_train::native_head;

/// Points of a tile.
const TILE: usize = 256;
/// Tiles in one iteration of the benchmark.
const TILES: usize = 16;

static LIGHT: LazyLock<EnvironmentLight> = LazyLock::new(|| {
    let map = std::env::var("HEADTAIL_MAP").unwrap_or_else(|_| "studio".to_owned());
    let environment = Arc::new(Environment::open(&map).expect("the map of HEADTAIL_MAP can be read"));
    EnvironmentLight::new(environment, TailKind::Hierarchical).expect("the map is lit")
});

/// The distribution of normals.
#[derive(Clone, Copy, Debug)]
enum Normals {
    Coherent,
    Scattered,
}

const NORMALS: [Normals; 2] = [Normals::Coherent, Normals::Scattered];

/// Returns diffuse points, seen along their normals.
fn tiles(normals: Normals) -> Vec<Tile> {
    tiles_of(normals, Lambert { albedo: Vec3::ONE }.into(), 0.0)
}

/// Returns points of a surface, seen from directions at an angle of `tilt` to their normals.
fn tiles_of(normals: Normals, surface: Surface, tilt: f32) -> Vec<Tile> {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let around = random.direction();
    let mut point = || {
        let normal = match normals {
            Normals::Coherent => (around + 0.1 * random.direction()).normalize(),
            Normals::Scattered => random.direction(),
        };
        let wo = (normal + tilt * random.direction()).normalize();
        ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo, surface }
    };
    (0..TILES).map(|_| Tile::of(&(0..TILE).map(|_| point()).collect::<Vec<_>>())).collect()
}

/// Measures one sample per point.
fn bench(bencher: Bencher, normals: Normals, sampler: &dyn Sampler) {
    bench_tiles(bencher, &tiles(normals), sampler);
}

/// Measures one sample per point on a glossy surface.
fn bench_glossy(bencher: Bencher, normals: Normals, sampler: &dyn Sampler) {
    bench_tiles(bencher, &tiles_of(normals, Ggx::new(0.4, Vec3::ONE).into(), 0.8), sampler);
}

fn bench_tiles(bencher: Bencher, tiles: &[Tile], sampler: &dyn Sampler) {
    let arena = Arena::default();
    bencher.counter(ItemsCount::new(TILES * TILE)).bench_local(|| {
        for tile in black_box(tiles) {
            let rows = tile.rows();
            let mut columns = arena.columns::<6>(rows.strips());
            let [u, v, x, y, z, pdf] = columns.get_mut();
            Points::new(PointSet::Sobol, 1).draw(Dimension::Light(0), &rows, [&mut *u, &mut *v]);
            prepared(sampler, &rows, &arena, |state| {
                sampler.sample(&rows, state, [u, v], Draws { wi: [x, y, z], pdf }, &arena);
            });
            black_box(columns.get());
        }
    });
}

fn direct(side: usize) -> impl Sampler {
    let cells = CellGrid::new(side, side).expect("a valid size");
    let normals = NormalGrid::new(16, 32).expect("a valid size");
    ProductSampler::new(LIGHT.clone(), direct_bake(LIGHT.tail(), normals, cells).expect("a lit map"))
}

fn head(share: bool) -> Head {
    let config = HeadConfig { share, ..HeadConfig::COSINE };
    let head =
        headtail_model::Head::new(config, 0, &headtail_train::Backend::default().device().expect("it is compiled"))
            .expect("a valid head");
    native_head(&head).expect("finite weights")
}

#[divan::bench(args = NORMALS)]
fn brdf(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &BrdfSampler);
}

#[divan::bench(args = NORMALS)]
fn emitter(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &EmitterSampler::new(LIGHT.clone()));
}

#[divan::bench(args = NORMALS)]
fn mis(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &OneSampleMis::new(EmitterSampler::new(LIGHT.clone()), BrdfSampler));
}

fn patches() -> PatchSampler {
    PatchSampler::new(LIGHT.clone(), Detail::Leaves).expect("a quad-tree tail")
}

#[divan::bench(name = "patches", args = NORMALS)]
fn patches_on_diffuse(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &patches());
}

#[divan::bench(name = "mis-ggx", args = NORMALS)]
fn mis_on_glossy(bencher: Bencher, normals: Normals) {
    bench_glossy(bencher, normals, &OneSampleMis::new(EmitterSampler::new(LIGHT.clone()), BrdfSampler));
}

#[divan::bench(name = "patches-ggx", args = NORMALS)]
fn patches_on_glossy(bencher: Bencher, normals: Normals) {
    bench_glossy(bencher, normals, &OneSampleMis::new(patches(), BrdfSampler));
}

#[divan::bench(args = NORMALS, consts = [8, 32, 64])]
fn direct_of_side<const SIDE: usize>(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &direct(SIDE));
}

#[divan::bench(name = "head", args = NORMALS)]
fn head_alone(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &ProductSampler::new(LIGHT.clone(), head(false)));
}

#[divan::bench(name = "head+mis", args = NORMALS)]
fn head_with_mis(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &OneSampleMis::new(ProductSampler::new(LIGHT.clone(), head(true)), BrdfSampler));
}

/// Measures drawing two numbers per point.
#[divan::bench(args = ["independent", "sobol", "lattice:16"])]
fn points(bencher: Bencher, set: &str) {
    let (tiles, arena) = (tiles(Normals::Coherent), Arena::default());
    let points = Points::new(set.parse().expect("a kind of points"), 1);
    bencher.counter(ItemsCount::new(TILES * TILE)).bench_local(|| {
        for tile in black_box(&tiles) {
            let rows = tile.rows();
            let mut columns = arena.columns::<2>(rows.strips());
            points.draw(Dimension::Light(0), &rows, columns.get_mut());
            black_box(columns.get());
        }
    });
}

/// Measures candidates, their light and BRDF, and the selection.
#[divan::bench(name = "ris:4", args = NORMALS)]
fn ris(bencher: Bencher, normals: Normals) {
    let emitter = Covering::new(EmitterSampler::new(LIGHT.clone())).expect("an exact tail");
    let brdf = Covering::new(BrdfSampler).expect("it covers everything");
    let ris = Ris::new(emitter, brdf, 4, LIGHT.environment().clone()).expect("a valid count");
    let (tiles, arena, mut out) = (tiles(normals), Arena::default(), Contributions::default());
    bencher.counter(ItemsCount::new(TILES * TILE)).bench_local(|| {
        for tile in black_box(&tiles) {
            out.clear();
            ris.propose(&tile.rows(), &Points::new(PointSet::Sobol, 1), &mut out, &arena);
            black_box(&out);
        }
    });
}

fn main() {
    divan::main();
}
