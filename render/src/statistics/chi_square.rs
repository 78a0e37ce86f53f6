//! Chi-square test that directions are drawn with the density that a sampler claims.
//!
//! After Mitsuba's `ChiSquareTest`: directions are counted in the cells of a lat-long grid and compared with the claimed
//! density, integrated over each cell. The number of rows is odd, so that no border of cells runs along the equator,
//! where many densities end.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::path::Path;

use glam::{Vec2, Vec3A};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::sidak;
use crate::error::Result;
use crate::file;
use crate::image::encode_png_rgb8;
use crate::latlong;
use crate::random::{Purpose, Stream};

/// The settings of a test; [`Default`] is one million directions on 51 x 102 cells at significance 0.01.
#[derive(Clone, Debug)]
pub struct SphereChiSquare {
    /// Rows of cells, odd; there are twice as many columns.
    pub rows: usize,
    /// The density of a cell is the mean over `subcells x subcells` points. 4 is enough for smooth densities;
    /// a density with details (an environment map) needs points as dense as its texels.
    pub subcells: usize,
    /// Number of draws.
    pub samples: usize,
    /// Probability of rejecting a correct density in any of the `tests`.
    pub significance: f64,
    /// Number of such tests performed together (Sidak's correction).
    pub tests: usize,
    /// Largest quadrature error: difference of the density's integral from the fraction of accepted draws.
    pub mass_tolerance: f64,
    /// Seed of the random stream.
    pub seed: u64,
}

impl Default for SphereChiSquare {
    fn default() -> Self {
        Self { rows: 51, subcells: 4, samples: 1_000_000, significance: 0.01, tests: 1, mass_tolerance: 0.01, seed: 1 }
    }
}

/// Cells with a smaller expected count are pooled: below it the statistic is not chi-square distributed.
const LEAST_EXPECTED: f64 = 5.0;

/// Draws per call of the sampler.
const BATCH: usize = 4096;

/// Largest deviation of the squared length of a direction from 1; `f32` normalisation leaves 1e-6.
const UNIT_TOLERANCE: f32 = 1e-3;

/// The outcome of a chi-square test.
#[derive(Clone, Debug)]
pub struct ChiSquareReport {
    /// Probability of a statistic at least this large if the density is correct.
    pub p_value: f64,
    /// `sum (observed - expected)^2 / expected` over the cells.
    pub statistic: f64,
    /// Cells (a pool counts as one) minus one.
    pub degrees_of_freedom: usize,
    /// The integral of the density over the sphere.
    pub integral: f64,
    /// The fraction of draws that gave a direction, which the integral must equal.
    pub accepted: f64,
    /// The p-value below which the density is rejected.
    pub threshold: f64,
    /// One sentence per failure; empty if the test passed.
    pub failures: Vec<String>,
    /// Rows of cells.
    pub rows: usize,
    /// Columns of cells.
    pub columns: usize,
    /// `[rows * columns]` directions counted in each cell.
    pub observed: Vec<f64>,
    /// `[rows * columns]` directions expected in each cell, with the same sum unless the integral is zero.
    pub expected: Vec<f64>,
}

impl SphereChiSquare {
    /// Draws directions with `sample`, which returns the given number of draws, and compares them with `pdf`,
    /// the density over solid angle at each direction of a list.
    ///
    /// A draw may be `None`: the density must integrate to the fraction of draws that are `Some`.
    ///
    /// # Panics
    /// If either returns a different number of values than requested.
    pub fn run(
        &self,
        mut sample: impl FnMut(&mut Stream, usize) -> Vec<Option<Vec3A>>,
        pdf: impl Fn(&[Vec3A]) -> Vec<f32>,
    ) -> ChiSquareReport {
        let mut failures = Vec::new();
        let mut expected = self.integrate(&pdf, &mut failures);
        let (observed, orphans) = self.count(&mut sample, &pdf, &expected, &mut failures);
        let (integral, drawn): (f64, f64) = (expected.iter().sum(), observed.iter().sum());
        let accepted = drawn / self.samples as f64;
        if (integral - accepted).abs() > self.mass_tolerance || !integral.is_finite() {
            failures
                .push(format!("the density integrates to {integral:.5}, but {accepted:.5} of the draws are samples"));
        }
        if orphans > 0 {
            failures.push(format!("{orphans} directions were drawn where the density is zero"));
        }
        if integral > 0.0 {
            expected.iter_mut().for_each(|cell| *cell *= drawn / integral);
        }
        let (statistic, cells) = statistic(&observed, &expected);
        let degrees_of_freedom = cells.saturating_sub(1);
        let p_value = match degrees_of_freedom {
            _ if !statistic.is_finite() => 0.0,
            0 => 1.0,
            freedom => ChiSquared::new(freedom as f64).expect("degrees of freedom are positive").sf(statistic),
        };
        if degrees_of_freedom == 0 {
            failures.push(format!("{cells} cells are too few for a test: {drawn} directions"));
        }
        let threshold = sidak(self.significance, self.tests);
        if p_value < threshold {
            failures.push(format!("p = {p_value:.2e} is below {threshold:.2e}"));
        }
        let (rows, columns) = (self.rows, self.columns());
        ChiSquareReport {
            p_value,
            statistic,
            degrees_of_freedom,
            integral,
            accepted,
            threshold,
            failures,
            rows,
            columns,
            observed,
            expected,
        }
    }

    fn columns(&self) -> usize {
        2 * self.rows
    }

    /// Integrates the density over each cell by midpoints of sub-cells with exact solid angles, one row of
    /// cells at a time.
    fn integrate(&self, pdf: impl Fn(&[Vec3A]) -> Vec<f32>, failures: &mut Vec<String>) -> Vec<f64> {
        let (rows, columns) = (self.rows * self.subcells, self.columns() * self.subcells);
        let mut cells = vec![0.0; self.rows * self.columns()];
        let mut invalid = 0_usize;
        for (index, cells) in cells.chunks_exact_mut(self.columns()).enumerate() {
            let own = index * self.subcells..(index + 1) * self.subcells;
            let centre = |row: usize, column: usize| {
                let x = Vec2::new((column as f32 + 0.5) / columns as f32, (row as f32 + 0.5) / rows as f32);
                latlong::direction(x)
            };
            let centres: Vec<Vec3A> =
                own.clone().flat_map(|row| (0..columns).map(move |column| centre(row, column))).collect();
            let densities = pdf(&centres);
            assert_eq!(densities.len(), centres.len(), "one density for each direction");
            for (row, densities) in own.zip(densities.chunks_exact(columns)) {
                let theta = |edge: usize| PI * edge as f64 / rows as f64;
                let solid_angle = (theta(row).cos() - theta(row + 1).cos()) * TAU / columns as f64;
                for (column, &density) in densities.iter().enumerate() {
                    if density >= 0.0 && density.is_finite() {
                        cells[column / self.subcells] += f64::from(density) * solid_angle;
                    } else {
                        invalid += 1;
                    }
                }
            }
        }
        if invalid > 0 {
            failures.push(format!("the density is negative, infinite or not a number at {invalid} points"));
        }
        cells
    }

    /// Draws and counts directions; also counts those of zero density in cells of zero density.
    ///
    /// The densities of directions decide there, since a cell that a lobe touches only in a corner can be
    /// zero at all quadrature points.
    fn count(
        &self,
        sample: &mut impl FnMut(&mut Stream, usize) -> Vec<Option<Vec3A>>,
        pdf: impl Fn(&[Vec3A]) -> Vec<f32>,
        expected: &[f64],
        failures: &mut Vec<String>,
    ) -> (Vec<f64>, usize) {
        let mut random = Stream::new(self.seed, Purpose::Test, 0);
        let mut observed = vec![0.0; expected.len()];
        let (mut in_empty_cells, mut invalid) = (Vec::new(), 0);
        for first in (0..self.samples).step_by(BATCH) {
            let count = BATCH.min(self.samples - first);
            let drawn = sample(&mut random, count);
            assert_eq!(drawn.len(), count, "as many draws as are asked for");
            for w in drawn.into_iter().flatten() {
                let off_unit = (w.length_squared() - 1.0).abs();
                if off_unit.is_nan() || off_unit > UNIT_TOLERANCE {
                    invalid += 1;
                    continue;
                }
                let x = latlong::square(w);
                let column = ((x.x * self.columns() as f32) as usize).min(self.columns() - 1);
                let row = ((x.y * self.rows as f32) as usize).min(self.rows - 1);
                let cell = row * self.columns() + column;
                observed[cell] += 1.0;
                if expected[cell] == 0.0 {
                    in_empty_cells.push(w);
                }
            }
        }
        if invalid > 0 {
            failures.push(format!("{invalid} directions are not of unit length"));
        }
        let orphans = pdf(&in_empty_cells).into_iter().filter(|&density| density <= 0.0).count();
        (observed, orphans)
    }
}

/// Returns the chi-square statistic and its number of cells after pooling.
fn statistic(observed: &[f64], expected: &[f64]) -> (f64, usize) {
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    let (mut statistic, mut cells) = (0.0, 0);
    let (mut pool_observed, mut pool_expected) = (0.0, 0.0);
    for cell in order {
        // A pool that is too small includes the next cell of any size, so that nothing remains unless all
        // cells are small.
        pool_observed += observed[cell];
        pool_expected += expected[cell];
        if pool_expected >= LEAST_EXPECTED {
            statistic += (pool_observed - pool_expected).powi(2) / pool_expected;
            cells += 1;
            (pool_observed, pool_expected) = (0.0, 0.0);
        }
    }
    (statistic, cells)
}

impl ChiSquareReport {
    /// Returns whether the test passed.
    pub fn passed(&self) -> bool {
        self.failures.is_empty()
    }

    /// Writes a PNG of three maps from top to bottom: observed counts, expected counts (both as square roots,
    /// black is 0) and their difference in standard deviations (blue: too few, white: as expected, red: too
    /// many; saturated at 5).
    ///
    /// # Errors
    /// See [`file::replace`].
    pub fn write_picture(&self, path: &Path) -> Result<()> {
        let largest = self.expected.iter().chain(&self.observed).copied().fold(0.0, f64::max).max(1e-300);
        let grey = |count: &f64| [(255.0 * (count / largest).sqrt()) as u8; 3];
        let difference = |(observed, expected): (&f64, &f64)| {
            let deviations = (observed - expected) / expected.max(1.0).sqrt();
            let fade = |strength: f64| (255.0 * (1.0 - strength.clamp(0.0, 1.0))) as u8;
            let (few, many) = (fade(-deviations / 5.0), fade(deviations / 5.0));
            [few, few.min(many), many]
        };
        let pixels: Vec<[u8; 3]> = self
            .observed
            .iter()
            .map(grey)
            .chain(self.expected.iter().map(grey))
            .chain(self.observed.iter().zip(&self.expected).map(difference))
            .collect();
        // Cells are squares of several pixels, visible without zooming.
        const SCALE: usize = 4;
        let (width, height) = (SCALE * self.columns, SCALE * 3 * self.rows);
        let enlarged: Vec<[u8; 3]> =
            (0..width * height).map(|i| pixels[i / width / SCALE * self.columns + i % width / SCALE]).collect();
        file::replace(path, &encode_png_rgb8(width, height, &enlarged)?)
    }

    /// Asserts, for use in tests, that the test passed.
    ///
    /// # Panics
    /// If the test failed, with its failures, after writing `chi_square_<name>.png` to the folder of
    /// temporary files.
    pub fn assert_passed(&self, name: &str) {
        if !self.passed() {
            let path = std::env::temp_dir().join(format!("chi_square_{name}.png"));
            let picture = match self.write_picture(&path) {
                Ok(()) => format!("see {}", path.display()),
                Err(error) => error.to_string(),
            };
            panic!("{name}: {self}; {picture}");
        }
    }
}

impl fmt::Display for ChiSquareReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { p_value, statistic, degrees_of_freedom, integral, .. } = self;
        write!(f, "p = {p_value:.3e}, chi-square {statistic:.1} with {degrees_of_freedom} degrees of freedom, ")?;
        write!(f, "integral {integral:.5}")?;
        for failure in &self.failures {
            write!(f, "; {failure}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
