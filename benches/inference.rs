//! Native inference of heads, without tail and map: `cargo bench --bench inference`.
//!
//! One thread. Every sample has its own condition. `prepare` covers the parts that depend only on the
//! condition (encoder and condition layers); `sample` and `density` cover the rest. Weights are the initial
//! ones; they do not affect the time.

use std::hint::black_box;

use divan::{Bencher, counter::ItemsCount};
use glam::{Vec3, Vec3A};
use headtail_model::Mode;
use headtail_render::{
    brdf::Ggx,
    columns::{Arena, Columns},
    head::Head,
    points::{Dimension, PointSet, Points},
    random::{Purpose, Stream},
    sampler::IntermediateDensity,
    tile::{Rows, ShadingPoint, Tile},
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
    let head =
        headtail_model::Head::new(config, 0, &headtail_train::Backend::default().device().expect("it is compiled"))
            .expect("a valid head");
    native_head(&head).expect("finite weights")
}

fn tile() -> Tile {
    let mut random = Stream::new(1, Purpose::Test, 0);
    let mut point = || {
        let (n, wo) = (random.direction(), random.direction());
        let wo = if wo.dot(n) < 0.0 { -wo } else { wo };
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface: Ggx::new(0.4, Vec3::ONE).into() }
    };
    Tile::of(&(0..SAMPLES).map(|_| point()).collect::<Vec<_>>())
}

/// Measures `work` with the head, the rows, their state, two input columns of uniform numbers and three
/// output columns.
fn bench(
    bencher: Bencher,
    name: (Preset, Mode),
    work: impl Fn(&Head, &Rows<'_>, &mut Columns<'_, 1>, &mut Columns<'_, 5>, &Arena),
) {
    let (head, tile, arena) = (head(name), tile(), Arena::default());
    let rows = tile.rows();
    let mut state = arena.columns::<1>(head.columns() * rows.strips());
    head.prepare(&rows, state.get_mut()[0], &arena);
    let mut columns = arena.columns::<5>(rows.strips());
    let [u, v, ..] = columns.get_mut();
    Points::new(PointSet::Sobol, 1).draw(Dimension::Light(0), &rows, [u, v]);
    bencher.counter(ItemsCount::new(SAMPLES)).bench_local(|| {
        work(&head, black_box(&rows), &mut state, &mut columns, &arena);
        black_box(columns.get());
    });
}

#[divan::bench(args = HEADS)]
fn prepare(bencher: Bencher, name: (Preset, Mode)) {
    bench(bencher, name, |head, rows, state, _, arena| head.prepare(rows, state.get_mut()[0], arena));
}

#[divan::bench(args = HEADS)]
fn sample(bencher: Bencher, name: (Preset, Mode)) {
    bench(bencher, name, |head, rows, state, columns, arena| {
        let [u, v, x, y, q] = columns.get_mut();
        head.sample(rows, state.get()[0], [u, v], [x, y], q, arena);
    });
}

#[divan::bench(args = HEADS)]
fn density(bencher: Bencher, name: (Preset, Mode)) {
    bench(bencher, name, |head, rows, state, columns, arena| {
        let [u, v, _, _, q] = columns.get_mut();
        head.density(rows, state.get()[0], [u, v], q, arena);
    });
}

fn main() {
    divan::main();
}
