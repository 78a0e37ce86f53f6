use super::*;

const GRIDS: [(usize, usize); 8] = [(1, 1), (3, 5), (8, 8), (16, 12), (32, 32), (7, 33), (5, 1), (64, 64)];

/// Three tables: irregular masses, the same with one cell that outweighs all others together, one bright row.
fn tables(cells: CellGrid) -> (CellMasses, [Vec<f64>; 3]) {
    let (count, columns) = (cells.cells(), cells.shape().1);
    let irregular: Vec<f64> = (0..count).map(|cell| ((cell * 7919) % 101) as f64 + 0.01).collect();
    let mut peaked = irregular.clone();
    peaked[count / 2] = 1e7;
    let row: Vec<f64> = (0..count).map(|cell| if cell / columns == 0 { 1.0 } else { 1e-9 }).collect();
    let tables = [irregular, peaked, row];
    (CellMasses::new(cells, &tables.concat()), tables)
}

/// One table alone.
fn alone(node: usize) -> Blend {
    Blend { nodes: [node, 0, 1, 2], weights: [1.0, 0.0, 0.0, 0.0] }
}

#[test]
fn masses_are_rounded_to_a_step_and_never_to_nothing() {
    for (rows, columns) in GRIDS {
        let (masses, tables) = tables(CellGrid::new(rows, columns).unwrap());
        for (node, table) in tables.iter().enumerate() {
            let Node { scale, rows: factors } = masses.node(node);
            let by_row = || table.chunks_exact(columns).map(|row| row.iter().sum::<f64>());
            let largest = by_row().fold(0.0, f64::max);
            let mut sum = 0.0;
            for ((row, whole), values) in by_row().enumerate().zip(table.chunks_exact(columns)) {
                for (column, &value) in values.iter().enumerate() {
                    let mass = masses.mass(&alone(node), row, column);
                    assert!(mass >= 1.0);
                    sum += f64::from(mass);
                    // Half a step of the row's factor and a step at either end of the cell; a row or cell that is less than
                    // a step takes one from the others of its row or table.
                    let row_step = largest / 65535.0;
                    let cell_steps = 2.0 + columns as f64;
                    let bound = row_step * (value / whole + cell_steps / 65535.0) + whole * cell_steps / 65535.0;
                    let error = (f64::from(mass) * f64::from(scale) - value).abs();
                    assert!(error <= 1.0001 * bound, "{rows}x{columns} {node}: {error} {bound}");
                }
            }
            // Products of 16-bit integers are rounded to 24 bits.
            let expected = f64::from(factors) * f64::from(CellMasses::ROW);
            assert!((sum / expected - 1.0).abs() < 1e-7, "{sum} {expected}");
        }
    }
}

/// The middles of cells, up to where their running sums say they are, in single tables and in weighted sums of them.
#[test]
fn cells_are_found_where_their_running_sums_say() {
    let weights = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.1, 0.2, 0.3, 0.4], [1e-8, 2.0, 1e-3, 0.0]];
    for (rows, columns) in GRIDS {
        let (masses, _) = tables(CellGrid::new(rows, columns).unwrap());
        for weights in weights {
            let blend = Blend { nodes: [0, 1, 2, 0], weights };
            let mass = |row: usize, column: usize| f64::from(masses.mass(&blend, row, column));
            let of_row = |row: usize| (0..columns).map(|column| mass(row, column)).sum::<f64>();
            let factor = |row: usize| of_row(row) / f64::from(CellMasses::ROW);
            let whole: f64 = (0..rows).map(factor).sum();
            let mut above = 0.0;
            for row in 0..rows {
                let (found, below) = masses.search_row(&blend, (above + 0.25 * factor(row)) as f32);
                // The target and the sums are rounded to 24 bits of the whole.
                let resolution = 3.0 * f64::from(f32::EPSILON) * whole / factor(row);
                assert!(found == row && (f64::from(below) - 0.25).abs() < resolution, "{row} {found} {below}");
                above += factor(row);
                let mut before = 0.0;
                for column in 0..columns {
                    let middle = (before + 0.5 * mass(row, column)) / of_row(row);
                    let (at, inside, own) = masses.search_column(&blend, row, middle as f32);
                    let resolution = 3.0 * f64::from(f32::EPSILON) * of_row(row) / mass(row, column);
                    assert!(at == column && f64::from(own) == mass(row, column), "{rows}x{columns} {column} {at}");
                    assert!((f64::from(inside) - 0.5).abs() < resolution, "{inside} {resolution}");
                    before += mass(row, column);
                }
            }
            // What rounding puts at the end is in the last cell.
            assert_eq!(masses.search_row(&blend, 1.01 * whole as f32).0, rows - 1);
            assert_eq!(masses.search_column(&blend, rows - 1, 1.0).0, columns - 1);
        }
    }
}
