//! The paper's figure of all fits: target, intermediate, final and naive densities.

use anyhow::Result;
use glam::{Vec2, Vec3A};
use headtail_render::{
    brdf::{Ggx, Lambert},
    color::luminance,
    environment::Environment,
    head::Head,
    latlong,
    random::{Purpose, Stream},
    tail::{Tail, TailWarp},
    tile::ShadingPoint,
};
use headtail_train::{Material, TrainingLight, Viewpoints, build_target};

use super::{
    Workshop,
    figure::{Panel, legend, strip},
};
use crate::report::{chart::Scale, number::text};

/// Powers of ten of the colours.
const DECADES: f64 = 5.0;

/// The section.
pub fn section(workshop: &Workshop) -> Result<String> {
    let mut html = String::from(
        "<p class=\"note\">For each map and material, two random conditions: the target (light \u{d7} BRDF \u{d7} cosine), the density that the head gives over the \
         intermediate square, the density of the whole model, and a head of the same size that has to learn the product without a tail. A cross \
         marks the normal (red) and the reflected view (yellow). Each row has one logarithmic scale, but for the intermediate density, which has its own.</p>\n",
    );
    for index in 0..workshop.effort.maps.min(workshop.data.map_count()) {
        let environment = workshop.data.map(index)?;
        for material in
            [Material::Lambert, Material::Ggx { low: 0.4, high: 0.4 }, Material::Ggx { low: 0.2, high: 0.8 }]
        {
            workshop.check()?;
            html += &fit(workshop, &environment, material, index as u64)?;
        }
    }
    Ok(html)
}

fn fit(workshop: &Workshop, environment: &Environment, material: Material, seed: u64) -> Result<String> {
    let trained = workshop.heads.of(environment, material)?;
    let light = TrainingLight::new(&workshop.heads.config(material), environment)?;
    let naive_config = workshop.heads.naive(material);
    let target = build_target(&naive_config, &light.tail, Viewpoints::Sphere);
    let (naive, _) = workshop.heads.train(&naive_config, &*target)?;
    let mut html = format!("<h3>{} \u{b7} {material}</h3>\n", crate::report::number::escape(environment.name()));
    let mut random = Stream::new(seed, Purpose::Test, 0);
    for _ in 0..2 {
        let at = condition(material, &mut random);
        html += &row(workshop.effort.density_rows, &light.tail, &trained.head, &naive, &at)?;
    }
    Ok(html)
}

/// A random surface that sees some light: its normal is above the horizon.
fn condition(material: Material, random: &mut Stream) -> ShadingPoint {
    let n = random.direction();
    let n = Vec3A::new(n.x, n.y.abs(), n.z);
    let wo = random.direction();
    let wo = if wo.dot(n) < 0.0 { -wo } else { wo };
    let alpha = |low: f32, high: f32, u: f32| low + u * (high - low);
    let surface = match material {
        Material::Lambert => Lambert { albedo: glam::Vec3::ONE }.into(),
        Material::Ggx { low, high } => Ggx::new(alpha(low, high, random.uniform()), glam::Vec3::ONE).into(),
        Material::Measured(_) => unreachable!("the paper's fits are of analytic materials"),
    };
    ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
}

/// Densities over X or Y on a grid of `rows` times twice as many columns.
pub struct Densities {
    /// Rows of the grid.
    pub rows: usize,
    /// The centres of its cells.
    pub points: Vec<Vec2>,
}

impl Densities {
    /// A grid.
    pub fn new(rows: usize) -> Self {
        let columns = 2 * rows;
        let at = |k: usize| Vec2::new((k % columns) as f32 + 0.5, (k / columns) as f32 + 0.5);
        let points = (0..rows * columns).map(|k| at(k) / Vec2::new(columns as f32, rows as f32)).collect();
        Self { rows, points }
    }

    /// Values with the mean 1: a density over the square.
    pub fn normalized(&self, values: impl Iterator<Item = f32>) -> Vec<f32> {
        let values: Vec<f32> = values.collect();
        let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
        values.into_iter().map(|value| (f64::from(value) / mean.max(f64::MIN_POSITIVE)) as f32).collect()
    }

    /// A head's density over the square that it was trained on.
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

    /// `KL(target || density)` in nats over the grid; what the density leaves out counts by its smallest value.
    pub fn kl(&self, target: &[f32], density: &[f32]) -> f64 {
        let parts = target.iter().zip(density).filter(|(t, _)| **t > 0.0);
        parts.map(|(&t, &q)| f64::from(t) * (f64::from(t) / f64::from(q).max(1e-12)).ln()).sum::<f64>()
            / target.len() as f64
    }
}

fn row(rows: usize, tail: &Tail, head: &Head, naive: &Head, at: &ShadingPoint) -> Result<String> {
    let grid = Densities::new(rows);
    let encoded = head.condition().encode(at.wo.into(), at.ns.into(), at.lobe_width());
    let condition = &encoded[..head.condition().length()];
    let directions: Vec<Vec3A> = grid.points.iter().map(|&x| latlong::direction(x)).collect();
    let reflected = at.one().brdf_cosines(&directions).into_iter().map(luminance);
    let target = grid.normalized(grid.points.iter().zip(reflected).map(|(&x, f)| tail.light().density(x) * f));
    let (middle, last) = (grid.of_head(head, condition)?, grid.through(tail, head, condition)?);
    let alone = grid.of_head(naive, condition)?;
    let scale = Scale::of(&target, DECADES);
    let marks = [(at.ns, [255, 60, 60]), (2.0 * at.ns.dot(at.wo) * at.ns - at.wo, [255, 220, 0])];
    let marks = if head.condition().length() == 3 { &marks[..1] } else { &marks[..] };
    let picture = |scale: Scale, values: &[f32], marks: &[(Vec3A, [u8; 3])]| {
        marked(&scale.png(values, 2 * rows)?, 2 * rows, rows, marks)
    };
    let own = Scale::of(&middle, 3.0);
    let panels = [
        Panel::new(&picture(scale, &target, marks)?, "target", ""),
        Panel::new(&picture(own, &middle, &[])?, "intermediate", format!("over Y, up to {}", text(own.top))),
        Panel::new(&picture(scale, &last, marks)?, "final", format!("KL {}", text(grid.kl(&target, &last)))),
        Panel::new(
            &picture(scale, &alone, marks)?,
            "naive, without a tail",
            format!("KL {}", text(grid.kl(&target, &alone))),
        ),
    ];
    Ok(strip("fits", &panels) + &legend(scale, "density over the square X"))
}

/// A PNG with crosses at directions.
fn marked(png: &[u8], width: usize, height: usize, marks: &[(Vec3A, [u8; 3])]) -> Result<Vec<u8>> {
    if marks.is_empty() {
        return Ok(png.to_vec());
    }
    let decoded =
        headtail_render::image::Photograph::decode(png).map_err(|reason| anyhow::anyhow!("a picture {reason}"))?;
    let mut pixels: Vec<[u8; 3]> =
        decoded.image.pixels.iter().map(|pixel| pixel.map(headtail_render::image::srgb_code)).collect();
    for &(direction, color) in marks {
        let at = latlong::square(direction.normalize()) * Vec2::new(width as f32, height as f32);
        for k in -3_i32..=3 {
            for (dx, dy) in [(k, 0), (0, k)] {
                let x = (at.x as i32 + dx).rem_euclid(width as i32) as usize;
                let y = (at.y as i32 + dy).clamp(0, height as i32 - 1) as usize;
                pixels[y * width + x] = color;
            }
        }
    }
    Ok(headtail_render::image::encode_png_rgb8(width, height, &pixels)?)
}

/// The number of weights of a head.
pub fn weights(head: &Head) -> usize {
    head.layers().iter().map(|(_, layer)| layer.weight().len() + layer.bias().len()).sum()
}
