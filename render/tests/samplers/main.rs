//! Every sampler draws what its pdf says, covers the integrand, and estimates the same light as every other.
//!
//! Each property is a function that returns what is wrong, so that the last tests can hold deliberately broken samplers
//! against the very same functions. All seeds are fixed; a pass is a pass on every machine of the same arithmetic.

mod conditioned;
mod faulty;
mod glossy;
mod mixed_tiles;
mod truth;

use std::sync::{Arc, LazyLock};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    bake::{BakedTable, CellGrid, NormalGrid, direct_bake},
    brdf::Lambert,
    color::luminance,
    columns::Arena,
    environment::{Environment, built_in, without_compact_emitters},
    estimator::{Contributions, Estimator, Ris, TwoSampleMis},
    head::{Condition, Head, Linear, Mode},
    image::Image,
    latlong,
    one_point::OnePoint,
    points::Points,
    random::{Purpose, Stream},
    sampler::*,
    statistics::{ChiSquareReport, Moments, SphereChiSquare, TTest, sidak},
    tail::{Tail, TailKind, WarpMap},
    tile::{ShadingPoint, Tile},
};
use rayon::prelude::*;
use truth::{Dense, Quadrature};

/// The chance that any test of a group rejects a right sampler.
const SIGNIFICANCE: f64 = 0.01;

/// A sampler under test.
struct Case {
    name: &'static str,
    sampler: Box<dyn Sampler>,
    /// Whether it may be used alone.
    covers: bool,
    /// Whether it draws through the tail alone, from lit directions only.
    through_tail: bool,
}

/// A light with everything that samples it, and the truth about it.
struct World {
    name: String,
    light: EnvironmentLight,
    cases: Vec<Case>,
    quadrature: Quadrature,
    dense: Dense,
}

/// Maps that differ in what they ask of a sampler, each with one tail; the hardest two with both.
static WORLDS: LazyLock<Vec<World>> = LazyLock::new(|| {
    let made = |name: &str, width: usize, height: usize, value: &dyn Fn(usize, usize) -> f32| {
        let tint = [1.0, 0.8, 0.5];
        let pixels = (0..width * height).map(|k| tint.map(|t| t * value(k % width, k / width))).collect();
        Environment::from_image(name, Image { width, height, pixels }).unwrap()
    };
    use TailKind::{Hierarchical, RowColumn};
    let maps = vec![
        (built_in("overcast").unwrap(), vec![RowColumn]),
        (built_in("window").unwrap(), vec![Hierarchical, RowColumn]),
        (built_in("studio").unwrap(), vec![Hierarchical]),
        (built_in("sunset").unwrap(), vec![Hierarchical, RowColumn]),
        (made("seam texel", 16, 9, &|i, j| f32::from(i == 0 && j == 4)), vec![Hierarchical]),
        (made("black half", 64, 32, &|i, _| f32::from(i < 32)), vec![RowColumn]),
        (made("1x1", 1, 1, &|_, _| 1.0), vec![Hierarchical]),
        (made("odd 37x23", 37, 23, &|i, j| ((i * 7 + j * 3) % 11) as f32), vec![RowColumn]),
    ];
    let worlds: Vec<_> = maps
        .into_iter()
        .flat_map(|(map, kinds)| {
            let map = Arc::new(map);
            kinds.into_iter().map(move |kind| (map.clone(), kind))
        })
        .collect();
    worlds.into_par_iter().map(|(map, kind)| World::new(&map, kind)).collect()
});

impl World {
    fn new(environment: &Arc<Environment>, kind: TailKind) -> Self {
        let light = EnvironmentLight::new(environment.clone(), kind).unwrap();
        let emitter = || EmitterSampler::new(light.clone());
        let compensated = || EmitterSampler::compensated(&light).unwrap();
        let direct = |normals: [usize; 2], cells: [usize; 2]| {
            let normals = NormalGrid::new(normals[0], normals[1]).unwrap();
            direct_bake(light.tail(), normals, CellGrid::new(cells[0], cells[1]).unwrap()).unwrap()
        };
        let mut cases = Vec::new();
        let mut add = |name, sampler: Box<dyn Sampler>, covers, through_tail| {
            cases.push(Case { name, sampler, covers, through_tail });
        };
        add("cosine", Box::new(BrdfSampler), true, false);
        add("emitter", Box::new(emitter()), true, true);
        add("mis", Box::new(OneSampleMis::new(emitter(), BrdfSampler)), true, false);
        add("compensated emitter", Box::new(compensated()), false, false);
        add("mis-comp", Box::new(OneSampleMis::new(compensated(), BrdfSampler)), true, false);
        let mut product = |name, sampler| add(name, sampler, true, true);
        product("oracle", composed(&light, Oracle::new(light.tail())));
        product("direct 16x32 32x32", composed(&light, direct([16, 32], [32, 32])));
        product("direct 16x32 8x8", composed(&light, direct([16, 32], [8, 8])));
        product("direct 2x3 5x12", composed(&light, direct([2, 3], [5, 12])));
        product("filled table", composed(&light, waves()));
        product("coupled, K = 4", composed(&light, random_head(Mode::Coupled, 4, &[])));
        product("autoregressive, K = 4", composed(&light, random_head(Mode::Autoregressive, 4, &[])));
        product("coupled, K = 32, encoder", composed(&light, random_head(Mode::Coupled, 32, &[16, 12])));
        product("autoregressive, K = 32, encoder", composed(&light, random_head(Mode::Autoregressive, 32, &[16, 12])));
        let head = ProductSampler::new(light.clone(), random_head(Mode::Coupled, 4, &[]));
        add("head and cosine", Box::new(OneSampleMis::new(head, BrdfSampler)), true, false);
        // A smooth tail that has nothing to do with the light (and hardly ever draws a sun), and compact emitters where there are any.
        if environment.name() != "sunset" {
            let flow = EnvironmentLight::with_tail(environment.clone(), Arc::new(swirl(environment)));
            add("flow emitter", Box::new(EmitterSampler::new(flow.clone())), true, false);
            let head = ProductSampler::new(flow, random_head(Mode::Coupled, 4, &[]));
            add("flow and head", Box::new(OneSampleMis::new(head, BrdfSampler)), true, false);
        }
        let (width, height, luminance) = (environment.width(), environment.height(), environment.luminance());
        if let Some(rest) = without_compact_emitters(width, height, &luminance) {
            let compact = Arc::new(CompactEmitters::new(environment, &rest).unwrap());
            let tail = Arc::new(Tail::new(kind, width, height, &rest).unwrap());
            let head = || {
                let light = EnvironmentLight::with_tail(environment.clone(), tail.clone());
                ProductSampler::new(light, random_head(Mode::Coupled, 4, &[]))
            };
            add("compact and head", Box::new(WithCompactEmitters::new(compact.clone(), head())), true, false);
            let rest = OneSampleMis::new(head(), BrdfSampler);
            add("compact, head and cosine", Box::new(WithCompactEmitters::new(compact, rest)), true, false);
        }
        let name = format!("{} / {}", environment.name(), kind.name());
        Self { name, cases, quadrature: Quadrature::new(environment), dense: Dense::new(&light), light }
    }

    fn environment(&self) -> &Arc<Environment> {
        self.light.environment()
    }

    /// Normals where samplers go wrong: poles of the map and next to them, its seam, a node of the default table and the
    /// middle between four, the brightest texel on the horizon, and anywhere.
    fn normals(&self) -> Vec<Vec3A> {
        let (width, height) = (self.environment().width(), self.environment().height());
        let values = self.environment().luminance();
        let brightest = (0..values.len()).max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap();
        let (column, row) = ((brightest % width) as f32, (brightest / width) as f32);
        let sun = latlong::direction(Vec2::new((column + 0.5) / width as f32, row / (height - 1) as f32));
        let grid = NormalGrid::new(16, 32).unwrap();
        let mut random = Stream::new(9, Purpose::Test, 0);
        vec![
            Vec3A::Y,
            sun.any_orthonormal_vector(),
            Vec3A::new(0.0, 0.3, -1.0).normalize(),
            random.direction(),
            grid.normal(5 * 32 + 7),
            Vec3A::new(1e-4, -1.0, 3e-5).normalize(),
            (grid.normal(5 * 32 + 7) + grid.normal(6 * 32 + 8)).normalize(),
            -Vec3A::Y,
            Vec3A::new(-2e-3, 1.0, 1e-3).normalize(),
            (sun + 0.05 * sun.any_orthonormal_vector()).normalize(),
            random.direction(),
        ]
    }
}

/// A flow tail that turns rows against each other.
fn swirl(environment: &Environment) -> Tail {
    let node = |k: usize| {
        let y = Vec2::new((k % 32) as f32, (k / 32) as f32) / 32.0;
        let v = y.y + 0.1 * (std::f32::consts::PI * y.y).sin() * (std::f32::consts::TAU * y.x).cos();
        Vec2::new(y.x + 0.6 * y.y, if k / 32 == 32 { 1.0 } else { v.clamp(0.0, 1.0) })
    };
    let nodes: Vec<Vec2> = (0..32 * 33).map(node).collect();
    let map = WarpMap::new(32, &nodes).unwrap();
    Tail::flow(map, environment.width(), environment.height(), &environment.luminance()).unwrap()
}

fn composed<I: IntermediateDensity + 'static>(light: &EnvironmentLight, intermediate: I) -> Box<dyn Sampler> {
    Box::new(ProductSampler::new(light.clone(), intermediate))
}

/// A table that no bake would give: waves, some cells at zero, and the nodes of -Y without any mass.
fn waves() -> BakedTable {
    BakedTable::fill(NormalGrid::new(5, 7).unwrap(), CellGrid::new(9, 13).unwrap(), |normal, masses| {
        for (k, mass) in masses.iter_mut().enumerate() {
            let wave = (0.7 * k as f32 + 3.0 * normal.x + normal.z).sin();
            *mass = if normal.y < -0.999 { 0.0 } else { (wave + 0.9).max(0.0) * (1.1 + normal.y) };
        }
    })
    .unwrap()
}

/// A head with random weights that is conditioned on the normal.
fn random_head(mode: Mode, bins: usize, encoder: &[usize]) -> Head {
    random_head_of(Condition::Normal, mode, bins, encoder, &[])
}

/// A head with random weights, of the size at which logits spread by about one. `encoder` and `selection` are the widths of
/// their layers' outputs.
fn random_head_of(condition: Condition, mode: Mode, bins: usize, encoder: &[usize], selection: &[usize]) -> Head {
    let mut random = Stream::new(5, Purpose::Weights, bins as u64);
    let mut network = |sizes: &[usize]| -> Vec<Linear> {
        let mut layer = |inputs: usize, outputs: usize| {
            let scale = 2.0 * (3.0 / inputs as f32).sqrt();
            let mut values = |count: usize, scale: f32| -> Vec<f32> {
                (0..count).map(|_| scale * (random.uniform() - 0.5)).collect()
            };
            let weight = values(inputs * outputs, scale);
            Linear::new("random", inputs, outputs, &weight, values(outputs, 1.0)).unwrap()
        };
        sizes.windows(2).map(|pair| layer(pair[0], pair[1])).collect()
    };
    let encoder = network(&[&[condition.length()], encoder].concat());
    let seen = condition.length() + encoder.last().map_or(0, Linear::outputs);
    let features = if mode == Mode::Coupled { 2 } else { 0 };
    let networks = [network(&[seen + features, 16, 16, 3 * bins + 1]), network(&[seen + 1, 16, 16, 3 * bins + 1])];
    let selection = network(&[&[seen], selection].concat());
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_selection(selection).unwrap()
}

fn shading_point(normal: Vec3A) -> ShadingPoint {
    let surface = Lambert { albedo: Vec3::ONE }.into();
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, surface }
}

type Verdict = Result<(), String>;

/// Rows of the chi-square test, and sub-cells along a side of its cells.
const ROWS: usize = 25;
const SUBCELLS: usize = 5;
/// A sub-cell's extent in the lat-long square.
const EXTENT: Vec2 = Vec2::new(0.5 / (ROWS * SUBCELLS) as f32, 1.0 / (ROWS * SUBCELLS) as f32);
/// Most points along a side of a sub-cell.
const MOST_POINTS: usize = 16;

/// Uniform points.
fn uniforms(random: &mut Stream, count: usize) -> Vec<Vec2> {
    (0..count).map(|_| random.uniform2()).collect()
}

/// Chi-square on the sphere, and the integral of the pdf, which must be the share of draws that give a direction.
fn draws_follow_pdf(bound: &AtPoint<'_>, dense: Option<&Dense>, probes: usize, tests: usize) -> Verdict {
    let (rows, subcells, samples) = (ROWS, SUBCELLS, 100_000);
    // Jumps of a table in dim places, which get 2 x 2 points, cost the integral up to half a percent.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 8e-3, ..SphereChiSquare::default() };
    let draw = |random: &mut Stream, count: usize| {
        bound.sample_many(&uniforms(random, count)).into_iter().map(|drawn| Some(drawn?.wi)).collect()
    };
    let report = test.run(draw, |w| means_over(bound, dense, w, probes));
    if report.passed() { Ok(()) } else { Err(format!("{report}; {}", worst_cell(&report))) }
}

/// Where observation and expectation differ most.
fn worst_cell(report: &ChiSquareReport) -> String {
    let part = |cell: usize| (report.observed[cell] - report.expected[cell]).powi(2) / report.expected[cell].max(5.0);
    let worst = (0..report.observed.len()).max_by(|&a, &b| part(a).total_cmp(&part(b))).unwrap_or(0);
    let (row, column) = (worst / report.columns, worst % report.columns);
    let (observed, expected) = (report.observed[worst], report.expected[worst]);
    format!("worst at row {row}, column {column}: {observed} drawn, {expected:.1} expected")
}

/// The means of the pdf over the sub-cells around directions.
///
/// `probes x probes` points, and more where they would stand for more than half an expected sample in 1e5 each: the
/// quadrature's error (at edges of lamps and of table cells) must be small against the noise of the counts, or the test
/// would reject right samplers.
fn means_over(bound: &AtPoint<'_>, dense: Option<&Dense>, w: &[Vec3A], probes: usize) -> Vec<f32> {
    let centres: Vec<Vec2> = w.iter().map(|&w| latlong::square(w)).collect();
    let mut means = means_of(bound, &centres, probes);
    // Sub-cells by the number of points along a side that they need: each group is evaluated at once.
    let mut finer: Vec<Vec<usize>> = vec![Vec::new(); MOST_POINTS + 1];
    for (k, (mean, centre)) in means.iter_mut().zip(&centres).enumerate() {
        if let Some(own) = dense.and_then(|dense| dense.mean(bound, w[k])) {
            *mean = own;
            continue;
        }
        let mass = *mean * EXTENT.x * EXTENT.y / latlong::solid_angle_factor(centre.y);
        let side = (mass / 5e-6).sqrt() as usize;
        if side > probes {
            finer[side.min(MOST_POINTS)].push(k);
        }
    }
    for (side, members) in finer.iter().enumerate().filter(|(_, members)| !members.is_empty()) {
        let own: Vec<Vec2> = members.iter().map(|&k| centres[k]).collect();
        for (&k, mean) in members.iter().zip(means_of(bound, &own, side)) {
            means[k] = mean;
        }
    }
    means
}

/// The means of the pdf over sub-cells around centres, by `side x side` points each.
fn means_of(bound: &AtPoint<'_>, centres: &[Vec2], side: usize) -> Vec<f32> {
    let point = |centre: Vec2, k: usize| {
        let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32 - 0.5;
        centre + inside * EXTENT
    };
    let points: Vec<Vec2> =
        centres.iter().flat_map(|&centre| (0..side * side).map(move |k| point(centre, k))).collect();
    let directions: Vec<Vec3A> = points.iter().map(|&x| latlong::direction(x)).collect();
    let pdfs = bound.pdf_many(&directions);
    let mean = |(points, pdfs): (&[Vec2], &[f32])| {
        let weights = points.iter().map(|x| latlong::sin_theta(x.y));
        let sum: f32 = weights.clone().zip(pdfs).map(|(weight, pdf)| weight * pdf).sum();
        sum / weights.sum::<f32>()
    };
    points.chunks_exact(side * side).zip(pdfs.chunks_exact(side * side)).map(mean).collect()
}

/// `pdf(sample) == sample.pdf`, as far as the rounding of the direction allows.
///
/// A direction fixes x to about 1e-7. What that does to a steep pdf is measured by moving x as far. Where the density over
/// Y is constant in cells, a y that is rounded across an edge has the neighbour's: with errors of 2e-6 and at most 256 cells
/// along both axes that befalls a share of 2 x 2 x 256 x 2e-6 = 2e-3 of the samples.
fn pdf_of_samples_agrees(bound: &AtPoint<'_>, samples: usize) -> Verdict {
    let mut random = Stream::new(3, Purpose::Test, 1);
    let drawn: Vec<Direction> = bound.sample_many(&uniforms(&mut random, samples)).into_iter().flatten().collect();
    let directions: Vec<Vec3A> = drawn.iter().map(|sample| sample.wi).collect();
    let error = |(sample, pdf): (&Direction, f32)| (pdf / sample.pdf - 1.0).abs();
    let errors: Vec<f32> = drawn.iter().zip(bound.pdf_many(&directions)).map(error).collect();
    let suspects: Vec<usize> = (0..drawn.len()).filter(|&k| errors[k].is_nan() || errors[k] > 1e-3).collect();
    let moved = |k: usize, axis: Vec2| {
        let x = latlong::square(drawn[k].wi);
        latlong::direction((x + 1.2e-7 * axis).clamp(Vec2::ZERO, Vec2::ONE))
    };
    let axes = [Vec2::X, -Vec2::X, Vec2::Y, -Vec2::Y];
    let around: Vec<Vec3A> = suspects.iter().flat_map(|&k| axes.map(|axis| moved(k, axis))).collect();
    let (mut wrong, mut example) = (0_usize, String::new());
    for (&k, pdfs) in suspects.iter().zip(bound.pdf_many(&around).chunks_exact(axes.len())) {
        let own = errors[k];
        let moved = pdfs.iter().map(|&pdf| error((&drawn[k], pdf)));
        let (least, most) = moved.fold((own, own), |(a, b), e| (a.min(e), b.max(e)));
        if own.is_nan() || own > 1e-3 + 2.0 * (most - least) {
            wrong += 1;
            example = format!("{} at {}, off by {own}", drawn[k].pdf, latlong::square(drawn[k].wi));
        }
    }
    let allowed = 2e-3 * drawn.len() as f64;
    if wrong as f64 <= allowed {
        Ok(())
    } else {
        Err(format!("{wrong} of {} pdfs differ, e.g. {example}", drawn.len()))
    }
}

/// Luminance of light x BRDF x cosine.
fn integrands(point: &OnePoint, environment: &Environment, wi: &[Vec3A]) -> Vec<f32> {
    let radiances = point.map(wi, |wi, out: [_; 3]| environment.radiances(wi, out));
    let both = point.brdf_cosines(wi).into_iter().zip(radiances);
    both.map(|(reflected, radiance)| luminance(reflected * Vec3A::from_array(radiance))).collect()
}

/// The pdf is positive wherever the integrand is: at uniform directions, and at directions that others draw.
fn pdf_covers(bound: &AtPoint<'_>, world: &World) -> Verdict {
    const EACH: usize = 3000;
    let point = bound.point();
    let emitter = EmitterSampler::new(world.light.clone());
    let emitter = AtPoint::new(&emitter, &point.tile().point(0));
    let mut random = Stream::new(4, Purpose::Test, 2);
    let mut wi: Vec<Vec3A> = (0..EACH).map(|_| random.direction()).collect();
    wi.extend(point.sample_brdf(&uniforms(&mut random, EACH)).into_iter().flatten().map(|(wi, _)| wi));
    wi.extend(emitter.sample_many(&uniforms(&mut random, EACH)).into_iter().flatten().map(|drawn| drawn.wi));
    let values = integrands(point, world.environment(), &wi);
    for ((wi, value), pdf) in wi.iter().zip(values).zip(bound.pdf_many(&wi)) {
        if value > 0.0 && (pdf.is_nan() || pdf <= 0.0) {
            return Err(format!("pdf {pdf} where the integrand is {value}: {wi}"));
        }
    }
    Ok(())
}

/// The mean of estimates is the truth, by a t-test.
fn mean_is(truth: f64, estimates: &[f64], tests: usize) -> Verdict {
    let mut moments = Moments::of(estimates).unwrap();
    let mean = moments.mean;
    // Single precision in tables and pdfs, and the quadrature: one part in 5000 proves nothing.
    moments.mean -= (mean - truth).clamp(-2e-4 * truth, 2e-4 * truth);
    let exact = Moments { count: 2, mean: truth, variance: 0.0 };
    let test = TTest::welch(&moments, &exact);
    let (p, t) = (test.p_value, test.t);
    if p >= sidak(SIGNIFICANCE, tests) {
        Ok(())
    } else {
        Err(format!("mean {mean}, truth {truth}, t = {t:.2}, p = {p:.1e}"))
    }
}

/// Estimates with a sampler alone: the integrand over the pdf, 0 where there is no sample.
fn estimates_of_sampler(bound: &AtPoint<'_>, world: &World, stream: u64, samples: usize) -> Vec<f64> {
    let mut random = Stream::new(6, Purpose::Test, stream);
    let drawn: Vec<Direction> = bound.sample_many(&uniforms(&mut random, samples)).into_iter().flatten().collect();
    let wi: Vec<Vec3A> = drawn.iter().map(|sample| sample.wi).collect();
    let values = integrands(bound.point(), world.environment(), &wi);
    let mut estimates: Vec<f64> =
        drawn.iter().zip(values).map(|(sample, value)| f64::from(value / sample.pdf)).collect();
    estimates.resize(samples, 0.0);
    estimates
}

fn mean_of_sampler(bound: &AtPoint<'_>, world: &World, truth: f64, samples: usize, tests: usize) -> Verdict {
    mean_is(truth, &estimates_of_sampler(bound, world, 3, samples), tests)
}

/// Estimates of an estimator in tiles of copies of a point, without shadows: the sum of the contributions of each copy.
fn estimates(estimator: &dyn Estimator, at: &ShadingPoint, samples: usize, seed: u64) -> Vec<f64> {
    /// Copies in a tile: not a whole number of strips.
    const COPIES: usize = 250;
    let (tile, arena) = (Tile::of(&[*at; COPIES]), Arena::default());
    let mut contributions = Contributions::default();
    let mut estimates = Vec::with_capacity(samples + COPIES);
    for sample in 0..samples.div_ceil(COPIES) {
        contributions.clear();
        estimator.propose(&tile.rows(), &Points::new(seed, sample as u32), &mut contributions, &arena);
        let mut sums = [0.0; COPIES];
        for (&place, &radiance) in contributions.places().iter().zip(contributions.radiance()) {
            sums[usize::from(place)] += f64::from(luminance(radiance));
        }
        estimates.extend(sums);
    }
    estimates.truncate(samples);
    estimates
}

/// RIS of a sampler and BRDF sampling.
fn ris(sampler: impl Sampler + 'static, candidates: u32, world: &World) -> Box<dyn Estimator> {
    let (first, second) = (Covering::new(sampler).unwrap(), Covering::new(BrdfSampler).unwrap());
    Box::new(Ris::new(first, second, candidates, world.environment().clone()).unwrap())
}

/// Two-sample MIS of a sampler and BRDF sampling.
fn mis2(sampler: impl Sampler + 'static, world: &World) -> Box<dyn Estimator> {
    Box::new(TwoSampleMis::new(sampler, BrdfSampler, world.environment().clone()).unwrap())
}

/// Runs a check for every sampler of every world, over `count` normals each: which ones changes from case to case, so that
/// every kind of sampler meets every normal.
fn for_all(count: usize, check: impl Fn(&World, &Case, &ShadingPoint, usize) -> Verdict + Sync) {
    let tasks: Vec<_> = WORLDS
        .iter()
        .enumerate()
        .flat_map(|(w, world)| {
            let normals = world.normals();
            world.cases.iter().enumerate().flat_map(move |(c, case)| {
                let normals = normals.clone();
                // 4 and 3 have no factor in common with 11 normals: all of them come up.
                (0..count).map(move |k| (world, case, normals[(4 * w + 3 * c + 2 * k) % normals.len()]))
            })
        })
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, case, normal)| {
            let verdict = check(world, case, &shading_point(*normal), tasks.len());
            verdict.err().map(|reason| format!("{} / {}, normal {normal}: {reason}", world.name, case.name))
        })
        .collect();
    assert!(failures.is_empty(), "{} of {}:\n{}", failures.len(), tasks.len(), failures.join("\n"));
}

#[test]
fn directions_are_drawn_with_the_claimed_density() {
    for_all(1, |world, case, at, tests| {
        // The rows of the map that cross a sun are sheared by the row-column tail: within half a degree of elevation, an edge
        // of a cell of Y moves by a quarter of a turn in azimuth, and a dim place gets no points for its mass. The p-value of
        // the oracle, whose cells are the narrowest, is an ordinary one from 12 points on (1e-24 with 2, 6e-5 with 4, 0.3 with
        // 12, 0.4 with 16).
        let probes = match (&*world.name, case.name) {
            ("sunset / row-column", "oracle") => 12,
            ("sunset / row-column", _) => 6,
            _ => 2,
        };
        draws_follow_pdf(&AtPoint::new(&*case.sampler, at), case.through_tail.then_some(&world.dense), probes, tests)
    });
}

#[test]
fn the_pdf_of_a_sample_is_the_sample_s_pdf() {
    for_all(2, |_, case, at, _| pdf_of_samples_agrees(&AtPoint::new(&*case.sampler, at), 5_000));
}

#[test]
fn whatever_reflects_light_can_be_drawn() {
    for_all(3, |world, case, at, _| {
        let says = case.sampler.coverage() == Coverage::Everything;
        if says != case.covers {
            return Err(format!("it says that it covers {:?}", case.sampler.coverage()));
        }
        if case.covers { pdf_covers(&AtPoint::new(&*case.sampler, at), world) } else { Ok(()) }
    });
}

#[test]
fn all_samplers_estimate_the_same_light() {
    for_all(3, |world, case, at, tests| {
        // Half of the light in 1e-5 of the sphere: the mean of cosine sampling is far from normally distributed.
        let hopeless = case.name == "cosine" && world.name.starts_with("sunset");
        if !case.covers || hopeless {
            return Ok(());
        }
        let bound = AtPoint::new(&*case.sampler, at);
        mean_of_sampler(&bound, world, world.quadrature.reflected(at.ns), 30_000, tests)
    });
}

#[test]
fn resampling_and_two_sample_mis_estimate_it_too() {
    let tasks: Vec<_> =
        WORLDS.iter().flat_map(|world| (0..11).step_by(4).map(move |k| (world, world.normals()[k]))).collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .flat_map_iter(|(world, normal)| {
            let emitter = || EmitterSampler::new(world.light.clone());
            let grid = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(8, 8).unwrap());
            let table =
                ProductSampler::new(world.light.clone(), direct_bake(world.light.tail(), grid.0, grid.1).unwrap());
            let estimators: Vec<(&str, Box<dyn Estimator>)> = vec![
                ("ris:1", ris(emitter(), 1, world)),
                ("ris:4", ris(emitter(), 4, world)),
                ("ris:16", ris(emitter(), 16, world)),
                ("ris:5 of a table", ris(table.clone(), 5, world)),
                ("mis2", mis2(emitter(), world)),
                ("mis2 of a table", mis2(table, world)),
            ];
            let at = shading_point(*normal);
            let truth = world.quadrature.reflected(*normal);
            let tests = 6 * tasks.len();
            estimators.into_iter().filter_map(move |(name, estimator)| {
                let verdict = mean_is(truth, &estimates(&*estimator, &at, 20_000, 8), tests);
                verdict.err().map(|reason| format!("{} / {name}, normal {}: {reason}", world.name, at.ns))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}
