//! The cells of a table within one coarse cell, and searching running sums.

use std::ops::Range;

use crate::bake::cell_masses::{Blend, CellMasses};

/// How much of the whole a running sum adds.
#[inline(always)]
pub(super) fn share(before: f32, sum: f32, whole: f32) -> f32 {
    (sum - before) / whole
}

/// The last of running sums but the very last that a target passes, and the number of those that it passes.
#[inline(always)]
pub(super) fn search(sums: &[f32], target: f32) -> (usize, f32, f32) {
    let mut passed = 0;
    for sum in &sums[..sums.len() - 1] {
        passed += i32::from(*sum <= target);
    }
    let place = passed as usize;
    (place, if place == 0 { 0.0 } else { sums[place - 1] }, sums[place])
}

/// The masses of the cells of the table in one coarse cell: running sums of its rows, and those along each of them.
pub(super) struct Fine {
    pub rows: [f32; MOST_FINE],
    pub along: [[f32; MOST_FINE]; MOST_FINE],
}

/// Most cells of a table along one side of a coarse cell: 64 over 8.
const MOST_FINE: usize = 8;

impl Fine {
    #[inline(always)]
    pub fn new(masses: &CellMasses, blend: &Blend, [rows, columns]: [&Range<usize>; 2]) -> Self {
        let mut out = Self { rows: [0.0; MOST_FINE], along: [[0.0; MOST_FINE]; MOST_FINE] };
        let mut all = 0.0;
        for (row, (along, whole)) in rows.clone().zip(out.along.iter_mut().zip(&mut out.rows)) {
            let mut sum = 0.0;
            for (column, along) in columns.clone().zip(along.iter_mut()) {
                sum += masses.mass(blend, row, column);
                *along = sum;
            }
            all += sum;
            *whole = all;
        }
        out
    }

    /// The probability of a cell, by its row and column in the coarse cell of so many.
    #[inline(always)]
    pub fn probability(&self, [row, column]: [usize; 2], [rows, columns]: [usize; 2]) -> f32 {
        let own = |sums: &[f32], place: usize, count: usize| {
            share(if place == 0 { 0.0 } else { sums[place - 1] }, sums[place], sums[count - 1])
        };
        own(&self.rows, row, rows) * own(&self.along[row], column, columns)
    }
}
