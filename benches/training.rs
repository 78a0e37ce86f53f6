//! Time of a training step's gradient: `cargo bench --bench training`.
//!
//! The head of the preset `paper-ggx` (36 k weights, K = 32), forward and backward on a batch in memory, in
//! two forms: in the tensor library's graph, and fused.

use divan::{Bencher, counter::ItemsCount};
use headtail_model::{Head, HeadConfig, Mode};
use headtail_render::{
    environment::Environment,
    random::Purpose,
    tail::{Tail, TailKind},
};
use headtail_train::{
    Backend, Batch, GradientSource, Loss, Objective, fused::FusedGradient, in_graph, integrand::BatchShape,
};

const MODES: [Mode; 2] = [Mode::Coupled, Mode::Autoregressive];

/// Returns a microfacet batch under the built-in studio.
fn batch(conditions: usize, strata: usize) -> Batch {
    let environment = Environment::open("studio").expect("a built-in environment");
    let (width, height) = (environment.width(), environment.height());
    let tail = Tail::new(TailKind::Hierarchical, width, height, &environment.luminance()).expect("it is lit");
    let target = headtail_train::build_target(
        &headtail_train::Preset::PaperGgx.config(),
        &tail,
        headtail_train::Viewpoints::Sphere,
    )
    .expect("no file is needed");
    let shape = BatchShape { conditions, strata, brdf_samples: 0 };
    Batch::draw(&*target, shape, 0, Purpose::Batch, 0).expect("a density")
}

fn head(mode: Mode) -> (Head, burn::prelude::Device) {
    let device = Backend::default().device().expect("it is compiled").autodiff();
    (Head::new(HeadConfig { mode, ..HeadConfig::MICROFACET }, 0, &device).expect("a valid head"), device)
}

const OBJECTIVE: Objective = Objective { loss: Loss::LogChiSquare, entropic: 0.0 };

#[divan::bench(args = MODES, sample_count = 3)]
fn in_graph(bencher: Bencher, mode: Mode) {
    let (batch, (head, device)) = (batch(16, 32), head(mode));
    bencher
        .counter(ItemsCount::new(batch.densities.len()))
        .bench_local(|| in_graph::in_graph(&head, OBJECTIVE, &batch, &device));
}

#[divan::bench(args = MODES, sample_count = 10)]
fn fused_paper_batch(bencher: Bencher, mode: Mode) {
    bench_fused(bencher, mode, &batch(256, 32));
}

#[divan::bench(args = MODES, sample_count = 50)]
fn fused_small_batch(bencher: Bencher, mode: Mode) {
    bench_fused(bencher, mode, &batch(64, 8));
}

fn bench_fused(bencher: Bencher, mode: Mode, batch: &Batch) {
    let (head, _) = head(mode);
    let weights = head.flat_weights();
    let mut fused = FusedGradient::new(&head);
    bencher.counter(ItemsCount::new(batch.densities.len())).bench_local(|| fused.gradient(&weights, OBJECTIVE, batch));
}

fn main() {
    divan::main();
}
