//! Samplers over a flow tail render the same picture as every other sampler.

use std::{
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use glam::Vec2;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    columns::Arena,
    environment::{Environment, built_in},
    estimator::{Estimator, SingleSample},
    export::{ExportedSampler, Intermediate, TrainingSummary},
    head::{Head, Mode},
    image::Image,
    random::{Purpose, Stream},
    sampler::{Coverage, Covering, Draws, EnvironmentLight, ProductSampler, Sampler},
    scene::Scene,
    simd::Lanes,
    spec::SamplerSpec,
    statistics::{TileTest, compare_images, sidak},
    tail::{Tail, TailKind, TailWarp, WarpMap},
    tile::Rows,
};

use super::{SIGNIFICANCE, Setting, bake, layers::random_layers, random_head};

/// Sides of the tables of warps: coarse, so that their density differs from the light.
const CELLS: usize = 64;
const SCENES: [&str; 2] = ["temple", "dishes"];
const MAPS: [&str; 2] = ["window", "sunset"];
/// Pairs of 9 samplers in two scenes under two maps.
const TESTS: usize = 9 * 8 / 2 * SCENES.len() * MAPS.len();

/// Returns a tabulated warp from uniform points to the approximate light of a map, rotated so that it crosses
/// the seam.
fn warp(environment: &Environment, cells: usize) -> Tail {
    let (width, height, luminance) = (environment.width(), environment.height(), environment.luminance());
    // A constant is added to the light, so that no cell of the table is much larger than the others.
    let mean = luminance.iter().sum::<f32>() / luminance.len() as f32;
    let lifted: Vec<f32> = luminance.iter().map(|value| value + 0.3 * mean).collect();
    let exact = Tail::new(TailKind::RowColumn, width, height, &lifted).unwrap();
    let node = |k: usize| {
        let y = Vec2::new((k % cells) as f32, (k / cells) as f32) / cells as f32;
        let turned = y.x + 0.3 + 0.8 * y.y + 0.05 * (std::f32::consts::TAU * y.x).sin();
        let (u, v) = (turned - turned.floor(), y.y.min(1.0 - f32::EPSILON / 2.0));
        let [start, x] = [0.0, u].map(|u| exact.forward(Vec2::new(u, v)).0);
        // The tail's cells begin in the middle of a texel: points before it are one turn further.
        let lap = turned.floor() + if u > 0.5 && x.x <= start.x { 1.0 } else { 0.0 };
        let border = if k < cells { 0.0 } else { 1.0 };
        Vec2::new(x.x + lap, if (cells..cells * cells).contains(&k) { x.y } else { border })
    };
    let (map, repair) = WarpMap::repaired(cells, (0..cells * (cells + 1)).map(node).collect()).unwrap();
    assert_eq!(repair.blended, 0.0, "the warp must not be lost to its repair: {repair:?}");
    Tail::flow(map, width, height, &luminance).unwrap()
}

/// Returns a random head with a mixture weight that depends on the normal.
fn selecting_head() -> Head {
    let mut random = Stream::new(6, Purpose::Weights, 0);
    random_head(Mode::Coupled).with_mixture_weight(random_layers(&[3, 8, 1], &mut random, |_| [2.0; 2])).unwrap()
}

/// Writes heads and tables over a flow tail and returns all specifications of them.
fn samplers(folder: &Path, environment: &Environment) -> Vec<SamplerSpec> {
    let tail = Arc::new(warp(environment, CELLS));
    let write = |form: &str, name: &str, intermediate: Intermediate| -> SamplerSpec {
        let path = folder.join(format!("{}-{name}.safetensors", environment.name()));
        let training = (!matches!(intermediate, Intermediate::DirectBake(_))).then(TrainingSummary::default);
        ExportedSampler::of_tail(intermediate, tail.clone(), environment, training).write(&path).unwrap();
        format!("{form}:{}", path.display()).parse().unwrap()
    };
    let coupled = random_head(Mode::Coupled);
    let (normals, cells) = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(16, 16).unwrap());
    vec![
        write("baked", "baked", Intermediate::Bake(bake(&coupled, &tail))),
        write("head", "coupled", Intermediate::Head(coupled)),
        write("ris:4:head", "autoregressive", Intermediate::Head(random_head(Mode::Autoregressive))),
        write("head+mis", "selecting", Intermediate::Head(selecting_head())),
        write("direct+mis", "direct", Intermediate::DirectBake(direct_bake(&tail, normals, cells).unwrap())),
    ]
}

impl Setting {
    fn shadowed(scene: &str, environment: &Arc<Environment>) -> Self {
        let scene = Scene::built_in(scene).unwrap();
        Self { scene, environment: environment.clone(), unshadowed: false, depth: 1, points: super::PointSet::Sobol }
    }

    fn picture(&self, estimator: &dyn Estimator, seed: u64) -> Image {
        self.estimate_until(estimator, 32, seed, &AtomicBool::new(false), &|_| {}).surfaces
    }
}

fn compare(a: &Image, b: &Image) -> TileTest {
    compare_images(a, b, 16, sidak(SIGNIFICANCE, TESTS)).unwrap()
}

#[test]
fn samplers_with_flow_tails_render_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    for map in MAPS {
        let environment = Arc::new(built_in(map).unwrap());
        let mut tested: Vec<SamplerSpec> = ["emitter", "mis", "mis2", "ris:4"].map(|name| name.parse().unwrap()).into();
        tested.extend(samplers(folder.path(), &environment));
        for scene in SCENES {
            let setting = Setting::shadowed(scene, &environment);
            let images: Vec<(String, Image)> = tested
                .iter()
                .enumerate()
                .map(|(k, sampler)| {
                    (sampler.to_string(), setting.picture(&*sampler.build(&environment).unwrap(), 70 + k as u64))
                })
                .collect();
            assert_eq!(TESTS, MAPS.len() * SCENES.len() * images.len() * (images.len() - 1) / 2);
            for (k, (first, a)) in images.iter().enumerate() {
                for (second, b) in &images[k + 1..] {
                    let test = compare(a, b);
                    assert!(test.passed(), "{scene} under {map}, {first} against {second}: {test}");
                }
            }
        }
    }
}

/// Draws from one sampler and returns the pdf of another.
struct Mistaken<A, B> {
    drawn: A,
    said: B,
}

impl<A: Sampler, B: Sampler> Mistaken<A, B> {
    /// Returns the states of both.
    fn states<'a>(&self, at: &Rows<'_>, state: &'a [Lanes]) -> (&'a [Lanes], &'a [Lanes]) {
        state.split_at(self.drawn.columns() * at.strips())
    }
}

impl<A: Sampler, B: Sampler> Sampler for Mistaken<A, B> {
    fn columns(&self) -> usize {
        self.drawn.columns() + self.said.columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let (drawn, said) = state.split_at_mut(self.drawn.columns() * at.strips());
        self.drawn.prepare(at, drawn, arena);
        self.said.prepare(at, said, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], Draws { wi, pdf }: Draws<'_>, arena: &Arena) {
        let (drawn, said) = self.states(at, state);
        let [x, y, z] = wi;
        self.drawn.sample(at, drawn, u, Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, arena);
        let mut own = arena.columns::<1>(at.strips());
        self.said.pdf(at, said, [x, y, z], own.get_mut()[0], arena);
        for (pdf, own) in pdf.as_flattened_mut().iter_mut().zip(own.get()[0].as_flattened()) {
            *pdf = if *pdf > 0.0 { *own } else { 0.0 };
        }
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.said.pdf(at, self.states(at, state).1, wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}

/// Detects likely mistakes with the same scenes, samples and significance.
#[test]
fn wrong_pdfs_of_flow_tails_are_detected() {
    for map in MAPS {
        let environment = Arc::new(built_in(map).unwrap());
        let (fine, coarse) = (warp(&environment, CELLS), warp(&environment, CELLS / 8));
        let exact = Tail::of_environment(TailKind::Hierarchical, &environment).unwrap();
        let over = |tail: &Tail| {
            let light = EnvironmentLight::with_tail(environment.clone(), Arc::new(tail.clone()));
            ProductSampler::new(light, random_head(Mode::Coupled))
        };
        let single = |sampler: Arc<dyn Sampler>| -> Box<dyn Estimator> {
            Box::new(SingleSample::new(Covering::new(sampler).unwrap(), environment.clone()))
        };
        let mistakes: [(&str, Box<dyn Estimator>); 2] = [
            (
                "the pdf of another table of the flow",
                single(Arc::new(Mistaken { drawn: over(&fine), said: over(&coarse) })),
            ),
            (
                "the light in place of the flow's density",
                single(Arc::new(Mistaken { drawn: over(&fine), said: over(&exact) })),
            ),
        ];
        let pictures = SCENES.map(|scene| {
            let setting = Setting::shadowed(scene, &environment);
            let truth = setting.picture(&*SamplerSpec::ris(4).build(&environment).unwrap(), 1);
            (setting, truth)
        });
        for (name, estimator) in mistakes {
            let is_seen =
                pictures.iter().any(|(setting, truth)| !compare(truth, &setting.picture(&*estimator, 2)).passed());
            assert!(is_seen, "{map}: {name} was not seen");
        }
    }
}
