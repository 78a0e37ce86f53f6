use super::*;
use crate::{
    bake::{CellGrid, NormalGrid},
    brdf::Lambert,
    random::{Purpose, Stream},
    tile::{ShadingPoint, Tile},
    visibility::{PATCHES, Weights},
};
use glam::{Vec3, Vec3A};

struct One(Weights);

impl Weighting for One {
    fn at(&self, _index: f32) -> Option<&Weights> {
        Some(&self.0)
    }
}

/// Sizes of tables with the sides of their coarse grids: multiples and not, a grid that is the table itself.
const SIZES: [(usize, usize, usize); 6] =
    [(32, 32, 16), (32, 32, 8), (64, 64, 32), (7, 33, 16), (1, 1, 8), (64, 64, 8)];

fn weight(cell: usize) -> f32 {
    ((cell * 37) % 10 + 1) as f32 / 10.0
}

fn tables() -> impl Iterator<Item = WeightedTable> {
    SIZES.into_iter().map(|(rows, columns, side)| {
        let (normals, cells) = (NormalGrid::new(5, 7).unwrap(), CellGrid::new(rows, columns).unwrap());
        let table = BakedTable::fill(normals, cells, |normal, masses| {
            for (k, mass) in masses.iter_mut().enumerate() {
                *mass = ((0.7 * k as f32 + 3.0 * normal.x + normal.z).sin() + 0.9).max(0.0) * (1.1 + normal.y);
            }
        });
        WeightedTable::new(table.unwrap(), side).unwrap()
    })
}

/// Runs work over columns of points of the square at one normal: three numbers of each.
fn at(
    density: &impl IntermediateDensity,
    normal: Vec3A,
    points: &[Vec2],
    work: impl Fn(&Rows<'_>, &[Lanes], [&[Lanes]; 2], [&mut [Lanes]; 3], &Arena),
) -> Vec<(Vec2, f32)> {
    let surface = Lambert { albedo: Vec3::ONE }.into();
    let point = ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, surface };
    let (arena, mut out) = (Arena::default(), Vec::new());
    for points in points.chunks(1024) {
        let tile = Tile::of(&vec![point; points.len()]);
        let rows = tile.rows();
        let mut state = vec![[0.0; LANES]; density.columns() * rows.strips()];
        density.prepare(&rows, &mut state, &arena);
        let mut columns = arena.columns::<5>(rows.strips());
        let [a, b, u, v, q] = columns.get_mut();
        for (k, point) in points.iter().enumerate() {
            (a[k / LANES][k % LANES], b[k / LANES][k % LANES]) = (point.x, point.y);
        }
        work(&rows, &state, [a, b], [&mut *u, &mut *v, &mut *q], &arena);
        let [_, _, u, v, q] = columns.get().map(<[Lanes]>::as_flattened);
        out.extend((0..points.len()).map(|k| (Vec2::new(u[k], v[k]), q[k])));
    }
    out
}

fn densities(density: &impl IntermediateDensity, normal: Vec3A, y: &[Vec2]) -> Vec<f64> {
    let work = |rows: &Rows<'_>, state: &[Lanes], y: [&[Lanes]; 2], [_, _, q]: [&mut [Lanes]; 3], arena: &Arena| {
        density.density(rows, state, y, q, arena);
    };
    at(density, normal, y, work).into_iter().map(|(_, q)| f64::from(q)).collect()
}

fn draws(density: &impl IntermediateDensity, normal: Vec3A, z: &[Vec2]) -> Vec<(Vec2, f32)> {
    let work = |rows: &Rows<'_>, state: &[Lanes], z: [&[Lanes]; 2], [u, v, q]: [&mut [Lanes]; 3], arena: &Arena| {
        density.sample(rows, state, z, [u, v], q, arena);
    };
    at(density, normal, z, work)
}

fn normals() -> impl Iterator<Item = Vec3A> {
    let mut random = Stream::new(4, Purpose::Test, 0);
    (0..8).map(move |_| random.direction()).chain([Vec3A::Y, -Vec3A::Y])
}

fn centres(table: &WeightedTable) -> Vec<Vec2> {
    let (rows, columns) = table.table.cells().shape();
    let centre =
        |k: usize| Vec2::new(((k % columns) as f32 + 0.5) / columns as f32, ((k / columns) as f32 + 0.5) / rows as f32);
    (0..rows * columns).map(centre).collect()
}

#[test]
fn the_density_is_the_table_s_times_the_weights() {
    for table in tables() {
        let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
        let centres = centres(&table);
        for normal in normals() {
            let own = densities(&table.weighted(&weights), normal, &centres);
            let mean = own.iter().sum::<f64>() / own.len() as f64;
            assert!((mean - 1.0).abs() < 1e-5, "{mean}");
            let plain = table.table.density_at(normal, &centres);
            let (rows, columns) = table.table.cells().shape();
            let weighted: Vec<f64> = (0..rows * columns)
                .map(|k| {
                    let (row, column) = (table.coarse[0][k / columns], table.coarse[1][k % columns]);
                    // In steps of 1/255, as weights are kept.
                    let weight = weight(usize::from(row) * table.layout.columns + usize::from(column));
                    f64::from(plain[k]) * f64::from((255.0 * weight).round())
                })
                .collect();
            let all = weighted.iter().sum::<f64>() / weighted.len() as f64;
            let largest = weighted.iter().copied().fold(0.0, f64::max) / all;
            for (own, weighted) in own.iter().zip(&weighted) {
                // A coarse cell is rounded up by a step of 1/65535 of the largest of each of four tables, whose largest need not be that
                // of the blend: a few steps. The whole is larger by as much.
                let expected = weighted / all;
                assert!((own - expected).abs() < 1e-4 * (expected + 10.0 * largest), "{own} {expected} {largest}");
            }
        }
    }
}

#[test]
fn draws_grow_with_their_uniform_numbers_and_have_the_density_that_is_given() {
    const STEPS: usize = 2048;
    let share = |k: usize| k as f32 / STEPS as f32;
    for table in tables() {
        let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
        let density = table.weighted(&weights);
        for normal in normals() {
            let down: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(0.3, share(k))).collect();
            let along: Vec<Vec2> = (0..STEPS).map(|k| Vec2::new(share(k), 0.7)).collect();
            let (down, along) = (draws(&density, normal, &down), draws(&density, normal, &along));
            // Within a coarse row, what a column holds decides where it is divided: the order of rows is kept from one coarse row to the next.
            let row = |y: Vec2| table.coarse[0][table.table.cells().cell(y).0];
            assert!(down.windows(2).all(|pair| row(pair[0].0) <= row(pair[1].0)));
            let column = |y: Vec2| table.coarse[1][table.table.cells().cell(y).1];
            assert!(along.windows(2).all(|pair| column(pair[0].0) <= column(pair[1].0)));
            for drawn in [down, along] {
                let y: Vec<Vec2> = drawn.iter().map(|&(y, _)| y).collect();
                for ((y, q), found) in drawn.iter().zip(densities(&density, normal, &y)) {
                    assert!((f64::from(*q) / found - 1.0).abs() < 1e-5, "{y}: {q} {found}");
                }
            }
        }
    }
}

/// Pearson's statistic over the table's cells, those that expect fewer than ten draws together as one, and as a normal deviate (Wilson and Hilferty
/// 1931). Five of those are 3e-7 for each of some fifty tests.
#[test]
fn draws_are_as_many_as_the_density_says() {
    const DRAWS: usize = 1 << 17;
    for (number, table) in tables().enumerate() {
        let weights = One(Weights::new(|_| 1.0, &[1.0; PATCHES]).with_grid(table.layout(), weight));
        let density = table.weighted(&weights);
        let (rows, columns) = table.table.cells().shape();
        for (k, normal) in normals().enumerate() {
            let mut random = Stream::new(9, Purpose::Test, (number * 100 + k) as u64);
            let z: Vec<Vec2> = (0..DRAWS).map(|_| random.uniform2()).collect();
            let mut counts = vec![0.0; rows * columns];
            for (y, _) in draws(&density, normal, &z) {
                let (row, column) = table.table.cells().cell(y);
                counts[row * columns + column] += 1.0;
            }
            let (mut statistic, mut cells, mut rest) = (0.0, 0, (0.0, 0.0));
            for (count, q) in counts.iter().zip(densities(&density, normal, &centres(&table))) {
                let expected = q * DRAWS as f64 / (rows * columns) as f64;
                if expected < 10.0 {
                    rest = (rest.0 + count, rest.1 + expected);
                } else {
                    statistic += (count - expected).powi(2) / expected;
                    cells += 1;
                }
            }
            if rest.1 >= 10.0 {
                statistic += (rest.0 - rest.1).powi(2) / rest.1;
                cells += 1;
            } else {
                assert!(rest.0 < rest.1 + 40.0, "{} draws where {} are expected", rest.0, rest.1);
            }
            let freedom = f64::from(cells - 1);
            if freedom > 0.0 {
                let spread = 2.0 / (9.0 * freedom);
                let deviate = ((statistic / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
                assert!(deviate < 5.0, "{rows} x {columns}, {normal}: {statistic} over {cells} cells");
            }
        }
    }
}

#[test]
fn only_three_sizes_are_taken() {
    let table = || tables().next().unwrap().table;
    for side in [0, 7, 64, usize::MAX] {
        assert!(WeightedTable::new(table(), side).unwrap_err().to_string().contains("8, 16 or 32"));
    }
}
