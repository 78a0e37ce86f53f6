//! The grid of cells over the intermediate square Y.

use glam::Vec2;

use crate::error::{Error, Result};

/// Maximum number of cells along a side of Y: f32 holds the sum of this many row factors exactly.
const MOST_CELLS: usize = 64;

/// The cells of the intermediate square: `rows` along elevation, `columns` around the circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellGrid {
    rows: usize,
    columns: usize,
}

impl CellGrid {
    /// Makes a grid of `rows x columns` cells.
    ///
    /// # Errors
    /// Both must be 1 to 64.
    pub fn new(rows: usize, columns: usize) -> Result<Self> {
        if !(1..=MOST_CELLS).contains(&rows) || !(1..=MOST_CELLS).contains(&columns) {
            return Err(Error::argument("cells", format!("{rows}x{columns}: choose from 1x1 up to 64x64")));
        }
        Ok(Self { rows, columns })
    }

    /// Rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.rows * self.columns
    }

    /// Row and column of a point of Y.
    #[inline(always)]
    pub fn cell(&self, y: Vec2) -> (usize, usize) {
        let row = ((y.y * self.rows as f32) as usize).min(self.rows - 1);
        let column = ((y.x * self.columns as f32) as usize).min(self.columns - 1);
        (row, column)
    }
}
