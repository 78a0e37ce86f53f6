//! Time of one direction sample, without rays: `cargo bench --bench sampling`.
//!
//! Each sample has a normal of its own: preparation is part of the time. Samples are drawn in batches, as the integrator does, or
//! one point at a time where the name ends in `single`. `coherent` normals lie within six degrees of each
//! other, as those of neighbouring pixels do; `scattered` normals are uniform over the sphere. The map is the file named by
//! the environment variable HEADTAIL_MAP, else the built-in `studio`.

use std::{
    hint::black_box,
    sync::{Arc, LazyLock},
};

use divan::{Bencher, counter::ItemsCount};
use glam::{Vec2, Vec3A};
use headtail_model::{HeadConfig, burn::prelude::Device};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::{Brdf, Lambert},
    environment::Environment,
    integrator::{DirectEstimator, ResampledEstimator, Unshadowed},
    random::{Purpose, Stream, Streams},
    sampler::{
        BrdfSampler, DirectionSampler, EmitterSampler, EnvironmentLight, OneSampleMis, ProductSampler, Resampled,
        ShadingPoint,
    },
    tail::TailKind,
};
use headtail_train::native_head;

/// Samples in one iteration of the benchmark.
const SAMPLES: usize = 4096;

/// Samples in one batch of an estimator.
const TILE: usize = 256;

static LIGHT: LazyLock<EnvironmentLight> = LazyLock::new(|| {
    let map = std::env::var("HEADTAIL_MAP").unwrap_or_else(|_| "studio".to_owned());
    let environment = Arc::new(Environment::open(&map).expect("the map of HEADTAIL_MAP can be read"));
    EnvironmentLight::new(environment, TailKind::Hierarchical).expect("the map is lit")
});

/// Which normals the samples have.
#[derive(Clone, Copy, Debug)]
enum Normals {
    Coherent,
    Scattered,
}

const NORMALS: [Normals; 2] = [Normals::Coherent, Normals::Scattered];

fn points(normals: Normals) -> Vec<(ShadingPoint, Vec2)> {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let around = random.direction();
    let mut point = || {
        let normal = match normals {
            Normals::Coherent => (around + 0.1 * random.direction()).normalize(),
            Normals::Scattered => random.direction(),
        };
        let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
        (ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, brdf }, random.uniform2())
    };
    (0..SAMPLES).map(|_| point()).collect()
}

/// One sample of each point, in batches as a wavefront renderer asks for them.
fn bench<S: DirectionSampler>(bencher: Bencher, normals: Normals, sampler: &S) {
    let (at, u): (Vec<_>, Vec<_>) = points(normals).into_iter().unzip();
    let mut out = vec![None; SAMPLES];
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| {
        sampler.sample_batch(black_box(&at), &u, &mut out);
        black_box(&out);
    });
}

/// The same one point at a time.
fn bench_single<S: DirectionSampler>(bencher: Bencher, normals: Normals, sampler: &S) {
    let points = points(normals);
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| {
        for (at, u) in &points {
            let prepared = sampler.prepare(at);
            black_box(sampler.sample(&prepared, at, *u));
        }
    });
}

fn direct(side: usize) -> impl DirectionSampler {
    let cells = CellGrid::new(side, side).expect("a valid size");
    let normals = NormalGrid::new(16, 32).expect("a valid size");
    ProductSampler::new(LIGHT.clone(), direct_bake(LIGHT.tail(), normals, cells).expect("a lit map"))
}

#[divan::bench(args = NORMALS)]
fn emitter(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &EmitterSampler::new(LIGHT.clone()));
}

#[divan::bench(args = NORMALS)]
fn emitter_single(bencher: Bencher, normals: Normals) {
    bench_single(bencher, normals, &EmitterSampler::new(LIGHT.clone()));
}

#[divan::bench(args = NORMALS)]
fn baked_32x32_single(bencher: Bencher, normals: Normals) {
    bench_single(bencher, normals, &direct(32));
}

#[divan::bench(args = NORMALS)]
fn baked_8x8_single(bencher: Bencher, normals: Normals) {
    bench_single(bencher, normals, &direct(8));
}

#[divan::bench(args = NORMALS)]
fn cosine(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &BrdfSampler::new(LIGHT.environment().clone()));
}

#[divan::bench(args = NORMALS)]
fn mis(bencher: Bencher, normals: Normals) {
    let brdf = BrdfSampler::new(LIGHT.environment().clone());
    bench(bencher, normals, &OneSampleMis::new(EmitterSampler::new(LIGHT.clone()), brdf));
}

#[divan::bench(args = NORMALS)]
fn baked_8x8(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &direct(8));
}

#[divan::bench(args = NORMALS)]
fn baked_32x32(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &direct(32));
}

#[divan::bench(args = NORMALS)]
fn baked_64x64(bencher: Bencher, normals: Normals) {
    bench(bencher, normals, &direct(64));
}

/// The weights do not change the time.
#[divan::bench(args = NORMALS)]
fn cosine_head(bencher: Bencher, normals: Normals) {
    let head = headtail_model::Head::new(HeadConfig::COSINE, 0, &Device::flex()).expect("a valid head");
    bench(bencher, normals, &ProductSampler::new(LIGHT.clone(), native_head(&head).expect("finite weights")));
}

#[divan::bench(args = NORMALS)]
fn ris_4(bencher: Bencher, normals: Normals) {
    let brdf = BrdfSampler::new(LIGHT.environment().clone());
    let resampled = Resampled::new(EmitterSampler::new(LIGHT.clone()), brdf, 4).expect("a valid count");
    let estimator = ResampledEstimator::new(resampled);
    let at: Vec<ShadingPoint> = points(normals).into_iter().map(|(at, _)| at).collect();
    let mut streams: Vec<Stream> = (0..SAMPLES).map(|k| Stream::new(2, Purpose::Test, k as u64)).collect();
    let order: Vec<usize> = (0..TILE).collect();
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| {
        for (at, streams) in at.chunks(TILE).zip(streams.chunks_mut(TILE)) {
            black_box(estimator.estimate_batch(at, &Unshadowed, &mut Streams::new(streams, &order)));
        }
    });
}

fn main() {
    divan::main();
}
