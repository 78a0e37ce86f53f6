//! Properties of the numbers themselves. Rendering tests check that estimates are unbiased and converge.

use super::*;

const SETS: [PointSet; 4] =
    [PointSet::Sobol, PointSet::LATTICE, PointSet::Lattice { samples: 22 }, PointSet::Independent];

fn numbers(set: PointSet, seed: u64, key: u32, sample: u32, dimension: Dimension, bounce: u32) -> [f32; 4] {
    let mut out = [[[0.0; LANES]; 1]; 4];
    let [a, b, c, d] = &mut out;
    Points::new(set, seed).at_sample(sample).at_bounce(bounce).draw_keyed(dimension, 1, |_| key, [a, b, c, d]);
    out.map(|column| column[0][0])
}

fn candidate(technique: u32, index: u32, of: u32) -> Dimension {
    Dimension::Candidate { technique, index, of }
}

#[test]
fn numbers_depend_on_every_part_of_the_address() {
    for set in SETS {
        let all = [
            numbers(set, 1, 0, 0, Dimension::Light(0), 0),
            numbers(set, 2, 0, 0, Dimension::Light(0), 0),
            numbers(set, 1 << 40, 0, 0, Dimension::Light(0), 0),
            numbers(set, 1, 1, 0, Dimension::Light(0), 0),
            numbers(set, 1, 0, 1, Dimension::Light(0), 0),
            numbers(set, 1, 0, 0, Dimension::Camera, 0),
            numbers(set, 1, 0, 0, Dimension::Path, 0),
            numbers(set, 1, 0, 0, Dimension::Light(1), 0),
            numbers(set, 1, 0, 0, candidate(0, 0, 2), 0),
            numbers(set, 1, 0, 0, candidate(0, 1, 2), 0),
            numbers(set, 1, 0, 0, candidate(1, 0, 2), 0),
            numbers(set, 1, 0, 0, Dimension::Light(0), 1),
        ];
        for (k, a) in all.iter().enumerate() {
            assert!(all[..k].iter().all(|b| a[..2].iter().zip(&b[..2]).all(|(a, b)| a != b)), "{set}: {k}");
        }
    }
}

/// When a set or a scrambling is exhausted, another one follows.
#[test]
fn points_do_not_repeat() {
    let first = |set, sample, dimension| numbers(set, 3, 9, sample, dimension, 0);
    let lattice = PointSet::Lattice { samples: 22 };
    assert_ne!(first(lattice, 5, Dimension::Light(0)), first(lattice, 5 + 22, Dimension::Light(0)));
    // Sample 2^31 takes points 2^32 and 2^32 + 1 of a sequence of two candidates.
    for index in [0, 1] {
        assert_ne!(
            first(PointSet::Sobol, 0, candidate(0, index, 2)),
            first(PointSet::Sobol, 1 << 31, candidate(0, index, 2))
        );
    }
    // The largest addresses.
    for set in SETS {
        let last = first(set, u32::MAX, candidate(1, MAX_CANDIDATES - 1, MAX_CANDIDATES));
        assert!(last.iter().all(|x| (0.0..1.0).contains(x)), "{set}");
    }
}

/// Over seeds, each sample of each pixel is uniform in the cube.
#[test]
fn numbers_and_their_pairs_are_uniform() {
    const SIDE: usize = 16;
    let samples = 200_000;
    for set in SETS {
        let mut counts = [[0.0_f64; SIDE * SIDE]; 3];
        for k in 0..samples {
            let n = numbers(set, u64::from(k), k % 11, k % 13, Dimension::Light(0), 0);
            assert!(n.iter().all(|x| (0.0..1.0).contains(x)));
            for (pair, counts) in counts.iter_mut().enumerate() {
                let [i, j] = [n[pair], n[pair + 1]].map(|x| (x * SIDE as f32) as usize);
                counts[i * SIDE + j] += 1.0;
            }
        }
        let expected = f64::from(samples) / (SIDE * SIDE) as f64;
        for counts in counts {
            let statistic: f64 = counts.iter().map(|count| (count - expected).powi(2) / expected).sum();
            // 255 degrees of freedom: mean 255, standard deviation 22.6; the bound is 5 of them, for 12
            // tests.
            assert!((statistic - 255.0).abs() < 113.0, "{set}: {statistic}");
        }
    }
}

/// Returns the correlation of two numbers over many seeds, and its standard deviation under independence.
fn correlation(pairs: impl Iterator<Item = (f32, f32)>) -> (f64, f64) {
    let (mut sum, mut count) = (0.0, 0.0);
    for (a, b) in pairs {
        sum += (f64::from(a) - 0.5) * (f64::from(b) - 0.5);
        count += 1.0;
    }
    // The variance of a uniform number is 1 / 12. Under independence the correlation has a standard deviation of 1 / sqrt(n).
    (12.0 * sum / count, 1.0 / f64::sqrt(count))
}

/// A function from a seed to two numbers.
type PairOfSeed<'a> = dyn Fn(u64) -> (f32, f32) + 'a;

#[test]
fn pixels_and_dimensions_are_not_correlated() {
    let light = |set, seed, key| numbers(set, seed, key, 3, Dimension::Light(0), 0);
    let of = |set, seed, dimension, bounce| numbers(set, seed, 5, 3, dimension, bounce);
    for set in SETS {
        let pairs: [(&str, &PairOfSeed<'_>); 7] = [
            ("pixels", &|seed| (light(set, seed, 70)[0], light(set, seed, 70 + (1 << 12))[0])),
            ("seeds", &|seed| (light(set, seed, 7)[1], light(set, seed + 1, 7)[1])),
            ("light and camera", &|seed| (light(set, seed, 5)[0], of(set, seed, Dimension::Camera, 0)[0])),
            ("light and path", &|seed| (light(set, seed, 5)[0], of(set, seed, Dimension::Path, 0)[0])),
            ("bounces", &|seed| (light(set, seed, 5)[0], of(set, seed, Dimension::Light(0), 1)[0])),
            ("techniques", &|seed| (of(set, seed, candidate(0, 0, 2), 0)[0], of(set, seed, candidate(1, 0, 2), 0)[0])),
            ("survivor", &|seed| (of(set, seed, candidate(0, 0, 2), 0)[2], of(set, seed, candidate(0, 1, 2), 0)[0])),
        ];
        for (name, pair) in pairs {
            let (correlation, deviation) = correlation((0..20_000).map(pair));
            // 5 standard deviations, for 28 tests.
            assert!(correlation.abs() < 5.0 * deviation, "{set}, {name}: {correlation} +- {deviation}");
        }
    }
}

/// Returns the smallest t for which `2^m` points are a (t, m, 2)-net: elementary intervals of area
/// `2^(t - m)` contain `2^t` of them.
fn quality(points: &[[f32; 2]]) -> u32 {
    let m = points.len().ilog2();
    assert!(points.len().is_power_of_two());
    let is_net = |t: u32| {
        (0..=m - t).all(|across| {
            let down = m - t - across;
            let mut counts = vec![0; 1 << (m - t)];
            for [x, y] in points {
                let (column, row) = ((x * (1_u32 << across) as f32) as usize, (y * (1_u32 << down) as f32) as usize);
                counts[column << down | row] += 1;
            }
            counts.iter().all(|&count| count == 1 << t)
        })
    };
    (0..=m).find(|&t| is_net(t)).expect("any points are a (m, m, 2)-net")
}

/// Returns the first two numbers of `dimension` for each of the samples.
fn pairs(set: PointSet, key: u32, samples: std::ops::Range<u32>, dimension: Dimension, bounce: u32) -> Vec<[f32; 2]> {
    samples.map(|sample| numbers(set, 1, key, sample, dimension, bounce)).map(|[x, y, ..]| [x, y]).collect()
}

/// Returns all candidates of a technique, in the order of samples.
fn candidates(set: PointSet, key: u32, samples: u32, of: u32) -> Vec<[f32; 2]> {
    let of_sample = |sample| (0..of).flat_map(move |k| pairs(set, key, sample..sample + 1, candidate(1, k, of), 0));
    (0..samples).flat_map(of_sample).collect()
}

#[test]
fn first_samples_of_a_pixel_are_nets() {
    let groups = [
        (Dimension::Light(0), 0),
        (Dimension::Light(1), 0),
        (Dimension::Path, 0),
        (Dimension::Path, 2),
        (Dimension::Light(0), 3),
    ];
    for m in 0..=10 {
        for (dimension, bounce) in groups {
            assert_eq!(quality(&pairs(PointSet::Sobol, 77, 0..1 << m, dimension, bounce)), 0, "{dimension:?}, 2^{m}");
        }
        // Dimensions 3 and 4 of Sobol's sequence together are not a (0, 2)-sequence; these are their
        // qualities.
        let camera = [0, 0, 1, 2, 0, 1, 1, 1, 1, 1, 1][m];
        assert_eq!(quality(&pairs(PointSet::Sobol, 77, 0..1 << m, Dimension::Camera, 0)), camera, "2^{m}");
    }
    for (samples, of) in [(1, 2), (8, 2), (64, 4), (256, 1)] {
        assert_eq!(quality(&candidates(PointSet::Sobol, 5, samples, of)), 0, "{samples} of {of}");
    }
    // A later block of samples is a net as well, and the measure detects a non-net.
    assert_eq!(quality(&pairs(PointSet::Sobol, 77, 96..128, Dimension::Path, 1)), 0);
    assert!(quality(&pairs(PointSet::Independent, 77, 0..256, Dimension::Light(0), 0)) > 3);
}

/// A number does not depend on the batch that it is drawn in.
#[test]
fn numbers_do_not_depend_on_the_batch() {
    for set in SETS {
        let mut out = [[[0.0; LANES]; 3]; 2];
        let [x, y] = &mut out;
        let key = |place: usize| (place as u32).wrapping_mul(2_654_435_761);
        Points::new(set, 4).at_sample(6).draw_keyed(Dimension::Camera, 40, key, [x, y]);
        for place in 0..40 {
            let alone = numbers_of_camera(set, key(place));
            assert_eq!([out[0][place / LANES][place % LANES], out[1][place / LANES][place % LANES]], alone, "{set}");
        }
    }
}

fn numbers_of_camera(set: PointSet, key: u32) -> [f32; 2] {
    let [mut x, mut y] = [[[0.0; LANES]; 1]; 2];
    Points::new(set, 4).at_sample(6).draw_keyed(Dimension::Camera, 1, |_| key, [&mut x, &mut y]);
    [x[0][0], y[0][0]]
}
