//! The exact integral of a map against the clamped cosine, for any normal.

use std::f64::consts::PI;

use glam::{DVec3, Vec2, Vec3A};
use rayon::prelude::*;

use crate::environment::Environment;

/// Maximum number of blocks whose moments are stored.
const MOST_BLOCKS: usize = 1 << 17;

/// Nodes of the two-point Gauss rule in a cell, which is exact for cubic polynomials.
const GAUSS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

/// The irradiance of a map, `E(n) = integral L(w) max(0, n . w) dw` per channel, in W/m^2.
///
/// The cosine is linear in the direction where it is not clamped. A block of the map above the horizon of `n`
/// therefore adds `n . integral L(w) w dw`, with an integral that does not depend on `n`, and a block below
/// it adds nothing; only blocks on the horizon need the map itself. Radiance is the bilinear lookup of
/// [`Environment`], to which estimators converge. Cells are integrated by a 2 x 2 Gauss rule, whose error is
/// of fourth order in the cell's size, and of second order in cells on the horizon, where the cosine is
/// small.
///
/// Nine spherical-harmonics coefficients (Ramamoorthi and Hanrahan 2001) are smaller but not exact: their
/// error reaches 10 % under a hard sun and would bias masks.
pub struct Irradiance<'a> {
    environment: &'a Environment,
    /// Sine and cosine of the azimuths and of the elevations of the Gauss points.
    angles: [Vec<(f64, f64)>; 2],
    /// Cells along each edge of a block.
    side: usize,
    /// Levels of blocks, from the finest to a single block.
    levels: Vec<Level>,
}

struct Level {
    columns: usize,
    rows: usize,
    blocks: Vec<Block>,
}

/// A rectangle of the map.
#[derive(Clone, Copy)]
struct Block {
    /// Integral of radiance times direction, per channel.
    moments: [DVec3; 3],
    /// A central direction; `radius` is the largest angle of the block's directions to it.
    middle: DVec3,
    radius: f64,
}

/// The radiance times solid angle of a Gauss point, and its direction.
struct Part {
    energy: DVec3,
    direction: DVec3,
}

impl<'a> Irradiance<'a> {
    /// Precomputes the moments of a map.
    pub fn new(environment: &'a Environment) -> Self {
        let (width, height) = (environment.width(), environment.height() - 1);
        let mut side = 1;
        while width.div_ceil(side) * height.div_ceil(side) > MOST_BLOCKS {
            side *= 2;
        }
        let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
        let gauss = |k: usize| (k / 2) as f64 + GAUSS[k % 2];
        let azimuths = (0..2 * width).map(|k| (2.0 * PI * (gauss(k) + 0.5) / width as f64).sin_cos());
        let elevations = (0..2 * height).map(|k| (PI * gauss(k) / height as f64).sin_cos());
        let angles = [azimuths.collect(), elevations.collect()];
        let mut irradiance = Self { environment, angles, side, levels: Vec::new() };
        let blocks = (0..columns * rows).into_par_iter().map(|k| irradiance.leaf(k % columns, k / columns)).collect();
        irradiance.levels.push(Level { columns, rows, blocks });
        while let Some(coarser) = irradiance.levels.last().and_then(Level::halved) {
            irradiance.levels.push(coarser);
        }
        irradiance
    }

    /// Returns the irradiance per channel of a surface with the unit normal `n`.
    pub fn at(&self, n: Vec3A) -> Vec3A {
        self.to_within(n, 0.0)
    }

    /// Returns the irradiance as [`Self::at`] does, without refining blocks of radius (radians) up to
    /// `coarse` on the horizon. The error is at most `coarse / 4` times the light within `coarse` of the
    /// horizon: for 0.01, 5e-5 of all light under a uniform sky.
    pub fn to_within(&self, n: Vec3A, coarse: f64) -> Vec3A {
        let n = n.as_dvec3().normalize();
        let top = self.levels.len() - 1;
        let mut total = DVec3::ZERO;
        let mut open = vec![(top, 0, 0)];
        while let Some((level, column, row)) = open.pop() {
            let own = &self.levels[level];
            let block = &own.blocks[row * own.columns + column];
            let height = n.dot(block.middle).clamp(-1.0, 1.0).asin();
            if height <= -block.radius {
                continue;
            }
            if height >= block.radius || block.radius <= coarse {
                total += DVec3::from_array(block.moments.map(|moment| moment.dot(n))).max(DVec3::ZERO);
            } else if level == 0 {
                total += self.along_horizon(column, row, n);
            } else {
                let finer = &self.levels[level - 1];
                for row in 2 * row..(2 * row + 2).min(finer.rows) {
                    open.extend(
                        (2 * column..(2 * column + 2).min(finer.columns)).map(|column| (level - 1, column, row)),
                    );
                }
            }
        }
        total.as_vec3().into()
    }

    fn along_horizon(&self, column: usize, row: usize, n: DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        self.parts(column, row, |part| sum += part.energy * n.dot(part.direction).max(0.0));
        sum
    }

    fn leaf(&self, column: usize, row: usize) -> Block {
        let mut moments = [DVec3::ZERO; 3];
        self.parts(column, row, |part| {
            for (moment, energy) in moments.iter_mut().zip(part.energy.to_array()) {
                *moment += energy * part.direction;
            }
        });
        let (width, height) = (self.environment.width(), self.environment.height() - 1);
        let (left, top) = (column * self.side, row * self.side);
        let (right, bottom) = ((left + self.side).min(width), (top + self.side).min(height));
        let at = |i: f64, j: f64| direction((i + 0.5) / width as f64, j / height as f64);
        let middle = at(0.5 * (left + right) as f64, 0.5 * (top + bottom) as f64);
        // Every direction of a cell is within half its width plus half its height of a corner.
        let cell = 0.5 * (PI / height as f64 + 2.0 * PI / width as f64);
        let corners = (top..=bottom).flat_map(|j| (left..=right).map(move |i| at(i as f64, j as f64)));
        let radius = corners.map(|corner| middle.angle_between(corner)).fold(0.0, f64::max) + cell;
        Block { moments, middle, radius }
    }

    /// Visits the Gauss points of the cells of a block.
    fn parts(&self, column: usize, row: usize, mut each: impl FnMut(Part)) {
        let (width, height) = (self.environment.width(), self.environment.height() - 1);
        let (left, top) = (column * self.side, row * self.side);
        let area = (2.0 * PI / width as f64) * (PI / height as f64) * 0.25;
        let [azimuths, elevations] = &self.angles;
        for row in 2 * top..2 * (top + self.side).min(height) {
            let (sin_theta, cos_theta) = elevations[row];
            let v = ((row / 2) as f64 + GAUSS[row % 2]) / height as f64;
            for column in 2 * left..2 * (left + self.side).min(width) {
                let (sin_phi, cos_phi) = azimuths[column];
                let u = ((column / 2) as f64 + 0.5 + GAUSS[column % 2]) / width as f64;
                let u = if u >= 1.0 { u - 1.0 } else { u };
                let radiance = self.environment.radiance_at(Vec2::new(u as f32, v as f32)).as_dvec3();
                let direction = DVec3::new(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta);
                each(Part { energy: area * sin_theta * radiance, direction });
            }
        }
    }
}

impl Level {
    /// Returns the level of twice the block size; `None` for a single block.
    fn halved(&self) -> Option<Self> {
        if self.blocks.len() == 1 {
            return None;
        }
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let block = |k: usize| {
            let (column, row) = (k % columns, k / columns);
            let children = (2 * row..(2 * row + 2).min(self.rows)).flat_map(|row| {
                (2 * column..(2 * column + 2).min(self.columns))
                    .map(move |column| self.blocks[row * self.columns + column])
            });
            let children: Vec<Block> = children.collect();
            let sum: DVec3 = children.iter().map(|child| child.middle).sum();
            let middle = sum.try_normalize().unwrap_or(DVec3::Y);
            let reach = |child: &Block| middle.angle_between(child.middle) + child.radius;
            Block {
                moments: std::array::from_fn(|c| children.iter().map(|child| child.moments[c]).sum()),
                middle,
                radius: children.iter().map(reach).fold(0.0, f64::max),
            }
        };
        Some(Self { columns, rows, blocks: (0..columns * rows).map(block).collect() })
    }
}

/// Returns the direction of a point of the lat-long square, in f64; see [`crate::latlong`].
fn direction(u: f64, v: f64) -> DVec3 {
    let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = ((2.0 * PI * u).sin_cos(), (PI * v).sin_cos());
    DVec3::new(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        environment::built_in,
        image::Image,
        random::{Purpose, Stream},
    };

    /// Integrates the same function by midpoints, 4 x 4 per cell of width h. The relative error is
    /// `(h / 4)^2 / 24`, 1e-6 for cells of 0.02 rad, also in cells on the horizon.
    fn by_midpoints(environment: &Environment, n: Vec3A) -> DVec3 {
        let (width, height) = (4 * environment.width(), 4 * (environment.height() - 1));
        let n = n.as_dvec3();
        let mut sum = DVec3::ZERO;
        for j in 0..height {
            let v = (j as f64 + 0.5) / height as f64;
            for i in 0..width {
                let u = (i as f64 + 0.5) / width as f64;
                let cosine = n.dot(direction(u, v)).max(0.0);
                let radiance = environment.radiance_at(Vec2::new(u as f32, v as f32)).as_dvec3();
                sum += (PI * v).sin() * cosine * radiance;
            }
        }
        sum * 2.0 * PI * PI / (width * height) as f64
    }

    #[test]
    fn a_constant_map_has_the_irradiance_pi() {
        for (width, height) in [(9, 5), (64, 32), (600, 301)] {
            let map =
                Environment::from_image("grey", Image { width, height, pixels: vec![[1.0, 2.0, 0.5]; width * height] })
                    .unwrap();
            let irradiance = Irradiance::new(&map);
            for n in [Vec3A::Y, Vec3A::NEG_Y, Vec3A::X, Vec3A::new(0.6, -0.3, 0.2)] {
                let found = irradiance.at(n.normalize()).as_dvec3() / PI;
                // Error of the cells on the horizon, of second order in their size; the largest value is 2.
                let tolerance = 0.1 * (2.0 * PI / width as f64).powi(2);
                assert!((found - DVec3::new(1.0, 2.0, 0.5)).abs().max_element() < tolerance, "{width}: {found}");
            }
        }
    }

    #[test]
    fn irradiance_matches_midpoint_integration_for_any_normal() {
        let mut random = Stream::new(7, Purpose::Test, 0);
        for name in ["studio", "sunset"] {
            let map = built_in(name).unwrap();
            let irradiance = Irradiance::new(&map);
            for k in 0..3 {
                let n = if k == 0 { Vec3A::Y } else { random.direction() };
                let (found, expected) = (irradiance.at(n).as_dvec3(), by_midpoints(&map, n));
                let error = ((found - expected) / expected).abs().max_element();
                assert!(error < 2e-5, "{name} {n}: {found} {expected}");
            }
        }
    }
}
