//! The paper's method of drawing training points: from a table of the product over the lat-long map, one per
//! condition.

use glam::{Vec2, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    discrete::{BELOW_ONE, invert_running_sums},
    flat::FlatArray,
    latlong,
    random::Stream,
    tail::{Tail, TailWarp},
};

use super::{
    ProductTarget, ShaderTarget, Surface,
    target::{BatchShape, PlacedPoints, PointValues, Target},
};
use crate::Result;

/// Rows of the table.
const ROWS: usize = 512;
/// Columns of the table.
const COLUMNS: usize = 1024;

/// Draws points in proportion to light x BRDF x cosine x sin theta, tabulated in X at the centres of 512 x
/// 1024 cells, and pulls them back through the tail. The reference method: it takes half a million
/// evaluations per condition.
pub struct TabulatedTarget<'a, S> {
    product: ProductTarget<'a, S>,
    tail: &'a Tail,
    /// Direction of each cell's centre.
    directions: Vec<Vec3A>,
    /// The light's density there.
    light: Vec<f32>,
}

impl<'a, S: Surface> TabulatedTarget<'a, S> {
    /// Computes the table's geometry and light.
    pub fn new(surface: S, tail: &'a Tail) -> Self {
        let centre = |index: usize| {
            let (row, column) = (index / COLUMNS, index % COLUMNS);
            let x = Vec2::new((column as f32 + 0.5) / COLUMNS as f32, (row as f32 + 0.5) / ROWS as f32);
            (latlong::direction(x), tail.light().density(x))
        };
        let (directions, light) = (0..ROWS * COLUMNS).map(centre).unzip();
        Self { product: ProductTarget::of_surface(surface, tail), tail, directions, light }
    }
}

/// The product at the centres of cells, as prefix sums for inversion.
struct Table {
    /// Inclusive prefix sums of each row.
    sums: Vec<f32>,
    /// Inclusive prefix sums of the row totals.
    row_sums: Vec<f32>,
}

impl Table {
    fn new(masses: &[f32]) -> Self {
        let mut sums = Vec::with_capacity(masses.len());
        let mut total = 0.0;
        let row_sum = |row: &[f32]| {
            let mut sum = 0.0;
            sums.extend(row.iter().map(|&mass| {
                sum += f64::from(mass);
                sum as f32
            }));
            total += sum;
            total as f32
        };
        let row_sums = masses.chunks_exact(COLUMNS).map(row_sum).collect();
        Self { sums, row_sums }
    }

    /// Returns a point of X and its density over X for two uniform numbers. The table must not be empty.
    fn draw(&self, u: f32, v: f32) -> (Vec2, f32) {
        let (row, within_row) = invert_running_sums(&self.row_sums, v);
        let sums = &self.sums[row * COLUMNS..][..COLUMNS];
        let (column, within_column) = invert_running_sums(sums, u);
        let x = Vec2::new((column as f32 + within_column) / COLUMNS as f32, (row as f32 + within_row) / ROWS as f32);
        (x, relative_probability(&self.row_sums, row) * relative_probability(sums, column))
    }
}

/// Returns the probability of a cell, from prefix sums, relative to the uniform probability.
fn relative_probability(sums: &[f32], cell: usize) -> f32 {
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    (sums[cell] - before) / sums[sums.len() - 1] * sums.len() as f32
}

impl<S: Surface> Target for TabulatedTarget<'_, S> {
    fn condition(&self) -> Condition {
        self.product.condition()
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        self.product.draw_condition(stream, condition);
    }

    fn at_points(&self, condition: &[f32], y: &[[f32; 2]]) -> Vec<PointValues> {
        self.product.at_points(condition, y)
    }

    fn has_brdf_sampling(&self) -> bool {
        self.product.has_brdf_sampling()
    }

    /// The table is the target, so the tail need not be exact.
    fn shader_target(&self) -> Option<ShaderTarget> {
        let surface = self.product.surface().in_shaders()?;
        let light = FlatArray::floats("light.cells", vec![ROWS, COLUMNS], self.light.clone());
        Some(ShaderTarget { arrays: [self.tail.flat(), vec![light]].concat(), surface, is_in_x: false })
    }

    /// All points are drawn from the table, and the table is the target: all points have the same weight.
    fn place(&self, condition: &[f32], _: BatchShape, place: PlacedPoints<'_>) -> Result<()> {
        let surface = self.product.surface();
        let mut masses = surface.lobes(condition, &self.directions);
        masses.iter_mut().zip(&self.light).for_each(|(mass, light)| *mass *= light);
        let table = Table::new(&masses);
        if table.row_sums[ROWS - 1] <= 0.0 {
            return Ok(());
        }
        let (points, _) = place.points.as_chunks_mut::<2>();
        let (x, densities): (Vec<Vec2>, Vec<f32>) = points.iter().map(|u| table.draw(u[0], u[1])).unzip();
        let back = self.tail.inverse_points(&x);
        for (y, (back, _)) in points.iter_mut().zip(&back) {
            *y = back.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)).to_array();
        }
        let values = self.product.at_points(condition, points);
        for (index, ((values, (_, jacobian)), density)) in values.into_iter().zip(back).zip(densities).enumerate() {
            // The table's cells overlap texels without light, where points have no position in Y.
            let in_y = density / jacobian;
            if !(in_y > 0.0 && in_y.is_finite()) {
                place.weights[index] = 0.0;
                continue;
            }
            place.densities[index] = in_y;
            place.weights[index] = 1.0 / in_y;
            place.brdf[index] = values.brdf;
            place.tails[index] = jacobian;
        }
        Ok(())
    }

    fn place_for_validation(&self, condition: &[f32], shape: BatchShape, points: PlacedPoints<'_>) -> Result<()> {
        self.product.place(condition, shape, points)
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        CosineTarget,
        integrand::{Batch, Lambert},
        test_support::studio,
    };

    /// Compares means over the target from points of the table and from strata of Y.
    #[test]
    fn it_draws_points_of_the_same_target() {
        let tail = studio();
        let tabulated = TabulatedTarget::new(Lambert::default(), &tail);
        let mean = |batch: &Batch, f: &dyn Fn(&[f32]) -> f32| {
            let weights = batch.densities.iter().zip(&batch.weights).map(|(g, v)| f64::from(g * v));
            let terms = weights.clone().zip(batch.points.chunks_exact(2)).map(|(w, y)| w * f64::from(f(y)));
            terms.sum::<f64>() / weights.sum::<f64>()
        };
        for index in 0..3 {
            let shape = BatchShape { conditions: 1, strata: 64, brdf_samples: 0 };
            let drawn = Batch::draw(&tabulated, shape, 0, Purpose::Test, index).unwrap();
            let exact = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, index).unwrap();
            assert_eq!(drawn.conditions, exact.conditions);
            for f in [|y: &[f32]| y[1], |y: &[f32]| (std::f32::consts::TAU * y[0]).cos()] {
                // 4096 independent points with a standard deviation below 0.7: 4 standard errors of 0.011.
                let (found, expected) = (mean(&drawn, &f), mean(&exact, &f));
                assert!((found - expected).abs() < 0.044, "{found} {expected}");
            }
        }
    }

    /// The table's density over Y is the normalised target, up to the cell size.
    #[test]
    fn its_densities_match_the_target() {
        let tail = studio();
        let tabulated = TabulatedTarget::new(Lambert::default(), &tail);
        let exact = CosineTarget::new(&tail);
        for index in 0..3 {
            let shape = BatchShape { conditions: 1, strata: 32, brdf_samples: 0 };
            let drawn = Batch::draw(&tabulated, shape, 0, Purpose::Test, index).unwrap();
            let even = Batch::draw(&exact, shape, 0, Purpose::Test, index).unwrap();
            let mean = even.densities.iter().sum::<f32>() / 1024.0;
            let close = drawn.points.chunks_exact(2).zip(&drawn.densities).filter(|(y, density)| {
                let expected = exact.at(&drawn.conditions, [y[0], y[1]]).target / mean;
                (**density / expected - 1.0).abs() < 0.1
            });
            // At the edges of lights, cell and map differ.
            let close = close.count();
            assert!(close > 850, "{close} of 1024");
        }
    }
}
