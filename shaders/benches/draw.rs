//! Directions in shaders: `cargo bench -p headtail-shaders --features gpu --bench draw`.
//!
//! An item is one call each of `headtail_sample`, `headtail_pdf` and `headtail_share`, with its query read
//! from and its answer written to device memory. Points are random, without coherence between neighbours:
//! rays are faster.

#[path = "../tests/draw/mod.rs"]
mod draw;

use std::{path::Path, sync::Arc};

use divan::{Bencher, counter::ItemsCount};
use headtail_sampling::{
    bake::{CellGrid, NormalGrid, direct_bake},
    environment::Environment,
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches},
    flat::FlatArray,
    patches::Detail,
    sampler::EnvironmentLight,
    tail::TailKind,
};
use headtail_shaders::{Shader, gpu::Gpu};

use draw::{Program, queries};

/// Queries in one iteration: half of the maximum of one dispatch.
const QUERIES: usize = 1 << 21;

fn main() {
    println!("adapter: {}", Gpu::open().expect("an adapter"));
    divan::main();
}

fn bench(bencher: Bencher, arrays: &[FlatArray], glossy: bool) {
    let shader = Shader::new(arrays).expect("a shader");
    let program = Program::new(&shader, &queries(QUERIES, glossy).0).expect("an adapter");
    let answers = {
        program.run();
        program.answers()
    };
    assert!(answers.iter().any(|answer| answer.pdf > 0.0 && answer.pdf_of_given > 0.0 && answer.mixture_weight > 0.0));
    bencher.counter(ItemsCount::new(QUERIES)).bench_local(|| program.run());
}

#[divan::bench(args = [false, true])]
fn patches(bencher: Bencher, glossy: bool) {
    let light = EnvironmentLight::new(Arc::new(studio()), TailKind::Hierarchical).expect("the light");
    bench(bencher, &flat_patches(light.tail(), Detail::Leaves).expect("patches"), glossy);
}

#[divan::bench]
fn table(bencher: Bencher) {
    let map = Arc::new(studio());
    let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical).expect("the light");
    let table =
        direct_bake(light.tail(), NormalGrid::new(16, 32).expect("a grid"), CellGrid::new(32, 32).expect("a grid"));
    let exported =
        ExportedSampler::new(Intermediate::DirectBake(table.expect("a table")), TailKind::Hierarchical, &map, None);
    bench(bencher, &flat_exported(&exported.expect("a sampler")).expect("arrays"), false);
}

/// Measures a head with 10,795 weights, two networks of two layers of 64 and K = 4.
#[divan::bench]
fn head(bencher: Bencher) {
    let exported = ExportedSampler::read(Path::new("../checkpoints/studio-head.safetensors")).expect("the head");
    bench(bencher, &flat_exported(&exported).expect("arrays"), false);
}

fn studio() -> Environment {
    Environment::open("studio").expect("a built-in map")
}
