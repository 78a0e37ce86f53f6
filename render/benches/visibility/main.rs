//! What knowing visibility gains, as CSV: `cargo bench -p headtail-render --bench visibility -- SCENES MAPS MATERIAL SAMPLERS SAMPLES [WIDTHxHEIGHT [POINTS [MEGABYTES [REFERENCE]]]] [--unshadowed]`,
//! the first five but the material with commas between; MEGABYTES bound what is learned, the reference has two halves of REFERENCE samples.
//!
//! In the names of samplers, `TABLE` is a direct bake of the map, `MAP` the map's name without folder and ending, and `LEARNEDn` what n samples per pixel of the view teach, for example
//! `direct:TABLE,direct+vis@LEARNED64:TABLE,head+mis:heads/MAP.safetensors`; after `always:` it is drawn with even where that does not pay; `mis` comes first. `cache:N[:ROWS[:DEGREES[:FLOOR]]]` is a cache of N maps of visibility over X (`map_cache.rs`). Rows have the mean square error, the reference's own noise taken off, that of `mis` over it, and the processor
//! seconds of a sample of all pixels on one thread, learning before the picture included.

mod map_cache;
#[path = "../views/mod.rs"]
mod views;

use std::{error::Error, path::Path, sync::Arc, sync::atomic::AtomicBool, time::Duration};

use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    environment::Environment,
    estimator::{Estimator, LearnedVisibility, SingleSample},
    export::{ExportedSampler, Intermediate},
    image::Image,
    integrator::{Budget, View, learn_visibility, render},
    patches::Detail,
    points::{PointSet, Points},
    sampler::{BrdfSampler, Covering, OneSampleMis},
    scene::{Camera, Scene},
    spec::{Place, SamplerSpec},
    tail::{Tail, TailKind},
    visibility::SceneVisibility,
};
use map_cache::MapCache;
use views::{dressed, stem};

/// Pictures of different seeds that an error is the mean of.
const SEEDS: u64 = 2;

fn main() -> Result<(), Box<dyn Error>> {
    // `cargo bench` adds a flag.
    let (flags, arguments): (Vec<_>, Vec<_>) = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .partition(|argument| argument.starts_with("--"));
    let unshadowed = match flags.as_slice() {
        [] => false,
        [flag] if flag == "--unshadowed" => true,
        _ => return Err("--unshadowed is the only option".into()),
    };
    let ([scenes, maps, material, samplers, budgets], size) = match arguments.as_slice() {
        [a, b, c, d, e] => ([a, b, c, d, e], "160x120"),
        [a, b, c, d, e, size, ..] => ([a, b, c, d, e], &**size),
        _ => {
            println!(
                "usage: SCENES MAPS MATERIAL SAMPLERS SAMPLES [WIDTHxHEIGHT [POINTS [MEGABYTES [REFERENCE]]]] [--unshadowed]"
            );
            return Ok(());
        }
    };
    let points = arguments.get(6).map_or(Ok(PointSet::Sobol), |points| points.parse())?;
    let memory =
        (arguments.get(7).map_or(Ok(64.0), |megabytes| megabytes.parse::<f64>())? * f64::from(1 << 20)) as usize;
    let reference = arguments.get(8).map_or(Ok(512), |samples| samples.parse())?;
    let (width, height) = size.split_once('x').ok_or("the size is WIDTHxHEIGHT")?;
    let size = (width.parse()?, height.parse()?);
    let budgets = budgets.split(',').map(str::parse).collect::<Result<Vec<u32>, _>>()?;
    // One thread, whose time is all there is.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let folder = tempfile::tempdir()?;
    println!("scene,map,sampler,spp,mse,over_mis,cpu_seconds_per_sample");
    for map in maps.split(',') {
        let environment = Arc::new(Environment::open(map)?);
        let table = folder.path().join("table");
        table_of(&environment)?.write(&table)?;
        for name in scenes.split(',') {
            let scene = dressed(name, material)?;
            let camera = scene.camera();
            let (environment, folder) = (environment.clone(), folder.path());
            let names = (stem(name), stem(map));
            let bench =
                Bench { names, scene, camera, environment, size, points, memory, reference, unshadowed, folder };
            pool.install(|| bench.compare(samplers, &budgets).map_err(|error| error.to_string()))?;
        }
    }
    Ok(())
}

/// The direct bake of a map, as the program makes it.
fn table_of(environment: &Arc<Environment>) -> Result<ExportedSampler, Box<dyn Error>> {
    let tail = Tail::of_environment(TailKind::Hierarchical, environment)?;
    let table = direct_bake(&tail, NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?;
    Ok(ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, environment, None)?)
}

struct Bench<'a> {
    /// Of scene and map.
    names: (&'a str, &'a str),
    scene: Scene,
    environment: Arc<Environment>,
    camera: Camera,
    size: (usize, usize),
    points: PointSet,
    memory: usize,
    /// Samples per pixel of either half of a reference.
    reference: u32,
    unshadowed: bool,
    folder: &'a Path,
}

impl Bench<'_> {
    fn compare(&self, samplers: &str, budgets: &[u32]) -> Result<(), Box<dyn Error>> {
        let patches = SamplerSpec::patches().build(&self.environment)?;
        let [a, b] =
            [1001, 1002].map(|seed| self.render(&*patches, self.reference, Points::new(PointSet::Sobol, seed)).0);
        let reference: Vec<f32> = samples(&a).zip(samples(&b)).map(|(a, b)| 0.5 * (a + b)).collect();
        // The variance of the mean of two is a quarter of the square of their difference.
        let noise = mean(samples(&a).zip(samples(&b)).map(|(a, b)| f64::from(a - b).powi(2) / 4.0));
        let (scene, map) = self.names;
        for &spp in budgets {
            let mut mis = None;
            for name in samplers.split(',') {
                let estimator = self.estimator(name)?;
                let (mut error, mut seconds) = (0.0, 0.0);
                for seed in 0..SEEDS {
                    let (image, time) = self.render(&*estimator, spp, Points::new(self.points, seed));
                    let squares = samples(&image).zip(&reference).map(|(a, b)| f64::from(a - b).powi(2));
                    error += (mean(squares) - noise) / SEEDS as f64;
                    seconds += time.as_secs_f64() / (SEEDS * u64::from(spp)) as f64;
                }
                let over_mis = *mis.get_or_insert(error) / error;
                println!("{scene},{map},{name},{spp},{error:.4e},{over_mis:.3},{seconds:.4e}");
            }
        }
        Ok(())
    }

    fn view(&self) -> View<'_> {
        let (scene, environment, (width, height)) = (&self.scene, &self.environment, self.size);
        View { scene, camera: &self.camera, environment, width, height, unshadowed: self.unshadowed, depth: 1 }
    }

    /// A picture, and the processor time that it took.
    fn render(&self, estimator: &dyn Estimator, spp: u32, points: Points) -> (Image, Duration) {
        let before = thread_time();
        let rendering = render(self.view(), estimator, Budget::Spp(spp), points, &AtomicBool::new(false), &|_| {});
        (rendering.surfaces, thread_time() - before)
    }

    /// The estimator of a name.
    fn estimator(&self, name: &str) -> Result<Box<dyn Estimator>, Box<dyn Error>> {
        if let Some(parameters) = name.strip_prefix("cache:") {
            let cache = MapCache::new(&self.view(), parameters.parse()?);
            eprintln!("{name}: {:.1} MB", cache.bytes() as f64 / 1e6);
            let sampler = Covering::new(OneSampleMis::new(cache, BrdfSampler))?;
            return Ok(Box::new(SingleSample::new(sampler, self.environment.clone())));
        }
        let name = name.replace("MAP", self.names.1);
        let mut name = name.replace("TABLE", &self.folder.join("table").display().to_string());
        if let Some(at) = name.find("LEARNED") {
            let digits: String = name[at + 7..].chars().take_while(char::is_ascii_digit).collect();
            let file = self.folder.join("learned");
            self.learn(digits.parse()?)?.write(&file)?;
            name = name.replace(&format!("LEARNED{digits}"), &file.display().to_string());
        }
        let (always, name) = name.strip_prefix("always:").map_or((false, &*name), |name| (true, name));
        let place = Place { scene: Some(&self.scene), memory: self.memory, always };
        Ok(name.parse::<SamplerSpec>()?.build_in(&self.environment, place)?)
    }
}

impl Bench<'_> {
    /// What so many samples per pixel of the view teach.
    fn learn(&self, samples: u32) -> Result<SceneVisibility, Box<dyn Error>> {
        let estimator = LearnedVisibility::new(self.environment.clone(), Detail::Leaves, self.memory)?;
        Ok(learn_visibility(self.view(), &estimator, None, (samples, 77), &AtomicBool::new(false), &|_| {}))
    }
}

fn samples(image: &Image) -> impl Iterator<Item = f32> {
    image.pixels.iter().flatten().copied()
}

fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for number in numbers {
        sum += number;
        count += 1.0;
    }
    sum / count
}

/// The processor time of this thread.
fn thread_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    Duration::from_nanos(text.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(0))
}
