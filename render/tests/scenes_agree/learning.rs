//! Estimators that learn visibility while they render: the mean stays, whatever they have learned.

use headtail_render::{
    estimator::LearnedVisibility,
    patches::{Detail, PatchSampler},
    sampler::EnvironmentLight,
    tail::TailKind,
};

use super::*;

fn learned(environment: &Arc<Environment>) -> LearnedVisibility {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical).unwrap();
    let patches = PatchSampler::new(light, Detail::Leaves).unwrap();
    LearnedVisibility::new(patches, environment.clone(), 64 << 20).unwrap()
}

#[test]
fn what_is_learned_depends_on_no_thread() {
    let environment = Arc::new(built_in("window").unwrap());
    for points in [PointSet::Sobol, PointSet::zsobol(20), PointSet::Independent] {
        for depth in [1, 3] {
            let scene = Scene::built_in("bedroom").unwrap();
            let setting = Setting { scene, environment: environment.clone(), unshadowed: false, depth, points };
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| setting.render(&"patches+vis".parse().unwrap(), 20, 3))
            };
            let (one, three) = (with(1), with(3));
            assert_eq!(bits(&one.surfaces), bits(&three.surfaces), "{points}, depth {depth}");
            assert_eq!(one.learned, three.learned);
            assert!(one.learned.is_some_and(|size| size.cells > 10 && size.unknown < 0.2), "{:?}", one.learned);
        }
    }
}

#[test]
fn nothing_stays_from_one_rendering_to_the_next() {
    let environment = Arc::new(built_in("window").unwrap());
    let scene = Scene::built_in("temple").unwrap();
    let setting =
        Setting { scene, environment: environment.clone(), unshadowed: false, depth: 1, points: PointSet::Sobol };
    let estimator = learned(&environment);
    let render = || setting.estimate_until(&estimator, 16, 5, &AtomicBool::new(false), &|_| {}).surfaces;
    assert_eq!(bits(&render()), bits(&render()));
}

/// Mean and standard error of the image's mean over renderings of different seeds.
fn mean_of(setting: &Setting, estimator: &dyn Estimator, renderings: u64) -> (f64, f64) {
    let means: Vec<f64> = (0..renderings)
        .map(|seed| {
            let image = setting.estimate_until(estimator, 64, 100 + seed, &AtomicBool::new(false), &|_| {}).surfaces;
            let sum: f64 = image.pixels.iter().flatten().map(|&number| f64::from(number)).sum();
            sum / (3 * image.pixels.len()) as f64
        })
        .collect();
    let moments = Moments::of(&means).unwrap();
    (moments.mean, (moments.variance / means.len() as f64).sqrt())
}

#[test]
fn the_mean_over_many_short_renderings_stays() {
    let environment = Arc::new(built_in("studio").unwrap());
    let scene = Scene::built_in("temple").unwrap();
    let setting =
        Setting { scene, environment: environment.clone(), unshadowed: false, depth: 1, points: PointSet::Sobol };
    let plain = SamplerSpec::patches().build(&environment).unwrap();
    let (truth, error) = mean_of(&setting, &*plain, 60);
    let (mean, own) = mean_of(&setting, &learned(&environment), 60);
    let error = error.hypot(own);
    // A standard normal number is beyond 3.5 once in 2000 times. That the test is sharp is a matter of the error: below 1e-3 of the mean.
    assert!((mean - truth).abs() < 3.5 * error, "{mean} {truth} +- {error}");
    assert!(error < 1e-3 * truth, "{error} {truth}");
}
