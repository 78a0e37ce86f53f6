use super::*;
use crate::simd::LANES;

const GRIDS: [(usize, usize); 8] = [(1, 1), (3, 5), (8, 8), (16, 12), (32, 32), (7, 33), (5, 1), (64, 64)];

/// Three tables: irregular masses, the same with one cell that outweighs all others together, and one
/// bright row. They belong to the first four nodes of a grid; the fourth node repeats the first table.
fn tables(cells: CellGrid) -> (CellMasses, [Vec<f64>; 4]) {
    let (count, columns) = (cells.cells(), cells.shape().1);
    let irregular: Vec<f64> = (0..count).map(|cell| ((cell * 7919) % 101) as f64 + 0.01).collect();
    let mut peaked = irregular.clone();
    peaked[count / 2] = 1e7;
    let row: Vec<f64> = (0..count).map(|cell| if cell / columns == 0 { 1.0 } else { 1e-9 }).collect();
    let nodes = [&irregular, &peaked, &row, &irregular, &row, &peaked].map(Vec::as_slice);
    let masses = CellMasses::new(NormalGrid::new(2, 3).unwrap(), cells, &nodes.concat());
    (masses, [irregular.clone(), peaked, row, irregular])
}

/// The masses and searches of one point, in every lane.
struct Single<'a> {
    masses: &'a CellMasses,
    blend: Blend,
}

impl Single<'_> {
    fn blends(&self) -> Blends<LANES> {
        Blends { cells: [self.blend.cell; LANES], weights: self.blend.weights.map(|weight| [weight; LANES]) }
    }

    fn mass(&self, row: usize, column: usize) -> f32 {
        let in_lanes = self.masses.masses(&self.blends(), &[row as u32; LANES], &[column as u32; LANES]);
        assert_eq!(in_lanes, [in_lanes[0]; LANES]);
        in_lanes[0]
    }

    fn search_row(&self, target: f32) -> (usize, f32) {
        let (rows, below) = self.masses.search_rows(&self.blends(), &[target; LANES]);
        assert!(rows == [rows[0]; LANES] && below == [below[0]; LANES]);
        (rows[0] as usize, below[0])
    }

    fn search_column(&self, row: usize, z: f32) -> (usize, f32, f32) {
        let (columns, right, masses) = self.masses.search_columns(&self.blends(), &[row as u32; LANES], &[z; LANES]);
        assert!(columns == [columns[0]; LANES] && right == [right[0]; LANES] && masses == [masses[0]; LANES]);
        (columns[0] as usize, right[0], masses[0])
    }
}

/// Four tables with a weight each.
struct Blend {
    cell: u32,
    weights: [f32; 4],
}

/// The table of one node alone, in units of its scale.
fn alone(masses: &CellMasses, node: usize) -> Blend {
    let (cell, corner) = masses.normals.cell_of(node);
    let mut weights = [0.0; 4];
    weights[corner] = 1.0;
    Blend { cell: cell as u32, weights }
}

#[test]
fn masses_are_rounded_by_at_most_a_step_and_stay_positive() {
    for (rows, columns) in GRIDS {
        let (masses, tables) = tables(CellGrid::new(rows, columns).unwrap());
        for (node, table) in tables.iter().enumerate() {
            let single = Single { masses: &masses, blend: alone(&masses, node) };
            let (cell, corner) = masses.normals.cell_of(node);
            let scale = masses.scales[cell][corner];
            let by_row = || table.chunks_exact(columns).map(|row| row.iter().sum::<f64>());
            let largest = by_row().fold(0.0, f64::max);
            let mut sum = 0.0;
            for ((row, whole), values) in by_row().enumerate().zip(table.chunks_exact(columns)) {
                for (column, &value) in values.iter().enumerate() {
                    let mass = single.mass(row, column);
                    assert!(mass >= 1.0);
                    sum += f64::from(mass);
                    // Half a step of the row's factor and a step at either end of the cell; a row or
                    // cell below one step takes one from the others of its row or table.
                    let row_step = largest / 65535.0;
                    let cell_steps = 2.0 + columns as f64;
                    let bound = row_step * (value / whole + cell_steps / 65535.0) + whole * cell_steps / 65535.0;
                    let error = (f64::from(mass) * f64::from(scale) - value).abs();
                    assert!(error <= 1.0001 * bound, "{rows}x{columns} {node}: {error} {bound}");
                }
            }
            // Products of 16-bit integers are rounded to 24 bits.
            let factors = masses.row_sums[(cell + 1) * rows - 1][corner];
            let expected = f64::from(factors) * f64::from(CellMasses::ROW);
            assert!((sum / expected - 1.0).abs() < 1e-7, "{sum} {expected}");
        }
    }
}

/// Searches for the middles of cells, in single tables and in weighted sums of them.
#[test]
fn searches_invert_running_sums() {
    let weights = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.1, 0.2, 0.3, 0.4], [1e-8, 2.0, 1e-3, 0.0]];
    for (rows, columns) in GRIDS {
        let (masses, _) = tables(CellGrid::new(rows, columns).unwrap());
        for (k, weights) in weights.into_iter().enumerate() {
            let single = Single { masses: &masses, blend: Blend { cell: k as u32 % 3, weights } };
            let mass = |row: usize, column: usize| f64::from(single.mass(row, column));
            let of_row = |row: usize| (0..columns).map(|column| mass(row, column)).sum::<f64>();
            let factor = |row: usize| of_row(row) / f64::from(CellMasses::ROW);
            let whole: f64 = (0..rows).map(factor).sum();
            let mut above = 0.0;
            for row in 0..rows {
                let (found, below) = single.search_row((above + 0.25 * factor(row)) as f32);
                // The target and the sums are rounded to 24 bits of the whole.
                let resolution = 3.0 * f64::from(f32::EPSILON) * whole / factor(row);
                assert!(found == row && (f64::from(below) - 0.25).abs() < resolution, "{row} {found} {below}");
                above += factor(row);
                let mut before = 0.0;
                for column in 0..columns {
                    let middle = (before + 0.5 * mass(row, column)) / of_row(row);
                    let (at, inside, own) = single.search_column(row, middle as f32);
                    let resolution = 3.0 * f64::from(f32::EPSILON) * of_row(row) / mass(row, column);
                    assert!(at == column && f64::from(own) == mass(row, column), "{rows}x{columns} {column} {at}");
                    assert!((f64::from(inside) - 0.5).abs() < resolution, "{inside} {resolution}");
                    before += mass(row, column);
                }
            }
            // Targets that rounding puts at the end or beyond are in the last cell.
            assert_eq!(single.search_row(1.01 * whole as f32).0, rows - 1);
            assert_eq!(single.search_column(rows - 1, 1.0).0, columns - 1);
        }
    }
}

/// Every lane has its own cell of the grid of normals, and its own weights.
#[test]
fn lanes_do_not_mix() {
    for (rows, columns) in GRIDS {
        let (masses, _) = tables(CellGrid::new(rows, columns).unwrap());
        let weights = std::array::from_fn(|corner| std::array::from_fn(|k| 0.1 + ((k * 5 + corner * 3) % 7) as f32));
        let cells: [u32; LANES] = std::array::from_fn(|k| k as u32 % 3);
        let (blends, totals) = masses.blends(&cells, &weights);
        let fraction = |k: usize| (k as f32 + 0.5) / LANES as f32;
        let targets = std::array::from_fn(|k| totals[k] * fraction(k));
        let z = std::array::from_fn(|k| fraction((k * 7) % LANES));
        let (found_rows, below) = masses.search_rows(&blends, &targets);
        let (found_columns, right, own) = masses.search_columns(&blends, &found_rows, &z);
        for k in 0..LANES {
            let blend = Blend { cell: cells[k], weights: lane(&blends.weights, k) };
            let single = Single { masses: &masses, blend };
            assert_eq!(single.search_row(targets[k]), (found_rows[k] as usize, below[k]));
            let found = (found_columns[k] as usize, right[k], own[k]);
            assert_eq!(single.search_column(found_rows[k] as usize, z[k]), found);
        }
    }
}
