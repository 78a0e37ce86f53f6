//! Tests that a tabulated warp is a bijection with an exact density for any table.

use std::{f32::consts::TAU, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::Lambert,
    environment::{Environment, built_in},
    image::Image,
    random::{Purpose, Stream},
    sampler::{AtPoint, EmitterSampler, EnvironmentLight},
    statistics::SphereChiSquare,
    tail::{Repair, Tail, TailWarp, WarpMap},
    tile::ShadingPoint,
};

fn nodes(cells: usize, mut map: impl FnMut(Vec2) -> Vec2) -> Vec<Vec2> {
    let at = |k: usize| Vec2::new((k % cells) as f32, (k / cells) as f32) / cells as f32;
    let mut nodes: Vec<Vec2> = (0..cells * (cells + 1)).map(|k| map(at(k))).collect();
    nodes[..cells].iter_mut().for_each(|node| node.y = 0.0);
    nodes[cells * cells..].iter_mut().for_each(|node| node.y = 1.0);
    nodes
}

/// Swirls the square, moving the seam by more than a turn.
fn swirl(y: Vec2) -> Vec2 {
    let u = y.x + 0.08 * (TAU * y.x).sin() + 1.3 * y.y + 0.4 * y.y * (1.0 - y.y) * (TAU * y.x).cos();
    Vec2::new(u - 0.7, y.y + 0.12 * (std::f32::consts::PI * y.y).sin() * (TAU * y.x).sin())
}

/// Maps most of the square to a spot of 1 % of its side, as for a sun.
fn spot(y: Vec2) -> Vec2 {
    let squeeze = |t: f32| 0.5 + 0.01 * (t - 0.5) + 0.99 * 64.0 * (t - 0.5).powi(7);
    Vec2::new(squeeze(y.x), squeeze(y.y))
}

fn warps() -> Vec<(&'static str, WarpMap)> {
    let identity = WarpMap::new(4, &nodes(4, |y| y)).unwrap();
    let swirl = WarpMap::new(64, &nodes(64, swirl)).unwrap();
    let (spot, _) = WarpMap::repaired(128, nodes(128, spot)).unwrap();
    let mut random = Stream::new(1, Purpose::Test, 0);
    let jittered = nodes(32, |y| y + (random.uniform2() - 0.5) / 32.0 * 0.45);
    let jittered = jittered.into_iter().map(|node| Vec2::new(node.x, node.y.clamp(0.0, 1.0))).collect();
    let (jittered, _) = WarpMap::repaired(32, jittered).unwrap();
    vec![("identity", identity), ("swirl", swirl), ("spot", spot), ("jittered", jittered)]
}

fn distance(a: Vec2, b: Vec2) -> f32 {
    let across = (a.x - b.x).abs();
    across.min((1.0 - across).abs()).max((a.y - b.y).abs())
}

#[test]
fn inverse_of_forward_is_the_identity_and_so_are_the_jacobians() {
    for (name, map) in warps() {
        let mut random = Stream::new(2, Purpose::Test, 0);
        for k in 0..200_000 {
            // Includes corners, edges and the seam.
            let snap = |t: f32| if k % 3 == 0 { (t * map.cells() as f32).floor() / map.cells() as f32 } else { t };
            let y = random.uniform2();
            let y = Vec2::new(snap(y.x), if k % 2 == 0 { y.y } else { snap(y.y) });
            let (x, jacobian) = map.forward(y);
            assert!((0.0..1.0).contains(&x.x) && (0.0..=1.0).contains(&x.y), "{name}: {y} -> {x}");
            let (back, density) = map.inverse(x);
            // x is rounded to 6e-8, which the inverse amplifies by at most its density times the cell's side.
            let bound = 2e-6 + 2e-7 * density.max(1.0) * 8.0;
            assert!(distance(back, y) < bound, "{name}: {y} -> {x} -> {back}, density {density}");
            // Jacobians of neighbouring cells differ, and a point on an edge may be found in either cell.
            let inside = (y * map.cells() as f32).fract();
            if inside.min_element() > 1e-3 && inside.max_element() < 1.0 - 1e-3 {
                assert!((density * jacobian - 1.0).abs() < 5e-2, "{name}: {density} * {jacobian} at {y}");
            }
        }
    }
}

#[test]
fn forward_of_inverse_is_the_identity() {
    for (name, map) in warps() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for _ in 0..100_000 {
            let x = random.uniform2();
            let (y, density) = map.inverse(x);
            assert!(density.is_finite() && density > 0.0, "{name}: {x}");
            // y is rounded to 6e-8, which the warp amplifies where it is sparse.
            let bound = 1e-6 + 4e-7 / density.min(1.0) * 4.0;
            assert!(distance(map.forward(y).0, x) < bound, "{name}: {x} -> {y} -> {}", map.forward(y).0);
        }
    }
}

/// The images of the cells tile the square, so that the areas of the cells times their densities sum to 1.
#[test]
fn the_density_integrates_to_one() {
    for (name, map) in warps() {
        let n = map.cells();
        let areas: f64 = (0..n * n)
            .map(|k| {
                let y = Vec2::new((k % n) as f32 + 0.5, (k / n) as f32 + 0.5) / n as f32;
                // The Jacobian is linear in a cell: its mean is the value at the centre.
                f64::from(map.forward(y).1) / (n * n) as f64
            })
            .sum();
        assert!((areas - 1.0).abs() < 1e-5, "{name}: {areas}");
        if name == "spot" {
            continue;
        }
        let side = 1500;
        let points =
            (0..side * side).map(|k| Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32);
        let integral = points.map(|x| f64::from(map.inverse(x).1)).sum::<f64>() / f64::from(side * side);
        assert!((integral - 1.0).abs() < 1e-4, "{name}: {integral}");
    }
}

#[test]
fn directions_follow_the_pdf_over_the_sphere() {
    let image = Image { width: 16, height: 9, pixels: vec![[1.0; 3]; 144] };
    let environment = Arc::new(Environment::from_image("constant", image).unwrap());
    for (name, map) in warps() {
        let tail = Arc::new(Tail::flow(map, 16, 9, &[1.0; 144]).unwrap());
        let sampler = EmitterSampler::new(EnvironmentLight::with_tail(environment.clone(), tail));
        let (n, surface) = (Vec3A::Y, Lambert { albedo: Vec3::ONE }.into());
        let bound = AtPoint::new(&sampler, &ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface });
        let test = SphereChiSquare {
            subcells: if name == "spot" { 24 } else { 8 },
            mass_tolerance: 0.01,
            tests: 4,
            samples: 500_000,
            ..SphereChiSquare::default()
        };
        let draw = |random: &mut Stream, count: usize| {
            let u: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
            bound.sample_many(&u).into_iter().map(|drawn| Some(drawn?.wi)).collect()
        };
        let report = test.run(draw, |wi| bound.pdf_many(wi));
        assert!(report.passed(), "{name}: {:?}", report.failures);
    }
}

#[test]
fn the_warp_is_continuous_across_the_seam() {
    for (name, map) in warps() {
        for k in 0..500 {
            let v = (k as f32 + 0.5) / 500.0;
            let (left, right) = (map.forward(Vec2::new(1.0 - 1e-6, v)).0, map.forward(Vec2::new(0.0, v)).0);
            assert!(distance(left, right) < 1e-4, "{name}: {left} {right}");
            let (below, above) = (map.inverse(Vec2::new(0.999_999_9, v)).0, map.inverse(Vec2::new(0.0, v)).0);
            assert!(
                distance(below, above) < 1e-4 * map.inverse(Vec2::new(0.0, v)).1.max(1.0),
                "{name}: {below} {above}"
            );
        }
    }
}

#[test]
fn folds_are_repaired_and_reported() {
    let fold = |y: Vec2| {
        let inside = (y - Vec2::new(0.4, 0.6)).length() < 0.06;
        if inside { Vec2::new(1.0 - y.x, y.y) } else { y }
    };
    assert!(WarpMap::new(64, &nodes(64, fold)).unwrap_err().to_string().contains("not convex"));
    let (map, repair) = WarpMap::repaired(64, nodes(64, fold)).unwrap();
    assert!(repair.cells > 10 && repair.rounds > 0, "{repair:?}");
    assert!(WarpMap::new(64, &map.nodes()).is_ok());
    // A knot that needs smoothing of several corners; distant corners do not move.
    let knot = |y: Vec2| {
        let (from, turn) = (y - Vec2::splat(0.5), 3.0 * (1.0 - 16.0 * (y - Vec2::splat(0.5)).length()).max(0.0));
        Vec2::splat(0.5) + Vec2::from_angle(turn * std::f32::consts::PI).rotate(from)
    };
    let knotted = nodes(64, knot);
    let (map, repair) = WarpMap::repaired(64, knotted.clone()).unwrap();
    assert!(repair.smoothings > 0 && repair.blended == 0.0, "{repair:?}");
    for (at, own) in knotted.iter().enumerate().filter(|(_, own)| (**own - Vec2::splat(0.5)).length() > 0.2) {
        let y = Vec2::new((at % 64) as f32, (at / 64) as f32) / 64.0;
        assert!(map.forward(y).0.distance(*own) < 1e-6, "{y}");
    }
    // Reversed rows cannot be repaired in place.
    let (_, repair) = WarpMap::repaired(16, nodes(16, |y| Vec2::new(y.x, 1.0 - y.y))).unwrap();
    assert!(repair.cells > 0);
    assert_eq!(WarpMap::repaired(16, nodes(16, |y| y)).unwrap().1, Repair::default());
}

#[test]
fn hostile_tables_are_rejected_with_the_name_of_the_field() {
    let good = nodes(8, |y| y);
    let with = |at: usize, node: Vec2| {
        let mut nodes = good.clone();
        nodes[at] = node;
        nodes
    };
    for (cells, nodes, named) in [
        (8, good[1..].to_vec(), "do not fit"),
        (7, nodes(7, |y| y), "power of two"),
        (0, Vec::new(), "power of two"),
        (2048, Vec::new(), "do not fit"),
        (8, with(20, Vec2::NAN), "outside the square"),
        (8, with(20, Vec2::new(0.5, 1.5)), "outside the square"),
        (8, with(20, Vec2::new(f32::INFINITY, 0.5)), "outside the square"),
        (8, with(3, Vec2::new(0.3, 0.1)), "borders"),
        (8, with(20, Vec2::new(0.0, 0.9)), "not convex"),
    ] {
        let error = WarpMap::new(cells, &nodes).unwrap_err().to_string();
        assert!(error.contains(named) && error.starts_with("tail.map"), "{error}");
    }
    assert!(WarpMap::repaired(8, with(20, Vec2::NAN)).is_err());
    assert!(WarpMap::repaired(8, Vec::new()).is_err());
}

#[test]
fn the_light_ratio_corrects_the_density_of_the_warp() {
    let map = built_in("window").unwrap();
    let warp = WarpMap::new(64, &nodes(64, swirl)).unwrap();
    let tail = Tail::flow(warp, map.width(), map.height(), &map.luminance()).unwrap();
    let mut random = Stream::new(4, Purpose::Test, 0);
    // E over uniform y of the ratio is the integral of the light: 1.
    let y: Vec<Vec2> = (0..400_000).map(|_| random.uniform2()).collect();
    let mean = tail.forward_points(&y).iter().map(|(x, _)| f64::from(tail.light_ratio(*x))).sum::<f64>() / 4e5;
    assert!((mean - 1.0).abs() < 0.02, "{mean}");
}
