//! Lights that are difficult for samplers in different ways, and all samplers of each.

use std::sync::{Arc, LazyLock};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    bake::{BakedTable, CellGrid, NormalGrid, direct_bake},
    brdf::Lambert,
    columns::Arena,
    environment::{Environment, built_in},
    head::{Condition, Head, Linear, Mode},
    image::Image,
    latlong,
    patches::{Detail, PatchSampler},
    portals::{Portal, PortalSampler},
    random::{Purpose, Stream},
    sampler::*,
    simd::Lanes,
    tail::{Tail, TailKind, WarpMap},
    tile::{Rows, ShadingPoint},
    visibility::{PATCHES, Weighting, Weights},
};
use rayon::prelude::*;

use super::{
    layers::random_layers,
    truth::{Dense, Quadrature},
};

/// A sampler under test.
pub struct Case {
    pub name: &'static str,
    pub sampler: Box<dyn Sampler>,
    /// Whether the sampler may be used alone.
    pub covers: bool,
    /// Whether the sampler draws only through the tail, from lit directions.
    pub through_tail: bool,
}

/// Patches with three kinds of weights, as learned visibility may give, which alternate between points.
pub struct Weighted {
    patches: PatchSampler,
    weights: Uneven,
}

impl Weighted {
    pub fn new(patches: PatchSampler) -> Self {
        Self { patches, weights: Uneven::new() }
    }
}

struct Uneven([Weights; 3]);

impl Uneven {
    fn new() -> Self {
        let of = |salt: usize| {
            let weight =
                move |patch: usize| if (patch * 7 + salt) % 5 < 2 { 0.02 } else { ((patch * salt) % 10) as f32 / 10.0 };
            Weights::new(weight, &[1.0; PATCHES])
        };
        Self([of(3), of(11), of(1)])
    }
}

impl Weighting for Uneven {
    const UNIT: f32 = Weights::UNIT;

    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        for (strip, out) in out.iter_mut().enumerate() {
            // By the point alone, so that results do not depend on the tile.
            *out = at.normals(strip)[0].map(|x| f32::from_bits(((x.abs() * 1e4) as u32) % 3));
        }
    }

    fn at(&self, index: f32) -> Option<&Weights> {
        self.0.get(index.to_bits() as usize)
    }
}

impl Sampler for Weighted {
    fn columns(&self) -> usize {
        self.patches.weighted(&self.weights).columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.patches.weighted(&self.weights).prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        self.patches.weighted(&self.weights).sample(at, state, u, out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.patches.weighted(&self.weights).pdf(at, state, wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        self.patches.weighted(&self.weights).coverage()
    }
}

/// A light with all of its samplers and its reference values.
pub struct World {
    pub name: String,
    pub light: EnvironmentLight,
    pub cases: Vec<Case>,
    pub quadrature: Quadrature,
    pub dense: Dense,
}

/// Maps that are difficult in different ways, each with one tail; the hardest two with both.
pub static WORLDS: LazyLock<Vec<World>> = LazyLock::new(|| {
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
        let compensated = || EmitterSampler::compensated(environment, kind).unwrap();
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
        if kind == TailKind::Hierarchical {
            let patches = |detail| PatchSampler::new(light.clone(), detail).unwrap();
            let over = |detail, head| PatchSampler::with_head(light.clone(), detail, head).unwrap();
            add("patches", Box::new(patches(Detail::Leaves)), true, true);
            add("patches:fine", Box::new(patches(Detail::Twigs)), true, true);
            let weighted = Weighted::new(patches(Detail::Leaves));
            add("weighted patches", Box::new(weighted), true, true);
            let head = || random_head(Mode::Coupled, 4, &[16, 12]);
            add("head over patches", Box::new(over(Detail::Leaves, head())), true, true);
            let weighted = Weighted::new(over(Detail::Twigs, head()));
            add("head over weighted patches", Box::new(weighted), true, true);
            let selecting = random_head_of(Condition::GgxRoughness, Mode::Autoregressive, 8, &[], &[16, 1]);
            let over = OneSampleMis::new(over(Detail::Leaves, selecting), BrdfSampler);
            add("head over patches, and cosine", Box::new(over), true, false);
            let portals = || PortalSampler::new(&box_of_portals(), environment);
            add("portals", Box::new(portals()), false, false);
            add("portals and cosine", Box::new(OneSampleMis::new(portals(), BrdfSampler)), true, false);
            let both = || PortalSampler::new(&box_of_portals(), environment).beside_emitter(light.clone());
            add("portals and emitter", Box::new(both()), true, false);
            add("portals, emitter and cosine", Box::new(OneSampleMis::new(both(), BrdfSampler)), true, false);
            add("patches and cosine", Box::new(OneSampleMis::new(patches(Detail::Leaves), BrdfSampler)), true, false);
        }
        // A smooth tail that is unrelated to the light (and rarely draws a sun).
        if environment.name() != "sunset" {
            let flow = EnvironmentLight::with_tail(environment.clone(), Arc::new(swirl(environment)));
            add("flow emitter", Box::new(EmitterSampler::new(flow.clone())), true, false);
            let head = ProductSampler::new(flow, random_head(Mode::Coupled, 4, &[]));
            add("flow and head", Box::new(OneSampleMis::new(head, BrdfSampler)), true, false);
        }
        let name = format!("{} / {}", environment.name(), kind.name());
        Self { name, cases, quadrature: Quadrature::new(environment), dense: Dense::new(&light), light }
    }

    pub fn environment(&self) -> &Arc<Environment> {
        self.light.environment()
    }

    /// Returns normals that are prone to errors: at and near the map's poles, at its seam, at a node of the
    /// default table and between four nodes, with the brightest texel on the horizon, and random ones.
    pub fn normals(&self) -> Vec<Vec3A> {
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

/// Returns the sides of a box around the origin, with gaps between them, and a smaller portal behind one.
fn box_of_portals() -> Vec<Portal> {
    let axes = [Vec3A::X, Vec3A::Y, Vec3A::Z];
    let side = |normal: Vec3A, up: Vec3A, distance: f32, size: f32| Portal {
        center: -distance * normal,
        normal,
        up,
        width: size,
        height: 0.9 * size,
    };
    let mut portals: Vec<Portal> =
        (0..3).flat_map(|k| [axes[k], -axes[k]].map(|normal| side(normal, axes[(k + 1) % 3], 4.0, 7.6))).collect();
    portals.push(side(Vec3A::new(0.6, -0.8, 0.0), Vec3A::new(0.8, 0.6, 0.0), 8.0, 6.0));
    portals
}

/// Returns a flow tail that rotates rows relative to each other.
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

/// Returns a table that no bake would give: waves, some cells at zero, and nodes of -Y without mass.
fn waves() -> BakedTable {
    BakedTable::fill(NormalGrid::new(5, 7).unwrap(), CellGrid::new(9, 13).unwrap(), |normal, masses| {
        for (k, mass) in masses.iter_mut().enumerate() {
            let wave = (0.7 * k as f32 + 3.0 * normal.x + normal.z).sin();
            *mass = if normal.y < -0.999 { 0.0 } else { (wave + 0.9).max(0.0) * (1.1 + normal.y) };
        }
    })
    .unwrap()
}

/// Returns a head with random weights that is conditioned on the normal.
fn random_head(mode: Mode, bins: usize, encoder: &[usize]) -> Head {
    random_head_of(Condition::Normal, mode, bins, encoder, &[])
}

/// Returns a head with random weights, scaled so that logits have a spread of about one. `encoder` and
/// `mixture_weight` are the output widths of the layers of the encoder and of the selection network.
pub fn random_head_of(
    condition: Condition,
    mode: Mode,
    bins: usize,
    encoder: &[usize],
    mixture_weight: &[usize],
) -> Head {
    let mut random = Stream::new(5, Purpose::Weights, bins as u64);
    let mut network =
        |sizes: &[usize]| random_layers(sizes, &mut random, |inputs| [2.0 * (3.0 / inputs as f32).sqrt(), 1.0]);
    let encoder = network(&[&[condition.length()], encoder].concat());
    let seen = condition.length() + encoder.last().map_or(0, Linear::outputs);
    let features = if mode == Mode::Coupled { 2 } else { 0 };
    let networks = [network(&[seen + features, 16, 16, 3 * bins + 1]), network(&[seen + 1, 16, 16, 3 * bins + 1])];
    let mixture_weight = network(&[&[seen], mixture_weight].concat());
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_mixture_weight(mixture_weight).unwrap()
}

pub fn shading_point(normal: Vec3A) -> ShadingPoint {
    let surface = Lambert { albedo: Vec3::ONE }.into();
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, surface }
}
