//! Native inference of heads, without tail and map: `cargo bench --bench inference`.
//!
//! One thread. Every sample has a condition of its own, so that encoder and condition layers are part of the time, except where
//! the name says `prepared`. `single` is the form for one point at a time. Weights are the initial ones; they do not change the time.

use std::hint::black_box;

use divan::{Bencher, counter::ItemsCount};
use glam::{Vec2, Vec3A};
use headtail_model::{Mode, burn::prelude::Device};
use headtail_render::{
    brdf::{Brdf, Ggx},
    head::Head,
    random::{Purpose, Stream},
    sampler::{IntermediateDensity, ShadingPoint},
};
use headtail_train::{Preset, native_head};

/// Samples in one iteration: a tile of a wavefront renderer.
const SAMPLES: usize = 256;

const HEADS: [(Preset, Mode); 5] = [
    (Preset::PaperGgx, Mode::Coupled),
    (Preset::PaperGgx, Mode::Autoregressive),
    (Preset::PaperCosine, Mode::Coupled),
    (Preset::PaperCosine, Mode::Autoregressive),
    (Preset::FastGgx, Mode::Coupled),
];

fn head((preset, mode): (Preset, Mode)) -> Head {
    let mut config = preset.config().head;
    config.mode = mode;
    let head = headtail_model::Head::new(config, 0, &Device::flex()).expect("a valid head");
    native_head(&head).expect("finite weights")
}

fn points() -> (Vec<ShadingPoint>, Vec<Vec2>) {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let mut point = || {
        let (n, wo) = (random.direction(), random.direction());
        let wo = if wo.dot(n) < 0.0 { -wo } else { wo };
        let brdf = Brdf::Ggx(Ggx::new(0.4, Vec3A::ONE));
        (ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, brdf }, random.uniform2())
    };
    (0..SAMPLES).map(|_| point()).unzip()
}

#[divan::bench(args = HEADS)]
fn sample(bencher: Bencher, name: (Preset, Mode)) {
    let (head, (at, z)) = (head(name), points());
    let (mut y, mut q) = (vec![Vec2::ZERO; SAMPLES], vec![0.0; SAMPLES]);
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| head.sample_batch(black_box(&at), &z, &mut y, &mut q));
}

#[divan::bench(args = HEADS)]
fn sample_prepared(bencher: Bencher, name: (Preset, Mode)) {
    let (head, (at, z)) = (head(name), points());
    let prepared = head.prepare_batch(&at);
    let prepared: Vec<_> = prepared.iter().collect();
    let (mut y, mut q) = (vec![Vec2::ZERO; SAMPLES], vec![0.0; SAMPLES]);
    bencher
        .counter(ItemsCount::new(SAMPLES))
        .bench_local(|| head.sample_prepared(black_box(&prepared), &z, &mut y, &mut q));
}

#[divan::bench(args = HEADS)]
fn density_prepared(bencher: Bencher, name: (Preset, Mode)) {
    let (head, (at, y)) = (head(name), points());
    let prepared = head.prepare_batch(&at);
    let prepared: Vec<_> = prepared.iter().collect();
    let mut q = vec![0.0; SAMPLES];
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| head.density_prepared(black_box(&prepared), &y, &mut q));
}

#[divan::bench(args = HEADS)]
fn sample_single(bencher: Bencher, name: (Preset, Mode)) {
    let (head, (at, z)) = (head(name), points());
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| {
        for (at, &z) in at.iter().zip(&z) {
            black_box(head.sample(&head.prepare(at), z));
        }
    });
}

fn main() {
    divan::main();
}
