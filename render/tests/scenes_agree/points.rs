//! All kinds of points give the same mean, and with Sobol points MSE falls faster than with independent ones; lattices have the least.

use super::*;

pub(super) fn setting(scene: &str, map: &str, unshadowed: bool, depth: u32, points: PointSet) -> Setting {
    let (scene, environment) = (Scene::built_in(scene).unwrap(), Arc::new(built_in(map).unwrap()));
    Setting { scene, environment, unshadowed, depth, points }
}

/// Returns the moments of the surfaces' mean luminance over `runs` renderings with different seeds.
fn means(setting: &Setting, sampler: &SamplerSpec, spp: u32, runs: u64, first: u64) -> Moments {
    let estimator = sampler.build(&setting.environment).unwrap();
    let mean = |seed| {
        let image = setting.estimate_until(&*estimator, spp, seed, &AtomicBool::new(false), &|_| {}).surfaces;
        image.pixels.iter().map(|&pixel| f64::from(luminance(pixel.into()))).sum::<f64>() / image.pixels.len() as f64
    };
    Moments::of(&(first..first + runs).map(mean).collect::<Vec<_>>()).unwrap()
}

#[test]
fn every_kind_of_points_gives_the_same_mean() {
    const RUNS: u64 = 64;
    let cases = [("mis", 1, 1), ("mis2", 1, 1), ("ris:5", 1, 1), ("ris:4", 3, 1), ("mis", 1, 4), ("patches", 1, 1)];
    // Runs are independent; pixels need not be. 6 cases x 3 kinds.
    let significance = sidak(SIGNIFICANCE, 18);
    for (sampler, spp, depth) in cases {
        let spec: SamplerSpec = sampler.parse().unwrap();
        let of = |points, first| means(&setting("dishes", "window", false, depth, points), &spec, spp, RUNS, first);
        let independent = of(PointSet::Independent, 1000);
        // Sobol, lattices of the samples there are, and of a different number.
        for points in [PointSet::Sobol, PointSet::Lattice { samples: spp }, PointSet::Lattice { samples: 3 }] {
            let test = TTest::welch(&independent, &of(points, 0));
            assert!(test.p_value > significance, "{sampler}, depth {depth}, {points}: {test:?}");
        }
    }
}

/// Returns the mean squared error over pixels: half of the mean squared difference of two runs with the same
/// mean.
pub(super) fn error(setting: &Setting, sampler: &SamplerSpec, spp: u32) -> f64 {
    let [a, b] = [1, 2].map(|seed| setting.render(sampler, spp, seed).surfaces);
    let squares = a.pixels.iter().flatten().zip(b.pixels.iter().flatten()).map(|(a, b)| f64::from(a - b).powi(2));
    0.5 * squares.sum::<f64>() / (3 * a.pixels.len()) as f64
}

/// The exponent of MSE from 4 to 256 samples per pixel, on smooth integrands: no shadows, surfaces without
/// edges in most pixels.
#[test]
fn mse_falls_faster_with_sobol_points_than_with_independent_ones_and_is_lower_with_lattices() {
    for sampler in ["brdf", "emitter", "mis", "mis2", "ris:4", "patches"] {
        let spec: SamplerSpec = sampler.parse().unwrap();
        let slope = |points| {
            let setting = setting("cloth", "overcast", true, 1, points);
            (error(&setting, &spec, 256) / error(&setting, &spec, 4)).ln() / 64.0_f64.ln()
        };
        let [independent, sobol] = [PointSet::Independent, PointSet::Sobol].map(slope);
        // The expected exponent is -1. MSE over 3,000 numbers is precise to some 3 %, the exponent to 0.01,
        // or 0.03 with heavy tails.
        assert!((independent + 1.0).abs() < 0.1, "{sampler}: {independent}");
        // Measured: brdf -1.70, emitter -1.73, mis -1.84, mis2 -1.66, ris:4 -1.47.
        assert!(sobol < -1.3, "{sampler}: {sobol}");
        // At 22 samples, not a power of two, lattices have less error than Sobol's sequence.
        let error = |points| error(&setting("cloth", "overcast", true, 1, points), &spec, 22);
        let [sobol, lattice] = [PointSet::Sobol, PointSet::LATTICE].map(error);
        assert!(lattice < sobol, "{sampler}: {lattice}, {sobol}");
    }
}
