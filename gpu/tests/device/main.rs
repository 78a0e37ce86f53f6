//! Pictures of a device (Mesa's software adapter if there is no other) match those of the CPU for the same points.

mod furnished;
#[path = "../../../render/tests/layers/mod.rs"]
mod layers;
#[path = "../../../render/tests/networks/mod.rs"]
mod networks;

use std::{
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use glam::Vec3A;
use headtail_gpu::{LitScene, Program, Renderer};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::neural::write_networks,
    environment::Environment,
    estimator::LearnedVisibility,
    export::{ExportedSampler, Intermediate},
    head::{Condition, Head, Mode},
    image::Image,
    integrator::{self, Budget, Rendering, View, learn_visibility},
    patches::Detail,
    points::{PointSet, Points},
    portals::Portals,
    random::{Purpose, Stream},
    scene::{Material, MaterialSpec, Scene},
    spec::{BuildContext, SamplerSpec, Source},
    tail::{Tail, TailKind},
};
use headtail_shaders::gpu::Gpu;
use layers::random_layers;
use libtest_mimic::{Arguments, Failed, Trial};

const WIDTH: usize = 40;
const HEIGHT: usize = 30;
const SAMPLES: u32 = 8;
/// Pixels that differ by more than [`NEAR`] of their value: rays that rounding moves across an edge, and draws that it
/// moves across a border of patches or a lobe. A pixel has 8 samples of up to 12 draws.
const APART: f64 = 0.02;
const NEAR: f32 = 1e-3;
/// Largest difference of the mean over all pixels: differing samples are as good as new ones, and few.
const MEAN: f64 = 3e-4;

struct Case {
    scene: &'static str,
    map: &'static str,
    material: Option<&'static str>,
    spec: &'static str,
    depth: u32,
    unshadowed: bool,
    points: PointSet,
}

const fn case(scene: &'static str, map: &'static str, material: Option<&'static str>, spec: &'static str) -> Case {
    Case { scene, map, material, spec, depth: 1, unshadowed: false, points: PointSet::LATTICE }
}

const LAMBERT: Option<&str> = Some("lambert");
const GGX: Option<&str> = Some("ggx:alpha=0.2..0.6");

/// Stands for the file of a table for the case's map.
const TABLE: &str = "{table}";
/// Stands for a file of two measured materials.
const MEASURED: &str = "{measured}";
/// Stand for files of heads that are told of measured and of neural materials.
const HEADS: [(&str, Condition); 2] = [("{family}", Condition::Family), ("{texture}", Condition::Texture)];
/// Stands for a file of visibility of the case's scene under its map.
const VISIBILITY: &str = "{visibility}";
/// The scene of `furnished.rs`.
const FURNISHED: &str = "furnished";

const CASES: [Case; 28] = [
    case("temple", "studio", LAMBERT, "brdf"),
    case("temple", "studio", LAMBERT, "head+mis:../checkpoints/studio-head.safetensors"),
    case("temple", "sunset", LAMBERT, "split:2:direct+mis:{table}"),
    case("dishes", "studio", GGX, "mis"),
    case("temple", "sunset", GGX, "mis-comp"),
    case("dishes", "window", LAMBERT, "mis2"),
    case("dishes", "overcast", GGX, "split:3:mis2-comp"),
    case("temple", "studio", LAMBERT, "mis2:patches"),
    case("dishes", "sunset", GGX, "ris:5"),
    case("dishes", "studio", Some("ggx:alpha=0.02"), "patches:fine"),
    case("droid", "studio", None, "split:2:mis-comp"),
    case("arcade", "window", LAMBERT, "split:4:patches+vis"),
    case("arcade", "sunset", GGX, "patches+vis"),
    case("arcade", "window", LAMBERT, "split:2:patches+vis:{visibility}"),
    Case { depth: 4, ..case("bedroom", "window", None, "mis2-comp") },
    case("bedroom", "sunset", None, "mis2:portals"),
    case("bedroom", "window", LAMBERT, "split:3:portals+mis"),
    Case { depth: 3, points: PointSet::Sobol, ..case("bedroom", "studio", None, "split:3:mis2-comp") },
    Case { depth: 2, points: PointSet::Independent, ..case("dishes", "window", GGX, "ris:4") },
    Case { unshadowed: true, ..case("arcade", "sunset", LAMBERT, "mis2-comp") },
    case(FURNISHED, "sunset", None, "split:4:patches"),
    Case { depth: 3, ..case(FURNISHED, "studio", None, "brdf") },
    case("dishes", "window", Some("nbrdf:{measured}#mirror,odd"), "mis2-comp"),
    Case { depth: 2, ..case("dishes", "sunset", Some("nbrdf:{measured}#odd"), "patches") },
    case("dishes", "studio", Some("nbrdf:{measured}#mirror,odd"), "head+mis:{family}"),
    case("cloth", "studio", Some("neural:../checkpoints/satin.safetensors"), "mis2-comp"),
    case("cloth", "window", Some("neural:../checkpoints/satin.safetensors"), "head+mis:{texture}"),
    Case { depth: 3, ..case("cloth", "sunset", Some("neural:../checkpoints/jersey.safetensors"), "split:2:patches") },
];

impl Case {
    fn name(&self) -> String {
        let Self { scene, map, material, spec, depth, points, .. } = self;
        format!("{spec} on {scene} under {map}, {}, depth {depth}, {points}", material.unwrap_or("own materials"))
    }

    fn check(&self, gpu: Arc<Gpu>) -> Result<(), Failed> {
        let environment = Arc::new(Environment::open(self.map)?);
        let folder = tempfile::tempdir()?;
        let mut scene = match self.scene {
            FURNISHED => furnished::scene(folder.path()),
            name => Scene::open(name)?,
        };
        if let Some(material) = self.material {
            let (measured, bounds) = (folder.path().join("measured.safetensors"), scene.bounds());
            if material.contains(MEASURED) {
                let forms = [("mirror", networks::MIRROR), ("odd", networks::ODD)];
                write_networks(&measured, &forms.map(|(name, form)| (name.to_owned(), form.network())))?;
            }
            let material = material.replace(MEASURED, &measured.display().to_string());
            scene = material.parse::<MaterialSpec>()?.dress(scene, &bounds)?;
        }
        let table = folder.path().join("table.safetensors");
        if self.spec.contains(TABLE) {
            write_table(&environment, &table)?;
        }
        let (visibility, camera) = (folder.path().join("visibility.safetensors"), scene.camera());
        let (depth, unshadowed) = (self.depth, self.unshadowed);
        let (width, height) = (WIDTH, HEIGHT);
        let view = View { scene: &scene, camera: &camera, environment: &environment, width, height, unshadowed, depth };
        let (points, stop) = (Points::new(self.points, 3), AtomicBool::new(false));
        if self.spec.contains(VISIBILITY) {
            let patches = LearnedVisibility::new(environment.clone(), Detail::Leaves, LearnedVisibility::MEMORY)?;
            learn_visibility(view, &patches, None, (4, 1), &stop, &|_| {}).write(&visibility)?;
        }
        let mut spec = self.spec.replace(TABLE, &table.display().to_string());
        for (name, condition) in HEADS {
            let path = folder.path().join("head.safetensors");
            if spec.contains(name) {
                write_head(condition, &environment, &path)?;
                spec = spec.replace(name, &path.display().to_string());
            }
        }
        let spec: SamplerSpec = spec.replace(VISIBILITY, &visibility.display().to_string()).parse()?;
        let portals = match spec.source() {
            Source::Portals(_) => Portals::find(&scene, &camera)?.portals,
            _ => Vec::new(),
        };
        let context = BuildContext { always: true, scene: Some(&scene), portals: &portals, ..BuildContext::default() };
        let estimator = spec.build_in(&environment, context)?;
        let expected = integrator::render(view, &*estimator, Budget::Spp(SAMPLES), points, &stop, &|_| {});
        let lit = LitScene::new(&scene, environment.clone())?;
        let program = Program::new(&lit, &spec, context)?;
        let mut renderer = Renderer::new(gpu, &lit, &program)?;
        if program.has_visibility {
            renderer = renderer.with_visibility(spec.build_learned(&environment, context)?);
        }
        let found = renderer.render(&view, view.whole(), Budget::Spp(SAMPLES), points, &stop, &|_| {})?;
        if program.has_visibility {
            let cells = [&found, &expected].map(|picture| picture.learned.map(|size| (size.cells, size.pays)));
            if cells[0] != cells[1] || !matches!(cells[0], Some((1.., true))) {
                return Err(format!("learned visibility: {cells:?}").into());
            }
        }
        compare(&found, &expected)
    }
}

fn write_table(environment: &Environment, path: &Path) -> Result<(), Failed> {
    let tail = Tail::of_environment(TailKind::Hierarchical, environment)?;
    let table = direct_bake(&tail, NormalGrid::new(8, 16)?, CellGrid::new(16, 16)?)?;
    let table = Intermediate::DirectBake(table);
    Ok(ExportedSampler::new(table, TailKind::Hierarchical, environment, None)?.write(path)?)
}

/// Writes a head with random weights.
fn write_head(condition: Condition, environment: &Environment, path: &Path) -> Result<(), Failed> {
    let mut random = Stream::new(5, Purpose::Weights, 4);
    let mut network =
        |sizes: &[usize]| random_layers(sizes, &mut random, |inputs| [2.0 * (3.0 / inputs as f32).sqrt(), 1.0]);
    let (length, encoded, logits) = (condition.length(), 12, 3 * 4 + 1);
    let encoder = network(&[length, 16, encoded]);
    let seen = length + encoded;
    let networks = [network(&[seen, 16, logits]), network(&[seen + 1, 16, logits])];
    let head = Head::new(condition, Mode::Autoregressive, 0.01, encoder, networks)?;
    let head = Intermediate::Head(head.with_mixture_weight(network(&[seen, 8, 1]))?);
    Ok(ExportedSampler::new(head, TailKind::Hierarchical, environment, None)?.write(path)?)
}

/// Compares pictures pixel by pixel, and their means.
fn compare(found: &Rendering, expected: &Rendering) -> Result<(), Failed> {
    let color = |image: &Image, k: usize| Vec3A::from_array(image.pixels[k]);
    let is_apart = |&k: &usize| {
        let (a, b) = (color(&found.composite(), k), color(&expected.composite(), k));
        (a - b).abs().max_element() > NEAR * b.abs().max_element().max(1e-3)
    };
    let pixels = WIDTH * HEIGHT;
    let apart = (0..pixels).filter(is_apart).count() as f64 / pixels as f64;
    let mean = |image: &Image| image.pixels.iter().map(|p| f64::from(p[0] + p[1] + p[2])).sum::<f64>();
    let difference = mean(&found.composite()) / mean(&expected.composite()) - 1.0;
    let rays = found.rays_per_sample / expected.rays_per_sample - 1.0;
    let weight = found.max_weight / expected.max_weight - 1.0;
    let text = format!(
        "{apart:.4} of pixels apart, mean {difference:+.1e}, rays {rays:+.1e}, largest weight {weight:+.1e}, {:.2} s",
        found.seconds
    );
    println!("{text}");
    // Where the camera sees no border, all rays hit what they hit on the CPU.
    // Surfaces are seen.
    let is_covered = expected.coverage.iter().sum::<f32>() > 0.2 * pixels as f32;
    let is_same = is_covered && apart < APART && difference.abs() < MEAN && rays.abs() < 1e-2;
    if is_same { Ok(()) } else { Err(text.into()) }
}

/// Under uniform light, a white surface without shadows reflects it exactly, whatever is sampled.
fn check_furnace(gpu: Arc<Gpu>, spec: &str) -> Result<(), Failed> {
    let white = Image { width: 64, height: 32, pixels: vec![[1.0; 3]; 64 * 32] };
    let environment = Arc::new(Environment::from_image("white", white)?);
    let scene = Scene::open("dishes")?.with_material(Material::diffuse(Vec3A::ONE));
    let camera = scene.camera();
    let (width, height) = (WIDTH, HEIGHT);
    let view =
        View { scene: &scene, camera: &camera, environment: &environment, width, height, unshadowed: true, depth: 1 };
    let lit = LitScene::new(&scene, environment.clone())?;
    let renderer = Renderer::new(gpu, &lit, &Program::new(&lit, &spec.parse()?, BuildContext::default())?)?;
    let (points, stop) = (Points::new(PointSet::LATTICE, 5), AtomicBool::new(false));
    let found = renderer.render(&view, view.whole(), Budget::Spp(256), points, &stop, &|_| {})?;
    let sums = found.surfaces.pixels.iter().zip(&found.coverage).map(|(pixel, coverage)| (pixel[1], *coverage));
    let (light, coverage) = sums.fold((0.0, 0.0), |(light, covered), (own, part)| (light + own, covered + part));
    // Directions below the geometric surface reflect nothing: shading normals lean by a few degrees at silhouettes.
    let ratio = light / coverage;
    if (ratio - 1.0).abs() < 5e-3 { Ok(()) } else { Err(format!("{spec}: a white surface reflects {ratio}").into()) }
}

fn main() {
    let arguments = Arguments::from_args();
    let open = || Ok::<_, Failed>(Arc::new(Gpu::open()?));
    let pictures = CASES.iter().map(|case| Trial::test(case.name(), move || case.check(open()?)));
    let furnaces = ["brdf", "mis2-comp"]
        .map(|spec| Trial::test(format!("white furnace, {spec}"), move || check_furnace(open()?, spec)));
    libtest_mimic::run(&arguments, pictures.chain(furnaces).collect()).exit();
}
