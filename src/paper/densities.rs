//! Densities over the square as pictures: targets, heads, samplers.

use std::f32::consts::PI;

use anyhow::{Result, anyhow};
use glam::{Vec2, Vec3A};
use headtail_render::{
    brdf::BrdfTable,
    color::luminance,
    head::Head,
    image::{Photograph, encode_png_rgb8, srgb_code},
    latlong,
    sampler::{AtPoint, Sampler},
    tail::{Tail, TailWarp},
    tile::ShadingPoint,
};

use super::{
    figure::{Layout, Panel, Strip},
    part::PartOutput,
};
use crate::report::{
    chart::Scale,
    number::text,
    table::{Cell, Value},
};

/// Decades that the colours span.
const DECADES: f64 = 5.0;
/// The colours of crosses: the normal, and the reflected view direction.
const CROSSES: [[u8; 3]; 2] = [[255, 60, 60], [255, 220, 0]];

/// Densities over X or Y on a grid of `rows` rows and `2 * rows` columns.
pub struct Densities {
    /// Rows of the grid.
    pub rows: usize,
    /// The centres of its cells.
    pub points: Vec<Vec2>,
}

impl Densities {
    /// A grid of `rows` rows.
    pub fn new(rows: usize) -> Self {
        let columns = 2 * rows;
        let at = |k: usize| Vec2::new((k % columns) as f32 + 0.5, (k / columns) as f32 + 0.5);
        let points = (0..rows * columns).map(|k| at(k) / Vec2::new(columns as f32, rows as f32)).collect();
        Self { rows, points }
    }

    /// Scales values to mean 1, which makes them a density over the square.
    pub fn normalized(&self, values: impl Iterator<Item = f32>) -> Vec<f32> {
        let values: Vec<f32> = values.collect();
        let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
        values.into_iter().map(|value| (f64::from(value) / mean.max(f64::MIN_POSITIVE)) as f32).collect()
    }

    /// A head's density over its own square.
    pub fn of_head(&self, head: &Head, condition: &[f32]) -> Result<Vec<f32>> {
        let at = head.at(condition)?;
        Ok(at.invert(&self.points).into_iter().map(|(_, density)| density).collect())
    }

    /// A head's density over X, through a tail.
    pub fn through(&self, tail: &Tail, head: &Head, condition: &[f32]) -> Result<Vec<f32>> {
        let (y, slopes): (Vec<Vec2>, Vec<f32>) = tail.inverse_points(&self.points).into_iter().unzip();
        let at = head.at(condition)?;
        let densities = at.invert(&y).into_iter().zip(slopes);
        Ok(densities.map(|((_, density), slope)| if slope > 0.0 { density * slope } else { 0.0 }).collect())
    }

    /// A sampler's density over X: that over solid angle times the `2 pi^2 sin theta` of the lat-long map.
    pub fn of_sampler(&self, sampler: &dyn Sampler, at: &Surface<'_>) -> Vec<f32> {
        let directions: Vec<Vec3A> = self.points.iter().map(|&x| latlong::direction(x)).collect();
        let pdf = AtPoint::of_table(sampler, at.point, at.brdfs).pdf_many(&directions);
        pdf.iter().zip(&self.points).map(|(pdf, x)| pdf * 2.0 * PI * PI * latlong::sin_theta(x.y)).collect()
    }

    /// Light times BRDF times cosine, without shadows, not normalised.
    pub fn target(&self, tail: &Tail, at: &Surface<'_>) -> Vec<f32> {
        let directions: Vec<Vec3A> = self.points.iter().map(|&x| latlong::direction(x)).collect();
        let reflected = at.point.one_of(at.brdfs).brdf_cosines(&directions).into_iter().map(luminance);
        self.points.iter().zip(reflected).map(|(&x, f)| tail.light().density(x) * f).collect()
    }

    /// `KL(target || density)` in nats over an even grid; densities below 1e-12 count as 1e-12.
    pub fn kl(&self, target: &[f32], density: &[f32]) -> f64 {
        let parts = target.iter().zip(density).filter(|(t, _)| **t > 0.0);
        parts.map(|(&t, &q)| f64::from(t) * (f64::from(t) / f64::from(q).max(1e-12)).ln()).sum::<f64>()
            / target.len() as f64
    }
}

/// Points of X that are the images of an even grid over Y under a tail, hence distributed as the light. An
/// even grid over X would miss suns or overweight them.
pub struct Carried {
    at: Densities,
    /// `|dx/dy|` at each.
    jacobians: Vec<f32>,
}

impl Carried {
    /// Points of a grid of `rows` rows.
    pub fn new(rows: usize, tail: &Tail) -> Self {
        let grid = Densities::new(rows);
        let (points, jacobians) = tail.forward_points(&grid.points).into_iter().unzip();
        Self { at: Densities { rows, points }, jacobians }
    }

    /// Values times the area of each point; 0 where a value is not positive.
    fn weights(&self, values: &[f32]) -> Vec<f64> {
        let weight = |(&t, &jacobian): (&f32, &f32)| if t > 0.0 { f64::from(t) * f64::from(jacobian) } else { 0.0 };
        values.iter().zip(&self.jacobians).map(weight).collect()
    }

    /// The mean over the square of values at the points.
    pub fn mean(&self, values: &[f32]) -> f64 {
        self.weights(values).iter().sum::<f64>() / values.len() as f64
    }

    /// `KL(target || density)` in nats of values at the points. The target need not be normalised; densities
    /// below 1e-12 count as 1e-12.
    pub fn kl(&self, target: &[f32], density: &[f32]) -> f64 {
        let (mean, weights) = (self.mean(target), self.weights(target));
        let lit = weights.iter().zip(target).zip(density).filter(|((weight, _), _)| **weight > 0.0);
        let parts = lit.map(|((weight, &t), &q)| weight * (f64::from(t) / (mean * f64::from(q).max(1e-12))).ln());
        parts.sum::<f64>() / (mean * weights.len() as f64)
    }
}

/// A point of a surface with the BRDFs of its scene.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    /// The point.
    pub point: &'a ShadingPoint,
    /// The BRDFs of its scene.
    pub brdfs: &'a BrdfTable,
}

/// The densities that a row shows beside the target.
#[derive(Clone, Copy)]
pub struct Models<'a> {
    /// A head over the tail: its intermediate and final densities.
    pub head: Option<&'a Head>,
    /// A head without a tail.
    pub naive: Option<&'a Head>,
    /// Samplers with their names.
    pub samplers: &'a [(&'a str, &'a dyn Sampler)],
}

/// Adds a row of pictures with its scales under a file name: the target and the densities of the models.
/// Returns each model's name and KL divergence from the target in nats.
pub fn row(
    (output, name): (&mut PartOutput, &str),
    rows: usize,
    tail: &Tail,
    at: Surface<'_>,
    models: Models<'_>,
) -> Result<Vec<(String, f64)>> {
    let (grid, carried, point) = (Densities::new(rows), Carried::new(rows, tail), at.point);
    let exact = carried.at.target(tail, &at);
    let mean = carried.mean(&exact).max(f64::MIN_POSITIVE);
    let target: Vec<f32> = grid.target(tail, &at).into_iter().map(|value| (f64::from(value) / mean) as f32).collect();
    let scale = Scale::of(&target, DECADES);
    let directions = [point.ns, 2.0 * point.ns.dot(point.wo) * point.ns - point.wo];
    let is_diffuse = models.head.is_some_and(|head| head.condition().length() == 3);
    let shown = if is_diffuse { &directions[..1] } else { &directions[..] };
    let mut panels = vec![Panel::new(&marked(&grid, scale, &target, shown)?, "target", "")];
    let mut scales = vec![(scale, "density over the square X")];
    let (mut divergences, mut finals) = (Vec::new(), Vec::new());
    let condition = |head: &Head| {
        let encoded = head.condition().encode(point.wo.into(), point.ns.into(), point.one_of(at.brdfs).lobe_width());
        encoded[..head.condition().length()].to_vec()
    };
    if let Some(head) = models.head {
        let middle = grid.of_head(head, &condition(head))?;
        let own = Scale::of(&middle, 3.0);
        panels.push(Panel::new(&marked(&grid, own, &middle, &[])?, "intermediate", "over Y"));
        scales.push((own, "intermediate density over Y"));
        let through = |points: &Densities| points.through(tail, head, &condition(head));
        finals.push(("final", [through(&grid)?, through(&carried.at)?]));
    }
    if let Some(naive) = models.naive {
        let alone = |points: &Densities| points.of_head(naive, &condition(naive));
        finals.push(("naive", [alone(&grid)?, alone(&carried.at)?]));
    }
    let of_sampler = |sampler| [&grid, &carried.at].map(|points| points.of_sampler(sampler, &at));
    finals.extend(models.samplers.iter().map(|&(name, sampler)| (name, of_sampler(sampler))));
    for (name, [density, at_carried]) in finals {
        let kl = carried.kl(&exact, &at_carried);
        panels.push(Panel::new(&marked(&grid, scale, &density, shown)?, name, format!("KL {}", text(kl))));
        divergences.push((name.to_owned(), kl));
    }
    let layout = if panels.len() > 4 { Layout::Five } else { Layout::Four };
    output.strip(name, &Strip { layout, panels, scales })?;
    Ok(divergences)
}

/// A table row of divergences: its name, then one cell per model.
pub fn line(name: impl Into<String>, divergences: &[(String, f64)]) -> Vec<Cell> {
    let numbers = divergences.iter().map(|(_, kl)| Value::Number(*kl, 3).into());
    std::iter::once(Cell::text(name)).chain(numbers).collect()
}

/// A picture of values with crosses at directions.
fn marked(grid: &Densities, scale: Scale, values: &[f32], crosses: &[Vec3A]) -> Result<Vec<u8>> {
    let (width, height) = (2 * grid.rows, grid.rows);
    let mut pixels = scale.pixels(values);
    for (direction, color) in crosses.iter().zip(CROSSES) {
        let at = latlong::square(direction.normalize()) * Vec2::new(width as f32, height as f32);
        cross(&mut pixels, (width, height), (at.x as usize, at.y as usize), color);
    }
    Ok(encode_png_rgb8(width, height, &pixels)?)
}

/// A PNG with a cross at a pixel.
pub fn with_cross(png: &[u8], at: (usize, usize), color: [u8; 3]) -> Result<Vec<u8>> {
    let image = Photograph::decode(png).map_err(|reason| anyhow!("a picture {reason}"))?.image;
    let mut pixels: Vec<[u8; 3]> = image.pixels.iter().map(|pixel| pixel.map(srgb_code)).collect();
    cross(&mut pixels, (image.width, image.height), at, color);
    Ok(encode_png_rgb8(image.width, image.height, &pixels)?)
}

/// Draws a cross of 7 x 7 pixels; columns wrap around.
fn cross(pixels: &mut [[u8; 3]], (width, height): (usize, usize), (x, y): (usize, usize), color: [u8; 3]) {
    for k in -3_i32..=3 {
        for (dx, dy) in [(k, 0), (0, k)] {
            let column = (x as i32 + dx).rem_euclid(width as i32) as usize;
            let row = (y as i32 + dy).clamp(0, height as i32 - 1) as usize;
            pixels[row * width + column] = color;
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use headtail_render::{
        brdf::Lambert, environment::built_in, sampler::EmitterSampler, sampler::EnvironmentLight, tail::TailKind,
    };

    use super::*;

    /// A surface faces the sun. Emitter sampling is proportional to the light alone, `q = l`, so the
    /// divergence is the mean of `(f / Z) ln(f / Z)` over the light with the cosine `f`.
    #[test]
    fn divergences_account_for_the_light_of_a_sun() {
        let map = std::sync::Arc::new(built_in("sunset").unwrap());
        let light = EnvironmentLight::new(map, TailKind::Hierarchical).unwrap();
        let tail = light.tail();
        let n = Vec3A::new(0.0, 1.0, 0.0);
        let surface = Lambert { albedo: Vec3::ONE }.into();
        let point = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
        let brdfs = BrdfTable::default();
        let at = Surface { point: &point, brdfs: &brdfs };
        // The reference integrates over Y with other points, about ten times the number.
        let cosines = Densities::new(500).points;
        let cosines = tail.forward_points(&cosines);
        let cosines: Vec<f64> = cosines.iter().map(|(x, _)| f64::from(latlong::direction(*x).y.max(0.0))).collect();
        let mean = cosines.iter().sum::<f64>() / cosines.len() as f64;
        let parts = cosines.iter().filter(|f| **f > 0.0).map(|f| f / mean * (f / mean).ln());
        let expected = parts.sum::<f64>() / cosines.len() as f64;
        let emitter = EmitterSampler::new(light.clone());
        let carried = Carried::new(160, tail);
        let kl = carried.kl(&carried.at.target(tail, &at), &carried.at.of_sampler(&emitter, &at));
        // The midpoint rule for a bounded function with a kink at the horizon has an error near 1e-3.
        assert!((kl - expected).abs() < 2e-3 * expected.max(1.0), "{kl} {expected}");
    }
}
