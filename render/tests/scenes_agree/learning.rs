//! Estimators that train visibility before rendering are unbiased for any trained visibility.

use headtail_render::{
    estimator::SingleSample,
    integrator::learn_visibility,
    patches::Detail,
    sampler::{AtPoint, Covering, Sampler},
    statistics::SphereChiSquare,
    visibility::SceneVisibility,
};

use super::*;

fn learned(environment: &Arc<Environment>) -> LearnedVisibility {
    LearnedVisibility::new(environment.clone(), Detail::Leaves, LearnedVisibility::MEMORY).unwrap()
}

#[test]
fn trained_visibility_does_not_depend_on_threads() {
    let environment = Arc::new(built_in("window").unwrap());
    for points in [PointSet::Sobol, PointSet::LATTICE, PointSet::Independent] {
        for depth in [1, 3] {
            let scene = Scene::built_in("bedroom").unwrap();
            let setting = Setting { scene, environment: environment.clone(), unshadowed: false, depth, points };
            let estimator = learned(&environment).always();
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| setting.estimate_until(&estimator, 20, 3, &AtomicBool::new(false), &|_| {}))
            };
            let (one, three) = (with(1), with(3));
            assert_eq!(bits(&one.surfaces), bits(&three.surfaces), "{points}, depth {depth}");
            assert_eq!(one.learned, three.learned);
            assert!(
                one.learned.is_some_and(|size| size.cells > 10 && size.unknown < 0.2 && size.pays),
                "{:?}",
                one.learned
            );
        }
    }
}

#[test]
fn training_does_not_change_pictures_without_shadows() {
    let environment = Arc::new(built_in("window").unwrap());
    let scene = Scene::built_in("plane").unwrap();
    let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
    let plain = setting.render(&SamplerSpec::patches(), 16, 3);
    let learning = setting.estimate_until(&learned(&setting.environment), 16, 3, &AtomicBool::new(false), &|_| {});
    assert!(bits(&plain.surfaces) == bits(&learning.surfaces));
    assert!(learning.learned.is_some_and(|size| size.cells > 10 && !size.pays), "{:?}", learning.learned);
}

#[test]
fn precomputed_visibility_is_used_if_it_pays_or_on_request() {
    let environment = Arc::new(built_in("window").unwrap());
    for (scene, pays) in [("plane", false), ("bedroom", true)] {
        let scene = Scene::built_in(scene).unwrap();
        let setting =
            Setting { scene, environment: environment.clone(), unshadowed: false, depth: 1, points: PointSet::Sobol };
        let informed = learned(&environment).with_precomputed(&learn(&setting, 16, None)).unwrap();
        let render =
            |estimator: &dyn Estimator| setting.estimate_until(estimator, 16, 3, &AtomicBool::new(false), &|_| {});
        let (plain, informed, always) =
            (setting.render(&SamplerSpec::patches(), 16, 3), render(&informed), render(&informed.clone().always()));
        assert_eq!(bits(&plain.surfaces) == bits(&informed.surfaces), !pays);
        assert_eq!(bits(&informed.surfaces) == bits(&always.surfaces), pays);
        let [predicted, forced] = [informed, always].map(|rendering| rendering.learned.unwrap());
        assert!(predicted.pays == pays && forced.pays, "{predicted:?}, {forced:?}");
        assert!((predicted.gain > 1.2) == pays && (predicted.gain >= 1.0), "{predicted:?}");
    }
}

#[test]
fn renderings_are_independent_of_earlier_ones() {
    let environment = Arc::new(built_in("window").unwrap());
    let scene = Scene::built_in("temple").unwrap();
    let setting =
        Setting { scene, environment: environment.clone(), unshadowed: false, depth: 1, points: PointSet::Sobol };
    let estimator = learned(&environment);
    let render = || setting.estimate_until(&estimator, 16, 5, &AtomicBool::new(false), &|_| {}).surfaces;
    assert_eq!(bits(&render()), bits(&render()));
}

/// Returns mean and standard error of the image's mean over renderings of different seeds.
pub fn mean_of(setting: &Setting, estimator: &dyn Estimator, spp: u32, renderings: u64) -> (f64, f64) {
    let means: Vec<f64> = (0..renderings)
        .into_par_iter()
        .map(|seed| {
            let image = setting.estimate_until(estimator, spp, 100 + seed, &AtomicBool::new(false), &|_| {}).surfaces;
            let sum: f64 = image.pixels.iter().flatten().map(|&number| f64::from(number)).sum();
            sum / (3 * image.pixels.len()) as f64
        })
        .collect();
    let moments = Moments::of(&means).unwrap();
    (moments.mean, (moments.variance / means.len() as f64).sqrt())
}

/// Trains visibility for a setting with `samples` samples per pixel.
fn learn(setting: &Setting, samples: u32, before: Option<SceneVisibility>) -> SceneVisibility {
    learn_with(setting, &learned(&setting.environment), samples, before)
}

/// Trains visibility as [`learn`] does, with an estimator.
pub fn learn_with(
    setting: &Setting,
    estimator: &LearnedVisibility,
    samples: u32,
    before: Option<SceneVisibility>,
) -> SceneVisibility {
    let (scene, camera) = (&setting.scene, setting.scene.camera());
    let view = View {
        scene,
        camera: &camera,
        environment: &setting.environment,
        width: WIDTH,
        height: HEIGHT,
        unshadowed: false,
        depth: setting.depth,
    };
    // The seed of one of the renderings, since training uses separate points.
    let of_seed = (samples, 100);
    learn_visibility(view, estimator, before, of_seed, &AtomicBool::new(false), &|_| {})
}

/// Compares the means of scenes with those of `mis`, each from `renderings` renderings of `spp` samples. The
/// standard error of a difference must be below `sharpness` times the mean.
fn means_agree_with_mis(scenes: &[&str], renderings: u64, spp: u32, sharpness: f64) {
    let environment = Arc::new(built_in("studio").unwrap());
    for name in scenes {
        let scene = Scene::built_in(name).unwrap();
        let scene = scene.with_material(Material::diffuse(Vec3A::splat(0.7)));
        let environment = environment.clone();
        let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
        let mis = SamplerSpec::mis().build(&setting.environment).unwrap();
        let (truth, error) = mean_of(&setting, &*mis, 8 * spp, renderings);
        let plain = learned(&setting.environment).always();
        let informed = plain.clone().with_precomputed(&learn(&setting, 16, None)).unwrap();
        for (estimator, kind) in [(plain, "learning"), (informed, "informed")] {
            let (mean, own) = mean_of(&setting, &estimator, spp, renderings);
            let error = error.hypot(own);
            println!("{name}, {kind}: {:.1e} of the mean, error {:.1e}", (mean - truth) / truth, error / truth);
            // One of 12 normal deviates exceeds 4.1 with a probability of 1/2000.
            assert!((mean - truth).abs() < 4.1 * error, "{name}, {kind}: {mean} {truth} +- {error}");
            assert!(error < sharpness * truth, "{name}, {kind}: the test is not sharp, {error} {truth}");
        }
    }
}

#[test]
fn means_agree_with_mis_at_high_and_low_occlusion() {
    means_agree_with_mis(&["bedroom", "droid"], 12, 64, 2e-3);
}

/// Six scenes, precise enough to detect a bias of 5e-5: each takes 10 to 30 minutes of one core, the diorama
/// 45.
macro_rules! means_agree_with_mis_sharply {
    ($($scene:ident: $renderings:literal of $spp:literal,)*) => {
        mod sharply {
            $(
                #[test]
                #[ignore = "takes minutes"]
                fn $scene() {
                    super::means_agree_with_mis(&[stringify!($scene)], $renderings, $spp, 5e-5);
                }
            )*
        }
    };
}

means_agree_with_mis_sharply! {
    temple: 48 of 1024,
    dishes: 48 of 512,
    diorama: 48 of 512,
    droid: 48 of 512,
    bedroom: 32 of 2048,
    cloth: 48 of 512,
}

#[test]
fn precomputed_visibility_survives_a_file_and_lowers_the_error() {
    let environment = Arc::new(built_in("studio").unwrap());
    let scene = Scene::built_in("bedroom").unwrap().with_material(Material::diffuse(Vec3A::splat(0.7)));
    let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bedroom.visibility");
    let first = learn(&setting, 4, None);
    first.write(&file).unwrap();
    let bytes = std::fs::read(&file).unwrap();
    let again = SceneVisibility::read(&file).unwrap();
    again.write(&file).unwrap();
    assert!(std::fs::read(&file).unwrap() == bytes, "what is read is what was written");
    // Training resumes.
    let (rays, cells) = (again.rays(), again.cells());
    let more = learn(&setting, 28, Some(again));
    assert!(more.rays() > 5 * rays && more.cells() >= cells, "{} {}", more.rays(), more.cells());
    more.write(&file).unwrap();

    let spec: SamplerSpec = format!("patches+vis:{}", file.display()).parse().unwrap();
    let context = BuildContext { scene: Some(&setting.scene), ..BuildContext::default() };
    let error = |estimator: &dyn Estimator| mean_square_error(&setting, estimator);
    let informed = error(&*spec.build_in(&setting.environment, context).unwrap());
    let plain = error(&*SamplerSpec::patches().build(&setting.environment).unwrap());
    // The ratio is above 2 at this size; pictures of other seeds differ by 10 %.
    assert!(1.5 * informed < plain, "{informed} {plain}");

    // As a sampler with a pdf, which needs no scene.
    let sampler = spec.build_sampler(&setting.environment).unwrap();
    let single = SingleSample::new(Covering::new(sampler.clone()).unwrap(), setting.environment.clone());
    assert!((error(&single) / informed - 1.0).abs() < 0.2, "{} {informed}", error(&single));
    draws_follow_pdf(&setting, &*sampler);

    // A different scene, a different map, too little memory, no scene.
    let refused = |spec: &SamplerSpec, environment: &Arc<Environment>, context: BuildContext<'_>| {
        spec.build_in(environment, context).err().expect("refused").to_string()
    };
    let temple = Scene::built_in("temple").unwrap();
    let other_scene = refused(&spec, &setting.environment, BuildContext { scene: Some(&temple), ..context });
    assert!(other_scene.contains("in another scene"), "{other_scene}");
    let other_map = refused(&spec, &Arc::new(built_in("window").unwrap()), context);
    assert!(other_map.contains("another map, studio"), "{other_map}");
    let little = refused(&spec, &setting.environment, BuildContext { memory: 100_000, ..context });
    assert!(little.contains("MB are allowed"), "{little}");
    let nowhere = refused(&spec, &setting.environment, BuildContext::default());
    assert!(nowhere.contains("no scene is given"), "{nowhere}");
}

/// Compares draws at points of a scene with the sampler's pdf.
fn draws_follow_pdf(setting: &Setting, sampler: &dyn Sampler) {
    let camera = setting.scene.camera();
    let points: Vec<_> = [(10.0, 8.0), (24.0, 20.0), (40.0, 28.0)]
        .into_iter()
        .filter_map(|(x, y)| setting.scene.intersect(&camera.ray(x, y, WIDTH, HEIGHT)))
        .collect();
    assert_eq!(points.len(), 3, "all points see a surface");
    for point in &points {
        let bound = AtPoint::new(sampler, point);
        let draw = |random: &mut Stream, count: usize| {
            let u: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
            bound.sample_many(&u).into_iter().map(|drawn| Some(drawn?.wi)).collect()
        };
        // Points as dense as the map's texels: the borders of lamps lie within cells.
        let (rows, subcells, samples) = (25, 20, 200_000);
        let test = SphereChiSquare { rows, subcells, samples, tests: points.len(), ..SphereChiSquare::default() };
        let report = test.run(draw, |wi| bound.pdf_many(wi));
        assert!(report.passed(), "{report}");
    }
}

/// Returns the variance of pictures: half the mean squared difference of two pairs of different seeds.
fn mean_square_error(setting: &Setting, estimator: &dyn Estimator) -> f64 {
    let picture = |seed| setting.estimate_until(estimator, 16, seed, &AtomicBool::new(false), &|_| {}).surfaces;
    let pairs = [[1, 2], [3, 4]].map(|pair| pair.map(picture));
    let differences = pairs.iter().flat_map(|[a, b]| a.pixels.iter().flatten().zip(b.pixels.iter().flatten()));
    let squares: Vec<f64> = differences.map(|(a, b)| f64::from(a - b).powi(2) / 2.0).collect();
    squares.iter().sum::<f64>() / squares.len() as f64
}

#[test]
fn damaged_files_of_visibility_are_refused() {
    let environment = Arc::new(built_in("studio").unwrap());
    let scene = Scene::built_in("plane").unwrap();
    let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("plane.visibility");
    learn(&setting, 1, None).write(&file).unwrap();
    let bytes = std::fs::read(&file).unwrap();
    let read = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        SceneVisibility::read(&file)
    };
    for length in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        let error = read(&bytes[..length]).expect_err("a cut file is read").to_string();
        assert!(error.contains("plane.visibility") && !error.contains('\n'), "{error}");
    }
    // Any damaged byte gives an error or other numbers, never a panic, and never more cells than the file
    // has.
    let cells = read(&bytes).unwrap().cells();
    let mut random = Stream::new(3, Purpose::Weights, 0);
    let estimator = learned(&setting.environment);
    for _ in 0..300 {
        let mut damaged = bytes.clone();
        for _ in 0..3 {
            // Files consist mostly of counts; half of the damage goes into the bytes before them.
            let range = if random.uniform() < 0.5 { 2000.min(bytes.len()) } else { bytes.len() };
            let at = ((random.uniform() * range as f32) as usize).min(range - 1);
            damaged[at] = (random.uniform() * 256.0) as u8;
        }
        if let Ok(visibility) = read(&damaged) {
            assert!(visibility.cells() <= cells);
            let _ = estimator.clone().with_precomputed(&visibility);
        }
    }
}
