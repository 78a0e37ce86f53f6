//! What a head gains from knowing the visibility of its surroundings, as CSV: `cargo bench --bench conditioned_head -- SCENES MAPS [STEPS]`, lists with commas.
//!
//! For shading points of a view with their true visibility, the relative variance of an estimate of the light that a diffuse surface reflects, shadows
//! included; points that see less than a twentieth of what they would reflect are left out, as a few of them would be all of the mean. The heads are trained on the product of cosine and visibility at one half of the points and judged at the other half:
//! `head` knows the normal and nothing of visibility, `head: mean` was trained with the visibility of the scene and is not told where it is,
//! `head: conditioned` is told the visibility that was learned for the cell of its shading point, as the means over 4 x 4 cells of Y. Two more know nothing of the
//! scene before they are told: `head: masks` was trained with random masks ([`mask`]), `head: elsewhere` with these and the other built-in scenes. Beside them the
//! estimators of the project, with `LEARNED64`, what 64 samples per pixel of the view teach, where their names say so; they are judged by their draws at
//! the same points.

#[path = "conditioned_head/mask.rs"]
mod mask;
#[path = "../render/benches/views/mod.rs"]
mod views;

use std::{
    error::Error,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::{Condition, burn::prelude::Device};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::Lambert,
    color::luminance,
    columns::Arena,
    environment::Environment,
    estimator::{Contributions, Estimator, LearnedVisibility, Setting},
    export::{ExportedSampler, Intermediate},
    head::MAX_CONDITION,
    integrator::{View, learn_visibility},
    latlong,
    patches::{Detail, PatchSampler},
    points::{PointSet, Points},
    random::Stream,
    sampler::EnvironmentLight,
    scene::Scene,
    spec::{Place, SamplerSpec},
    tail::{TailKind, TailWarp},
    tile::{ShadingPoint, Tile},
    visibility::{Known, SceneVisibility},
};
use headtail_train::{
    FitConfig, Preset, Target, fit,
    integrand::{PointValues, TailMap, TailPoint},
    validation::Validation,
};
use mask::Mask;
use rayon::prelude::*;
use views::{dressed, stem};

type Fallible<T> = Result<T, Box<dyn Error>>;

/// Cells of Y along a side that a head is told the visibility of.
const SIDE: usize = 4;
/// Points of Y along a side of such a cell that say what patches it is of.
const POINTS_OF_CELL: usize = 16;
/// Shading points, and draws of an estimator at each.
const SHADING_POINTS: usize = 4096;
const DRAWS: usize = 2048;
/// The least share of the light that a point would reflect, of which it must see as much.
const LEAST_SEEN: f32 = 0.05;
/// Where a condition has the number of its shading point, and by how much it is scaled down there, so that networks see nothing of it.
const PLACE: usize = 3;
const HIDDEN: f32 = 1e-30;
/// What the networks are told.
const TOLD: usize = 4;
/// The picture whose pixels are learned from.
const SIZE: (usize, usize) = (160, 120);
/// Random masks to train with, and built-in scenes.
const MASKS: usize = 16384;
const ELSEWHERE: [&str; 6] = ["temple", "dishes", "diorama", "droid", "bedroom", "cloth"];
const ESTIMATORS: [&str; 6] =
    ["mis", "direct:TABLE", "patches", "direct+vis@LEARNED:TABLE", "patches+vis:LEARNED", "mis-comp"];

fn main() -> Fallible<()> {
    // `cargo bench` adds a flag.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [scenes, maps, rest @ ..] = arguments.as_slice() else {
        println!("usage: SCENES MAPS [STEPS]");
        return Ok(());
    };
    let steps = rest.first().map_or(Ok(4000), |steps| steps.parse())?;
    println!("scene,map,sampler,relative_variance,ln(1 + chi^2)");
    for map in maps.split(',') {
        let environment = Arc::new(Environment::open(map)?);
        for scene in scenes.split(',') {
            for (sampler, [variance, divergence]) in measure(scene, &environment, steps)? {
                println!("{},{},{sampler},{variance:.4},{divergence:.4}", stem(scene), stem(map));
            }
        }
    }
    Ok(())
}

/// The relative variance and the divergence of every sampler.
fn measure(name: &str, environment: &Arc<Environment>, steps: usize) -> Fallible<Vec<(String, [f64; 2])>> {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let sky = PatchSampler::new(light.clone(), Detail::Leaves)?;
    let map = MapOfCells::new(&light, &sky);
    let scene = Arc::new(dressed(name, "lambert")?);
    let (learned, own) = surroundings(&scene, &map)?;
    let (train, test): (Vec<_>, Vec<_>) = own.iter().enumerate().partition(|(k, _)| k % 2 == 0);
    let [train, test] = [train, test].map(|list| list.into_iter().map(|(_, one)| one.clone()).collect::<Vec<_>>());
    let masked: Vec<Surroundings> = (0..MASKS).map(|k| map.masked(k as u64)).collect();
    // Points know what they see, whatever scene they are of.
    let mut elsewhere = masked.clone();
    for other in ELSEWHERE.into_iter().filter(|other| *other != name) {
        let scene = Arc::new(dressed(other, "lambert")?);
        elsewhere.extend(surroundings(&scene, &map)?.1);
    }

    let mut results = Vec::new();
    let target = |points, sees, tells| Occluded { light: &light, points, sees, tells };
    let config = config(steps)?;
    for (name, points, sees, tells) in [
        ("head", &train, false, false),
        ("head: mean", &train, true, false),
        ("head: conditioned", &train, true, true),
        ("head: masks", &masked, true, true),
        ("head: elsewhere", &elsewhere, true, true),
    ] {
        let fitted = fit(&config, &target(&points[..], sees, tells), &mut |_| {}, &AtomicBool::new(false))?;
        let shape = config.validation_shape();
        let judged = Validation::new(&target(&test[..], true, tells), shape, config.seed)?;
        let found = judged.divergence(&fitted.head, &Device::default());
        results.push((name.to_owned(), [found.relative_variance, found.log_chi_square]));
    }

    let folder = tempfile::tempdir()?;
    let [table, file] = ["table", "learned"].map(|name| folder.path().join(name));
    learned.write(&file)?;
    let direct = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?;
    ExportedSampler::new(Intermediate::DirectBake(direct), TailKind::Hierarchical, environment, None)?.write(&table)?;
    for name in ESTIMATORS {
        let text = name.replace("TABLE", &table.display().to_string()).replace("LEARNED", &file.display().to_string());
        let place = Place { scene: Some(&scene), ..Place::default() };
        let estimator = text.parse::<SamplerSpec>()?.build_in(environment, place)?;
        // What is learned is drawn with in a rendering alone.
        let (camera, (width, height)) = (scene.camera(), SIZE);
        let setting = Setting { eye: camera.look_from(), pixel: camera.pixel_angle(height), pixels: width * height };
        let judged = match estimator.learner(setting) {
            Some(learner) => by_draws(&*learner, &scene, &test),
            None => by_draws(&*estimator, &scene, &test),
        };
        results.push((name.to_owned(), judged));
    }
    Ok(results)
}

/// The fast preset of diffuse surfaces, with conditions that say where a point is. The longest ones are those of textures, and a configuration wants the
/// material that they are of; nothing else of it is used.
fn config(steps: usize) -> Fallible<FitConfig> {
    let mut config = Preset::FastCosine.config();
    config.material = concat!("neural:", env!("CARGO_MANIFEST_DIR"), "/checkpoints/satin.safetensors").parse()?;
    config.head.condition = Condition::Texture;
    (config.head.share, config.brdf_samples, config.steps) = (false, 0, steps);
    (config.validation_conditions, config.validation_strata) = (512, 64);
    Ok(config)
}

/// What hides the sky at a point.
#[derive(Clone)]
enum Hidden {
    Scene(Arc<Scene>),
    Mask(Mask),
}

/// A shading point, and what a head is told of the visibility there.
#[derive(Clone)]
struct Surroundings {
    point: ShadingPoint,
    hidden: Hidden,
    told: [f32; SIDE * SIDE],
}

impl Surroundings {
    /// Whether the sky is seen in directions.
    fn sees(&self, directions: impl Iterator<Item = Vec3A>) -> Vec<bool> {
        match &self.hidden {
            Hidden::Mask(mask) => directions.map(|direction| mask.is_seen(direction)).collect(),
            Hidden::Scene(scene) => {
                let leaving = |direction| scene.leaving(self.point.p, self.point.ng, direction);
                let rays: Vec<_> = directions.map(leaving).collect();
                let mut visible = vec![true; rays.len()];
                scene.visible_batch(&rays, &mut visible);
                visible
            }
        }
    }
}

/// What the camera sees of a scene under a map, but for points that see next to nothing of the light; and what was learned of it.
fn surroundings(scene: &Arc<Scene>, map: &MapOfCells<'_>) -> Fallible<(SceneVisibility, Vec<Surroundings>)> {
    let environment = map.light.environment();
    let learner = LearnedVisibility::new(environment.clone(), Detail::Leaves, LearnedVisibility::MEMORY)?;
    let ((width, height), camera) = (SIZE, scene.camera());
    let view = View { scene, camera: &camera, environment, width, height, unshadowed: false, depth: 1 };
    let learned = learn_visibility(view, &learner, None, (64, 77), &AtomicBool::new(false), &|_| {});
    let known = Known::new(&learned, &map.sky.division(), LearnedVisibility::MEMORY)?;
    let of_point = |point: ShadingPoint| Surroundings {
        point,
        hidden: Hidden::Scene(scene.clone()),
        told: map.told(&known, &point),
    };
    let list = shading_points(scene, SHADING_POINTS).into_iter().map(of_point);
    let is_lit = |one: &Surroundings| Occluded::of_one(map.light, one).seen_share() >= LEAST_SEEN;
    Ok((learned, list.filter(is_lit).collect()))
}

/// Cosine times visibility, seen through the tail.
struct Occluded<'a> {
    light: &'a EnvironmentLight,
    points: &'a [Surroundings],
    /// Whether what is hidden is dark.
    sees: bool,
    /// Whether conditions hold what is known of the visibility.
    tells: bool,
}

impl<'a> Occluded<'a> {
    fn of_one(light: &'a EnvironmentLight, point: &'a Surroundings) -> Self {
        Self { light, points: std::slice::from_ref(point), sees: true, tells: false }
    }

    /// The share that the first point sees of the light that it would reflect.
    fn seen_share(self) -> f32 {
        const SIDE: usize = 64;
        let at = |k: usize| (k as f32 + 0.5) / SIDE as f32;
        let y: Vec<[f32; 2]> = (0..SIDE * SIDE).map(|k| [at(k % SIDE), at(k / SIDE)]).collect();
        let condition = [0.0; MAX_CONDITION];
        let sum = |of: &Self| of.at_points(&condition, &y).iter().map(|point| point.target).sum::<f32>();
        sum(&self) / sum(&Self { sees: false, ..self }).max(f32::MIN_POSITIVE)
    }
}

impl Target for Occluded<'_> {
    fn condition(&self) -> Condition {
        Condition::Texture
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let place = ((stream.uniform() * self.points.len() as f32) as usize).min(self.points.len() - 1);
        let Surroundings { point, told, .. } = &self.points[place];
        condition.fill(0.0);
        condition[..PLACE].copy_from_slice(&point.ns.to_array());
        condition[PLACE] = HIDDEN * place as f32;
        if self.tells {
            condition[TOLD..TOLD + told.len()].copy_from_slice(told);
        }
    }

    fn at_points(&self, condition: &[f32], y: &[[f32; 2]]) -> Vec<PointValues> {
        let surroundings = &self.points[(condition[PLACE] / HIDDEN).round() as usize];
        let (point, there) = (&surroundings.point, TailMap::forward(&**self.light.tail(), y));
        let visible = match self.sees {
            true => surroundings.sees(there.iter().map(|there| there.direction)),
            false => vec![true; y.len()],
        };
        let value = |(there, visible): (&TailPoint, bool)| {
            let lit = visible && point.ng.dot(there.direction) > 0.0;
            let target = if lit { there.light * point.ns.dot(there.direction).max(0.0) } else { 0.0 };
            PointValues { target, brdf: 0.0, tail: there.density }
        };
        there.iter().zip(visible).map(value).collect()
    }
}

/// The cells of Y of a map that heads are told of.
struct MapOfCells<'a> {
    light: &'a EnvironmentLight,
    sky: &'a PatchSampler,
    cells: Vec<CellOfY>,
}

/// What a cell of Y has of the sky.
struct CellOfY {
    /// The shares of it that are of patches.
    shares: Vec<(usize, f32)>,
    /// Directions to points of it.
    directions: Vec<Vec3A>,
}

impl<'a> MapOfCells<'a> {
    fn new(light: &'a EnvironmentLight, sky: &'a PatchSampler) -> Self {
        let place = |cell: usize, k: usize| {
            let at = |cell: usize, k: usize| (cell as f32 + (k as f32 + 0.5) / POINTS_OF_CELL as f32) / SIDE as f32;
            Vec2::new(at(cell % SIDE, k % POINTS_OF_CELL), at(cell / SIDE, k / POINTS_OF_CELL))
        };
        let of_cell = |cell: usize| {
            let y: Vec<Vec2> = (0..POINTS_OF_CELL * POINTS_OF_CELL).map(|k| place(cell, k)).collect();
            let (share, there) = (1.0 / y.len() as f32, light.tail().forward_points(&y));
            let shares = there.iter().map(|&(x, _)| (usize::from(sky.patch_at(x)), share)).collect();
            CellOfY { shares, directions: there.iter().map(|&(x, _)| latlong::direction(x)).collect() }
        };
        Self { light, sky, cells: (0..SIDE * SIDE).map(of_cell).collect() }
    }

    /// The learned visibility of the cells at a point; 1/2 where nothing is known.
    fn told(&self, known: &Known, point: &ShadingPoint) -> [f32; SIDE * SIDE] {
        let mut told = [0.5; SIDE * SIDE];
        if let Some((_, _, visibility)) = known.at(point.p, point.ns) {
            for (told, cell) in told.iter_mut().zip(&self.cells) {
                *told = cell.shares.iter().map(|&(patch, share)| share * visibility[patch]).sum();
            }
        }
        told
    }

    /// A point behind a mask, of which all is known; the next one if that sees next to nothing.
    fn masked(&self, number: u64) -> Surroundings {
        let of_number = |number: u64| {
            let (mask, normal) = Mask::random(number);
            let seen = |CellOfY { directions, .. }: &CellOfY| {
                directions.iter().filter(|direction| mask.is_seen(**direction)).count() as f32 / directions.len() as f32
            };
            let told = std::array::from_fn(|cell| seen(&self.cells[cell]));
            let point = ShadingPoint {
                p: Vec3A::ZERO,
                ng: normal,
                ns: normal,
                wo: normal,
                surface: Lambert { albedo: Vec3::ONE }.into(),
            };
            Surroundings { point, told, hidden: Hidden::Mask(mask) }
        };
        let mut tries = (0..).map(|k| of_number(number + k * MASKS as u64));
        let is_lit = |one: &Surroundings| Occluded::of_one(self.light, one).seen_share() >= LEAST_SEEN;
        tries.find(is_lit).expect("some mask lets light through")
    }
}

/// What the camera sees through a grid of rays.
fn shading_points(scene: &Scene, count: usize) -> Vec<ShadingPoint> {
    let height = (0.75 * count as f64).sqrt().ceil() as usize;
    let (width, camera) = (height * 4 / 3, scene.camera());
    let ray = |k: usize| camera.ray((k % width) as f32 + 0.5, (k / width) as f32 + 0.5, width, height);
    (0..width * height).filter_map(|k| scene.intersect(&ray(k))).collect()
}

/// The means over points of the relative variance of an estimator's draws, and of its divergence.
fn by_draws(estimator: &dyn Estimator, scene: &Scene, points: &[Surroundings]) -> [f64; 2] {
    let one = |(k, Surroundings { point, .. }): (usize, &Surroundings)| {
        let tile = Tile::of_table(&vec![*point; DRAWS], scene.brdfs());
        let (arena, mut drawn) = (Arena::default(), Contributions::default());
        estimator.propose(&tile.rows(), &Points::new(PointSet::Independent, k as u64), &mut drawn, &arena);
        let rays: Vec<_> = drawn.wi().iter().map(|&wi: &Vec3A| scene.leaving(point.p, point.ng, wi)).collect();
        let mut visible = vec![true; rays.len()];
        scene.visible_batch(&rays, &mut visible);
        let mut weights = vec![0.0; DRAWS];
        for ((&place, &radiance), visible) in drawn.places().iter().zip(drawn.radiance()).zip(visible) {
            weights[usize::from(place)] += if visible { f64::from(luminance(radiance)) } else { 0.0 };
        }
        let mean = weights.iter().sum::<f64>() / DRAWS as f64;
        (mean > 0.0).then(|| weights.iter().map(|weight| (weight / mean - 1.0).powi(2)).sum::<f64>() / DRAWS as f64)
    };
    let variances: Vec<f64> = points.par_iter().enumerate().filter_map(one).collect();
    let count = variances.len() as f64;
    [variances.iter().sum::<f64>() / count, variances.iter().map(|variance| variance.ln_1p()).sum::<f64>() / count]
}
