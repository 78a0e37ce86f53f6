use super::*;

fn tree(columns: usize, rows: usize) -> Hierarchical {
    let luminance: Vec<f32> = (0..columns * (rows + 1)).map(|k| ((k * 7919) % 13) as f32).collect();
    Hierarchical::new(BilinearDensity::new(columns, rows + 1, &luminance).unwrap())
}

#[test]
fn cells_are_numbered_one_to_one_for_every_shape() {
    for (columns, rows) in [(1, 1), (8, 8), (16, 4), (4, 32), (7, 3), (1, 9), (1024, 511)] {
        let tree = tree(columns, rows);
        let mut seen = vec![false; columns.next_power_of_two() * rows.next_power_of_two()];
        for row in 0..rows as u32 {
            for column in 0..columns as u32 {
                let index = cell_index(tree.square_levels, column, row);
                assert_eq!(cell(tree.square_levels, tree.top_columns, index), (column, row), "{columns} x {rows}");
                assert!(!std::mem::replace(&mut seen[index as usize], true));
            }
        }
    }
}

#[test]
fn rectangles_tile_the_square_in_proportion_to_the_light() {
    for (columns, rows) in [(1, 1), (16, 4), (4, 32), (7, 3), (64, 31)] {
        let tree = tree(columns, rows);
        let cells = (columns * rows) as f32;
        let mut sum = 0.0;
        for row in 0..rows {
            for column in 0..columns {
                let bounds = tree.bounds(&[column as u32; LANES], &[row as u32; LANES]);
                let [left, right, top, bottom] =
                    [bounds.left, bounds.right, bounds.top, bounds.bottom].map(|side| side[0]);
                let (area, mass) = ((right - left) * (bottom - top), tree.grid.corners(column, row).mean() / cells);
                assert!((0.0..=1.0).contains(&left) && right <= 1.0 && top >= 0.0 && bottom <= 1.0);
                // Four bounds, each rounded to 6e-8, times sides of at most 1.
                assert!((area - mass).abs() < 3e-7, "{columns} x {rows}: {column} {row}: {area} {mass}");
                sum += area;
            }
        }
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    }
}

#[test]
fn a_node_of_the_map_is_a_rectangle_of_y() {
    for (columns, rows) in [(1, 1), (16, 4), (4, 32), (7, 3), (64, 31)] {
        let tree = tree(columns, rows);
        let (root, cells) = (Node::root(columns, rows), (columns * rows) as f64);
        let mut nodes = vec![root];
        while let Some(node) = nodes.pop() {
            let [left, right, top, bottom] = tree.rectangle(node);
            let inside = |first: u32, bits: u32, end: usize| first as usize..((first + (1 << bits)) as usize).min(end);
            let (mut light, mut cell) = (0.0, None);
            for row in inside(node.row, node.height_bits, rows) {
                for column in inside(node.column, node.width_bits, columns) {
                    light += f64::from(tree.grid.corners(column, row).mean()) / cells;
                    cell = Some((column as u32, row as u32));
                }
            }
            // Four sides, each rounded to 6e-8, times sides of at most 1.
            let area = f64::from((right - left) * (bottom - top));
            assert!((area - light).abs() < 5e-7, "{columns} x {rows} {node:?}: {area} {light}");
            if let Some((column, row)) = cell {
                let y = tree.inverse(tree.grid.point(column, row, Vec2::splat(0.5))).0;
                assert!(y.x >= left && y.x <= right && y.y >= top && y.y <= bottom, "{node:?} {y}");
            }
            if !node.is_cell() {
                nodes.extend(node.children());
            }
        }
    }
}
