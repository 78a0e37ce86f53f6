//! Tails as flat lists, for implementations on other devices.

use super::{FlowTail, Hierarchical, RowColumn, Tail};
use crate::{environment::BilinearDensity, flat::FlatArray};

impl Tail {
    /// Returns all arrays that the warp reads; their names identify the kind of tail.
    pub fn flat(&self) -> Vec<FlatArray> {
        match self {
            Self::Hierarchical(tail) => tail.flat(),
            Self::RowColumn(tail) => tail.flat(),
            Self::Flow(tail) => tail.flat(),
        }
    }
}

/// `tail.nodes` `[height, width]`: the density at the texels of the map.
fn nodes(grid: &BilinearDensity) -> FlatArray {
    FlatArray::floats("tail.nodes", vec![grid.rows() + 1, grid.columns()], grid.nodes().collect())
}

impl Hierarchical {
    /// Returns all arrays that the warp reads.
    ///
    /// - `tail.nodes` `[height, width]`: the density at the texels of the map.
    /// - `tail.cuts` `[nodes, 4]`, `tail.levels` `[levels, 3]`: see [`Self::levels`]; per level the two
    ///   logarithms and the index of its first cut.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut cuts, mut levels) = (Vec::new(), Vec::new());
        for ([column_bits, row_bits], own) in self.levels() {
            levels.extend([column_bits, row_bits, (cuts.len() / 4) as u32]);
            cuts.extend_from_slice(own.as_flattened());
        }
        vec![
            nodes(self.grid()),
            FlatArray::floats("tail.cuts", vec![cuts.len() / 4, 4], cuts),
            FlatArray::integers("tail.levels", vec![levels.len() / 3, 3], levels),
        ]
    }
}

impl RowColumn {
    /// Returns all arrays that the warp reads.
    ///
    /// - `tail.shape` `[2]`: columns of texels of the map, rows of cells.
    /// - `tail.windows` `[1, 8]`, `tail.numbers` `[numbers]`: see `window`.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (window, numbers) = self.window();
        vec![
            FlatArray::integers("tail.shape", vec![2], vec![self.grid().columns() as u32, self.grid().rows() as u32]),
            FlatArray::integers("tail.windows", vec![1, 8], window.to_vec()),
            FlatArray::floats("tail.numbers", vec![numbers.len()], numbers),
        ]
    }

    /// Returns the part of the map that has light, and its numbers. First row of cells and row count, first
    /// column and column count, then the starts of four lists in the numbers: densities at the texels around
    /// its cells `[rows + 1, columns + 1]`; marginal densities at its rows of texels `[rows + 1]`; the
    /// fraction of the light above each of these rows; the integral of each row of texels from the left edge
    /// of the part, `[rows + 1, columns + 1]`.
    fn window(&self) -> ([u32; 8], Vec<f32>) {
        let (width, height) = (self.grid().columns(), self.grid().rows());
        let nodes: Vec<f32> = self.grid().nodes().collect();
        let [marginal, above, before] = self.tables();
        let is_lit = |row: &usize| marginal[*row] > 0.0 || marginal[row + 1] > 0.0;
        let (first, last) = ends((0..height).filter(is_lit));
        let rows = first..last + 2;
        let is_lit = |column: &usize| {
            let next = (column + 1) % width;
            rows.clone().any(|row| nodes[row * width + column] > 0.0 || nodes[row * width + next] > 0.0)
        };
        let (left, right) = ends((0..width).filter(is_lit));
        let mut numbers = Vec::new();
        for row in rows.clone() {
            numbers.extend((left..right + 2).map(|column| nodes[row * width + column % width]));
        }
        let of_marginal = numbers.len();
        numbers.extend(&marginal[rows.clone()]);
        let of_above = numbers.len();
        numbers.extend(&above[rows.clone()]);
        let of_before = numbers.len();
        for row in rows {
            numbers.extend(&before[row * (width + 1)..][left..right + 2]);
        }
        let window = [first, last + 1 - first, left, right + 1 - left, 0, of_marginal, of_above, of_before];
        (window.map(|n| n as u32), numbers)
    }
}

/// Returns the first and the last number of an ascending list; 0 for an empty one.
fn ends(mut list: impl Iterator<Item = usize>) -> (usize, usize) {
    let first = list.next().unwrap_or(0);
    (first, list.last().unwrap_or(first))
}

impl FlowTail {
    /// Returns all arrays that the warp reads.
    ///
    /// - `tail.cells` `[cells * cells, 8]`: for each cell of Y, row by row, `p`, `e`, `f`, `g` of the image
    ///   `p + s e + t f + s t g` in X; the circle's coordinate is lifted to the line.
    /// - `tail.boxes` `[boxes, 4]`: a tree of bounding boxes of images (left, top, right, bottom): level `k`
    ///   has `2^k x 2^k` boxes, row by row, and the last level one per cell. Levels are consecutive.
    pub fn flat(&self) -> Vec<FlatArray> {
        let map = self.map();
        let side = map.cells();
        let cells: Vec<f32> = (0..side * side).flat_map(|index| map.cell_numbers(index)).collect();
        let boxes: Vec<f32> = map.box_numbers().collect();
        vec![
            FlatArray::floats("tail.cells", vec![side * side, 8], cells),
            FlatArray::floats("tail.boxes", vec![boxes.len() / 4, 4], boxes),
        ]
    }
}
