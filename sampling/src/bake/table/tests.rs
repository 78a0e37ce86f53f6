use super::*;
use crate::random::{Purpose, Stream};

const GRIDS: [(usize, usize); 6] = [(1, 1), (5, 12), (8, 8), (32, 32), (7, 33), (64, 64)];

/// Waves that change with the normal, one cell that outweighs its row, and a node without mass.
fn waves(rows: usize, columns: usize) -> BakedTable {
    let (normals, cells) = (NormalGrid::new(5, 7).unwrap(), CellGrid::new(rows, columns).unwrap());
    BakedTable::fill(normals, cells, |normal, masses| {
        for (k, mass) in masses.iter_mut().enumerate() {
            let wave = (0.7 * k as f32 + 3.0 * normal.x + normal.z).sin();
            *mass = if normal.y < -0.999 { 0.0 } else { (wave + 0.9).max(0.0) * (1.1 + normal.y) };
        }
        masses[rows * columns / 2] *= 1e3;
    })
    .unwrap()
}

fn normals(count: usize) -> Vec<Vec3A> {
    let mut random = Stream::new(4, Purpose::Test, 0);
    let mut normals: Vec<Vec3A> = (0..count).map(|_| random.direction()).collect();
    normals.extend([Vec3A::Y, -Vec3A::Y, Vec3A::X, Vec3A::Z, -Vec3A::Z]);
    normals
}

/// Each coordinate of y grows with its own uniform number, from 0 to 1, and y.y does not depend on z.x.
#[test]
fn draws_grow_with_their_uniform_numbers() {
    const STEPS: usize = 4096;
    let fraction = |k: usize| k as f32 / STEPS as f32;
    for (rows, columns) in GRIDS {
        let table = waves(rows, columns);
        for normal in normals(20) {
            let down: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(0.3, fraction(k))).collect();
            let along: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(fraction(k), 0.7)).collect();
            let (down, along) = (table.sample_at(normal, &down), table.sample_at(normal, &along));
            assert!(down.windows(2).all(|pair| pair[0].0.y < pair[1].0.y), "{rows}x{columns} {normal}");
            assert!(along.windows(2).all(|pair| pair[0].0.x < pair[1].0.x && pair[0].0.y == pair[1].0.y));
            assert_eq!((down[0].0.y, along[0].0.x), (0.0, 0.0));
            let ends = table.sample_at(normal, &[Vec2::splat(BELOW_ONE)])[0].0;
            assert!(ends.x < 1.0 && ends.y < 1.0 && ends.min_element() > 0.99, "{ends}");
        }
    }
}

/// Integrals of the interpolated density over the rows up to y, and along the row up to y, return z.
#[test]
fn draws_invert_the_integral_of_the_density() {
    for (rows, columns) in GRIDS {
        let table = waves(rows, columns);
        let middle = |k: usize| {
            Vec2::new(((k % columns) as f32 + 0.5) / columns as f32, ((k / columns) as f32 + 0.5) / rows as f32)
        };
        let centres: Vec<Vec2> = (0..rows * columns).map(middle).collect();
        let mut random = Stream::new(5, Purpose::Test, 0);
        for normal in normals(20) {
            let q: Vec<f64> = table.density_at(normal, &centres).into_iter().map(f64::from).collect();
            let of_row = |row: usize| q[row * columns..][..columns].iter().sum::<f64>() / columns as f64;
            let whole = (0..rows).map(of_row).sum::<f64>() / rows as f64;
            assert!((whole - 1.0).abs() < 1e-5, "{whole}");
            let z: Vec<Vec2> = (0..200).map(|_| random.uniform2()).collect();
            for (z, (y, density)) in z.iter().zip(table.sample_at(normal, &z)) {
                let (row, column) = table.cells.cell(y);
                let inside = Vec2::new(y.x * columns as f32 - column as f32, y.y * rows as f32 - row as f32);
                let own = q[row * columns + column];
                assert!((f64::from(density) / own - 1.0).abs() < 1e-5, "{density} {own}");
                let above = (0..row).map(of_row).sum::<f64>() + f64::from(inside.y) * of_row(row);
                let left = q[row * columns..][..column].iter().sum::<f64>() + f64::from(inside.x) * own;
                // Sums of up to 64 rows and the position inside a row or cell, in single precision.
                assert!((above / rows as f64 - f64::from(z.y)).abs() < 4e-6, "{above} {z}");
                assert!((left / columns as f64 / of_row(row) - f64::from(z.x)).abs() < 4e-6, "{left} {z}");
            }
        }
    }
}

/// Draws do not jump where the normal crosses from one cell of the grid of normals to the next.
#[test]
fn draws_are_continuous_in_the_normal() {
    let (table, mut random) = (waves(32, 32), Stream::new(6, Purpose::Test, 0));
    let z: Vec<Vec2> = (0..100).map(|_| random.uniform2()).collect();
    for node in table.normals.shape().1..table.normals.nodes() - table.normals.shape().1 {
        let (at, aside) = (table.normals.normal(node), random.direction());
        let step = 1e-4 * aside;
        let [one, other] = [at - step, at + step].map(|normal| table.sample_at(normal.normalize(), &z));
        for ((one, density), (other, _)) in one.into_iter().zip(other) {
            // Weights change by at most 1e-3, and running sums by 2e-3 of the total; a row of little
            // mass stretches that to its own height, and columns of different rows are not comparable.
            let apart = (one - other).abs();
            let same_row = table.cells.cell(one).0 == table.cells.cell(other).0;
            assert!(apart.y < 0.1 && (!same_row || apart.x * density.min(1.0) < 0.1), "{node}: {one} {other}");
        }
    }
}
