//! Tests that every tail is a bijection whose Jacobian is the density of the light.

use glam::Vec2;
use headtail_render::{
    color::luminance,
    environment::{BUILT_IN_NAMES, Environment, built_in},
    image::Image,
    random::{Purpose, Stream},
    tail::{Tail, TailKind, TailWarp},
};

const KINDS: [TailKind; 2] = [TailKind::RowColumn, TailKind::Hierarchical];

/// Returns built-in maps and edge cases: one lit texel (at a pole, at the seam), odd sizes, half black.
fn maps() -> Vec<Environment> {
    let mut maps: Vec<_> = BUILT_IN_NAMES.iter().map(|name| built_in(name).unwrap()).collect();
    let mut made = |name: &str, width: usize, height: usize, value: &dyn Fn(usize, usize) -> f32| {
        let pixels = (0..width * height).map(|k| [value(k % width, k / width); 3]).collect();
        maps.push(Environment::from_image(name, Image { width, height, pixels }).unwrap());
    };
    made("constant 1x1", 1, 1, &|_, _| 1.0);
    made("constant 7x2", 7, 2, &|_, _| 3.0);
    made("pole texel", 16, 9, &|i, j| f32::from(i == 3 && j == 0));
    made("seam texel", 16, 9, &|i, j| f32::from(i == 0 && j == 4));
    made("odd 37x23", 37, 23, &|i, j| ((i * 7 + j * 3) % 11) as f32);
    made("black half", 64, 32, &|i, _| f32::from(i < 32));
    made("1e6 : 1", 64, 32, &|i, j| if (i, j) == (20, 9) { 1e6 } else { 1.0 });
    maps
}

fn tails() -> Vec<(String, Environment, Tail)> {
    let both = |map: Environment| {
        KINDS.map(|kind| {
            let tail = Tail::new(kind, map.width(), map.height(), &map.luminance()).unwrap();
            (format!("{} / {}", map.name(), kind.name()), map.clone(), tail)
        })
    };
    maps().into_iter().flat_map(both).collect()
}

/// Returns the distance, periodic in coordinate 0.
fn distance(a: Vec2, b: Vec2) -> f32 {
    let across = (a.x - b.x).abs();
    across.min(1.0 - across).max((a.y - b.y).abs())
}

#[test]
fn inverse_of_forward_is_the_identity() {
    for (name, _, tail) in tails() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        let ys: Vec<Vec2> = (0..100_000).map(|_| random.uniform2()).collect();
        let forward = tail.forward_points(&ys);
        let xs: Vec<Vec2> = forward.iter().map(|(x, _)| *x).collect();
        // x is rounded to 6e-8; the effect on y is measured by moving x twice as far along either axis.
        let moved = [Vec2::X, -Vec2::X, Vec2::Y, -Vec2::Y].map(|axis| {
            let moved = |x: &Vec2| (*x + 1.2e-7 * axis).clamp(Vec2::ZERO, Vec2::ONE);
            tail.inverse_points(&xs.iter().map(moved).collect::<Vec<_>>())
        });
        for (k, (back, inverse)) in tail.inverse_points(&xs).into_iter().enumerate() {
            let (y, (x, forward)) = (ys[k], forward[k]);
            assert!((0.0..1.0).contains(&x.x) && (0.0..=1.0).contains(&x.y), "{name}: {y} -> {x}");
            let tolerance = 4e-6 + moved.iter().map(|moved| distance(moved[k].0, back)).fold(0.0, f32::max);
            // Along the dark edge of a cell, intervals of y map to one x; the pdf there is near zero.
            if inverse > 1e-3 {
                let error = distance(back, y);
                assert!(error < tolerance, "{name}: {y} -> {x} -> {back}, density {inverse}, error {error}");
                assert!((forward * inverse - 1.0).abs() < 0.02, "{name}: {forward} * {inverse} at {x}");
            }
        }
    }
}

#[test]
fn the_density_integrates_to_one() {
    for (name, map, tail) in tails() {
        // The density is bilinear in a cell: its mean is the value at the centre.
        let (columns, rows) = (map.width(), map.height() - 1);
        let mut sum = 0.0_f64;
        for row in 0..rows {
            for column in 0..columns {
                let u = ((column as f32 + 1.0) / columns as f32).fract();
                sum += f64::from(tail.density(Vec2::new(u, (row as f32 + 0.5) / rows as f32)));
            }
        }
        let integral = sum / (columns * rows) as f64;
        assert!((integral - 1.0).abs() < 1e-5, "{name}: {integral}");
    }
}

#[test]
fn the_density_is_the_light() {
    // The intermediate target has no environment factor only if p1 is L sin theta, up to the linear sine in a
    // cell.
    for (name, map, tail) in tails().into_iter().take(2 * BUILT_IN_NAMES.len()) {
        let mut random = Stream::new(2, Purpose::Test, 0);
        let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
        let n = 100_000;
        let y: Vec<Vec2> = (0..n).map(|_| random.uniform2()).collect();
        for (x, wi, pdf) in tail.forward_directions(&y) {
            let ratio = f64::from(luminance(map.radiance(wi)) / pdf);
            assert!(ratio.is_finite(), "{name} at {x}");
            sum += ratio;
            squares += ratio * ratio;
        }
        let relative_variance = squares * n as f64 / (sum * sum) - 1.0;
        assert!(relative_variance < 1e-3, "{name}: emitter sampling of the map alone has variance {relative_variance}");
    }
}

#[test]
fn equal_areas_of_y_carry_equal_light() {
    // The fraction of a grid of Y that lands above a row of nodes is the exact integral of the density above
    // it.
    for (name, map, tail) in tails() {
        let (columns, rows) = (map.width(), map.height() - 1);
        let mut above = 0.0_f64;
        let y = |k: usize| Vec2::new((k % 512) as f32 + 0.5, (k / 512) as f32 + 0.5) / 512.0;
        let landed = tail.forward_points(&(0..512 * 512).map(y).collect::<Vec<_>>());
        for row in 0..rows {
            let lands_above = landed.iter().filter(|(x, _)| x.y < row as f32 / rows as f32).count();
            // The preimage of the line crosses each column of the grid about once: 1/512 each, and the same
            // again for jumps.
            let fraction = lands_above as f64 / f64::from(512 * 512);
            assert!((fraction - above).abs() < 4.0 / 512.0, "{name}: {fraction} above row {row}, expected {above}");
            let v = (row as f32 + 0.5) / rows as f32;
            let middle = |column| Vec2::new(((column as f32 + 1.0) / columns as f32).fract(), v);
            above += (0..columns).map(|column| f64::from(tail.density(middle(column)))).sum::<f64>()
                / (columns * rows) as f64;
            if row > 24 {
                break;
            }
        }
    }
}

#[test]
fn hostile_luminance_is_refused() {
    for kind in KINDS {
        assert!(Tail::new(kind, 2, 2, &[0.0; 4]).is_err());
        assert!(Tail::new(kind, 2, 2, &[1.0, f32::NAN, 0.0, 0.0]).is_err());
        assert!(Tail::new(kind, 2, 2, &[1.0, -1.0, 0.0, 0.0]).is_err());
        assert!(Tail::new(kind, 2, 1, &[1.0; 2]).is_err());
        assert!(Tail::new(kind, 3, 2, &[1.0; 4]).is_err());
    }
}
