//! Every sampler draws what its pdf says, covers the integrand, and estimates the same light as every other.
//!
//! Each property is a function that returns what is wrong, so that the last tests can hold deliberately broken samplers
//! against the very same functions. All seeds are fixed; a pass is a pass on every machine of the same arithmetic.

mod batches;
mod conditioned;
mod glossy;

use std::{
    collections::HashMap,
    rc::Rc,
    sync::{Arc, LazyLock},
};

use glam::{Quat, Vec2, Vec3A};
use headtail_render::{
    bake::{BakedTable, CellGrid, NormalGrid, direct_bake},
    brdf::{Brdf, Lambert},
    color::luminance,
    environment::{Environment, built_in, without_compact_emitters},
    head::{Condition, Head, Linear, Mode},
    image::Image,
    integrator::{DirectEstimator, ResampledEstimator, TwoSampleMis, Unshadowed},
    latlong,
    random::{Purpose, Stream},
    sampler::*,
    statistics::{ChiSquareReport, Moments, SphereChiSquare, TTest, sidak},
    tail::{Tail, TailKind, WarpMap},
};
use rayon::prelude::*;

/// The chance that any test of a group rejects a right sampler.
const SIGNIFICANCE: f64 = 0.01;

/// A sampler prepared for one shading point, its type forgotten.
struct Bound<'a> {
    sample: Box<dyn Fn(Vec2) -> Option<DirectionSample> + 'a>,
    pdf: Box<dyn Fn(Vec3A) -> f32 + 'a>,
}

/// Any [`DirectionSampler`]; that trait has an associated type and cannot be a trait object.
trait Subject: Send + Sync {
    fn bind<'a>(&'a self, at: &'a ShadingPoint) -> Bound<'a>;
}

impl<S: DirectionSampler> Subject for S {
    fn bind<'a>(&'a self, at: &'a ShadingPoint) -> Bound<'a> {
        let prepared = Rc::new(self.prepare(at));
        let same = prepared.clone();
        Bound {
            sample: Box::new(move |u| self.sample(&prepared, at, u)),
            pdf: Box::new(move |wi| self.pdf(&same, at, wi)),
        }
    }
}

/// A sampler under test.
struct Case {
    name: &'static str,
    subject: Box<dyn Subject>,
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
        let brdf = || BrdfSampler::new(environment.clone());
        let emitter = || EmitterSampler::new(light.clone());
        let compensated = || CompensatedEmitterSampler::new(&light).unwrap();
        let direct = |normals: [usize; 2], cells: [usize; 2]| {
            let normals = NormalGrid::new(normals[0], normals[1]).unwrap();
            direct_bake(light.tail(), normals, CellGrid::new(cells[0], cells[1]).unwrap()).unwrap()
        };
        let mut cases = Vec::new();
        let mut add = |name, subject: Box<dyn Subject>, covers, through_tail| {
            cases.push(Case { name, subject, covers, through_tail });
        };
        add("cosine", Box::new(brdf()), true, false);
        add("emitter", Box::new(emitter()), true, true);
        add("mis", Box::new(OneSampleMis::new(emitter(), brdf())), true, false);
        add("compensated emitter", Box::new(compensated()), false, false);
        add("mis-comp", Box::new(OneSampleMis::new(compensated(), brdf())), true, false);
        let mut product = |name, subject: Box<dyn Subject>| add(name, subject, true, true);
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
        add("head and cosine", Box::new(OneSampleMis::new(head, brdf())), true, false);
        // A smooth tail that has nothing to do with the light (and hardly ever draws a sun), and compact emitters where there are any.
        if environment.name() != "sunset" {
            let flow = EnvironmentLight::with_tail(environment.clone(), Arc::new(swirl(environment)));
            add("flow emitter", Box::new(EmitterSampler::new(flow.clone())), true, false);
            let head = ProductSampler::new(flow, random_head(Mode::Coupled, 4, &[]));
            add("flow and head", Box::new(OneSampleMis::new(head, brdf())), true, false);
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
            let rest = OneSampleMis::new(head(), brdf());
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

fn composed<I: IntermediateDensity + 'static>(light: &EnvironmentLight, intermediate: I) -> Box<dyn Subject> {
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
    let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, brdf }
}

/// The truth without any sampler: points of every bilinear cell of a map, with luminance times solid angle.
struct Quadrature(Vec<(Vec3A, f32)>);

impl Quadrature {
    fn new(map: &Environment) -> Self {
        let (columns, rows) = (map.width(), map.height() - 1);
        let cells = columns * rows;
        let flux = |x: Vec2, area: f32| {
            luminance(map.radiance_at(x))
                * (area * 2.0 * std::f32::consts::PI.powi(2) * (std::f32::consts::PI * x.y).sin())
        };
        let place = |cell: usize, inside: Vec2| {
            let u = ((cell % columns) as f32 + 0.5 + inside.x) / columns as f32;
            Vec2::new(u.fract(), ((cell / columns) as f32 + inside.y) / rows as f32)
        };
        let points = |cell: usize, side: usize| {
            (0..side * side).map(move |k| {
                let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
                let x = place(cell, inside);
                (latlong::direction(x), flux(x, 1.0 / (cells * side * side) as f32))
            })
        };
        let coarse: Vec<f32> = (0..cells).map(|cell| points(cell, 3).map(|point| point.1).sum()).collect();
        let total: f32 = coarse.iter().sum();
        // Within a cell all is smooth but for the horizon: its kink costs h^2 / 4 of the share of the cells it runs through,
        // 1e-6 with three points across small cells, 2e-4 with 32 across a sun.
        let side = ((1e6 / cells as f32).sqrt() as usize).clamp(3, 1024);
        let side_of = |cell: usize| if coarse[cell] > 1e-3 * total { side.max(32) } else { side };
        Self((0..cells).flat_map(|cell| points(cell, side_of(cell))).filter(|point| point.1 > 0.0).collect())
    }

    /// Luminance reflected by a white Lambert surface without shadows.
    fn reflected(&self, normal: Vec3A) -> f64 {
        let cosine = |(wi, flux): &(Vec3A, f32)| f64::from(normal.dot(*wi).max(0.0) * flux);
        self.0.iter().map(cosine).sum::<f64>() / std::f64::consts::PI
    }
}

impl Quadrature {
    /// Luminance reflected by any surface without shadows.
    fn reflected_at(&self, at: &ShadingPoint) -> f64 {
        self.0.iter().map(|&(wi, flux)| f64::from(luminance(at.brdf_cosine(wi)) * flux)).sum()
    }
}

type Verdict = Result<(), String>;

/// Rows of the chi-square test, and sub-cells along a side of its cells.
const ROWS: usize = 25;
const SUBCELLS: usize = 5;
/// A sub-cell's extent in the lat-long square.
const EXTENT: Vec2 = Vec2::new(0.5 / (ROWS * SUBCELLS) as f32, 1.0 / (ROWS * SUBCELLS) as f32);
/// Most points along a side of a sub-cell.
const MOST_POINTS: usize = 16;

/// Chi-square on the sphere, and the integral of the pdf, which must be the share of draws that give a direction.
fn draws_follow_pdf(bound: &Bound<'_>, dense: Option<&Dense>, probes: usize, tests: usize) -> Verdict {
    let (rows, subcells, samples) = (ROWS, SUBCELLS, 100_000);
    // Jumps of a table in dim places, which get 2 x 2 points, cost the integral up to half a percent.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 8e-3, ..SphereChiSquare::default() };
    let draw = |random: &mut Stream| (bound.sample)(random.uniform2()).map(|s| s.wi);
    let pdf = |w| dense.and_then(|dense| dense.mean(bound, w)).unwrap_or_else(|| mean_over(bound, w, probes));
    let report = test.run(draw, pdf);
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

/// The mean of the pdf over the sub-cell around a direction.
///
/// `probes x probes` points, and more where they would stand for more than half an expected sample in 1e5 each: the quadrature's error (at
/// edges of lamps and of table cells) must be small against the noise of the counts, or the test would reject right samplers.
fn mean_over(bound: &Bound<'_>, w: Vec3A, probes: usize) -> f32 {
    let centre = latlong::square(w);
    let mean = |side: usize| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..side * side {
            let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32 - 0.5;
            let x = centre + inside * EXTENT;
            let weight = latlong::sin_theta(x.y);
            sum += weight * (bound.pdf)(latlong::direction(x));
            weights += weight;
        }
        sum / weights
    };
    let coarse = mean(probes);
    let mass = coarse * EXTENT.x * EXTENT.y / latlong::solid_angle_factor(centre.y);
    let side = (mass / 5e-6).sqrt() as usize;
    if side <= probes { coarse } else { mean(side.min(MOST_POINTS)) }
}

/// The sub-cells that hold so much of the light that points of Y, carried over by the tail, resolve them better than
/// [`mean_over`]: inside a sun, a density over Y can have any detail, squeezed into a tenth of a degree.
///
/// For samplers that draw through the tail. That the tail itself is right is seen with the others.
struct Dense(HashMap<usize, Vec<(Vec3A, f32)>>);

impl Dense {
    fn new(light: &EnvironmentLight) -> Self {
        const SIDE: usize = 512;
        let mut random = Stream::new(2, Purpose::Test, 6);
        let mut points: HashMap<usize, Vec<(Vec3A, f32)>> = HashMap::new();
        for k in 0..SIDE * SIDE {
            let y = (Vec2::new((k % SIDE) as f32, (k / SIDE) as f32) + random.uniform2()) / SIDE as f32;
            let (_, wi, emitter) = light.tail().forward_direction(y);
            if emitter > 0.0 && emitter.is_finite() {
                let weight = 1.0 / (emitter * (SIDE * SIDE) as f32);
                points.entry(Self::index(wi)).or_default().push((wi, weight));
            }
        }
        points.retain(|_, points| points.len() > MOST_POINTS * MOST_POINTS);
        Self(points)
    }

    fn index(w: Vec3A) -> usize {
        let (x, rows) = (latlong::square(w), ROWS * SUBCELLS);
        let row = ((x.y * rows as f32) as usize).min(rows - 1);
        row * 2 * rows + ((x.x * (2 * rows) as f32) as usize).min(2 * rows - 1)
    }

    /// The mean of the pdf over the sub-cell of a direction, if it is one of these.
    fn mean(&self, bound: &Bound<'_>, w: Vec3A) -> Option<f32> {
        let index = Self::index(w);
        let points = self.0.get(&index)?;
        let theta = |row: usize| std::f64::consts::PI * row as f64 / (ROWS * SUBCELLS) as f64;
        let row = index / (2 * ROWS * SUBCELLS);
        let solid_angle = (theta(row).cos() - theta(row + 1).cos()) * std::f64::consts::PI / (ROWS * SUBCELLS) as f64;
        let mass: f64 = points.iter().map(|&(wi, weight)| f64::from((bound.pdf)(wi) * weight)).sum();
        Some((mass / solid_angle) as f32)
    }
}

/// `pdf(sample) == sample.pdf`, as far as the rounding of the direction allows.
///
/// A direction fixes x to about 1e-7. What that does to a steep pdf is measured by moving x as far. Where the density over
/// Y is constant in cells, a y that is rounded across an edge has the neighbour's: with errors of 2e-6 and at most 256 cells
/// along both axes that befalls a share of 2 x 2 x 256 x 2e-6 = 2e-3 of the samples.
fn pdf_of_samples_agrees(bound: &Bound<'_>, samples: usize) -> Verdict {
    let mut random = Stream::new(3, Purpose::Test, 1);
    let (mut drawn, mut wrong, mut example) = (0_usize, 0_usize, String::new());
    for _ in 0..samples {
        let Some(sample) = (bound.sample)(random.uniform2()) else { continue };
        drawn += 1;
        let error = |wi: Vec3A| ((bound.pdf)(wi) / sample.pdf - 1.0).abs();
        let own = error(sample.wi);
        if own <= 1e-3 {
            continue;
        }
        let x = latlong::square(sample.wi);
        let moved = [Vec2::X, -Vec2::X, Vec2::Y, -Vec2::Y]
            .map(|axis| error(latlong::direction((x + 1.2e-7 * axis).clamp(Vec2::ZERO, Vec2::ONE))));
        let (least, most) = moved.into_iter().fold((own, own), |(a, b), e| (a.min(e), b.max(e)));
        if own.is_nan() || own > 1e-3 + 2.0 * (most - least) {
            wrong += 1;
            example = format!("{} at {x}, {} again", sample.pdf, (bound.pdf)(sample.wi));
        }
    }
    let allowed = 2e-3 * drawn as f64;
    if wrong as f64 <= allowed { Ok(()) } else { Err(format!("{wrong} of {drawn} pdfs differ, e.g. {example}")) }
}

/// The pdf is positive wherever the integrand is: at uniform directions, and at directions that others draw.
fn pdf_covers(bound: &Bound<'_>, at: &ShadingPoint, world: &World) -> Verdict {
    let (cosine, emitter) = (BrdfSampler::new(world.environment().clone()), EmitterSampler::new(world.light.clone()));
    let mut random = Stream::new(4, Purpose::Test, 2);
    for _ in 0..3000 {
        let mut drawn = vec![random.direction()];
        drawn.extend(cosine.sample(&(), at, random.uniform2()).map(|s| s.wi));
        drawn.extend(emitter.sample(&(), at, random.uniform2()).map(|s| s.wi));
        for wi in drawn {
            let value = luminance(at.brdf_cosine(wi) * world.environment().radiance(wi));
            let pdf = (bound.pdf)(wi);
            if value > 0.0 && (pdf.is_nan() || pdf <= 0.0) {
                return Err(format!("pdf {pdf} where the integrand is {value}: {wi}"));
            }
        }
    }
    Ok(())
}

/// The mean of `samples` estimates is the truth, by a t-test.
fn mean_is(truth: f64, samples: usize, mut estimate: impl FnMut() -> f64, tests: usize) -> Verdict {
    let values: Vec<f64> = (0..samples).map(|_| estimate()).collect();
    let mut moments = Moments::of(&values).unwrap();
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

fn mean_of_sampler(bound: &Bound<'_>, at: &ShadingPoint, truth: f64, samples: usize, tests: usize) -> Verdict {
    let mut random = Stream::new(6, Purpose::Test, 3);
    let estimate = || {
        let sample = (bound.sample)(random.uniform2());
        sample.map_or(0.0, |s| f64::from(luminance(at.brdf_cosine(s.wi) * s.radiance / s.pdf)))
    };
    mean_is(truth, samples, estimate, tests)
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
        draws_follow_pdf(&case.subject.bind(at), case.through_tail.then_some(&world.dense), probes, tests)
    });
}

#[test]
fn the_pdf_of_a_sample_is_the_sample_s_pdf() {
    for_all(2, |_, case, at, _| pdf_of_samples_agrees(&case.subject.bind(at), 5_000));
}

#[test]
fn whatever_reflects_light_can_be_drawn() {
    for_all(3, |world, case, at, _| if case.covers { pdf_covers(&case.subject.bind(at), at, world) } else { Ok(()) });
}

#[test]
fn all_samplers_estimate_the_same_light() {
    for_all(3, |world, case, at, tests| {
        // Half of the light in 1e-5 of the sphere: the mean of cosine sampling is far from normally distributed.
        let hopeless = case.name == "cosine" && world.name.starts_with("sunset");
        if !case.covers || hopeless {
            return Ok(());
        }
        mean_of_sampler(&case.subject.bind(at), at, world.quadrature.reflected(at.ns), 30_000, tests)
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
            let brdf = || BrdfSampler::new(world.environment().clone());
            let ris = |count| -> Box<dyn DirectEstimator> {
                Box::new(ResampledEstimator::new(Resampled::new(emitter(), brdf(), count).unwrap()))
            };
            let grid = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(8, 8).unwrap());
            let table =
                ProductSampler::new(world.light.clone(), direct_bake(world.light.tail(), grid.0, grid.1).unwrap());
            let of_table = ResampledEstimator::new(Resampled::new(table.clone(), brdf(), 5).unwrap());
            let estimators: Vec<(&str, Box<dyn DirectEstimator>)> = vec![
                ("ris:1", ris(1)),
                ("ris:4", ris(4)),
                ("ris:16", ris(16)),
                ("ris:5 of a table", Box::new(of_table)),
                ("mis2", Box::new(TwoSampleMis::new(emitter(), brdf()))),
                ("mis2 of a table", Box::new(TwoSampleMis::new(table, brdf()))),
            ];
            let at = shading_point(*normal);
            let truth = world.quadrature.reflected(*normal);
            let tests = 6 * tasks.len();
            estimators.into_iter().filter_map(move |(name, estimator)| {
                let mut random = Stream::new(8, Purpose::Test, 4);
                let one = || f64::from(luminance(estimator.estimate(&at, &Unshadowed, &mut random).radiance));
                let verdict = mean_is(truth, 20_000, one, tests);
                verdict.err().map(|reason| format!("{} / {name}, normal {}: {reason}", world.name, at.ns))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}

/// A right sampler with a fault.
struct Faulty<S> {
    sampler: S,
    fault: Fault,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Sample and pdf both claim 2 % more than there is.
    ClaimsMore,
    /// Only the pdf function does: MIS weights would be wrong.
    PdfClaimsMore,
    /// Directions within 20 degrees of the zenith are never drawn, and their pdf says so.
    LeavesOut,
    /// Draws with the table of a normal 6 degrees away, as a bake does that draws from the nearest node and claims the
    /// interpolated pdf.
    DrawsFromNeighbour,
}

impl<S: DirectionSampler> DirectionSampler for Faulty<S> {
    type Prepared = [S::Prepared; 2];

    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared {
        let turned = Quat::from_rotation_x(0.105) * at.ns;
        [self.sampler.prepare(at), self.sampler.prepare(&ShadingPoint { ns: turned, ..*at })]
    }

    fn sample(&self, [own, other]: &Self::Prepared, at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        let mut sample =
            self.sampler.sample(if self.fault == Fault::DrawsFromNeighbour { other } else { own }, at, u)?;
        match self.fault {
            Fault::ClaimsMore => sample.pdf *= 1.02,
            Fault::DrawsFromNeighbour => sample.pdf = self.sampler.pdf(own, at, sample.wi),
            Fault::LeavesOut if sample.wi.y > 0.94 => return None,
            _ => {}
        }
        Some(sample)
    }

    fn pdf(&self, [own, _]: &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32 {
        let pdf = self.sampler.pdf(own, at, wi);
        match self.fault {
            Fault::ClaimsMore | Fault::PdfClaimsMore => 1.02 * pdf,
            Fault::LeavesOut if wi.y > 0.94 => 0.0,
            _ => pdf,
        }
    }
}

#[test]
fn broken_samplers_are_found_out() {
    let world = WORLDS.iter().find(|world| world.name.starts_with("overcast")).unwrap();
    let at = shading_point(Vec3A::new(0.4, 0.8, -0.3).normalize());
    let table =
        direct_bake(world.light.tail(), NormalGrid::new(16, 32).unwrap(), CellGrid::new(32, 32).unwrap()).unwrap();
    let truth = world.quadrature.reflected(at.ns);
    // Each fault with the checks that must find it: 0 chi-square and mass, 1 pdf of samples, 2 coverage, 3 mean.
    let expected: [(Fault, &[usize]); 5] = [
        (Fault::None, &[]),
        (Fault::ClaimsMore, &[0, 3]),
        (Fault::PdfClaimsMore, &[0, 1]),
        (Fault::LeavesOut, &[2, 3]),
        (Fault::DrawsFromNeighbour, &[0]),
    ];
    for (fault, finders) in expected {
        let sampler = Faulty { sampler: ProductSampler::new(world.light.clone(), table.clone()), fault };
        let bound = sampler.bind(&at);
        let verdicts = [
            draws_follow_pdf(&bound, None, 2, 150),
            pdf_of_samples_agrees(&bound, 10_000),
            pdf_covers(&bound, &at, world),
            mean_of_sampler(&bound, &at, truth, 50_000, 450),
        ];
        assert!(finders.iter().all(|&check| verdicts[check].is_err()), "{fault:?} was not found: {verdicts:?}");
        assert!(fault != Fault::None || verdicts.iter().all(Verdict::is_ok), "{verdicts:?}");
    }
}
