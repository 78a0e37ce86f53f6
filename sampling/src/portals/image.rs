//! The map in the angles of a portal, and sums over its rectangles.

use glam::Vec3A;

use super::Portal;
use crate::{
    color::luminance,
    columns::strips,
    discrete::BELOW_ONE,
    environment::Environment,
    parallel::*,
    simd::{LANES, Lanes},
};

/// Pixels along a side: as many as the map has rows, between these.
const SIZES: [usize; 2] = [64, 1024];
/// Points along a side of a pixel, whose mean it holds.
const POINTS: usize = 3;
/// The sum of all pixels, before each is rounded to an integer of at least 1; sums stay below 2^31.
const TOTAL: f64 = (1_u32 << 30) as f64;

/// Luminance times solid angle over a square of pixels, as a summed-area table.
///
/// In the frame of a portal, whose z points out of the room, a direction has the tangents `x / z` and `y / z`. From every point, a
/// rectangle parallel to the axes has constant tangents at its sides, hence also constant `x / (z + |x|)`, which is uniform over pixels:
/// like the angles of Bitterli et al., but without trigonometry.
///
/// Sums are integers, so that differences of them are exact: a narrow rectangle is as precise as a wide one.
#[derive(Clone, Debug)]
pub struct PortalImage {
    size: usize,
    /// Sum of the pixels below and left of each corner, `size + 1` to a row.
    sums: Vec<u32>,
}

/// A rectangle in pixels: left, right, bottom, top.
pub type Span = [f32; 4];

impl PortalImage {
    pub fn new(portal: &Portal, environment: &Environment) -> Self {
        let size = environment.height().clamp(SIZES[0], SIZES[1]);
        let mut own = Self { size, sums: vec![0; (size + 1) * (size + 1)] };
        let inside = |k: usize| (k % POINTS) as f32 + 0.5;
        let place = |k: usize| (k / POINTS) as f32 + inside(k) / POINTS as f32;
        let tangents: Vec<f32> = (0..size * POINTS).map(|k| own.tangent(place(k))).collect();
        let row = |up: &[f32]| own.row(&tangents, up, portal, environment);
        let rows: Vec<Vec<f64>> = tangents.par_chunks(POINTS).map(row).collect();
        let all: f64 = rows.iter().flatten().sum();
        let scale = if all > 0.0 { TOTAL / all } else { 0.0 };
        for (row, values) in rows.iter().enumerate() {
            let mut along = 0;
            for (column, &value) in values.iter().enumerate() {
                along += if value > 0.0 { (scale * value).max(1.0) as u32 } else { 0 };
                let corner = (row + 1) * (size + 1) + column + 1;
                own.sums[corner] = own.sums[corner - size - 1] + along;
            }
        }
        own
    }

    /// Returns the sums over the points of each pixel of a row, at all tangents `across` and those `up` of the row.
    fn row(&self, across: &[f32], up: &[f32], portal: &Portal, environment: &Environment) -> Vec<f64> {
        let mut sums = vec![0.0; self.size];
        let column = || -> Vec<Lanes> { vec![[0.0; LANES]; strips(across.len())] };
        let [mut wx, mut wy, mut wz, mut red, mut green, mut blue] = std::array::from_fn(|_| column());
        for &y in up {
            for (k, &x) in across.iter().enumerate() {
                let (strip, lane, wi) = (k / LANES, k % LANES, direction(portal, [x, y]));
                (wx[strip][lane], wy[strip][lane], wz[strip][lane]) = (wi.x, wi.y, wi.z);
            }
            environment.radiances([&wx, &wy, &wz], [&mut red, &mut green, &mut blue]);
            for (k, &x) in across.iter().enumerate() {
                let (strip, lane) = (k / LANES, k % LANES);
                let radiance = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
                sums[k / POINTS] += f64::from(luminance(radiance) * self.solid_angle([x, y]));
            }
        }
        sums
    }

    /// Returns the sums, row by row.
    pub fn sums(&self) -> &[u32] {
        &self.sums
    }

    /// Returns the place of a tangent, in pixels.
    #[inline(always)]
    pub fn pixel(&self, tangent: f32) -> f32 {
        0.5 * self.size as f32 * (1.0 + tangent / (1.0 + tangent.abs()))
    }

    /// Returns the tangent of a place in pixels.
    #[inline(always)]
    pub fn tangent(&self, pixel: f32) -> f32 {
        let from_middle = pixel / (0.5 * self.size as f32) - 1.0;
        let within = from_middle.clamp(-BELOW_ONE, BELOW_ONE);
        within / (1.0 - within.abs())
    }

    /// Returns the solid angle per pixel at tangents, in steradians.
    #[inline(always)]
    pub fn solid_angle(&self, [x, y]: [f32; 2]) -> f32 {
        let (across, along) = (1.0 + x.abs(), 1.0 + y.abs());
        let (squared, pixel) = (1.0 + x * x + y * y, 2.0 / self.size as f32);
        // In an order in which no product overflows.
        (pixel * across) * (across / squared) * (pixel * along) * (along / squared.sqrt())
    }

    #[inline(always)]
    fn sum(&self, column: usize, row: usize) -> u32 {
        self.sums[row * (self.size + 1) + column]
    }

    #[inline(always)]
    fn cell(&self, pixel: f32) -> usize {
        (pixel as usize).min(self.size - 1)
    }

    /// Returns the pixel at a place.
    #[inline(always)]
    pub fn value(&self, place: [f32; 2]) -> f32 {
        let [column, row] = place.map(|at| self.cell(at));
        let upper = self.sum(column + 1, row + 1) - self.sum(column, row + 1);
        (upper - (self.sum(column + 1, row) - self.sum(column, row))) as f32
    }

    /// Returns the sum over all pixels that a rectangle touches.
    #[inline(always)]
    pub fn bound(&self, [left, right, bottom, top]: Span) -> f32 {
        let ([left, right], [bottom, top]) =
            ([left, right].map(|at| self.cell(at)), [bottom, top].map(|at| self.cell(at)));
        let upper = self.sum(right + 1, top + 1) - self.sum(left, top + 1);
        (upper - (self.sum(right + 1, bottom) - self.sum(left, bottom))) as f32
    }

    /// Returns the sum over a rectangle; pixels count by the part that it covers.
    #[inline]
    pub fn total(&self, span: Span) -> f32 {
        let band = Band::new(self, span);
        let [start, end] = ends([span[0], span[1]], self.size, |column| band.left_of(column));
        (end - start) as f32
    }

    /// Maps uniform numbers to a place in a rectangle, in proportion to the pixels. Returns the place, and its pixel over the sum of
    /// the rectangle; 0 if that is dark.
    #[inline]
    pub fn draw(&self, span: Span, u: [f32; 2]) -> ([f32; 2], f32) {
        let [left, right, bottom, top] = span;
        let band = Band::new(self, span);
        let across = invert([left, right], u[0], self.size, |column| band.left_of(column));
        let from = self.of_column(across.cell, self.cell(bottom));
        let below = |row: usize| f64::from(self.of_column(across.cell, row).wrapping_sub(from) as i32);
        let along = invert([bottom, top], u[1], self.size, below);
        let density = if across.total > 0.0 { along.value / across.total } else { 0.0 };
        ([across.place, along.place], density as f32)
    }

    /// Returns the sum of a column's pixels below a row.
    #[inline(always)]
    fn of_column(&self, column: usize, row: usize) -> u32 {
        self.sum(column + 1, row) - self.sum(column, row)
    }
}

/// The part of an image between two rows, which are places and not whole numbers.
struct Band<'a> {
    image: &'a PortalImage,
    rows: [usize; 2],
    fractions: [f64; 2],
    /// The sums at the column from which they are counted.
    base: [u32; 4],
}

impl<'a> Band<'a> {
    #[inline(always)]
    fn new(image: &'a PortalImage, [left, _, bottom, top]: Span) -> Self {
        let rows = [bottom, top].map(|at| image.cell(at));
        let fractions = [f64::from(bottom) - rows[0] as f64, f64::from(top) - rows[1] as f64];
        let own = Self { image, rows, fractions, base: [0; 4] };
        Self { base: own.corners(image.cell(left)), ..own }
    }

    /// Returns the sums left of a column, below the rows and the ones above each.
    #[inline(always)]
    fn corners(&self, column: usize) -> [u32; 4] {
        let [bottom, top] = self.rows;
        let sum = |row: usize| self.image.sum(column, row);
        [sum(bottom), sum(bottom + 1), sum(top), sum(top + 1)]
    }

    /// Returns the sum between the base and a column.
    #[inline(always)]
    fn left_of(&self, column: usize) -> f64 {
        let corners = self.corners(column);
        // Signed: by rounding, the right side of a thin rectangle may be left of the base.
        let sum = |k: usize| f64::from(corners[k].wrapping_sub(self.base[k]) as i32);
        let below = |k: usize| sum(2 * k) + self.fractions[k] * (sum(2 * k + 1) - sum(2 * k));
        below(1) - below(0)
    }
}

/// Returns a sum at both ends of an interval of places. `sum` is that up to whole numbers, at most `size`, between which it grows
/// linearly; it is 0 at the first one.
#[inline(always)]
fn ends([from, to]: [f32; 2], size: usize, sum: impl Fn(usize) -> f64) -> [f64; 2] {
    let [first, last] = [from, to].map(|at| (at as usize).min(size - 1));
    let below = sum(last);
    let end = below + (f64::from(to) - last as f64) * (sum(last + 1) - below);
    [(f64::from(from) - first as f64) * sum(first + 1), end]
}

/// Where a sum reaches a fraction of its growth.
struct Inverse {
    place: f32,
    /// The whole number below it.
    cell: usize,
    /// Growth in the cell and over the interval.
    value: f64,
    total: f64,
}

/// Finds where a sum, as that of [`ends`], reaches the fraction `u` of its growth over an interval.
#[inline(always)]
fn invert([from, to]: [f32; 2], u: f32, size: usize, sum: impl Fn(usize) -> f64) -> Inverse {
    let [start, end] = ends([from, to], size, &sum);
    let target = start + f64::from(u) * (end - start);
    let [first, last] = [from, to].map(|at| (at as usize).min(size - 1));
    // The last cell whose left border is at most the target.
    let (mut low, mut high) = (first, last.max(first) + 1);
    let (mut below, mut above) = (0.0, f64::NAN);
    while high - low > 1 {
        let middle = usize::midpoint(low, high);
        let at = sum(middle);
        if at <= target { (low, below) = (middle, at) } else { (high, above) = (middle, at) }
    }
    let above = if above.is_nan() { sum(low + 1) } else { above };
    let value = above - below;
    let inside = if value > 0.0 { ((target - below) / value) as f32 } else { 0.5 };
    Inverse { place: low as f32 + inside.clamp(0.0, BELOW_ONE), cell: low, value, total: end - start }
}

/// Returns the unit direction of tangents.
#[inline(always)]
pub fn direction(portal: &Portal, [x, y]: [f32; 2]) -> Vec3A {
    (x * portal.right() + y * portal.up - portal.normal).normalize()
}
