//! How numbers of the sky lie in memory: patches by clusters, and cells of a grid over Y.

use crate::simd::LANES;

/// Clusters of patches.
pub const CLUSTERS: usize = 32;
/// Patches: [`LANES`] of each cluster.
pub const PATCHES: usize = CLUSTERS * LANES;

/// Numbers for the cells of a grid, twice: column by column, each padded to whole lanes, and row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridLayout {
    /// Rows of cells.
    pub rows: usize,
    /// Columns of cells.
    pub columns: usize,
}

impl GridLayout {
    /// Numbers from one column to the next.
    #[inline(always)]
    pub fn column(self) -> usize {
        self.rows.next_multiple_of(LANES)
    }

    /// Numbers from one row to the next.
    #[inline(always)]
    pub fn row(self) -> usize {
        self.columns.next_multiple_of(LANES)
    }

    /// Numbers before the rows.
    #[inline(always)]
    pub fn rows_start(self) -> usize {
        self.columns * self.column()
    }

    /// All numbers.
    pub fn bytes(self) -> usize {
        self.rows_start() + self.rows * self.row()
    }

    /// Lays out a number for each cell; padding has 0.
    pub fn lay_out<T: Copy + Default>(self, of_cell: impl Fn(usize, usize) -> T) -> Box<[T]> {
        let mut out = vec![T::default(); self.bytes()];
        for row in 0..self.rows {
            for column in 0..self.columns {
                let number = of_cell(row, column);
                out[column * self.column() + row] = number;
                out[self.rows_start() + row * self.row() + column] = number;
            }
        }
        out.into()
    }
}
