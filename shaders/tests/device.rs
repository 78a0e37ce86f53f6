//! Shaders on a device (Mesa's software adapter if there is no other) match the native samplers.
//!
//! Points and densities agree to rounding, except where rounding moves a point across a border (of a patch, a
//! cell of a table, a texel): there densities jump, but few points are near borders.

mod draw;

use std::{path::Path, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_eval::conformance;
use headtail_sampling::{
    bake::{CellGrid, NormalGrid, direct_bake},
    batch::{self, DrawList, Numbers, PointList, SurfaceList},
    brdf::{Ggx, Lambert},
    columns::Arena,
    environment::Environment,
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches, flat_portals},
    head::{Condition, Head, Linear, Mode},
    patches::{Detail, PatchSampler},
    portals::{Portal, PortalSampler},
    random::{Purpose, Stream},
    sampler::{EnvironmentLight, Sampler, prepared},
    simd::LANES,
    spline::logit_count,
    tail::{Tail, TailKind, WarpMap},
    tile::{ShadingPoint, Tile},
};
use headtail_shaders::{
    Shader,
    gpu::{Gpu, GpuError},
};

use draw::{Answer, Program, Query, queries};

/// Number of points of samplers in closed form, and of heads, which are slow on software adapters.
const COUNT: usize = 1 << 18;
const OF_HEADS: usize = 1 << 16;
/// Largest difference of results, relative to the pdf.
const TOLERANCE: f32 = 1e-4;
/// Largest fraction of points beyond the tolerance.
const FAR: f64 = 5e-2;
/// Largest fraction of points across a border or rounded differently: the native sampler computes masses of
/// patches with fused multiply-adds, which shaders need not use, and at 0.3 % of glossy points the last
/// digits of a mass matter as much.
const ACROSS: f64 = 5e-3;

/// Compares a shader with its native sampler and prints the differences. [`compare_mixture_weights`] compares the
/// mixture weights.
fn compare(name: &str, shader: &Shader, sampler: &dyn Sampler, count: usize, glossy: bool) -> Vec<Answer> {
    let (queries, alphas) = queries(count, glossy);
    let start = std::time::Instant::now();
    let program = Program::new(shader, &queries).expect("a device: install mesa-vulkan-drivers");
    program.run();
    let answers = program.answers();
    let seconds = start.elapsed().as_secs_f64();
    let [n, wo]: [Vec<[f32; 3]>; 2] = [queries.iter().map(|q| q.n).collect(), queries.iter().map(|q| q.wo).collect()];
    let u: Vec<[f32; 2]> = queries.iter().map(|q| [q.u, q.v]).collect();
    let given: Vec<[f32; 3]> = queries.iter().map(|q| [q.wi[0], q.wi[1], q.wi[2]]).collect();
    let surface = if glossy { SurfaceList::Glossy { alpha: &alphas, f0: &[1.0] } } else { SurfaceList::Diffuse };
    // As `Program::new` has them.
    let p: Vec<[f32; 3]> = queries.iter().map(|query| [0, 1, 2].map(|axis| 2.0 * query.wi[axis])).collect();
    let at = PointList { p: &p, n: &n, wo: &wo, surface };
    let (mut wi, mut pdf, mut of_given) = (vec![[0.0; 3]; count], vec![0.0; count], vec![0.0; count]);
    batch::sample(sampler, &at, Numbers::Given(&u), DrawList { wi: &mut wi, pdf: &mut pdf, radiance: None }).unwrap();
    batch::pdf(sampler, &at, &given, &mut of_given).unwrap();
    let spread = Spread::new(sampler, &at, &u, &given, (&wi, &pdf, &of_given));
    // Beyond the tolerance, and additionally beyond the effect of input rounding on the native sampler.
    let (mut far, mut unexplained) = ([0_usize; 3], [0_usize; 3]);
    for (k, answer) in answers.iter().enumerate() {
        let apart = |axis: usize| (answer.wi[axis] - wi[k][axis]).abs();
        let direction = if pdf[k] > 0.0 { apart(0).max(apart(1)).max(apart(2)) } else { 0.0 };
        let relative = |a: f32, b: f32| if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) };
        let differences = [direction, relative(answer.pdf, pdf[k]), relative(answer.pdf_of_given, of_given[k])];
        for (index, difference) in differences.into_iter().enumerate() {
            far[index] += usize::from(difference > TOLERANCE);
            unexplained[index] += usize::from(difference > TOLERANCE + spread.0[index][k]);
        }
    }
    let fractions = |counts: [usize; 3]| counts.map(|far| far as f64 / count as f64);
    let text = |counts| fractions(counts).map(|fraction| format!("{fraction:.1e}")).join(", ");
    println!(
        "{name}: beyond {TOLERANCE} of directions, their pdfs, pdfs of given directions: {}; beyond rounding too: {}; {seconds:.1} s on the device",
        text(far),
        text(unexplained),
    );
    assert!(fractions(far).iter().all(|fraction| *fraction < FAR), "{name}: {far:?} of {count}");
    assert!(fractions(unexplained).iter().all(|fraction| *fraction < ACROSS), "{name}: {unexplained:?} of {count}");
    answers
}

/// Compares the mixture weights in answers with those of a native sampler at the same points.
fn compare_mixture_weights(name: &str, sampler: &dyn Sampler, answers: &[Answer], glossy: bool) {
    let (queries, alphas) = queries(answers.len(), glossy);
    let point = |(query, &alpha): (&Query, &f32)| {
        let (n, wo) = (Vec3A::from_array(query.n), Vec3A::from_array(query.wo));
        let surface = if glossy { Ggx::new(alpha, Vec3::ONE).into() } else { Lambert { albedo: Vec3::ONE }.into() };
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
    };
    let points: Vec<ShadingPoint> = queries.iter().zip(&alphas).map(point).collect();
    // A mixture weight s follows the power 1.92 of the masses' unevenness: rounding that changes masses by
    // the tolerance changes s by at most 1.92 s (1 - s) times twice as much, and slightly more where the
    // light of small lights is divided out, by a division that may be off by 2.5 ULP on a device.
    let (mut far, mut farthest) = (0, 0.0_f32);
    for (points, answers) in points.chunks(1024).zip(answers.chunks(1024)) {
        let (tile, arena) = (Tile::of(points), Arena::default());
        let mut mixture_weights = vec![[0.0; LANES]; tile.rows().strips()];
        let rows = tile.rows();
        prepared(sampler, &rows, &arena, |state| sampler.mixture_weight(&rows, state, &mut mixture_weights, &arena));
        for (answer, mixture_weight) in answers.iter().zip(mixture_weights.as_flattened()) {
            let difference = (answer.mixture_weight - mixture_weight).abs();
            far += usize::from(difference > TOLERANCE);
            farthest = farthest.max(difference);
        }
    }
    println!("{name}: {far} of {} mixture weights beyond {TOLERANCE}, the farthest by {farthest:.1e}", answers.len());
    assert!((far as f64) < FAR * answers.len() as f64 && farthest < 10.0 * TOLERANCE, "{name}: {far}, {farthest}");
}

/// Changes of directions, their pdfs and pdfs of given directions, in the measure of the test, if the inputs
/// change in their last digits. A density over Y changes by |d ln q / dy| times the rounding of y, which in a
/// narrow bin of a spline exceeds the tolerance.
struct Spread([Vec<f32>; 3]);

impl Spread {
    fn new(
        sampler: &dyn Sampler,
        at: &PointList<'_>,
        u: &[[f32; 2]],
        given: &[[f32; 3]],
        (wi, pdf, of_given): (&[[f32; 3]], &[f32], &[f32]),
    ) -> Self {
        /// Eight times the spacing of floats below 1.
        const STEP: f32 = 4.8e-7;
        let count = u.len();
        let mut spread = [(); 3].map(|()| vec![0.0_f32; count]);
        let relative = |a: f32, b: f32| if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) };
        let (mut other_wi, mut other_pdf) = (vec![[0.0; 3]; count], vec![0.0; count]);
        for (across, along) in [(STEP, 0.0), (-STEP, 0.0), (0.0, STEP), (0.0, -STEP)] {
            let moved = |[a, b]: &[f32; 2]| [a + across, b + along].map(|u| u.clamp(0.0, 0.999_999_94));
            let u: Vec<[f32; 2]> = u.iter().map(moved).collect();
            let out = DrawList { wi: &mut other_wi, pdf: &mut other_pdf, radiance: None };
            batch::sample(sampler, at, Numbers::Given(&u), out).unwrap();
            for k in 0..count {
                let apart = (0..3).map(|axis| (wi[k][axis] - other_wi[k][axis]).abs()).fold(0.0, f32::max);
                spread[0][k] = spread[0][k].max(apart);
                spread[1][k] = spread[1][k].max(relative(pdf[k], other_pdf[k]));
            }
            let moved = |w: &[f32; 3]| {
                let w = Vec3::from_array(*w);
                let (s, t) = w.any_orthonormal_pair();
                (w + across * s + along * t).normalize().to_array()
            };
            let given: Vec<[f32; 3]> = given.iter().map(moved).collect();
            batch::pdf(sampler, at, &given, &mut other_pdf).unwrap();
            for k in 0..count {
                spread[2][k] = spread[2][k].max(relative(of_given[k], other_pdf[k]));
            }
        }
        Self(spread)
    }
}

/// Of three portals, two share an image, two overlap, and some points are behind each.
#[test]
fn shaders_of_portals_match_the_native_sampler() {
    let window = |center: [f32; 3], normal, [width, height]: [f32; 2]| Portal {
        center: center.into(),
        normal,
        up: Vec3A::Y,
        width,
        height,
    };
    let portals = [
        window([1.5, 0.2, 0.0], Vec3A::NEG_X, [2.0, 1.5]),
        window([2.5, 0.0, 0.4], Vec3A::NEG_X, [3.0, 2.5]),
        window([0.3, 0.6, -1.8], Vec3A::new(0.6, 0.0, 0.8), [0.7, 0.9]),
    ];
    for name in ["studio", "sunset"] {
        let map = Arc::new(Environment::open(name).unwrap());
        let shader = Shader::new(&flat_portals(&portals, &map).unwrap()).unwrap();
        let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical).unwrap();
        let native = PortalSampler::new(&portals, &map).beside_emitter(light);
        compare(&format!("portals under {name}"), &shader, &native, COUNT, false);
    }
}

/// Other tests open the same one afterwards.
#[test]
fn adapters_are_chosen_by_number() {
    assert!(matches!(Gpu::use_adapter(1000), Err(GpuError::NoSuchAdapter { number: 1000, count: 1.. })));
    Gpu::use_adapter(0).unwrap();
    assert!(Gpu::adapters()[0].starts_with(&Gpu::open().unwrap().to_string()));
}

#[test]
fn shaders_match_the_native_samplers() {
    println!("adapter: {}", Gpu::open().expect("a device: install mesa-vulkan-drivers"));
    let map = Arc::new(Environment::open("studio").unwrap());
    let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical).unwrap();
    let shader = Shader::new(&flat_patches(light.tail(), Detail::Leaves).unwrap()).unwrap();
    let patches = PatchSampler::new(light.clone(), Detail::Leaves).unwrap();
    for (name, glossy) in [("patches, diffuse", false), ("patches, glossy", true)] {
        let answers = compare(name, &shader, &patches, COUNT, glossy);
        compare_mixture_weights(name, &patches, &answers, glossy);
    }
    let sun = EnvironmentLight::new(Arc::new(Environment::open("sunset").unwrap()), TailKind::Hierarchical).unwrap();
    let shader = Shader::new(&flat_patches(sun.tail(), Detail::Leaves).unwrap()).unwrap();
    let patches = PatchSampler::new(sun, Detail::Leaves).unwrap();
    for (name, glossy) in [("patches beside a sun, diffuse", false), ("patches beside a sun, glossy", true)] {
        let answers = compare(name, &shader, &patches, COUNT, glossy);
        compare_mixture_weights(name, &patches, &answers, glossy);
    }
    let table = direct_bake(light.tail(), NormalGrid::new(16, 32).unwrap(), CellGrid::new(32, 32).unwrap()).unwrap();
    let exported = ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, &map, None).unwrap();
    let shader = Shader::new(&flat_exported(&exported).unwrap()).unwrap();
    let native = exported.open(&map).unwrap();
    compare("table", &shader, &native, COUNT, false);
}

#[test]
fn shaders_pass_the_conformance_kit() {
    let (map, folder) = (conformance::map().unwrap(), tempfile::tempdir().unwrap());
    let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical).unwrap();
    let patches = Shader::new(&flat_patches(light.tail(), Detail::Leaves).unwrap()).unwrap();
    let table = Shader::new(&flat_exported(&conformance::table(&map).unwrap()).unwrap()).unwrap();
    for (name, shader) in [("patches", &patches), ("patches-glossy", &patches), ("table", &table)] {
        let case = conformance::cases(&map).unwrap().into_iter().find(|case| case.name == name).unwrap();
        let query = |row: &conformance::Row| {
            let lobes = match case.alpha {
                Some(alpha) => [0.0, 1.0, 1.0, alpha],
                None => [1.0, 0.0, 1.0, 1.0],
            };
            let (n, wo, wi) = (row.n.to_array(), row.wo.to_array(), row.given.extend(0.0).to_array());
            Query { n, u: row.u.x, wo, v: row.u.y, lobes, wi }
        };
        let program = Program::new(shader, &case.rows().unwrap().iter().map(query).collect::<Vec<_>>()).unwrap();
        program.run();
        let answer = |answer: &Answer| conformance::Answer {
            wi: Vec3A::from_array(answer.wi),
            pdf: answer.pdf,
            pdf_of_given: answer.pdf_of_given,
        };
        let answers: Vec<_> = program.answers().iter().map(answer).collect();
        conformance::write_answers(folder.path(), name, &answers).unwrap();
    }
    let verdicts = conformance::check(folder.path()).unwrap();
    verdicts.iter().for_each(|verdict| println!("{verdict}"));
    assert!(verdicts.len() == 3 && verdicts.iter().all(conformance::Verdict::passed));
}

/// Returns layers of random weights between sizes, scaled so that activations neither grow nor shrink much.
fn layers(sizes: &[usize], random: &mut Stream) -> Vec<Linear> {
    let mut layer = |pair: &[usize]| {
        let [inputs, outputs] = [pair[0], pair[1]];
        let reach = (3.0 / inputs as f32).sqrt();
        let mut numbers =
            |count: usize| -> Vec<f32> { (0..count).map(|_| reach * (2.0 * random.uniform() - 1.0)).collect() };
        let (weight, bias) = (numbers(inputs * outputs), numbers(outputs));
        Linear::new("layer", inputs, outputs, &weight, bias).unwrap()
    };
    sizes.windows(2).map(&mut layer).collect()
}

/// Returns a head of random weights.
fn head(condition: Condition, mode: Mode, encoder: &[usize], hidden: &[usize], bins: [usize; 2]) -> Head {
    let mut random = Stream::new(17, Purpose::Test, hidden.len() as u64);
    let encoder = [&[condition.length()], encoder].concat();
    let seen = condition.length() + if encoder.len() > 1 { encoder[encoder.len() - 1] } else { 0 };
    let features = [if mode == Mode::Coupled { 2 } else { 0 }, 1];
    let networks = [0, 1].map(|k| {
        let sizes = [&[seen + features[k]], hidden, &[logit_count(bins[k])]].concat();
        layers(&sizes, &mut random)
    });
    let encoder = layers(&encoder, &mut random);
    let mixture_weight = layers(&[seen, 13, 1], &mut random);
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_mixture_weight(mixture_weight).unwrap()
}

#[test]
fn shaders_of_heads_match_the_native_heads() {
    let read = |name: &str| ExportedSampler::read(Path::new(name)).unwrap();
    let studio = Arc::new(Environment::open("studio").unwrap());
    let trained = read("../checkpoints/studio-head.safetensors");
    let of_head =
        |head: Head| ExportedSampler::new(Intermediate::Head(head), TailKind::Hierarchical, &studio, None).unwrap();
    let (coupled, autoregressive) = (Mode::Coupled, Mode::Autoregressive);
    let count = OF_HEADS;
    for (name, exported, count, glossy) in [
        ("head of a checkpoint", trained, count, false),
        (
            "head, 4 layers, 61 wide",
            of_head(head(Condition::Normal, autoregressive, &[9, 30], &[61; 3], [32, 17])),
            count / 16,
            false,
        ),
        ("head, widest, most bins", of_head(head(Condition::Ggx, coupled, &[], &[256], [64; 2])), count / 16, true),
        (
            "head for widths",
            of_head(head(Condition::GgxRoughness, coupled, &[33], &[64; 2], [2, 16])),
            count / 16,
            true,
        ),
        (
            "head over patches",
            of_head(head(Condition::Normal, coupled, &[], &[32], [8, 16])).over_patches(Detail::Leaves),
            count / 16,
            false,
        ),
        (
            "head over fine patches",
            of_head(head(Condition::GgxRoughness, autoregressive, &[24], &[32; 2], [8; 2])).over_patches(Detail::Twigs),
            count / 16,
            true,
        ),
    ] {
        let shader = Shader::new(&flat_exported(&exported).unwrap()).unwrap();
        let native = exported.sampler(&studio, false).unwrap();
        let answers = compare(name, &shader, &*native, count, glossy);
        compare_mixture_weights(name, &*native, &answers, glossy);
    }
}

/// Returns a smooth warp that concentrates points around one, as under a lamp.
fn gathered(cells: usize) -> WarpMap {
    let node = |k: usize| {
        let (u, v) = ((k % cells) as f32 / cells as f32, (k / cells) as f32 / cells as f32);
        let turn = std::f32::consts::TAU;
        let down = if k >= cells * cells { 1.0 } else { v + 0.12 * (turn * v).sin() };
        Vec2::new(u + 0.14 * (turn * u).sin() + 0.9 * v, down)
    };
    let nodes: Vec<Vec2> = (0..cells * (cells + 1)).map(node).collect();
    WarpMap::new(cells, &nodes).unwrap()
}

#[test]
fn shaders_over_other_tails_match_the_native_samplers() {
    let map = Arc::new(Environment::open("sunset").unwrap());
    let (width, height, luminance) = (map.width(), map.height(), map.luminance());
    let tails = [
        ("row-column tail", Tail::of_environment(TailKind::RowColumn, &map)),
        ("flow tail", Tail::flow(gathered(64), width, height, &luminance)),
    ];
    for (name, tail) in tails {
        let tail = Arc::new(tail.unwrap());
        let head = Intermediate::Head(head(Condition::Normal, Mode::Coupled, &[], &[16], [4, 5]));
        let exported = ExportedSampler::of_tail(head, tail, &map, None);
        let shader = Shader::new(&flat_exported(&exported).unwrap()).unwrap();
        let native = exported.sampler(&map, false).unwrap();
        compare(name, &shader, &*native, OF_HEADS / 2, false);
    }
}
