//! Pictures depend only on the seed and the number of samples, not on threads, budgets, passes or tiles.

use std::{
    sync::atomic::{AtomicUsize, Ordering},
    time::Duration,
};

use super::*;

#[test]
fn pictures_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let environment = Arc::new(built_in("studio").unwrap());
    let scene = Scene::built_in("dishes").unwrap();
    let direct = exported(folder.path(), &environment).pop().unwrap();
    let setting = Setting { scene, environment, unshadowed: false, depth: 1, points: PointSet::Sobol };
    for sampler in [direct, SamplerSpec::ris(4)] {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| setting.render(&sampler, 20, 3))
        };
        let one = with(1);
        for threads in [2, 3] {
            let many = with(threads);
            assert_eq!(bits(&many.surfaces), bits(&one.surfaces), "{sampler} with {threads} threads");
            assert_eq!(bits(&many.background), bits(&one.background), "{sampler} with {threads} threads");
            assert_eq!((many.rays_per_sample, many.max_weight), (one.rays_per_sample, one.max_weight));
        }
        assert_ne!(bits(&setting.render(&sampler, 20, 4).surfaces), bits(&one.surfaces), "the seed must matter");
    }
}

#[test]
fn an_interrupted_rendering_holds_the_finished_passes() {
    let setting = Setting {
        scene: Scene::built_in("temple").unwrap(),
        environment: Arc::new(built_in("overcast").unwrap()),
        unshadowed: false,
        depth: 1,
        points: PointSet::Sobol,
    };
    let (stop, passes) = (AtomicBool::new(false), AtomicUsize::new(0));
    let after_two = |fraction: f64| {
        assert!(fraction > 0.0 && fraction < 1.0);
        if passes.fetch_add(1, Ordering::Relaxed) == 1 {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let interrupted = setting.render_until(&SamplerSpec::mis(), 1 << 20, 6, &stop, &after_two);
    assert_eq!(passes.load(Ordering::Relaxed), 2);
    let whole = setting.render(&SamplerSpec::mis(), interrupted.spp, 6);
    assert_eq!(whole.spp, interrupted.spp);
    assert_eq!(bits(&whole.composite()), bits(&interrupted.composite()));
    // Stopped before the start: one pass, not an image of NaN.
    let first = setting.render_until(&SamplerSpec::mis(), 1 << 20, 6, &AtomicBool::new(true), &|_| {});
    assert!(first.spp > 0 && first.surfaces.pixels.iter().flatten().all(|value| value.is_finite()));
}

#[test]
fn a_budget_of_zero_samples_takes_one() {
    let setting = Setting {
        scene: Scene::built_in("plane").unwrap(),
        environment: Arc::new(built_in("overcast").unwrap()),
        unshadowed: true,
        depth: 1,
        points: PointSet::Sobol,
    };
    let rendering = setting.render(&SamplerSpec::mis(), 0, 1);
    assert_eq!(rendering.spp, 1);
    assert!(rendering.surfaces.pixels.iter().flatten().all(|value| value.is_finite()));
}

/// Returns all numbers of a rendering as bits.
fn all_bits(rendering: &Rendering) -> Vec<u64> {
    let Rendering { surfaces, background, coverage, rays_per_sample, max_weight, .. } = rendering;
    let pixels = surfaces.pixels.iter().chain(&background.pixels).flatten();
    let numbers = pixels.chain(coverage).chain([max_weight]).map(|number| u64::from(number.to_bits()));
    numbers.chain([rays_per_sample.to_bits()]).collect()
}

/// Sizes that are not multiples of a tile (16), mostly not of a block (4); some are smaller than a tile.
const SIZES: [(usize, usize); 4] = [(37, 23), (17, 33), (5, 3), (1, 1)];

#[test]
fn time_and_samples_as_budgets_give_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    let environment = Arc::new(built_in("window").unwrap());
    let direct = exported(folder.path(), &environment).pop().unwrap();
    let scene = Scene::built_in("dishes").unwrap();
    let samplers = [(direct, 1), (SamplerSpec::ris(4), 1), ("mis2".parse().unwrap(), 4)];
    for ((sampler, depth), set) in samplers.into_iter().zip([PointSet::Sobol, PointSet::LATTICE, PointSet::LATTICE]) {
        let estimator = sampler.build(&environment).unwrap();
        for (width, height) in SIZES {
            let (camera, environment) = (scene.camera(), &*environment);
            let view = View { scene: &scene, camera: &camera, environment, width, height, unshadowed: false, depth };
            let render =
                |budget, set| render(view, &*estimator, budget, Points::new(set, 3), &AtomicBool::new(false), &|_| {});
            // Tries longer limits on a busy machine, since a single pass tests nothing.
            let limits = (0..8).map(|k| Duration::from_millis(50 << k));
            let timed = limits.map(|limit| render(Budget::Time(limit), set)).find(|timed| timed.spp > 1);
            let timed = timed.expect("several passes in some seconds");
            assert_eq!(timed.surfaces.pixels.len(), width * height);
            // Names the number of samples that the budget in time was planned for.
            let counted = render(Budget::Spp(timed.spp), timed.points);
            assert_eq!(counted.spp, timed.spp);
            assert_eq!(all_bits(&counted), all_bits(&timed), "{sampler}, {width} x {height}, {} samples", timed.spp);
        }
    }
}

#[test]
fn images_of_any_size_do_not_depend_on_threads() {
    let environment = Arc::new(built_in("window").unwrap());
    let scene = Scene::built_in("temple").unwrap();
    for (sampler, depth, set) in [
        ("mis", 1, PointSet::LATTICE),
        ("ris:5", 3, PointSet::Sobol),
        ("ris:5", 3, PointSet::LATTICE),
        ("brdf", 4, PointSet::Independent),
    ] {
        let points = Points::new(set, 3);
        let estimator = sampler.parse::<SamplerSpec>().unwrap().build(&environment).unwrap();
        for (width, height) in SIZES {
            let (camera, environment) = (scene.camera(), &*environment);
            let view = View { scene: &scene, camera: &camera, environment, width, height, unshadowed: false, depth };
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| render(view, &*estimator, Budget::Spp(18), points, &AtomicBool::new(false), &|_| {}))
            };
            let one = all_bits(&with(1));
            for threads in [2, 3] {
                assert_eq!(all_bits(&with(threads)), one, "{sampler}, {width} x {height}, {threads} threads");
            }
        }
    }
}

/// Tiles and their blocks end at the border, and every pixel belongs to one.
#[test]
fn no_pixel_is_missing_at_any_size() {
    let environment = Arc::new(built_in("overcast").unwrap());
    let scene = Scene::built_in("plane").unwrap();
    let estimator = SamplerSpec::mis().build(&environment).unwrap();
    for (width, height) in SIZES {
        let (camera, environment) = (scene.camera(), &*environment);
        let view = View { scene: &scene, camera: &camera, environment, width, height, unshadowed: false, depth: 1 };
        let rendering = render(
            view,
            &*estimator,
            Budget::Spp(4),
            Points::new(PointSet::Sobol, 3),
            &AtomicBool::new(false),
            &|_| {},
        );
        // Neither the map nor the plane under it is black anywhere.
        let black = rendering.composite().pixels.iter().filter(|pixel| pixel.iter().all(|&value| value <= 0.0)).count();
        assert_eq!(black, 0, "{width} x {height}");
    }
}
