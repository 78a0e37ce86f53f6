//! Reference values for samplers: the light that a surface reflects, and means of a pdf over cells.

use std::collections::HashMap;

use glam::{Vec2, Vec3A};
use headtail_render::{
    color::luminance,
    environment::Environment,
    latlong,
    random::{Purpose, Stream},
    sampler::{AtPoint, EnvironmentLight},
    tile::ShadingPoint,
};

use super::{
    BRDFS,
    checks::{MOST_POINTS, ROWS, SUBCELLS},
};

/// A quadrature without any sampler: points of every bilinear cell of a map, with radiance times solid angle.
pub struct Quadrature {
    directions: Vec<Vec3A>,
    fluxes: Vec<Vec3A>,
}

impl Quadrature {
    pub fn new(map: &Environment) -> Self {
        let (columns, rows) = (map.width(), map.height() - 1);
        let cells = columns * rows;
        let flux = |x: Vec2, area: f32| {
            map.radiance_at(x) * (area * 2.0 * std::f32::consts::PI.powi(2) * (std::f32::consts::PI * x.y).sin())
        };
        let place = |cell: usize, inside: Vec2| {
            let u = ((cell % columns) as f32 + 0.5 + inside.x) / columns as f32;
            Vec2::new(u.fract(), ((cell / columns) as f32 + inside.y) / rows as f32)
        };
        let points = |cell: usize, side: usize| {
            (0..side * side).map(move |k| {
                let inside = Vec2::new((k % side) as f32 + 0.5, (k / side) as f32 + 0.5) / side as f32;
                let x = place(cell, inside);
                (latlong::direction(x), flux(x, 1.0 / (cells * side * side) as f32))
            })
        };
        let coarse: Vec<f32> = (0..cells).map(|cell| points(cell, 3).map(|point| luminance(point.1)).sum()).collect();
        let total: f32 = coarse.iter().sum();
        // Within a cell everything is smooth except at the horizon, whose kink causes an error of h^2 / 4 of
        // the fraction of cells on it: 1e-6 with three points across small cells, 2e-4 with 32 across a sun.
        let side = ((1e6 / cells as f32).sqrt() as usize).clamp(3, 1024);
        let side_of = |cell: usize| if coarse[cell] > 1e-3 * total { side.max(32) } else { side };
        let points = (0..cells).flat_map(|cell| points(cell, side_of(cell))).filter(|point| luminance(point.1) > 0.0);
        let (directions, fluxes) = points.unzip();
        Self { directions, fluxes }
    }

    /// Returns the luminance reflected by a white Lambert surface without shadows.
    pub fn reflected(&self, normal: Vec3A) -> f64 {
        let points = self.directions.iter().zip(&self.fluxes);
        let cosine = |(wi, flux): (&Vec3A, &Vec3A)| f64::from(normal.dot(*wi).max(0.0) * luminance(*flux));
        points.map(cosine).sum::<f64>() / std::f64::consts::PI
    }

    /// Returns the luminance reflected by any surface without shadows.
    pub fn reflected_at(&self, at: &ShadingPoint) -> f64 {
        let values = at.one_of(&BRDFS).brdf_cosines(&self.directions);
        values.into_iter().zip(&self.fluxes).map(|(value, flux)| f64::from(luminance(value * *flux))).sum()
    }
}

/// Sub-cells with so much light that points of Y, mapped by the tail, resolve them better than the grid of
/// `checks::means_over`: inside a sun, a density over Y can have any detail within 0.1 degrees.
///
/// For samplers that draw through the tail. The tail itself is tested with the other samplers.
pub struct Dense(HashMap<usize, Points>);

/// Directions in a sub-cell, and the solid angles that they represent.
#[derive(Default)]
struct Points {
    directions: Vec<Vec3A>,
    solid_angles: Vec<f32>,
}

impl Dense {
    pub fn new(light: &EnvironmentLight) -> Self {
        const SIDE: usize = 512;
        let mut random = Stream::new(2, Purpose::Test, 6);
        let mut points: HashMap<usize, Points> = HashMap::new();
        let mut y = |k: usize| (Vec2::new((k % SIDE) as f32, (k / SIDE) as f32) + random.uniform2()) / SIDE as f32;
        let y: Vec<Vec2> = (0..SIDE * SIDE).map(&mut y).collect();
        for (_, wi, emitter) in light.tail().forward_directions(&y) {
            if emitter > 0.0 && emitter.is_finite() {
                let own = points.entry(Self::index(wi)).or_default();
                own.directions.push(wi);
                own.solid_angles.push(1.0 / (emitter * (SIDE * SIDE) as f32));
            }
        }
        points.retain(|_, points| points.directions.len() > MOST_POINTS * MOST_POINTS);
        Self(points)
    }

    fn index(w: Vec3A) -> usize {
        let (x, rows) = (latlong::square(w), ROWS * SUBCELLS);
        let row = ((x.y * rows as f32) as usize).min(rows - 1);
        row * 2 * rows + ((x.x * (2 * rows) as f32) as usize).min(2 * rows - 1)
    }

    /// Returns the mean of the pdf over the sub-cell of a direction, if it is one of these.
    pub fn mean(&self, bound: &AtPoint<'_>, w: Vec3A) -> Option<f32> {
        let index = Self::index(w);
        let points = self.0.get(&index)?;
        let theta = |row: usize| std::f64::consts::PI * row as f64 / (ROWS * SUBCELLS) as f64;
        let row = index / (2 * ROWS * SUBCELLS);
        let solid_angle = (theta(row).cos() - theta(row + 1).cos()) * std::f64::consts::PI / (ROWS * SUBCELLS) as f64;
        let pdfs = bound.pdf_many(&points.directions);
        let mass: f64 = pdfs.iter().zip(&points.solid_angles).map(|(pdf, weight)| f64::from(pdf * weight)).sum();
        Some((mass / solid_angle) as f32)
    }
}
