use glam::Vec3A;

use super::*;
use crate::{
    brdf::{Brdf, Ggx},
    head::Head,
    random::{Purpose, Stream},
    sampler::IntermediateDensity,
};

fn layers(random: &mut Stream, sizes: &[usize], scale: f32) -> Vec<Linear> {
    let layer = |pair: &[usize]| {
        let mut numbers = |count: usize, size: f32| -> Vec<f32> {
            (0..count).map(|_| size * (2.0 * random.uniform() - 1.0)).collect()
        };
        let size = scale / (pair[0] as f32).sqrt();
        Linear::new("layer", pair[0], pair[1], &numbers(pair[0] * pair[1], size), numbers(pair[1], 0.1)).unwrap()
    };
    sizes.windows(2).map(layer).collect()
}

fn head(random: &mut Stream, mode: Mode, condition: Condition, bins: usize, encoder: bool) -> Head {
    let length = condition.length();
    let (encoder, seen) =
        if encoder { (layers(random, &[length, 16, 20], 1.7), length + 20) } else { (Vec::new(), length) };
    let features = if mode == Mode::Coupled { 2 } else { 0 };
    let mut network = |features: usize, bins: usize| layers(random, &[seen + features, 33, 24, 3 * bins + 1], 1.7);
    // A file may give the two splines different numbers of bins.
    let networks = [network(features, bins + 1), network(1, bins)];
    let selection = layers(random, &[seen, 9, 1], 1.0);
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_selection(selection).unwrap()
}

fn points(random: &mut Stream, count: usize) -> Vec<ShadingPoint> {
    let mut point = || {
        let (n, wo) = (random.direction(), random.direction());
        let wo = if wo.dot(n) < 0.0 { -wo } else { wo };
        let brdf = Brdf::Ggx(Ggx::new(0.1 + 0.5 * random.uniform(), Vec3A::ONE));
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, brdf }
    };
    (0..count).map(|_| point()).collect()
}

/// Points near the floor of a bin's width magnify rounding by the slopes there.
fn agree(one: (Vec2, f32), many: (Vec2, f32), what: &str) {
    let apart = (one.0 - many.0).abs();
    let apart = apart.min(1.0 - apart).max_element();
    let (slack, density) = (1.0 + one.1 + 1.0 / one.1, (one.1 - many.1).abs() / one.1);
    assert!(apart < 1e-6 * slack && density < 1e-5 * slack, "{what}: {one:?} {many:?}");
}

#[test]
fn many_points_get_what_one_point_gets() {
    let mut random = Stream::new(8, Purpose::Test, 0);
    for mode in [Mode::Coupled, Mode::Autoregressive] {
        for (condition, bins, encoder) in
            [(Condition::Normal, 4, false), (Condition::Ggx, 8, false), (Condition::GgxRoughness, 32, true)]
        {
            let head = head(&mut random, mode, condition, bins, encoder);
            // Not a whole number of strips.
            for count in [1, LANES, 5 * LANES + 3] {
                let at = points(&mut random, count);
                let z: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
                let (mut y, mut q) = (vec![Vec2::NAN; count], vec![f32::NAN; count]);
                head.sample_batch(&at, &z, &mut y, &mut q);
                let prepared = head.prepare_batch(&at);
                let references: Vec<&PreparedHead> = prepared.iter().collect();
                let (mut again, mut q_again) = (y.clone(), q.clone());
                head.sample_prepared(&references, &z, &mut again, &mut q_again);
                assert_eq!((&again, &q_again), (&y, &q), "prepared or not, the same bits");
                head.density_prepared(&references, &z, &mut q_again);
                for k in 0..count {
                    let one = head.prepare(&at[k]);
                    assert!((one.share_beside_brdf - prepared[k].share_beside_brdf).abs() < 1e-5);
                    agree(head.sample_at(&one, z[k]), (y[k], q[k]), "sample");
                    let (image, density) = head.inverse_at(&one, z[k]);
                    agree((image, density), (image, q_again[k]), "density");
                }
            }
        }
    }
}

#[test]
fn ends_of_the_square_stay_inside() {
    let mut random = Stream::new(9, Purpose::Test, 0);
    let head = head(&mut random, Mode::Coupled, Condition::Normal, 6, false);
    let at = points(&mut random, 4);
    let below = 1.0 - f32::EPSILON / 2.0;
    let z = [Vec2::ZERO, Vec2::splat(below), Vec2::new(0.0, below), Vec2::new(below, 0.0)];
    let (mut y, mut q) = ([Vec2::NAN; 4], [f32::NAN; 4]);
    head.sample_batch(&at, &z, &mut y, &mut q);
    for (y, q) in y.iter().zip(q) {
        assert!((0.0..1.0).contains(&y.x) && (0.0..1.0).contains(&y.y) && q > 0.0 && q.is_finite(), "{y} {q}");
    }
}
