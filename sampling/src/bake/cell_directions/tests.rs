//! Bounds and integrals compared with sums over every texel.

use super::*;
use crate::{
    bake::{BakedTable, CellPoints, direct_bake},
    environment::{Environment, built_in},
    image::Image,
    random::{Purpose, Stream},
    tail::TailKind,
};

const KINDS: [TailKind; 2] = [TailKind::Hierarchical, TailKind::RowColumn];

fn made(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Environment {
    let pixels = (0..width * height).map(|k| [value(k % width, k / width); 3]).collect();
    Environment::from_image("made", Image { width, height, pixels }).unwrap()
}

/// Lamps on a wall that is 1e5 times dimmer, some of them at the poles and the seam.
fn lamps() -> Environment {
    made(64, 32, |i, j| if (i % 13 < 2) && (j % 8 < 2) { 1.0 } else { 1e-5 * (1 + i % 3) as f32 })
}

fn maps() -> Vec<Environment> {
    vec![
        lamps(),
        built_in("studio").unwrap(),
        made(16, 9, |i, j| f32::from(u8::from(i == 0 && j == 4))),
        made(37, 23, |i, j| ((i * 7 + j * 3) % 11) as f32),
        made(1, 2, |_, _| 1.0),
    ]
}

/// `side x side` points of X in each cell of a density, with their points of Y and densities.
fn points(tail: &Tail, side: usize) -> Vec<(Vec2, Vec2, f32)> {
    let (light, size) = (tail.light(), side as f32);
    let inside = |k: usize| (Vec2::new((k % side) as f32, (k / side) as f32) + 0.5) / size;
    let of_cell = |cell: usize| {
        let (column, row) = (cell % light.columns(), cell / light.columns());
        (0..side * side).map(move |k| light.point(column as u32, row as u32, inside(k)))
    };
    let x: Vec<Vec2> = (0..light.columns() * light.rows()).flat_map(of_cell).collect();
    let y = tail.inverse_points(&x);
    x.into_iter().zip(y).map(|(x, (y, density))| (x, y, density)).collect()
}

fn normals(count: usize) -> Vec<Vec3A> {
    let mut random = Stream::new(2, Purpose::Test, 0);
    (0..count).map(|_| random.direction()).collect()
}

fn tails() -> Vec<Tail> {
    let of = |map: Environment| KINDS.map(|kind| Tail::of_environment(kind, &map).unwrap());
    maps().into_iter().flat_map(of).collect()
}

#[test]
fn no_lit_direction_escapes_the_bounds_of_its_cell() {
    let cells = CellGrid::new(9, 16).unwrap();
    for (case, tail) in tails().iter().enumerate() {
        let directions = CellDirections::new(tail, cells);
        let points: Vec<_> =
            points(tail, (64 / tail.light().rows()).max(2)).into_iter().filter(|point| point.2 > 0.0).collect();
        let mut bounds = vec![0.0; cells.cells()];
        for normal in normals(8) {
            directions.highest_cosines(normal, 0.0, &mut bounds);
            for &(x, y, _) in &points {
                let (row, column) = cells.cell(y);
                let cosine = normal.dot(latlong::direction(x));
                assert!(cosine <= bounds[row * 16 + column] + 1e-5, "{case}: {x} {y} {cosine}");
            }
        }
    }
}

#[test]
fn integrals_over_cells_add_up_to_those_over_the_map() {
    let cells = CellGrid::new(8, 8).unwrap();
    for (case, tail) in tails().iter().enumerate() {
        let directions = CellDirections::new(tail, cells);
        let points = points(tail, (128 / tail.light().rows()).max(2));
        let mut of_cells = vec![0.0; cells.cells()];
        for normal in normals(10) {
            let cosines = points.iter().map(|&(x, _, density)| (normal.dot(latlong::direction(x)).max(0.0), density));
            let (mut first, mut second, mut whole) = (0.0_f64, 0.0_f64, 0.0_f64);
            for (cosine, density) in cosines {
                whole += f64::from(density);
                first += f64::from(density * cosine);
                second += f64::from(density * cosine * cosine);
            }
            directions.root_mean_squares(normal, &mut of_cells);
            let squares = of_cells.iter().map(|rms| f64::from(rms * rms)).sum::<f64>() / cells.cells() as f64;
            // Directions of a block of 1.4 degrees are merged: with all light in one block at the
            // horizon, the mean over half of that is 0.006 in the cosine. Points of X are spaced at
            // half of that.
            assert!((squares - second / whole).abs() < 0.01, "{case}: {squares} {}", second / whole);
            let irradiance = f64::from(directions.irradiance(normal));
            assert!((irradiance - first / whole).abs() < 0.01, "{case}: {irradiance} {}", first / whole);
        }
    }
}

/// The largest light x cosine over density, over its mean, among lit points at normals.
fn largest_weight(tail: &Tail, table: &BakedTable, normals: &[Vec3A]) -> f32 {
    let points: Vec<_> = points(tail, 2).into_iter().filter(|point| point.2 > 0.0).collect();
    let (x, y): (Vec<Vec2>, Vec<Vec2>) = points.iter().map(|point| (point.0, point.1)).unzip();
    let excess = tail.light().light_over_density(&tail.light().row_weights(), &x);
    let of_normal = |&normal: &Vec3A| {
        let cosine = |x: Vec2| normal.dot(latlong::direction(x)).max(0.0);
        let whole: f32 = points.iter().map(|point| point.2).sum();
        let mean = points.iter().map(|&(x, _, density)| density * cosine(x)).sum::<f32>() / whole;
        let weights = x.iter().zip(table.density_at(normal, &y)).zip(&excess);
        weights.map(|((&x, q), excess)| excess * cosine(x) / q / mean).fold(0.0, f32::max)
    };
    normals.iter().map(of_normal).fold(0.0, f32::max)
}

#[test]
fn raised_tables_have_no_large_weight() {
    let (normals, cells) = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(32, 32).unwrap());
    let mut random = Stream::new(3, Purpose::Test, 0);
    let mut at: Vec<Vec3A> = (0..12).map(|_| random.direction()).collect();
    at.extend([Vec3A::Y, -Vec3A::Y, normals.normal(100)]);
    for map in [lamps(), built_in("studio").unwrap(), built_in("sunset").unwrap()] {
        for kind in KINDS {
            let tail = Tail::of_environment(kind, &map).unwrap();
            let raised = direct_bake(&tail, normals, cells).unwrap();
            let largest = largest_weight(&tail, &raised, &at);
            assert!(largest < 12.0, "{} {}: {largest}", map.name(), kind.name());
            if map.name() == "sunset" {
                continue;
            }
            // Without raising, weights exceed the bound by far, except where the whole sky is bright.
            let points = CellPoints::new(&tail, cells, 16);
            let plain = BakedTable::fill(normals, cells, |normal, masses| {
                for (mass, directions) in masses.iter_mut().zip(points.directions()) {
                    let squares: f32 = directions.iter().map(|wi| normal.dot(*wi).max(0.0).powi(2)).sum();
                    *mass = (squares / directions.len() as f32).sqrt();
                }
            });
            let largest = largest_weight(&tail, &plain.unwrap(), &at);
            assert!(largest > 50.0, "{} {}: {largest}", map.name(), kind.name());
        }
    }
}
