//! Chi-square test: are directions drawn with the density that a sampler claims?
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

/// The test with its settings; [`Default`] is one million directions on 51 x 102 cells at significance 0.01.
#[derive(Clone, Debug)]
pub struct SphereChiSquare {
    /// Rows of cells, odd; there are twice as many columns.
    pub rows: usize,
    /// The density of a cell is the mean over `subcells x subcells` points. 4 does for smooth densities; a density with
    /// details (an environment map) needs points as dense as its texels.
    pub subcells: usize,
    /// Directions drawn.
    pub samples: usize,
    /// The chance to reject a right density in any of the `tests`.
    pub significance: f64,
    /// How many such tests are made together (Sidak's correction).
    pub tests: usize,
    /// How far the integral of the density may be from the fraction of draws that gave a direction: quadrature error.
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

/// Directions that are drawn at a time.
const BATCH: usize = 4096;

/// How far the squared length of a direction may be from 1; `f32` normalisation leaves 1e-6.
const UNIT_TOLERANCE: f32 = 1e-3;

/// The outcome of a chi-square test.
#[derive(Clone, Debug)]
pub struct ChiSquareReport {
    /// The chance of a statistic at least this large if the density is right.
    pub p_value: f64,
    /// `sum (observed - expected)^2 / expected` over the cells.
    pub statistic: f64,
    /// Cells (a pool counts as one) minus one.
    pub degrees_of_freedom: usize,
    /// The integral of the density over the sphere.
    pub integral: f64,
    /// The fraction of draws that gave a direction; what the integral must be.
    pub accepted: f64,
    /// The p-value below which the density is rejected.
    pub threshold: f64,
    /// What is wrong, one sentence each; empty if the test passed.
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
    /// Draws with `sample`, as many as it is asked for, and compares with `pdf`, a density over solid angle at each of
    /// many directions.
    ///
    /// A draw of `None` is no sample: the density must then integrate to the fraction of draws that are one.
    ///
    /// # Panics
    /// If either gives another number of values than it is asked for.
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

    /// The integral of the density over each cell: midpoints of sub-cells, each with its exact solid angle. A row of
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

    /// Draws and counts; also the number of directions in cells of zero density whose own density is zero.
    ///
    /// Directions alone decide there, since a cell that a lobe touches only in a corner can be zero at all of its points.
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

/// The chi-square statistic, and the number of cells in it after pooling.
fn statistic(observed: &[f64], expected: &[f64]) -> (f64, usize) {
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    let (mut statistic, mut cells) = (0.0, 0);
    let (mut pool_observed, mut pool_expected) = (0.0, 0.0);
    for cell in order {
        // A pool that is still too small takes in the next cell, however large: nothing is left over unless all is small.
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
    /// Whether the density is right, as far as the test can tell.
    pub fn passed(&self) -> bool {
        self.failures.is_empty()
    }

    /// Writes a PNG of three maps, one above the other: observed counts, expected counts (both as square roots, dark is few)
    /// and their difference in standard deviations (blue: too few, white: as expected, red: too many; full at 5).
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
        // Cells are drawn as squares of several pixels, to be looked at without zoom.
        const SCALE: usize = 4;
        let (width, height) = (SCALE * self.columns, SCALE * 3 * self.rows);
        let enlarged: Vec<[u8; 3]> =
            (0..width * height).map(|i| pixels[i / width / SCALE * self.columns + i % width / SCALE]).collect();
        file::replace(path, &encode_png_rgb8(width, height, &enlarged)?)
    }

    /// Panics if the test failed, saying why, after leaving `chi_square_<name>.png` in the folder of temporary files.
    ///
    /// # Panics
    /// If the test failed: this is for tests.
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
mod tests {
    use super::*;
    use crate::frame::Frame;
    use glam::Vec3;

    const UNIFORM: f32 = 0.25 / std::f32::consts::PI;

    fn cosine(frame: &Frame, u: Vec2) -> Vec3A {
        let (r, (sin, cos)) = (u.x.sqrt(), (std::f32::consts::TAU * u.y).sin_cos());
        frame.to_world(Vec3::new(r * cos, r * sin, (1.0 - u.x).max(0.0).sqrt())).normalize().into()
    }

    /// A sampler of many directions from one of a single direction.
    fn many(mut one: impl FnMut(&mut Stream) -> Option<Vec3A>) -> impl FnMut(&mut Stream, usize) -> Vec<Option<Vec3A>> {
        move |random, count| (0..count).map(|_| one(random)).collect()
    }

    /// The same of a density.
    fn each(one: impl Fn(Vec3A) -> f32) -> impl Fn(&[Vec3A]) -> Vec<f32> {
        move |directions| directions.iter().map(|&w| one(w)).collect()
    }

    fn uniform(random: &mut Stream, count: usize) -> Vec<Option<Vec3A>> {
        (0..count).map(|_| Some(random.direction())).collect()
    }

    fn cosine_pdf(n: Vec3A, w: Vec3A) -> f32 {
        n.dot(w).max(0.0) / std::f32::consts::PI
    }

    fn small() -> SphereChiSquare {
        SphereChiSquare { samples: 200_000, ..SphereChiSquare::default() }
    }

    #[test]
    fn right_densities_pass_at_every_orientation() {
        let test = SphereChiSquare { tests: 6, ..SphereChiSquare::default() };
        let report = test.run(uniform, each(|_| UNIFORM));
        report.assert_passed("uniform");
        assert_eq!(report.degrees_of_freedom, 51 * 102 - 1);
        for n in [Vec3A::Y, -Vec3A::Y, Vec3A::X, -Vec3A::Z, Vec3A::new(1.0, -2.0, 0.5).normalize()] {
            let frame = Frame::from_normal(n.into());
            let report = test.run(many(|random| Some(cosine(&frame, random.uniform2()))), each(|w| cosine_pdf(n, w)));
            report.assert_passed("cosine");
            assert!((report.integral - 1.0).abs() < 1e-3, "{report}");
        }
    }

    #[test]
    fn p_values_of_a_right_density_are_uniform() {
        let test = |seed| SphereChiSquare { rows: 11, samples: 20_000, seed, ..SphereChiSquare::default() };
        let mut p: Vec<f64> = (0..200).map(|seed| test(seed).run(uniform, each(|_| UNIFORM)).p_value).collect();
        p.sort_by(f64::total_cmp);
        // Kolmogorov-Smirnov at 0.001: 1.95 / sqrt(200).
        let distance = p.iter().enumerate().map(|(i, p)| (p - (i as f64 + 0.5) / 200.0).abs()).fold(0.0, f64::max);
        assert!(distance < 0.138, "{distance}");
    }

    #[test]
    fn wrong_densities_fail() {
        let frame = Frame::from_normal(Vec3::Y);
        // A cosine drawn as if it were uniform, 3 % of another density mixed in, a frame turned by one degree.
        let cosines = || many(|random| Some(cosine(&frame, random.uniform2())));
        assert!(!small().run(cosines(), each(|_| UNIFORM)).passed());
        let mixed = |random: &mut Stream| {
            let uniform = random.uniform() < 0.03;
            Some(if uniform { random.direction() } else { cosine(&frame, random.uniform2()) })
        };
        let pdf = |w: Vec3A| 0.999 * cosine_pdf(Vec3A::Y, w) + 0.001 * UNIFORM;
        assert!(!small().run(many(mixed), each(pdf)).passed());
        let tilted = Vec3A::new(0.05, 1.0, 0.0).normalize();
        assert!(!small().run(cosines(), each(|w| cosine_pdf(tilted, w))).passed());
    }

    #[test]
    fn a_density_of_wrong_mass_fails_even_where_its_shape_is_right() {
        let report = small().run(uniform, each(|_| 1.02 * UNIFORM));
        assert!(!report.passed() && report.p_value > 0.01, "{report}");
        assert!(report.failures[0].contains("integrates to 1.02"), "{report}");
    }

    #[test]
    fn draws_without_a_direction_lower_the_mass_that_is_asked_for() {
        let half = |random: &mut Stream| Some(random.direction()).filter(|w| w.y > 0.0);
        let pdf = |w: Vec3A| if w.y > 0.0 { UNIFORM } else { 0.0 };
        small().run(many(half), each(pdf)).assert_passed("half");
        assert!(!small().run(many(half), each(|w| 2.0 * pdf(w))).passed());
    }

    #[test]
    fn a_single_direction_of_zero_density_fails() {
        let frame = Frame::from_normal(Vec3::Y);
        let mut first = true;
        let strays = |random: &mut Stream| {
            let w = cosine(&frame, random.uniform2());
            Some(if std::mem::take(&mut first) { -w } else { w })
        };
        let report = small().run(many(strays), each(|w| cosine_pdf(Vec3A::Y, w)));
        assert!(report.failures.iter().any(|f| f.starts_with("1 directions were drawn")), "{report}");
    }

    #[test]
    fn broken_densities_and_directions_fail() {
        for broken in [f32::NAN, f32::INFINITY, -UNIFORM] {
            let report = small().run(uniform, each(|w| if w.x > 0.9 { broken } else { UNIFORM }));
            assert!(report.failures.iter().any(|f| f.starts_with("the density is negative")), "{report}");
        }
        assert!(!small().run(many(|random| Some(1.01 * random.direction())), each(|_| UNIFORM)).passed());
        assert!(!small().run(many(|_| Some(Vec3A::NAN)), each(|_| UNIFORM)).passed());
        assert!(
            !small().run(many(|_| None), each(|_| 0.0)).passed(),
            "a sampler that never samples has nothing to show"
        );
    }

    #[test]
    fn the_picture_shows_three_maps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let report = small().run(uniform, each(|_| UNIFORM));
        report.write_picture(&path).unwrap();
        let picture = image::open(&path).unwrap();
        assert_eq!((picture.width(), picture.height()), (4 * 102, 4 * 3 * 51));
    }
}
