//! `auto`: chooses between `split:4:patches+vis` and `split:3:mis2-comp` by a pilot rendering, which is not
//! part of the picture. In rooms that little light enters, all of it through portals, it chooses
//! `split:4:portals+mis`, which is many times better there (`results/rooms.csv`, staircase).
//!
//! Each candidate renders the same small picture twice, with its own points. Half the squared difference of
//! the two estimates the candidate's error; its efficiency is 1 / (error x cost^a), where errors fall as
//! samples^-a. Costs are not timed but taken from [`COSTS`], so that the choice for a budget of samples depends on
//! the view and the number of samples alone. For a budget of seconds, the clock also determines the samples of
//! the pilot. The sampler is fixed after the choice, so the picture is as unbiased as with either candidate.

use std::{sync::atomic::AtomicBool, time::Instant};

use headtail_render::{
    brdf::{BrdfTable, Surface},
    estimator::{Estimator, LearnedVisibility},
    integrator::{Rendering, View, learn_visibility},
    points::PointSet,
    portals::{Portal, Portals, openness},
    spec::SamplerSpec,
};

use crate::{Budget, OpenedView, Result};

/// Directions of patches and portals, and pairs of compensated MIS. Where edges and textures make most of the noise, two
/// pairs are best; where light does, four.
const DIRECTIONS: u32 = 4;
const PAIRS: u32 = 3;
/// The largest fraction of a budget that a pilot takes.
const FRACTION: f64 = 0.06;
/// Picture pixels per pilot pixel, along each side.
const COARSENESS: usize = 8;
/// Samples per pixel of the pilot; the most that fit are taken. With 2, fireflies decide too often; 16 decide
/// hardly better than 8.
const SAMPLES: [u32; 2] = [8, 4];
/// Seeds of the pilot, which users are unlikely to choose.
const SEEDS: [u64; 2] = [0x7069_6c6f_7431, 0x7069_6c6f_7432];
/// Fraction of pixels with the greatest differences that is excluded, so that no single pixel decides.
const TRIMMED: f64 = 0.01;
/// Factor by which the first candidate must seem better than the second: it learns visibility for the picture, which
/// the pilot does not count.
const MARGIN: f64 = 1.04;
/// The exponent by which errors fall with the number of samples: near the median of `results/equal-time.csv` for
/// low-discrepancy points.
const FALL: f64 = 1.4;
/// Fraction of the most light that a candidate saw, below which a candidate has missed light: its error says
/// nothing.
const MISSED: f64 = 0.5;
/// Cost of preparing the second candidate beside the first, in samples of `mis` per texel of the map.
const PREPARATION: f64 = 0.15;
/// The largest fraction of a room's rays that reaches the environment, and the least coverage of portals, for
/// which `split:4:portals+mis` is chosen. In more open rooms it is about as good as the others; light that misses
/// portals is found by few samples.
const OPEN: f32 = 0.02;
const COVERED: f32 = 0.98;
/// Strides through the paths that estimate openness and coverage.
const STEPS: [usize; 2] = [16, 4];
/// Cost of finding portals and preparing their sampler, in samples of `mis`, and the largest fraction of a budget
/// that it takes: with portals, the error is smaller by more than the samples that this takes away.
const SEARCH: f64 = 1.2e6;
const SEARCH_FRACTION: f64 = 0.5;
/// Thread-seconds per sample of `mis`: converts a budget of seconds into samples before anything is timed.
const SECONDS_PER_SAMPLE: f64 = 2.6e-7;
/// Cost of a point of visibility training, in samples of `mis`.
const LEARNED_POINT: f64 = 8.0;
/// GGX width below which lobes are narrow.
const NARROW: f32 = 0.2;

/// Kind of surface, by the cost of a sample on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SurfaceClass {
    Diffuse,
    Glossy,
    Narrow,
    MetallicRoughness,
    Other,
}

/// Time of a sample relative to one of `mis` on the same surfaces, for `split:4:patches+vis` and
/// `split:3:mis2-comp`: near the medians of `results/equal-time.csv` by surface.
const COSTS: [(SurfaceClass, [f64; 2]); 5] = [
    (SurfaceClass::Diffuse, [3.4, 3.0]),
    (SurfaceClass::Glossy, [3.8, 2.9]),
    (SurfaceClass::Narrow, [4.6, 2.9]),
    (SurfaceClass::MetallicRoughness, [4.1, 3.1]),
    (SurfaceClass::Other, [4.3, 3.1]),
];

/// Result of a candidate in the pilot.
#[derive(Clone, Debug)]
pub struct Trial {
    /// SPEC of the candidate.
    pub spec: SamplerSpec,
    /// Mean squared error of the pilot's picture, without its worst pixels.
    pub error: f64,
    /// Mean of the same pixels.
    pub light: f64,
    /// Time of a sample relative to one of `mis`.
    pub cost: f64,
    /// The exponent by which errors fall with the number of samples.
    pub fall: f64,
}

impl Trial {
    /// The error in a given time, up to a factor.
    fn price(&self) -> f64 {
        self.error * self.cost.powf(self.fall)
    }

    /// Whether the candidate saw so much less light than another that its error says nothing.
    fn missed_light(&self, trials: &[Self]) -> bool {
        self.light < MISSED * trials.iter().map(|trial| trial.light).fold(0.0, f64::max)
    }

    /// Returns the efficiency relative to the best of the trials, at most 1; `None` if this one missed light that
    /// another saw.
    pub fn efficiency(&self, trials: &[Self]) -> Option<f64> {
        let best =
            trials.iter().filter(|trial| !trial.missed_light(trials)).map(Self::price).fold(f64::INFINITY, f64::min);
        // Errors can be 0, as under uniform light.
        (!self.missed_light(trials)).then(|| if self.price() > best { best / self.price() } else { 1.0 })
    }
}

/// The sampler chosen for a view.
pub struct Choice {
    /// The chosen SPEC; rendering with it gives the same picture to the bit.
    pub spec: SamplerSpec,
    /// Estimator of the chosen SPEC.
    pub estimator: Box<dyn Estimator>,
    /// Pilot results, the first candidate first; empty if a fixed rule decided.
    pub trials: Vec<Trial>,
    /// What decided.
    pub reason: &'static str,
    /// Seconds of choice and preparation.
    pub seconds: f64,
}

/// Chooses the sampler of a view for a budget.
///
/// # Errors
/// If a candidate cannot be prepared.
pub fn choose(view: &OpenedView, budget: Budget, stop: &AtomicBool) -> Result<Choice> {
    let start = Instant::now();
    let by_rule = |spec, estimator, reason| {
        Ok(Choice { spec, estimator, trials: Vec::new(), reason, seconds: start.elapsed().as_secs_f64() })
    };
    if let Some(portals) = portals(view, budget) {
        let spec = SamplerSpec::split_portals(DIRECTIONS);
        let estimator = view.estimator_through(&portals, &spec)?;
        return by_rule(spec, estimator, "little light enters, through portals");
    }
    let fractions = classes(view);
    let costs = [0, 1].map(|k| COSTS.iter().map(|(class, costs)| fractions[*class as usize] * costs[k]).sum::<f64>());
    let spec = SamplerSpec::split_patches_with_visibility(DIRECTIONS);
    let small = view.resized(COARSENESS);
    let pixels = (small.view().width * small.view().height) as f64;
    let texels = (view.environment.width() * view.environment.height()) as f64;
    // Cost of a pilot in samples of `mis`.
    let pilot_cost = |samples: u32| 2.0 * f64::from(samples) * pixels * (costs[0] + costs[1]) + PREPARATION * texels;
    // The picture takes at least as long as with the cheaper candidate.
    let affordable = |seconds_per_sample: f64| {
        let most = FRACTION * samples_of(view, budget, costs[0].min(costs[1]), seconds_per_sample);
        SAMPLES.into_iter().find(|&samples| pilot_cost(samples) <= most)
    };
    const TOO_SMALL: &str = "the budget is too small for a pilot";
    let patches = || -> Result<LearnedVisibility> { Ok(view.patches_with_visibility()?.with_directions(DIRECTIONS)?) };
    if affordable(SECONDS_PER_SAMPLE).is_none() {
        return by_rule(spec, Box::new(patches()?), TOO_SMALL);
    }
    let compensated = SamplerSpec::compensated_pairs(PAIRS);
    let (patches, pairs) = rayon::join(patches, || view.estimator(&compensated));
    let (patches, pairs) = (patches?, pairs?);
    // Larger than the pilot, which has too few pixels to match the training of the picture.
    let learning = view.resized(COARSENESS / 2);
    let begun = Instant::now();
    let learned = learn_visibility(learning.view(), &patches, None, (1, SEEDS[0]), stop, &|_| {});
    let points = (learning.view().width * learning.view().height) as f64;
    let thread_seconds = begun.elapsed().as_secs_f64() * rayon::current_num_threads() as f64;
    let Some(samples) = affordable(thread_seconds / (LEARNED_POINT * points)) else {
        return by_rule(spec, Box::new(patches), TOO_SMALL);
    };
    let informed = patches.clone().with_precomputed(&learned)?;
    let fall = if view.points(0).set() == PointSet::Independent { 1.0 } else { FALL };
    let trial = |spec: SamplerSpec, cost: f64, estimator: &dyn Estimator| {
        let [error, light] = error_and_light(&small, estimator, samples, stop);
        Trial { spec, error, light, cost, fall }
    };
    let trials = vec![trial(spec, costs[0], &informed), trial(compensated, costs[1], &*pairs)];
    let chosen = best_of(&trials);
    let estimator = if chosen == 0 { Box::new(patches) as Box<dyn Estimator> } else { pairs };
    let (spec, reason) = (trials[chosen].spec.clone(), "efficiency in a pilot");
    Ok(Choice { spec, estimator, trials, reason, seconds: start.elapsed().as_secs_f64() })
}

/// Returns the portals of a room that little light enters, if they cover it, and the budget allows for the search.
fn portals(view: &OpenedView, budget: Budget) -> Option<Vec<Portal>> {
    let View { scene, camera, .. } = view.view();
    // A sample costs about as much as one of `mis` for each of its directions.
    let affordable = SEARCH_FRACTION * samples_of(view, budget, f64::from(DIRECTIONS), SECONDS_PER_SAMPLE);
    // Without shadow rays all light passes through walls.
    if view.unshadowed || SEARCH > affordable || openness(scene, camera, STEPS[0]) > OPEN {
        return None;
    }
    let found = Portals::find(scene, camera).ok()?;
    need_no_pilot(&found, found.coverage(scene, camera, STEPS[1])).then_some(found.portals)
}

/// Returns whether portals of this coverage are chosen without a pilot: little light enters the room, all of it through
/// them.
pub fn need_no_pilot(found: &Portals, coverage: f32) -> bool {
    found.openness <= OPEN && coverage >= COVERED
}

/// Returns the index of the most efficient candidate that missed no light; the first one must be better by
/// [`MARGIN`].
fn best_of(trials: &[Trial]) -> usize {
    let price = |k: usize| trials[k].price() * if k == 0 { MARGIN } else { 1.0 };
    let eligible = (0..trials.len()).filter(|&k| !trials[k].missed_light(trials));
    eligible.min_by(|&a, &b| price(a).total_cmp(&price(b))).unwrap_or(0)
}

/// Converts a budget to samples of `mis` over all pixels. A sample of the picture costs `cost` of them, and one of
/// them takes `seconds_per_sample` of one thread.
fn samples_of(view: &OpenedView, budget: Budget, cost: f64, seconds_per_sample: f64) -> f64 {
    let part = view.part();
    match budget {
        Budget::Samples(samples) => cost * f64::from(samples) * (part.width * part.height) as f64,
        Budget::Seconds(seconds) => seconds * rayon::current_num_threads() as f64 / seconds_per_sample,
    }
}

/// Returns the fraction of visible surface in each class.
fn classes(view: &OpenedView) -> [f64; COSTS.len()] {
    let small = view.resized(4 * COARSENESS);
    let (seen, mut counts) = (small.view(), [0.0; COSTS.len()]);
    for y in 0..seen.height {
        for x in 0..seen.width {
            let ray = seen.camera.ray(x as f32 + 0.5, y as f32 + 0.5, seen.width, seen.height);
            if let Some(at) = seen.scene.intersect(&ray) {
                counts[class_of(&at.surface) as usize] += 1.0;
            }
        }
    }
    let all: f64 = counts.iter().sum();
    // Without visible surfaces, the class does not matter.
    if all == 0.0 { [1.0, 0.0, 0.0, 0.0, 0.0] } else { counts.map(|count| count / all) }
}

fn class_of(surface: &Surface) -> SurfaceClass {
    match surface.brdf {
        BrdfTable::LAMBERT => SurfaceClass::Diffuse,
        // The first parameter is the width.
        BrdfTable::GGX if surface.parameters[0] < NARROW => SurfaceClass::Narrow,
        BrdfTable::GGX => SurfaceClass::Glossy,
        BrdfTable::METALLIC_ROUGHNESS => SurfaceClass::MetallicRoughness,
        _ => SurfaceClass::Other,
    }
}

/// Returns half the mean squared difference of two pilots, and their mean, without the worst pixels.
fn error_and_light(small: &OpenedView, estimator: &dyn Estimator, samples: u32, stop: &AtomicBool) -> [f64; 2] {
    let budget = Budget::Samples(samples);
    let [a, b]: [Rendering; 2] = SEEDS.map(|seed| small.render(estimator, budget, small.points(seed), stop, &|_| {}));
    let of_pixel = |(a, b): (&[f32; 3], &[f32; 3])| -> [f64; 2] {
        let square = (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 6.0;
        [square, (0..3).map(|c| f64::from(a[c]) + f64::from(b[c])).sum::<f64>() / 6.0]
    };
    let mut pixels: Vec<[f64; 2]> = a.surfaces.pixels.iter().zip(&b.surfaces.pixels).map(of_pixel).collect();
    pixels.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let kept = pixels.len() - (TRIMMED * pixels.len() as f64) as usize;
    [0, 1].map(|k| pixels[..kept].iter().map(|pixel| pixel[k]).sum::<f64>() / kept as f64)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Vec3, Vec3A};
    use headtail_render::{
        environment::Environment,
        scene::{Camera, Material, Mesh, Scene},
    };

    use super::*;
    use crate::{CameraSettings, Record, Store, ViewSettings};

    fn opened(scene: &str, env: &str, material: Option<&str>) -> OpenedView {
        let mut settings = ViewSettings::new(scene, env, CameraSettings::of_size(128, 96));
        settings.material = material.map(|material| material.parse().unwrap());
        settings.open().unwrap()
    }

    #[test]
    fn choice_depends_only_on_view_and_samples() {
        let view = opened("dishes", "studio", Some("lambert"));
        let choice = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| choose(&view, Budget::Samples(512), &AtomicBool::new(false)).unwrap())
        };
        let (one, two) = (choice(1), choice(2));
        assert_eq!((one.spec, one.trials.len()), (two.spec, 2));
        for (a, b) in one.trials.iter().zip(&two.trials) {
            assert_eq!((a.error.to_bits(), a.cost), (b.error.to_bits(), b.cost));
        }
    }

    #[test]
    fn candidates_that_miss_light_are_not_chosen() {
        let spec: SamplerSpec = "mis".parse().unwrap();
        let trial = |error: f64, light: f64, cost: f64| Trial { spec: spec.clone(), error, light, cost, fall: 1.0 };
        let efficiencies =
            |trials: &[Trial]| -> Vec<Option<f64>> { trials.iter().map(|trial| trial.efficiency(trials)).collect() };
        // The first one saw nothing.
        let trials = [trial(0.0, 0.0, 3.0), trial(2.0, 1.0, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (1, vec![None, Some(1.0)]));
        let trials = [trial(2.0, 1.0, 3.0), trial(0.0, 0.4, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (0, vec![Some(1.0), None]));
        // A uniform sky, in which both are exact, or one is.
        let trials = [trial(0.0, 1.0, 3.0), trial(0.0, 1.0, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (0, vec![Some(1.0), Some(1.0)]));
        let trials = [trial(0.1, 1.0, 3.0), trial(0.0, 1.0, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (1, vec![Some(0.0), Some(1.0)]));
        // Nothing is lit.
        let trials = [trial(0.0, 0.0, 3.0), trial(0.0, 0.0, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (0, vec![Some(1.0), Some(1.0)]));
        let trials = [trial(1.0, 1.0, 3.0), trial(1.0, 0.9, 2.0)];
        assert_eq!((best_of(&trials), efficiencies(&trials)), (1, vec![Some(2.0 / 3.0), Some(1.0)]));
    }

    #[test]
    fn small_budgets_have_no_pilot() {
        let view = opened("sphere", "studio", None);
        let choice = choose(&view, Budget::Samples(1), &AtomicBool::new(false)).unwrap();
        assert!(choice.trials.is_empty() && choice.spec.to_string() == "split:4:patches+vis");
    }

    /// A closed box of 4 x 3 x 4 m with a square hole in its ceiling.
    fn room(hole: f32) -> OpenedView {
        let (low, high) = (Vec3::new(-2.0, 0.0, -2.0), Vec3::new(2.0, 3.0, 2.0));
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| axis * (high - low));
        let mut positions = Vec::new();
        let mut add =
            |corner: Vec3, u: Vec3, v: Vec3| positions.extend([corner, corner + u, corner + u + v, corner + v]);
        for [u, v] in [[x, z], [x, y], [y, z]] {
            add(low, u, v);
        }
        add(low + z, x, y);
        add(low + x, y, z);
        // The ceiling around the hole.
        let (ceiling, rest) = (low + y, 0.5 * (1.0 - hole / 4.0));
        add(ceiling, rest * x, z);
        add(ceiling + (1.0 - rest) * x, rest * x, z);
        add(ceiling + rest * x, (1.0 - 2.0 * rest) * x, rest * z);
        add(ceiling + rest * x + (1.0 - rest) * z, (1.0 - 2.0 * rest) * x, rest * z);
        let triangles = (0..positions.len() as u32).step_by(4).flat_map(|k| [[k, k + 1, k + 2], [k, k + 2, k + 3]]);
        let mesh = Mesh::new(positions, Vec::new(), Vec::new(), triangles.collect(), 0).unwrap();
        let scene = Scene::new("room", vec![mesh], vec![Material::diffuse(Vec3A::splat(0.5))], None).unwrap();
        let camera = Camera::new(Vec3A::new(-1.5, 1.2, -1.5), Vec3A::new(1.0, 0.8, 1.0), 60.0).unwrap();
        let environment = Arc::new(Environment::open("studio").unwrap());
        OpenedView::new(Arc::new(scene), camera, environment, (128, 96))
    }

    #[test]
    fn portals_of_small_openings_need_no_pilot_and_are_the_same_by_name() {
        let (view, stop) = (room(0.5), AtomicBool::new(false));
        let choice = choose(&view, Budget::Samples(512), &stop).unwrap();
        assert_eq!((choice.spec.to_string().as_str(), choice.trials.len()), ("split:4:portals+mis", 0));
        let budget = Budget::Samples(2);
        let picture =
            |estimator: &dyn Estimator| view.render(estimator, budget, view.points(1), &stop, &|_| {}).surfaces;
        let by_name = picture(&*view.estimator(&choice.spec).unwrap());
        assert!(by_name.pixels.iter().any(|pixel| pixel[0] > 0.0));
        assert_eq!(picture(&*choice.estimator).pixels, by_name.pixels);
        let larger = choose(&room(2.2), Budget::Samples(512), &stop).unwrap();
        assert_ne!(larger.spec, choice.spec);
        let mut unshadowed = view.clone();
        unshadowed.unshadowed = true;
        let unshadowed = choose(&unshadowed, Budget::Samples(512), &stop).unwrap();
        assert_ne!(unshadowed.spec, choice.spec);
    }

    /// Returns the measurements that [`COSTS`] and [`FALL`] are taken from.
    fn measured() -> Vec<Record> {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../results");
        Store::new(&folder).records("equal-time").unwrap()
    }

    fn median(mut numbers: Vec<f64>) -> Option<f64> {
        numbers.sort_by(f64::total_cmp);
        numbers.get(numbers.len() / 2).copied()
    }

    const CANDIDATES: [&str; 2] = ["split:4:patches+vis", "split:3:mis2-comp"];

    #[test]
    fn costs_match_the_measurements() {
        let rows: Vec<Record> = measured().into_iter().filter(|row| row.budget == "1s").collect();
        let time = |row: &Record| row.seconds / row.spp;
        let surfaces: [&[&str]; 5] = [&["diffuse"], &["glossy"], &["mirror-like"], &["own"], &["measured", "neural"]];
        for ((_, costs), surfaces) in COSTS.into_iter().zip(surfaces) {
            for (stated, spec) in costs.into_iter().zip(CANDIDATES) {
                let of = |mis: &Record| {
                    let is_same = |row: &&Record| row.view() == mis.view() && row.run == mis.run && row.sampler == spec;
                    rows.iter().find(is_same).map(|row| time(row) / time(mis))
                };
                let mis = rows.iter().filter(|row| row.sampler == "mis" && surfaces.contains(&&*row.material));
                let Some(found) = median(mis.filter_map(of).collect()) else { continue };
                let is_near = (stated / found - 1.0).abs() < 0.15;
                assert!(is_near, "{spec} on {surfaces:?} surfaces: {stated}, measured {found:.2}");
            }
        }
    }

    #[test]
    fn errors_fall_as_measured() {
        let rows = measured();
        for spec in CANDIDATES {
            let of = |long: &Record| {
                let is_short = |row: &&Record| {
                    row.view() == long.view() && (&*row.sampler, row.run, &*row.budget) == (spec, long.run, "0.25s")
                };
                let short = rows.iter().find(is_short).filter(|short| long.spp > 1.8 * short.spp)?;
                Some((short.mse / long.mse).ln() / (long.spp / short.spp).ln())
            };
            let long = rows.iter().filter(|row| row.sampler == spec && row.budget == "1s");
            let Some(found) = median(long.filter_map(of).collect()) else { continue };
            assert!((found - FALL).abs() < 0.1, "{spec}: {FALL}, measured {found:.2}");
        }
    }
}
